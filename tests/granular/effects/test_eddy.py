"""Eddy currents that grains make for each other: tensor, flow and lattices."""

import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, load_scene, simulate
from granular.effects.mutual_eddy_drag import (
    FARTHEST,
    LEFT_OUT,
    USUAL,
    Plate,
    drag_tensor,
    drag_tensor_of_squares,
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
NEARLY_ALIKE = {"grains.species": [BIG, BIG | {"name": "other", "density": 7368.000001}]}
"""Alike, as two species: compiled code is that of unlike grains."""


def scene_of(positions: np.ndarray, velocities: np.ndarray, **changes: Any) -> Scene:
    """Grains at positions [D] with velocities [m/s] that feel nothing but eddy currents."""
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


def loose(columns: int, rows: int, seed: int) -> np.ndarray:
    """Positions (n, 2) [D] on a square grid, each moved a little."""
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    grid = 1.4 * np.stack([i, j], -1).reshape(-1, 2) + [100.0, 50.0]
    return np.asarray(grid + np.random.default_rng(seed).uniform(-0.15, 0.15, grid.shape))


def thin(displacement: np.ndarray, h: float = H) -> np.ndarray:
    """Tensor of two dipoles over that of one, in closed form."""
    s = float(displacement @ displacement) + h * h
    outer = np.outer(displacement, displacement)
    return np.asarray((h * h / s) ** 2.5 * (np.eye(2) - 5.0 * outer / s))


def matrix(positions: np.ndarray) -> np.ndarray:
    """Tensor (2n, 2n) of a bed."""
    return np.block([[thin(a - b) for b in positions] for a in positions])


def decayed(
    scene: Scene, dt: float, tensor: np.ndarray | None = None, thickness: float = 1.0, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities [m/s] at the end, as computed and as by the matrix exponential."""
    from scipy.linalg import expm

    run = simulate(scene, dt=dt, progress=False, **options)
    scales = Scales.from_grains(scene.grains)
    rate = scene.effects.eddy.dipole_drag_coefficient(scales) / scales.mass / thickness
    positions = run.dataset["position"][0].values / 0.006
    start = run.dataset["velocity"][0].values
    duration = float(run.dataset["time"][-1])
    moments = np.repeat(scene.grains.moment_ratios()[scene.grains.species_indices()], 2)
    masses = np.repeat(scene.grains.mass_ratios()[scene.grains.species_indices()], 2)
    tensor = matrix(positions) if tensor is None else tensor
    weighted = moments[:, None] * tensor * moments / masses[:, None]
    exact = (expm(-duration * rate * weighted) @ start.ravel()).reshape(-1, 2)
    return run.dataset["velocity"][-1].values, exact


def test_flow_is_of_second_order() -> None:
    velocities = 1e-9 * np.random.default_rng(3).normal(size=(12, 2))
    scene = scene_of(loose(4, 3, 3), velocities, **{"output.frames": 0.02})
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        computed, exact = decayed(scene, dt)
        errors.append(np.abs(computed - exact).max() / np.abs(exact).max())
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(slopes, 2.0, atol=0.15)


def test_what_is_lost_is_never_negative_and_closes_the_ledger() -> None:
    random = np.random.default_rng(4)
    positions = random.uniform(0.0, 6.0, (40, 2))
    form = matrix(positions)
    for _ in range(1000):
        velocity = random.normal(size=80)
        assert velocity @ form @ velocity >= 0.0
    assert np.linalg.eigvalsh(form).min() > -1e-12
    scene = scene_of(loose(8, 5, 4), 0.1 * random.normal(size=(40, 2)))
    for conductivity in ("59.6 MS/m", "60 GS/m"):  # of the second a step is as long as the decay
        good = scene.replace(**{"effects.eddy.conductivity": conductivity})
        run = simulate(good, dt=1e-3, progress=False)
        kinetic, lost = (run.dataset[name].values for name in ("kinetic_energy", "eddy_loss"))
        assert lost[1] > 0.0
        assert (np.diff(lost) >= 0.0).all()
        np.testing.assert_allclose(kinetic + lost, kinetic[0], rtol=1e-13)


@pytest.mark.parametrize(
    ("spacing", "factor"), [(1.375, 0.3035), (1.6, 0.4561), (2.0, 0.6728), (2.6, 0.8527)]
)
def test_lattice_that_moves_as_one_body(spacing: float, factor: float) -> None:
    """Against the sum over the reciprocal lattice, which converges at once."""
    assert lattice_drag_factor(Plate(H / 2.0, 0.0), spacing) == pytest.approx(factor, abs=1e-3)
    area = math.sqrt(0.75) * spacing**2
    numbers = np.array([(i, j) for i in range(-8, 9) for j in range(-8, 9) if (i, j) != (0, 0)])
    basis = 2.0 * math.pi / spacing * np.array([[1.0, -1.0 / math.sqrt(3.0)], [0.0, 2.0 / math.sqrt(3.0)]])
    k = np.hypot(*(numbers @ basis).T)
    exact = float((math.pi * H**4 / 3.0 / area * k**2 * np.exp(-k * H)).sum())
    assert lattice_drag_factor(Plate(H / 2.0, 0.0), spacing) == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("motion", ["as one body", "affinely"])
def test_periodic_lattice_feels_the_sum_over_all_images(motion: str) -> None:
    spacing, columns, rows = 1.375, 6, 6
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    height = math.sqrt(0.75) * spacing
    positions = np.stack([(i + 0.5 * (j % 2) + 0.25) * spacing, (j + 0.5) * height], -1).reshape(-1, 2)
    wave = 2.0 * math.pi / (rows * height)
    velocities = np.zeros_like(positions)
    # The longest wave of compression that fits is as affine as a periodic cell allows.
    velocities[:, 1] = 1e-9 * (1.0 if motion == "as one body" else np.sin(wave * positions[:, 1]))
    cell = {"width": f"{6 * columns * spacing} mm", "height": f"{6 * rows * height} mm", "sides": "periodic"}
    scene = scene_of(positions, velocities, **NEARLY_ALIKE, **{"cell": cell})
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


def test_thick_plate_and_discs() -> None:
    """Drag of a lone magnet over a dipole's, and the series against the integrals themselves."""
    assert Plate(4.0 / 6.0, 2.0 / 6.0).thickness_drag_factor() == pytest.approx(1.2389, abs=1e-4)
    disc = Disc(0.5, 0.5)
    for h, factor in ((3, 0.497), (4, 0.651), (6, 0.817), (9, 0.913)):
        lone, _ = drag_tensor(Plate(h / 6.0, 0.0), np.zeros(1), (disc, disc))
        assert lone[0] == pytest.approx(factor, abs=1e-3)
    thick, near = Plate(4.0 / 6.0, 2.0 / 6.0), Plate(0.5, 2.0 / 3.0)  # the face of ``near`` is 0.17 D away
    for plate, discs in ((thick, ()), (near, ()), (Plate(4.0 / 6.0, 1.0 / 6.0), (disc, disc))):
        r = np.linspace(0.0, 28.0, 57)
        isotropic, radial = drag_tensor(plate, r, discs)
        across, along = drag_tensor_of_squares(plate, r * r, discs)
        np.testing.assert_allclose(across, isotropic, rtol=0, atol=1e-10)
        np.testing.assert_allclose(along * r * r, radial, rtol=0, atol=1e-10)


def test_neighbours_count_where_they_take_more_than_a_tenth() -> None:
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
    with pytest.raises(SceneError, match="reaches the grains' middle"):
        scene.replace(**{"effects.eddy": {**PLATE, "plate": "thick", "thickness": "9 mm"}})


def reach_of(h: float) -> float:
    """Reach [D] at which (8 pi/3) rho H^5/R^3 is what may be neglected."""
    return float((8.0 / 3.0 * math.pi * USUAL * h**5 / LEFT_OUT) ** (1.0 / 3.0))


@pytest.mark.parametrize("h", [0.5 * H, H])
def test_drag_that_keeps_a_cut_sum_positive_is_that_of_a_lattice_beyond_the_reach(h: float) -> None:
    i, j = np.meshgrid(np.arange(-400, 401), np.arange(-400, 401))
    r = 1.0 / math.sqrt(USUAL * math.sqrt(0.75)) * np.hypot(i + 0.5 * j, math.sqrt(0.75) * j).ravel()
    u = h * h / (h * h + r[r > reach_of(h)] ** 2)
    norms = u**2.5 * np.abs(1.0 - 5.0 * (1.0 - u))
    assert 0.9 * LEFT_OUT < norms.sum() < 1.03 * LEFT_OUT


@quick_in_plain_python
def test_large_bed_is_summed_within_a_reach() -> None:
    """Against the matrix exponential; the drag exceeds the full sum's by a little, and stays positive."""
    h, positions = 0.5 * H, loose(12, 12, 2)
    count = len(positions)
    random = np.random.default_rng(2)
    positions = random.permutation(positions)
    scene = scene_of(positions, 1e-9 * random.normal(size=(count, 2)), **{"effects.eddy.distance": "2 mm"})
    law = scene_in_natural_units(scene).constants.acting.laws[1]
    assert law.reach == pytest.approx(reach_of(h), rel=1e-12)
    full = np.block([[thin(a - b, h) for b in positions] for a in positions])
    near = np.hypot(*(positions[:, None] - positions).T) < law.reach
    assert 0.1 < near.mean() < 0.5
    cut = full * np.kron(near, np.ones((2, 2))) + LEFT_OUT * np.eye(2 * count)
    assert np.linalg.eigvalsh(cut - full).min() > 0.0
    assert np.linalg.eigvalsh(cut - full).max() < 2.0 * LEFT_OUT
    computed, exact = decayed(scene, 1e-6, cut, t_end=5e-6)
    np.testing.assert_allclose(computed, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_unlike_grains_in_a_periodic_cell_feel_every_image() -> None:
    """Against the plain sum over images up to a distance, and an even density beyond."""
    random, sides = np.random.default_rng(5), np.array([9.0, 7.0])
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(2)), -1).reshape(-1, 2)
    positions = (grid + random.uniform(0.2, 0.6, (8, 2))) * sides / [4.0, 2.0]
    cell = {"width": "54 mm", "height": "42 mm", "sides": "periodic"}
    scene = scene_of(positions, 1e-9 * random.normal(size=(8, 2)), cell=cell)
    blocks = np.full((8, 2, 8, 2), 0.0)
    for i, j in np.ndindex(8, 8):
        blocks[i, :, j] -= math.pi * H**5 / (FARTHEST**3 * sides.prod()) * np.eye(2)
        for turns in np.ndindex(11, 11):
            apart = positions[i] - positions[j] + (np.array(turns) - 5) * sides
            if np.hypot(*apart) < FARTHEST:
                blocks[i, :, j] += thin(apart)
    computed, exact = decayed(scene, 1e-5, blocks.reshape(16, 16), t_end=1e-3)
    np.testing.assert_allclose(computed, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


@pytest.mark.long  # quick: thick plate and discs, above
@pytest.mark.parametrize("mutual", [False, True])
def test_discs_are_braked_as_the_tensor_says(mutual: bool) -> None:
    """Two unlike discs over a thick plate; each alone, and with the currents of the other."""
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
                a, b = drag_tensor(plate, np.array([0.0 if i == j else r]), (disc, other))
                blocks[i][j] = a[0] * np.eye(2) + b[0] * np.outer(away, away) / r**2
    computed, exact = decayed(scene, 1e-5, np.block(blocks), plate.thickness_drag_factor())
    np.testing.assert_allclose(computed, exact, rtol=0, atol=2e-6 * np.abs(exact).max())
    with pytest.raises(SceneError, match="discs touch the"):
        scene.replace(**{"effects.eddy.distance": "1.9 mm"})
