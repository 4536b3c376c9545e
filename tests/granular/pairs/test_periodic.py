"""Pair sums in periodic cells by nearest images, cut-off and mesh, compared with explicit sums over
images.
"""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import erfc, gammaincc

from granular import Scene, evaluate, simulate
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, SceneError

DIAMETER = 0.006


def crystal(columns: int, rows: int, spacing: float = 1.9, **changes: Any) -> Scene:
    """Return the scene of a nearly triangular lattice in a periodic cell."""
    a = spacing * DIAMETER
    return Scene.from_plain(
        {
            "grains": {"count": columns * rows, "species": [{"diameter": DIAMETER}]},
            "cell": {"width": columns * a, "height": rows * a * math.sqrt(0.75), "sides": "periodic"},
            "effects": {"dipole": True},
            "arrangement": {"jitter": 0.15},
            "protocol": [{"kind": "hold", "name": "rest"}],
        }
    ).replace(**changes)


def natural(scene: Scene) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return positions and sides [D], and the units of force and energy."""
    scales = Scales.from_grains(scene.grains)
    places = scene.initial_positions_and_velocities()[0] / scales.length
    return places, np.array(scene.cell.periods) / scales.length, scales.force, scales.energy


def elsewhere(scene: Scene) -> np.ndarray:
    """Return the scene's positions [m], each replaced by a random image."""
    places = scene.initial_positions_and_velocities()[0]
    turns = np.random.default_rng(1).integers(-2, 3, places.shape)
    return np.asarray(places + turns * scene.cell.periods)


def all_images(
    places: np.ndarray, sides: np.ndarray, grains: range, most: int = 12
) -> tuple[np.ndarray, float]:
    """Return forces on some grains, summed image by image, and the rms sum of their magnitudes."""
    steps = np.arange(-most, most + 1)
    images = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * sides
    forces, loads = [], []
    for i in grains:
        way = places[i] - places
        way = (way - sides * np.round(way / sides))[:, None] + images
        r = np.linalg.norm(way, axis=2)
        taken = (r < most * sides.min()) & (r > 0.0)
        push = np.where(taken, 0.75 * np.where(taken, r, 1.0) ** -5, 0.0)
        forces.append((push[:, :, None] * way).sum(axis=(0, 1)))
        loads.append((push * r).sum())
    return np.array(forces), float(np.sqrt(np.mean(np.square(loads))))


def ewald_energy(places: np.ndarray, sides: np.ndarray, moments: np.ndarray | None = None) -> float:
    """Return the energy [F* D] by Ewald summation over all images, including each grain's own images.

    Magnetic moments are relative to the first grain's.
    """
    sharp, area, count = 12.0 / sides.min(), sides.prod(), len(places)
    q = np.ones(count) if moments is None else moments
    total = 0.0
    for i in range(count):
        way = places[i] - places
        r = np.linalg.norm(way - sides * np.round(way / sides), axis=1)
        met = r > 0.0
        total += q[i] * (q[met] * gammaincc(1.5, (sharp * r[met]) ** 2) / r[met] ** 3).sum()
    most = np.ceil(12.0 * sharp * sides / (2.0 * np.pi)).astype(int)
    # Only half of the waves, since k and -k contribute equally.
    series = sharp * q.sum() ** 2
    phases = [
        np.exp(2j * np.pi / side * np.outer(np.arange(-m, m + 1), slot))
        for side, slot, m in zip(sides, places.T, most, strict=True)
    ]
    for m in range(most[0] + 1):
        k = 2.0 * np.pi * np.hypot(m / sides[0], np.arange(-most[1], most[1] + 1) / sides[1])
        fraction = 2.0 * sharp * np.exp(-((k / (2 * sharp)) ** 2))
        fraction -= np.sqrt(np.pi) * k * erfc(k / (2 * sharp))
        weights = np.abs(phases[1] @ (q * phases[0][most[0] + m])) ** 2 * fraction
        series += weights.sum() if m else weights[most[1] + 1 :].sum()
    total += 2.0 * np.sqrt(np.pi) / area * 2.0 * series
    return 0.125 * (total - (q * q).sum() * 4.0 / (3.0 * np.sqrt(np.pi)) * sharp**3)


def test_energy_by_ewald_summation_agrees_with_a_sum_image_by_image() -> None:
    """Images of the 14 grains beyond a large circle are replaced by an integral.

    Other tests use the Ewald sum as reference.
    """
    scene = crystal(7, 2)
    places, sides, *_ = natural(scene)
    steps = np.arange(-150, 151)
    images = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * sides
    most, total = 150 * sides.min(), 0.0
    for i in range(14):
        for j in range(14):
            r = np.linalg.norm(places[i] - places[j] + images, axis=1)
            total += (r[(r > 0.0) & (r < most)] ** -3.0).sum()
    total += 14**2 * 2.0 * math.pi / (sides.prod() * most)
    assert ewald_energy(places, sides) == pytest.approx(0.125 * total, rel=1e-6)


def held_by_images(scene: Scene, force_error: float, energy_error: float) -> None:
    places, sides, force, energy = natural(scene)
    found = evaluate(scene, elsewhere(scene))
    wanted, load = all_images(places, sides, range(10))
    assert abs(found.force[:10] / force - wanted).max() < force_error * load
    potential = ewald_energy(places, sides)
    assert found.potential_energy / energy == pytest.approx(potential, rel=energy_error)


@pytest.mark.long
@pytest.mark.parametrize(
    ("columns", "rows", "tolerance", "force_error", "energy_error"),
    [(24, 22, 3e-5, 3e-6, 1e-6), (48, 56, 1e-6, 1e-7, 1e-6), (50, 56, 1e-6, 1e-7, 1e-6)],
)
def test_mesh_sum_includes_all_periodic_images_to_its_tolerance(
    columns: int, rows: int, tolerance: float, force_error: float, energy_error: float
) -> None:
    changes = {"pairs.method": "mesh", "pairs.tolerance": tolerance}
    held_by_images(crystal(columns, rows, **changes), force_error, energy_error)


@pytest.mark.long
@pytest.mark.parametrize("method", ["direct", "cut-off", "mesh"])
def test_energy_and_momentum_in_a_periodic_cell_are_conserved_with_any_number_of_threads(method: str) -> None:
    """Grains cross the sides of the cell. The energy error is of second order in the step."""
    scene = crystal(
        32,
        34,
        **{
            "pairs.method": method,
            "arrangement.speed": "0.3 m/s",
            "output": {"scalars": "20 ms", "frames": "0.2 s"},
        },
    )
    drifts, ends = [], []
    for step, threads in ((2e-4, 1), (1e-4, 1), (1e-4, 2)):
        run = simulate(scene, t_end=1.0, dt=step, threads=threads, progress=False)
        energy = run.dataset["kinetic_energy"].values + run.dataset["pair_energy"].values
        drifts.append(np.sqrt(np.mean((energy - energy[0])[1:] ** 2)))
        ends.append(run.dataset["position"].values[-1])
        velocity = run.dataset["velocity"].values
        size = abs(velocity[0]).sum()
        assert (
            abs((velocity[-1] - velocity[0]).sum(axis=0)).max() < (2e-3 if method == "mesh" else 1e-12) * size
        )
    assert np.abs(ends[0] - run.scene.initial_positions_and_velocities()[0]).max() > 3 * 1.9 * DIAMETER
    assert drifts[0] / drifts[1] > 3.0
    np.testing.assert_array_equal(ends[1], ends[2])


def test_a_perfect_lattice_in_a_periodic_cell_stays_at_rest() -> None:
    scene = crystal(12, 12, **{"arrangement.jitter": 0.0, "pairs": {"method": "direct", "cut_off": "9 D"}})
    found = evaluate(scene, scene.initial_positions_and_velocities()[0]).force
    assert abs(found).max() < 1e-12 * Scales.from_grains(scene.grains).force


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cell.height": None}, "cell.height: is missing; a periodic cell needs a height"),
        ({"cell.sides": "closed"}, "only a periodic cell has a height"),
        ({"piston": {"height": "0.2 m"}}, "piston: a cell with periodic sides cannot have a piston"),
        ({"effects.gravity": {}}, "effects.gravity: cannot act in a cell with periodic sides"),
        ({"effects.walls": {"top": None}}, "effects.walls: cannot act in a cell"),
        ({"pairs": {"method": "verlet-list"}}, "pairs.method: de Paula's list does not support"),
        ({"pairs": {"method": "cut-off", "cut_off": "9 D"}}, "0.39 times the shorter side"),
        ({"pairs": {"method": "direct", "cut_off": "12 D"}}, "0.5 times the shorter side"),
        ({"pairs": {"method": "mesh", "tolerance": 1e-5}}, "pairs.tolerance: needs a radius of"),
        ({"pairs": {"method": "direct", "far_every": 8}}, "has no far field; use 'mesh'"),
        ({"arrangement.height": "0.1 m"}, "a periodic cell is filled"),
    ],
)
def test_incompatible_effects_are_refused_in_a_periodic_cell(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        crystal(12, 12).replace(**changes)


def test_variable_steps_are_refused_in_a_periodic_cell() -> None:
    with pytest.raises(InputError, match="cannot run a periodic cell"):
        simulate(crystal(6, 4), method="adaptive-verlet", t_end=0.1, progress=False)


def test_positions_are_wrapped_into_the_periodic_cell() -> None:
    cell = crystal(6, 4).cell
    assert cell.periods is not None
    width, height = cell.periods
    places = np.array([[-1e-20, 0.0], [width, -height], [1.5 * width, 0.25 * height], [np.nan, 1.0]])
    wanted = [[0.0, 0.0], [0.0, 0.0], [0.5 * width, 0.25 * height], [np.nan, 1.0 % height]]
    np.testing.assert_allclose(cell.wrap_positions(places), wanted, atol=1e-15)
    assert (cell.wrap_positions(places[:3]) < cell.periods).all()


def test_scene_text_reports_a_periodic_cell() -> None:
    scene = crystal(12, 12)
    assert Scene.from_plain(scene.to_plain()) == scene
    assert scene.pair_method == "mesh"
    assert crystal(8, 8).pair_method == "direct"
    assert (
        "sides"
        not in Scene.from_plain(
            {
                "grains": {"count": 1, "species": [{"diameter": DIAMETER}]},
                "cell": {"width": 0.1},
                "arrangement": {"height": "0.1 m"},
            }
        ).to_plain()["cell"]
    )
