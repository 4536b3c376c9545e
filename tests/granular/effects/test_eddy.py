"""Eddy-current drag between grains over a conducting plate: drag tensor, time integration and lattices."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene, simulate
from granular.effects.mutual_eddy_drag import (
    FARTHEST,
    NEGLECTED_DRAG,
    USUAL,
    Plate,
    isotropic_and_radial_drag_tensor,
    isotropic_and_radial_drag_tensor_of_squares,
    lattice_drag_factor,
)
from granular.pairs.disc_law import Disc
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.schema.natural_units import Scales
from granular.shared.errors import SceneError
from tests.modes import quick_in_plain_python

PLATE = {"conductivity": "59.6 MS/m", "thickness": "1 mm", "distance": "4 mm", "mutual": True}
H = 8.0 / 6.0
BIG = {"name": "big", "diameter": "6 mm", "share": 0.5}
DENSE = {"name": "dense", "diameter": "4 mm", "share": 0.5, "density": 16000.0}
NEARLY_EQUAL = {"grains.species": [BIG, BIG | {"name": "other", "density": 7368.000001}]}
"""Nearly equal grains as two species, which use the compiled code of different grains."""


def scene_of(positions: np.ndarray, velocities: np.ndarray, **changes: Any) -> Scene:
    """Return a scene of grains at positions [D] with velocities [m/s], subject only to eddy currents."""
    return load_scene("single-particle").replace(
        **{
            "grains.count": len(positions),
            "grains.species": [BIG, DENSE],
            "cell.width": "400 D",
            "piston": "none",
            "arrangement.positions": (0.006 * positions).tolist(),
            "arrangement.velocities": velocities.tolist(),
            "arrangement.height": None,
            "effects": {"eddy": dict(PLATE), "drag": {"coefficient": 0.0}, "dipole": "none"},
            "protocol": [{"kind": "hold", "name": "hold", "duration": 0.02}],
            "output": {"scalars": 1e-3, "frames": 0.01, "record": "none"},
        }
        | changes
    )


def jittered_grid(columns: int, rows: int, seed: int) -> np.ndarray:
    """Return positions (n, 2) [D] on a square grid with random displacements."""
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    grid = 1.4 * np.stack([i, j], -1).reshape(-1, 2) + [100.0, 50.0]
    return np.asarray(grid + np.random.default_rng(seed).uniform(-0.15, 0.15, grid.shape))


def thin_plate_tensor(displacement: np.ndarray, h: float = H) -> np.ndarray:
    """Return the closed-form drag tensor of two dipoles over a thin plate.

    Its unit is the drag of a single dipole.
    """
    s = float(displacement @ displacement) + h * h
    outer = np.outer(displacement, displacement)
    return np.asarray((h * h / s) ** 2.5 * (np.eye(2) - 5.0 * outer / s))


def drag_matrix(positions: np.ndarray) -> np.ndarray:
    """Return the drag matrix (2n, 2n) of a bed of n grains."""
    return np.block([[thin_plate_tensor(a - b) for b in positions] for a in positions])


def final_velocities(
    scene: Scene, dt: float, tensor: np.ndarray | None = None, thickness: float = 1.0, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return final velocities [m/s] from the simulation, and from the matrix exponential."""
    from scipy.linalg import expm

    run = simulate(scene, dt=dt, progress=False, **options)
    scales = Scales.from_grains(scene.grains)
    rate = scene.effects.eddy.dipole_drag_coefficient(scales) / scales.mass / thickness
    positions = run.dataset["position"][0].values / 0.006
    start = run.dataset["velocity"][0].values
    duration = float(run.dataset["time"][-1])
    moments = np.repeat(scene.grains.moment_ratios()[scene.grains.species_indices()], 2)
    masses = np.repeat(scene.grains.mass_ratios()[scene.grains.species_indices()], 2)
    tensor = drag_matrix(positions) if tensor is None else tensor
    weighted = moments[:, None] * tensor * moments / masses[:, None]
    exact = (expm(-duration * rate * weighted) @ start.ravel()).reshape(-1, 2)
    return run.dataset["velocity"][-1].values, exact


def test_error_of_mutual_eddy_drag_is_of_second_order_in_the_time_step() -> None:
    velocities = 1e-9 * np.random.default_rng(3).normal(size=(12, 2))
    scene = scene_of(jittered_grid(4, 3, 3), velocities, **{"output.frames": 0.02})
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        computed, exact = final_velocities(scene, dt)
        errors.append(np.abs(computed - exact).max() / np.abs(exact).max())
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(slopes, 2.0, atol=0.15)


def test_eddy_current_loss_is_never_negative_and_closes_the_energy_balance() -> None:
    random = np.random.default_rng(4)
    positions = random.uniform(0.0, 6.0, (40, 2))
    form = drag_matrix(positions)
    for _ in range(1000):
        velocity = random.normal(size=80)
        assert velocity @ form @ velocity >= 0.0
    assert np.linalg.eigvalsh(form).min() > -1e-12
    scene = scene_of(jittered_grid(8, 5, 4), 0.1 * random.normal(size=(40, 2)))
    for conductivity in ("59.6 MS/m", "60 GS/m"):  # with the second, a step is as long as the decay time
        conducting = scene.replace(**{"effects.eddy.conductivity": conductivity})
        run = simulate(conducting, dt=1e-3, progress=False)
        kinetic, lost = (run.dataset[name].values for name in ("kinetic_energy", "eddy_loss"))
        assert lost[1] > 0.0
        assert (np.diff(lost) >= 0.0).all()
        np.testing.assert_allclose(kinetic + lost, kinetic[0], rtol=1e-13)


@pytest.mark.parametrize(
    ("spacing", "factor"), [(1.375, 0.3035), (1.6, 0.4561), (2.0, 0.6728), (2.6, 0.8527)]
)
def test_eddy_drag_of_a_rigidly_moving_lattice_equals_the_sum_over_the_reciprocal_lattice(
    spacing: float, factor: float
) -> None:
    assert lattice_drag_factor(Plate(H / 2.0, 0.0), spacing) == pytest.approx(factor, abs=1e-3)
    area = math.sqrt(0.75) * spacing**2
    numbers = np.array([(i, j) for i in range(-8, 9) for j in range(-8, 9) if (i, j) != (0, 0)])
    basis = 2.0 * math.pi / spacing * np.array([[1.0, -1.0 / math.sqrt(3.0)], [0.0, 2.0 / math.sqrt(3.0)]])
    k = np.hypot(*(numbers @ basis).T)
    exact = float((math.pi * H**4 / 3.0 / area * k**2 * np.exp(-k * H)).sum())
    assert lattice_drag_factor(Plate(H / 2.0, 0.0), spacing) == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("motion", ["as one body", "affinely"])
def test_eddy_drag_in_a_periodic_cell_is_the_sum_over_all_images(motion: str) -> None:
    spacing, columns, rows = 1.375, 6, 6
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    height = math.sqrt(0.75) * spacing
    positions = np.stack([(i + 0.5 * (j % 2) + 0.25) * spacing, (j + 0.5) * height], -1).reshape(-1, 2)
    wave = 2.0 * math.pi / (rows * height)
    velocities = np.zeros_like(positions)
    # The longest compression wave that fits is the most affine motion of a periodic cell.
    velocities[:, 1] = 1e-9 * (1.0 if motion == "as one body" else np.sin(wave * positions[:, 1]))
    cell = {"width": f"{6 * columns * spacing} mm", "height": f"{6 * rows * height} mm", "sides": "periodic"}
    scene = scene_of(positions, velocities, **NEARLY_EQUAL, **{"cell": cell})
    run = simulate(scene, dt=2e-5, t_end=1e-3, progress=False)
    before, after = (run.dataset["velocity"][k].values for k in (0, -1))
    scales = Scales.from_grains(run.scene.grains)
    rate = run.scene.effects.eddy.dipole_drag_coefficient(scales) / scales.mass
    measured = -math.log((after * before).sum() / (before * before).sum()) / 1e-3 / rate
    own = 0.0 if motion == "as one body" else wave
    m = np.arange(-60, 61)
    basis = 2.0 * math.pi / spacing * np.array([[1.0, -1.0 / math.sqrt(3.0)], [0.0, 2.0 / math.sqrt(3.0)]])
    k = np.array([(a, b) for a in m for b in m]) @ basis + [0.0, own]
    size = np.maximum(np.hypot(k[:, 0], k[:, 1]), 1e-300)
    terms = k[:, 1] ** 2 * np.exp(-size * H)
    exact = 2.0 * math.pi * H**4 / 3.0 / (height * spacing) * float(terms.sum())
    assert measured == pytest.approx(exact, abs=1e-4)


def test_eddy_drag_factors_for_thick_plates_and_discs_and_the_series_fitted_to_them_are_accurate() -> None:
    """The drag factor of a single magnet is relative to a dipole over a thin plate.

    The series fitted to the factors are compared with integrals.
    """
    assert Plate(4.0 / 6.0, 2.0 / 6.0).thickness_drag_factor() == pytest.approx(1.2389, abs=1e-4)
    disc = Disc(0.5, 0.5)
    for h, factor in ((3, 0.497), (4, 0.651), (6, 0.817), (9, 0.913)):
        lone, _ = isotropic_and_radial_drag_tensor(Plate(h / 6.0, 0.0), np.zeros(1), (disc, disc))
        assert lone[0] == pytest.approx(factor, abs=1e-3)
    thick, near = Plate(4.0 / 6.0, 2.0 / 6.0), Plate(0.5, 2.0 / 3.0)  # the face of ``near`` is 0.17 D away
    for plate, discs in ((thick, ()), (near, ()), (Plate(4.0 / 6.0, 1.0 / 6.0), (disc, disc))):
        r = np.linspace(0.0, 28.0, 57)
        isotropic, radial = isotropic_and_radial_drag_tensor(plate, r, discs)
        across, along = isotropic_and_radial_drag_tensor_of_squares(plate, r * r, discs)
        np.testing.assert_allclose(across, isotropic, rtol=0, atol=1e-10)
        np.testing.assert_allclose(along * r * r, radial, rtol=0, atol=1e-10)


def test_mutual_eddy_currents_are_included_by_default_if_they_change_the_drag_by_a_tenth() -> None:
    positions = np.array([[100.0, 50.0], [101.3, 50.4]])
    scene = scene_of(positions, np.zeros((2, 2)), **{"effects.eddy.mutual": None})
    scales = Scales.from_grains(scene.grains)
    assert scene.effects.eddy.includes_mutual_currents(2, scales)
    assert not scene.effects.eddy.includes_mutual_currents(1, scales)
    near = scene.replace(**{"effects.eddy.distance": "1 mm"})
    assert not near.effects.eddy.includes_mutual_currents(2, scales)
    assert "mutual" not in scene.to_plain()["effects"]["eddy"]
    with pytest.raises(SceneError, match="must be true or false"):
        scene.replace(**{"effects.eddy.mutual": 1})
    with pytest.raises(SceneError, match="reaches the grains' mid-plane"):
        scene.replace(**{"effects.eddy": {**PLATE, "plate": "thick", "thickness": "9 mm"}})


def cut_off_distance(h: float) -> float:
    """Return the cut-off R [D].

    The drag (8 pi/3) rho h^5/R^3 by all grains beyond R is small enough to be neglected, for rho grains
    per D^2 and a distance h [D] from a magnet to its image.
    """
    return float((8.0 / 3.0 * math.pi * USUAL * h**5 / NEGLECTED_DRAG) ** (1.0 / 3.0))


@pytest.mark.parametrize("h", [0.5 * H, H])
def test_eddy_drag_added_for_distant_grains_equals_the_lattice_sum_beyond_the_cut_off(h: float) -> None:
    i, j = np.meshgrid(np.arange(-400, 401), np.arange(-400, 401))
    r = 1.0 / math.sqrt(USUAL * math.sqrt(0.75)) * np.hypot(i + 0.5 * j, math.sqrt(0.75) * j).ravel()
    u = h * h / (h * h + r[r > cut_off_distance(h)] ** 2)
    norms = u**2.5 * np.abs(1.0 - 5.0 * (1.0 - u))
    assert 0.9 * NEGLECTED_DRAG < norms.sum() < 1.03 * NEGLECTED_DRAG


@quick_in_plain_python
def test_mutual_eddy_drag_of_a_large_bed_is_summed_within_a_cut_off() -> None:
    """The result agrees with the matrix exponential.

    The drag slightly exceeds the full sum and stays positive.
    """
    h, positions = 0.5 * H, jittered_grid(12, 12, 2)
    count = len(positions)
    random = np.random.default_rng(2)
    positions = random.permutation(positions)
    scene = scene_of(positions, 1e-9 * random.normal(size=(count, 2)), **{"effects.eddy.distance": "2 mm"})
    law = scene_in_natural_units(scene).constants.acting.laws[1]
    assert law.reach == pytest.approx(cut_off_distance(h), rel=1e-12)
    full = np.block([[thin_plate_tensor(a - b, h) for b in positions] for a in positions])
    near = np.hypot(*(positions[:, None] - positions).T) < law.reach
    assert 0.1 < near.mean() < 0.5
    cut = full * np.kron(near, np.ones((2, 2))) + NEGLECTED_DRAG * np.eye(2 * count)
    assert np.linalg.eigvalsh(cut - full).min() > 0.0
    assert np.linalg.eigvalsh(cut - full).max() < 2.0 * NEGLECTED_DRAG
    computed, exact = final_velocities(scene, 1e-6, cut, t_end=5e-6)
    np.testing.assert_allclose(computed, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_mutual_eddy_drag_of_unequal_grains_in_a_periodic_cell_includes_all_images() -> None:
    """The reference is the direct sum over images up to a large distance, and a uniform density beyond it."""
    random, sides = np.random.default_rng(5), np.array([9.0, 7.0])
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(2)), -1).reshape(-1, 2)
    positions = (grid + random.uniform(0.2, 0.6, (8, 2))) * sides / [4.0, 2.0]
    cell = {"width": "54 mm", "height": "42 mm", "sides": "periodic"}
    scene = scene_of(positions, 1e-9 * random.normal(size=(8, 2)), cell=cell)
    blocks = np.full((8, 2, 8, 2), 0.0)
    for i, j in np.ndindex(8, 8):
        blocks[i, :, j] -= math.pi * H**5 / (FARTHEST**3 * sides.prod()) * np.eye(2)
        for image in np.ndindex(11, 11):
            displacement = positions[i] - positions[j] + (np.array(image) - 5) * sides
            if np.hypot(*displacement) < FARTHEST:
                blocks[i, :, j] += thin_plate_tensor(displacement)
    computed, exact = final_velocities(scene, 1e-5, blocks.reshape(16, 16), t_end=1e-3)
    np.testing.assert_allclose(computed, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


@pytest.mark.long  # quick: thick plate and discs, above
@pytest.mark.parametrize("mutual", [False, True])
def test_eddy_drag_of_two_discs_equals_their_drag_tensor(mutual: bool) -> None:
    """Two different discs move over a thick plate, with and without mutual eddy currents."""
    positions = np.array([[100.0, 50.0], [101.3, 50.4]])
    start = 1e-9 * np.array([[1.0, 0.3], [-0.4, 1.0]])
    scene = scene_of(
        positions,
        start,
        **{
            "grains.species": [
                {"name": "big", "diameter": "6 mm", "share": 0.5},
                {"name": "small", "diameter": "4 mm", "share": 0.5, "thickness": "2 mm"},
            ],
            "grains.magnets": "cylinders",
            "effects.eddy.plate": "thick",
            "effects.eddy.mutual": mutual,
        },
    )
    plate = Plate(4.0 / 6.0, 1.0 / 6.0)
    discs = (Disc(0.5, 0.5), Disc(1.0 / 3.0, 1.0 / 3.0))
    away = positions[1] - positions[0]
    r = float(np.hypot(*away))
    blocks = [[np.zeros((2, 2)) for _ in discs] for _ in discs]
    for i, disc in enumerate(discs):
        for j, other in enumerate(discs):
            if i == j or mutual:
                a, b = isotropic_and_radial_drag_tensor(
                    plate, np.array([0.0 if i == j else r]), (disc, other)
                )
                blocks[i][j] = a[0] * np.eye(2) + b[0] * np.outer(away, away) / r**2
    computed, exact = final_velocities(scene, 1e-5, np.block(blocks), plate.thickness_drag_factor())
    np.testing.assert_allclose(computed, exact, rtol=0, atol=2e-6 * np.abs(exact).max())
    with pytest.raises(SceneError, match="discs touch the"):
        scene.replace(**{"effects.eddy.distance": "1.9 mm"})
