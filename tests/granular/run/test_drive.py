"""Records of driven runs carry what drives them, as the equations of motion have it."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from granular import Scene, quantity, simulate, stage
from tests.modes import quick_in_plain_python

MASS, GRAVITY = 2.0, 9.8
BASE = ("base_height", "base_velocity", "base_acceleration")


def empty(*stages: dict[str, Any], **changes: Any) -> Scene:
    """A heavy piston over a cell without grains."""
    return Scene.from_plain(
        {
            "grains": {"count": 0, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": "60 mm"},
            "piston": {"height": "120 mm", "mass": MASS},
            "effects": {"gravity": {}},
            "protocol": list(stages),
            "output": {"scalars": 1e-4, "frames": 0.01},
        }
    ).replace(**changes)


def acceleration(time: np.ndarray, height: np.ndarray) -> np.ndarray:
    """At the inner samples, by second differences; the samples are evenly spaced."""
    return np.diff(height, 2) / np.diff(time)[0] ** 2


def test_a_shaken_cell_lends_its_motion() -> None:
    """Seen from the base, the piston falls and the base's motion is taken away: z'' = -g - b''."""
    angle = 0.6
    scene = empty(
        {"kind": "free", "name": "fall", "duration": 0.05},
        **{
            "effects.shaking": {"amplitude": 0.002, "frequency": 25.0, "angle": angle},
            "effects.drag": {"coefficient": 0.0},  # of no size: as what is compiled for falling grains
        },
    )
    record = simulate(scene, progress=False).piston()
    assert tuple(record.extra) == BASE
    found = acceleration(record.time, record.height)
    assert found == pytest.approx(-GRAVITY - record.extra["base_acceleration"][1:-1], abs=2e-3)
    assert record.extra["base_height"].max() == pytest.approx(0.002 * math.sin(angle), rel=1e-3)
    for name, rate in itertools.pairwise(BASE):
        slope = np.gradient(record.extra[name], record.time)[2:-2]
        assert slope == pytest.approx(record.extra[rate][2:-2], abs=2e-4 * np.ptp(slope))


def test_a_push_lends_its_force() -> None:
    """M z'' = -M g + F, with a phase that counts from the stage's start; 0 in other stages."""
    scene = empty(
        {"kind": "hold", "name": "wait", "duration": 0.0123},
        {"kind": "push", "name": "push", "mean": 3.0, "amplitude": 5.0, "frequency": 40.0, "duration": 0.04},
        {"kind": "free", "name": "fall", "duration": 0.01},
    )
    run = simulate(scene, progress=False)
    record = run.piston("push")
    assert record.extra["outer_force"][0] == pytest.approx(3.0)
    found = acceleration(record.time[:300], record.height[:300])
    force = record.extra["outer_force"][1:299]
    assert found == pytest.approx(-GRAVITY + force / MASS, abs=1e-3)
    integer = run.piston().extra["outer_force"]
    indices = run.dataset["stage"].values
    assert np.count_nonzero(integer) == pytest.approx(np.count_nonzero(indices == 1), abs=2)
    assert "outer_force" not in run.piston("fall").extra


@stage
class Tug:
    """A pull that dies out."""

    size: float = quantity("N")

    @staticmethod
    def force(p: Any, time: float) -> float:
        return float(p.size * math.exp(-100.0 * time))


def test_a_force_formula_and_an_own_stage_lend_their_force() -> None:
    """M z'' = -M g + F in either stage, and 0 before them."""
    scene = empty(
        {"kind": "hold", "name": "wait", "duration": 0.01},
        {
            "kind": "force",
            "name": "formula",
            "force": "f*exp(-t/s)",
            "f": "30 N",
            "s": "5 ms",
            "duration": 0.02,
        },
        {"kind": "tug", "name": "own", "size": "40 N", "duration": 0.02},
    )
    run = simulate(scene, progress=False)
    for name, size, rate in (("formula", 30.0, 200.0), ("own", 40.0, 100.0)):
        record = run.piston(name)
        force = record.extra["outer_force"]
        wanted = size * np.exp(-rate * (record.time - run.stage(name).start))
        np.testing.assert_allclose(force, wanted, rtol=1e-9)
        found = acceleration(record.time, record.height)
        assert found == pytest.approx(-GRAVITY + force[1:-1] / MASS, abs=2e-2)
    force = run.piston().extra["outer_force"]
    assert not force[run.piston().time < 0.01 - 1e-9].any()
    assert np.count_nonzero(force) > 390


@quick_in_plain_python
def test_a_shaken_base_lends_its_acceleration() -> None:
    """Seen from the base that carries the cell: z'' = -g - b''."""
    drive = {"displacement": "2 mm", "frequency": "25 Hz"}
    scene = empty(
        {"kind": "free", "name": "fall", "duration": 0.05},
        **{"effects.host": {"mount": "base", "bodies": [], "excitation": drive}},
    )
    record = simulate(scene, dt="auto/4", progress=False).piston()
    assert tuple(record.extra) == ("base_acceleration",)
    found = acceleration(record.time, record.height)
    assert found == pytest.approx(-GRAVITY - record.extra["base_acceleration"][1:-1], abs=2e-3)


def test_a_piston_that_is_not_driven_has_no_further_columns() -> None:
    run = simulate(empty({"kind": "free", "name": "fall", "duration": 0.01}), progress=False)
    assert run.piston().extra == {}
