"""Langevin bath: random numbers, temperature and order of accuracy."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from granular import Scene, evaluate, simulate
from granular.effects.langevin_bath import draw_normal_pair, philox_random_words
from granular.observables import configurational_temperature
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, SceneError

TEMPERATURE = 2e-6


def crystal(small_bed: Scene, **changes: object) -> Scene:
    return small_bed.replace(
        **{
            "effects": {
                "dipole": True,
                "walls": True,
                "bath": {"temperature": TEMPERATURE, "rate": "100 1/s"},
            },
            "protocol": [{"kind": "hold", "name": "rest", "duration": 100.0}],
            "output": {"scalars": "20 ms", "frames": "20 ms"},
            **changes,
        }
    )


def test_philox_generator_reproduces_published_values_of_random123() -> None:
    """The values are for counter and key with all bits zero, and with all bits one."""
    zero, ones = np.uint64(0), np.uint64(2**64 - 1)
    assert [int(word) for word in philox_random_words(zero, zero, zero)] == [
        0x6627E8D5,
        0xE169C58D,
        0xBC57AC4C,
        0x9B00DBD8,
    ]
    assert [int(word) for word in philox_random_words(ones, ones, ones)] == [
        0x408F276D,
        0x41C83B0E,
        0xA20BC7C6,
        0x6D5451FD,
    ]


def test_random_numbers_of_the_bath_have_the_moments_of_a_normal_distribution() -> None:
    steps, grains = np.divmod(np.arange(40_000, dtype=np.uint64), np.uint64(200))
    drawn = np.array([draw_normal_pair(np.uint64(7), s, g) for s, g in zip(steps, grains, strict=True)])
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose(drawn.var(axis=0), 1.0, atol=0.03)
    np.testing.assert_allclose((drawn**4).mean(axis=0), 3.0, atol=0.2)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.02


def test_langevin_bath_requires_stormer_verlet_and_excludes_dry_friction(small_bed: Scene) -> None:
    with pytest.raises(InputError, match="while a step moves the grains; use 'stormer-verlet'"):
        simulate(crystal(small_bed), method="kahan-li-8", t_end=0.1, progress=False)
    with pytest.raises(SceneError, match="'friction' would hold at rest"):
        crystal(small_bed).replace(**{"effects.friction": {}})


@pytest.mark.long
def test_crystal_in_a_langevin_bath_has_the_bath_temperature_and_harmonic_displacements(
    small_bed: Scene,
) -> None:
    """Kinetic and configurational temperature agree with the bath's temperature T to 0.5 %.

    The mean square displacement agrees to 2 % with T tr H^-1, for the Hessian H.
    """
    settled = crystal(small_bed, **{"effects.bath.temperature": 0.0})
    rest = simulate(settled, t_end=20.0, progress=False).dataset["position"].values[-1]
    # So cold that the crystal is harmonic and its grains stay on their sites.
    cold = TEMPERATURE / 200.0
    scene = crystal(
        small_bed,
        **{
            "effects.bath.temperature": cold,
            "arrangement.positions": rest.tolist(),
            "arrangement.height": None,
        },
    )
    run = simulate(scene, t_end=300.0, progress=False)
    equilibrated = run.dataset.isel(frame=slice(50, None))
    masses = run.scene.grains.masses()
    kinetic = (masses[None, :, None] * equilibrated["velocity"].values ** 2).mean()
    assert kinetic == pytest.approx(cold, rel=5e-3)
    positions = equilibrated["position"].values
    assert configurational_temperature(scene, positions) == pytest.approx(cold, rel=5e-3)
    count, step = len(rest), 1e-6
    hessian = np.zeros((2 * count, 2 * count))
    for k, shift in enumerate(step * np.eye(2 * count)):
        up, down = (evaluate(scene, rest + sign * shift.reshape(count, 2)).force for sign in (1.0, -1.0))
        hessian[k] = -(up - down).ravel() / (2.0 * step)
    expected = cold * np.trace(np.linalg.inv(hessian))
    mean_square = ((positions - positions.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean()
    assert mean_square == pytest.approx(expected, rel=0.02)


WELL_SPACING = 0.02
"""Distance of neighbouring potential wells [m]."""
DEPTH = 1e-4
"""a of the energy a (2 - cos kx - cos ky) [J]."""
WARM = 2.0
"""Temperature of the bath over a: strongly anharmonic."""
RATE = 0.2
"""Relaxation rate of the bath over the frequency of small oscillations."""


def grains_in_wells(columns: int, seed: int) -> tuple[Scene, float]:
    """Return a scene with one grain in each well, and the angular frequency of small oscillations [1/s]."""
    extent = (columns + 1) * WELL_SPACING
    scene = Scene.from_plain(
        {
            "grains": {"count": columns**2, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": extent},
            "effects": {
                "field": [
                    {
                        "energy": "a*(2 - cos(k*x) - cos(k*y))",
                        "a": f"{DEPTH} J",
                        "k": f"{2.0 * math.pi / WELL_SPACING!r} 1/m",
                    }
                ]
            },
            "arrangement": {"height": extent, "jitter": 0.0},
            "protocol": [{"kind": "hold", "name": "rest"}],
        }
    )
    frequency = 2.0 * math.pi / WELL_SPACING * math.sqrt(DEPTH / Scales.from_grains(scene.grains).mass)
    bath = {"temperature": WARM * DEPTH, "rate": RATE * frequency, "seed": seed}
    return scene.replace(**{"effects.bath": bath}), frequency


def gradients_and_laplacians(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums over grains of grad(U)^2/(a k)^2 and of the Laplacian of U over a k^2.

    U is the energy a (2 - cos kx - cos ky) of a grain; `angles` (f, n) are k times the coordinates in f
    frames.
    """
    return (np.sin(angles) ** 2).sum(axis=1), np.cos(angles).sum(axis=1)


def temperature_error(squares: np.ndarray, bends: np.ndarray) -> tuple[float, float]:
    """Return the relative error of the configurational temperature, and its standard error from blocks."""
    blocks = [
        square.sum() / bend.sum()
        for square, bend in zip(np.array_split(squares, 20), np.array_split(bends, 20), strict=True)
    ]
    error = float(np.std(blocks) / math.sqrt(19.0))
    return squares.sum() / bends.sum() / WARM - 1.0, error / WARM


def error_of_engine(step: float) -> tuple[float, float]:
    """Return the toolkit's temperature error and its standard error.

    The time step is in units of the inverse angular frequency of small oscillations.
    """
    squares, bends = [], []
    for seed in range(1, 11):
        scene, frequency = grains_in_wells(160, seed)
        dt = step / frequency
        interval = max(1, round(1.5 / step)) * dt
        scene = scene.replace(**{"output": {"scalars": interval, "frames": interval}})
        run = simulate(scene, t_end=(20 + 800) * interval, dt=dt, progress=False, threads=1)
        positions = run.dataset["position"].values[21:].reshape(800, -1)
        square, bend = gradients_and_laplacians(2.0 * math.pi / WELL_SPACING * positions)
        squares.append(square)
        bends.append(bend)
    return temperature_error(np.concatenate(squares), np.concatenate(bends))


Splitting = Callable[[np.ndarray, np.ndarray, float, np.random.Generator], None]


def _bath(v: np.ndarray, total_duration: float, random: np.random.Generator) -> None:
    decay = math.exp(-RATE * total_duration)
    v *= decay
    v += math.sqrt(WARM * (1.0 - decay**2)) * random.normal(size=v.size)


def kick_drift_bath(x: np.ndarray, v: np.ndarray, step: float, random: np.random.Generator) -> None:
    """Advance by a full kick, a drift and the bath (first order)."""
    v -= step * np.sin(x)
    x += step * v
    _bath(v, step, random)


def bath_verlet_bath(x: np.ndarray, v: np.ndarray, step: float, random: np.random.Generator) -> None:
    """Advance by half of the bath, a Verlet step, and the other half of the bath (second order)."""
    _bath(v, 0.5 * step, random)
    v -= 0.5 * step * np.sin(x)
    x += step * v
    v -= 0.5 * step * np.sin(x)
    _bath(v, 0.5 * step, random)


def error_of_splitting(splitting: Splitting, step: float) -> tuple[float, float]:
    """Return the temperature error of another splitting in the same potential, in natural units."""
    random = np.random.default_rng(5)
    x, v = np.zeros(100_000), math.sqrt(WARM) * random.normal(size=100_000)
    every, frames = max(1, round(1.5 / step)), []
    for tick in range(170 * every):
        splitting(x, v, step, random)
        if tick >= 20 * every and tick % every == 0:
            frames.append(x.copy())
    return temperature_error(*gradients_and_laplacians(np.array(frames)))


def order_of_accuracy(steps: tuple[float, ...], results: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the slope of ln(abs(error)) against ln(step), and its standard error."""
    errors, sigmas = np.abs(results).T
    x, weights = np.log(steps), (errors / sigmas) ** 2
    middle = np.average(x, weights=weights)
    spread = (weights * (x - middle) ** 2).sum()
    value = (weights * (x - middle) * np.log(errors)).sum() / spread
    return float(value), float(1.0 / math.sqrt(spread))


@pytest.mark.long  # quick: the generator's numbers, and a resumed run
def test_error_of_configurational_temperature_is_of_second_order_in_the_time_step() -> None:
    """The error is due to the anharmonic potential of the wells.

    Two other splittings of the time step are compared.
    """
    steps = (0.14, 0.23, 0.38)
    engine = [error_of_engine(step) for step in steps]
    value, sigma = order_of_accuracy(steps, engine)
    print("engine", engine, value, sigma)
    assert sigma < 0.07
    assert value == pytest.approx(2.0, abs=0.2)
    assert all(error > 0.0 for error, _ in engine)
    second = [error_of_splitting(bath_verlet_bath, step) for step in steps]
    first = [error_of_splitting(kick_drift_bath, step) for step in (0.075, 0.15)]
    print("bath outside", second, order_of_accuracy(steps, second))
    print("kick first", first, order_of_accuracy((0.075, 0.15), first))
    assert order_of_accuracy(steps, second)[0] == pytest.approx(2.0, abs=0.2)
    assert second[-1][0] > 1.5 * engine[-1][0]
    # The test distinguishes a splitting of first order from one of second order.
    assert order_of_accuracy((0.075, 0.15), first)[0] < 1.5
