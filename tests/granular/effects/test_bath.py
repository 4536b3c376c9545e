"""The bath: its random numbers, its temperature, its order, and bits that nothing changes."""

from pathlib import Path

import numpy as np
import pytest

from granular import Scene, evaluate, simulate
from granular.effects.langevin_bath import draw_normal_pair, philox_random_words
from granular.observables import configurational_temperature
from granular.shared.errors import InputError, SceneError

ROOT = Path(__file__).parents[3]
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


def test_known_answers_of_the_generator() -> None:
    """Of Random123's file of known answers, for a counter and a key of zeros and of ones."""
    zero, ones = np.uint64(0), np.uint64(2**64 - 1)
    assert [int(one) for one in philox_random_words(zero, zero, zero)] == [
        0x6627E8D5,
        0xE169C58D,
        0xBC57AC4C,
        0x9B00DBD8,
    ]
    assert [int(one) for one in philox_random_words(ones, ones, ones)] == [
        0x408F276D,
        0x41C83B0E,
        0xA20BC7C6,
        0x6D5451FD,
    ]


def test_normal_numbers() -> None:
    steps, grains = np.divmod(np.arange(40_000, dtype=np.uint64), np.uint64(200))
    drawn = np.array([draw_normal_pair(np.uint64(7), s, g) for s, g in zip(steps, grains, strict=True)])
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.02)
    np.testing.assert_allclose(drawn.var(axis=0), 1.0, atol=0.03)
    np.testing.assert_allclose((drawn**4).mean(axis=0), 3.0, atol=0.2)
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.02


def test_kicks_need_the_plain_steps_and_grains_that_slide(small_bed: Scene) -> None:
    with pytest.raises(InputError, match="acts within the drift; take 'stormer-verlet'"):
        simulate(crystal(small_bed), method="kahan-li-8", t_end=0.1, progress=False)
    with pytest.raises(SceneError, match="'friction' holds at rest"):
        crystal(small_bed).replace(**{"effects.friction": {}})


@pytest.mark.long
def test_temperatures_and_displacements_of_a_crystal(small_bed: Scene) -> None:
    """Both temperatures to 0.5 %, displacements to 2 % of T tr H^-1, at the automatic step."""
    settled = crystal(small_bed, **{"effects.bath.temperature": 0.0})
    rest = simulate(settled, t_end=20.0, progress=False).dataset["position"].values[-1]
    # So cold that the crystal is harmonic, and its grains stay where they are.
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
    kept = run.dataset.isel(frame=slice(50, None))
    masses = run.scene.grains.masses()
    kinetic = (masses[None, :, None] * kept["velocity"].values ** 2).mean()
    assert kinetic == pytest.approx(cold, rel=5e-3)
    places = kept["position"].values
    found = configurational_temperature(scene, places)
    assert found == pytest.approx(cold, rel=5e-3)
    count, step = len(rest), 1e-6
    matrix = np.zeros((2 * count, 2 * count))
    for k, way in enumerate(step * np.eye(2 * count)):
        up, down = (evaluate(scene, rest + sign * way.reshape(count, 2)).force for sign in (1.0, -1.0))
        matrix[k] = -(up - down).ravel() / (2.0 * step)
    wanted = cold * np.trace(np.linalg.inv(matrix))
    moved = ((places - places.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean()
    assert moved == pytest.approx(wanted, rel=0.02)
