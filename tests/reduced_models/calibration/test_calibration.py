"""Calibration of scenes by synthetic features of a motion, and the features of a record."""

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from granular import PistonRecord, Scene, load_scene
from granular.shared.errors import InputError, RecordError
from reduced_models import load_model
from reduced_models.calibration.calibrate import MAXIMUM_STEP, run_calibration
from reduced_models.calibration.result import Calibration
from reduced_models.calibration.simulations import (
    FeaturesOfRecord,
    SceneSimulator,
    SimulatedPoint,
    measure_record_features,
    positive_scene_parameter,
)

MASS, DRAG, REMANENCE = "piston.mass", "effects.drag.coefficient", "grains.remanence"
NAMES = ("height", "period", "damping_ratio", "force")
RECORD = PistonRecord(np.linspace(0.0, 3.0, 50), 0.06 + 1e-3 * np.sin(np.linspace(0, 60.0, 50)))
NOISE, SCATTER = np.array([1e-3, 2e-3, 5e-3, 1e-3]), np.array([2e-3, 3e-3, 1e-2, 1e-9])


@functools.cache
def damper_scene() -> Scene:
    """Return the packaged damper with so few grains that its many variants are checked quickly."""
    small = {"grains.count": 23, "cell.width": "15 D", "piston.height": "6 D", "arrangement.height": "5.5 D"}
    return load_scene("damper").replace(**small)


def synthetic_features(mass: float, drag: float, remanence: float, bed: np.ndarray) -> np.ndarray:
    """Return the logarithms (4,) of the features of a synthetic damper, with the scatter of its packing."""
    load = math.log((mass + 0.1) / remanence**2)
    period = -0.2 * load + 0.03 * load**2
    damping = math.log(drag / (mass + 0.1)) + 0.1 * math.sin(load)
    return np.array([-0.35 * load, period, damping - 4.0, math.log(9.8 * mass)]) + SCATTER * bed


@dataclasses.dataclass(frozen=True)
class SyntheticSimulator(SceneSimulator):
    """Simulator that computes features by a formula; its beds have shifted seeds."""

    shift: int = 0
    fails: Callable[[float], bool] = lambda mass: False
    asked: list[np.ndarray] = dataclasses.field(default_factory=list)

    def simulate_points(self, places: Sequence[np.ndarray]) -> list[SimulatedPoint]:
        self.asked.extend(places)
        return [self.point(place) for place in places]

    def point(self, place: np.ndarray) -> SimulatedPoint:
        if self.fails(math.exp(place[0])):
            return SimulatedPoint(place, (), np.empty((0, 0)), "the simulation with it failed: boom")
        plain = self.scene.replace(**self.scene_changes(place))
        values = plain.piston.mass, plain.effects.drag.coefficient, plain.grains.remanence
        beds = (np.random.default_rng(seed + self.shift).normal(size=4) for seed in self.seeds)
        rows = np.array([synthetic_features(*values, bed) for bed in beds])
        records = (RECORD.with_time_from_zero(),) * len(rows)
        return SimulatedPoint(place, records, rows[:, : 4 if self.force else 3])


class Lab(NamedTuple):
    """Features of the record of a bed. Its random start differs from the starts of the simulations."""

    wanted: FeaturesOfRecord
    shift: int

    @classmethod
    def of(cls, seed: int, *, force: bool = False, **values: float) -> "Lab":
        random = np.random.default_rng(seed)
        truth = {"mass": 7.5, "drag": 0.1, "remanence": 1.3} | values
        logs = synthetic_features(**truth, bed=random.normal(size=4)) + NOISE * random.normal(size=4)
        used = slice(4 if force else 3)
        wanted = FeaturesOfRecord(NAMES[used], np.exp(logs[used]), NOISE[used], ())
        return cls(wanted, int(random.integers(1, 10**6)))

    def simulator(self, *keys: str, scene: Scene | None = None, **options: Any) -> SyntheticSimulator:
        """Return a simulator for the calibration of these features."""
        scene = scene or damper_scene()
        return SyntheticSimulator(
            scene=scene,
            parameters=tuple(positive_scene_parameter(scene, key) for key in keys or (MASS, DRAG)),
            seeds=(1, 2, 3, 4),
            law="linear",
            duration=3.0,
            force=len(self.wanted.names) == 4,
            settings={},
            shift=self.shift,
            **options,
        )

    def calibrated(self, *keys: str, **options: Any) -> Calibration:
        simulator = self.simulator(*keys, **options)
        return run_calibration(simulator, RECORD, self.wanted, 0.95, checks=False)


def test_calibrated_intervals_contain_the_true_values_with_their_nominal_probability() -> None:
    """The 95 % intervals are tested for records of beds with other random packings."""
    covered, halves, truth = [], [], {MASS: 6.0, DRAG: 0.15}
    for seed in range(100):
        found = Lab.of(seed, mass=6.0, drag=0.15).calibrated()
        assert found.undetermined == ()
        covered.append([found.intervals[key][0] <= truth[key] <= found.intervals[key][1] for key in truth])
        halves.append(0.5 * math.log(found.intervals[MASS][1] / found.intervals[MASS][0]))
    assert (np.mean(covered, axis=0) >= 0.92).all()
    assert (np.mean(covered, axis=0) <= 0.99).all()
    # Neither is an interval idly wide: one standard deviation of the mass is about 0.7 %.
    assert np.median(halves) < 0.03


def test_calibration_converges_from_distant_start_values() -> None:
    """Starts with a third of the drag and twice the mass need several steps of maximum size."""
    lab = Lab.of(3, mass=3.75, drag=0.3)
    simulator = lab.simulator()
    found = run_calibration(simulator, RECORD, lab.wanted, 0.95, checks=False)
    assert found.values == pytest.approx({MASS: 3.75, DRAG: 0.3}, rel=0.05)
    assert found.notes == ()
    assert len(simulator.asked) <= 3 + math.ceil(math.log(3.0) / MAXIMUM_STEP) + 3
    assert found.scene.piston.mass == found.values[MASS]


def test_calibration_reports_parameters_that_the_record_cannot_separate() -> None:
    """A free oscillation determines only mass over remanence squared; the force determines the mass."""
    found = Lab.of(1, mass=6.0).calibrated(MASS, DRAG, REMANENCE)
    assert len(found.undetermined) == 1
    powers = found.undetermined[0].powers
    assert powers[REMANENCE] / powers[MASS] == pytest.approx(0.5, abs=0.02)
    assert powers[DRAG] / powers[MASS] == pytest.approx(1.0, abs=0.1)
    low, high = found.intervals[MASS]
    assert low < 6.0 < high
    assert high / low > 5.0
    # The well-determined combination is found, even if mass and remanence separately are not.
    told = (found.values[MASS] + 0.1) / found.values[REMANENCE] ** 2
    assert told == pytest.approx(6.1 / 1.3**2, rel=0.03)
    assert "open: hardly identifiable from this record: " in str(found)
    (note,) = found.notes
    changes = dict(re.findall(r"([a-z.]+) by \+(\d+) %", note))
    assert float(changes[REMANENCE]) / float(changes[MASS]) == pytest.approx(0.5, abs=0.02)
    assert "weigh the piston and set its mass" in note
    assert Lab.of(1, mass=6.0).calibrated(DRAG, REMANENCE).notes == ()

    found = Lab.of(1, mass=6.0, force=True).calibrated(MASS, DRAG, REMANENCE)
    assert found.undetermined == ()
    for key, value in ((MASS, 6.0), (DRAG, 0.1), (REMANENCE, 1.3)):
        low, high = found.intervals[key]
        assert low < value < high
        assert high / low < 1.3


def test_calibration_notes_that_the_scene_cannot_reproduce_the_record() -> None:
    lab = Lab.of(1)
    wrong = lab.wanted._replace(values=lab.wanted.values * np.array([1.0, 1.3, 1.0]))
    notes = lab._replace(wanted=wrong).calibrated().notes
    assert notes
    for note in notes:
        assert note.startswith("the calibrated values do not reproduce the record's")
        assert "standard deviations, so the scene differs" in note


def test_calibration_notes_a_height_error_above_its_uncertainty() -> None:
    """The uncertainty is three standard deviations of noise and of random packings."""
    lab = Lab.of(1)
    values = lab.wanted.values * np.array([1.0 + 8e-3, 1.0, 1.0])
    assert lab.calibrated(DRAG).notes == ()
    (note,) = lab._replace(wanted=lab.wanted._replace(values=values)).calibrated(DRAG).notes
    assert note.startswith("the calibrated values do not reproduce the record's height")


def test_calibration_notes_a_height_error_above_one_percent() -> None:
    """The note appears even if noise and random packings may explain the error."""
    lab = Lab.of(1)
    off = np.array([1.025, 1.0, 1.0])
    wanted = lab.wanted._replace(values=lab.wanted.values * off, errors=lab.wanted.errors * [30.0, 1.0, 1.0])
    found = lab._replace(wanted=wanted).calibrated(DRAG)
    (note,) = found.notes
    assert note.startswith("the simulated equilibrium height differs by -2.")
    assert f"note: {note}" in str(found)


def test_search_for_a_calibrated_scene_ends_only_if_its_features_match_the_record() -> None:
    """If the features determine the mass poorly, its small error can still change the height strongly."""
    for seed in range(6):
        found = Lab.of(seed, mass=7.1).calibrated(MASS, DRAG, REMANENCE)
        for match in found.matches[:2]:
            error = math.hypot(match.noise, math.sqrt(1.25) * match.scatter)
            assert abs(math.log(match.simulated / match.record)) < 3.0 * error


def test_a_failed_simulation_shortens_the_step_of_a_calibration() -> None:
    """A failure at the start values ends the calibration with a one-line error."""
    lab = Lab.of(3, mass=3.75)

    def far(mass: float) -> bool:
        return not 3.6 < mass < 8.5

    assert lab.calibrated(fails=far).values[MASS] == pytest.approx(3.75, rel=0.03)
    heavy = damper_scene().replace(**{MASS: 20.0})
    with pytest.raises(InputError, match="boom; use other start values"):
        lab.calibrated(scene=heavy, fails=far)


SAVED = Path(__file__).parents[2] / "data" / "model.json"


def test_features_of_a_linear_oscillator_have_their_exact_values() -> None:
    """The features are equilibrium height, undamped period, damping ratio and force."""
    times = np.linspace(0.0, 2.0, 2000)
    swing = 1e-3 * np.exp(-0.8 * times) * np.cos(math.sqrt(21.8**2 - 0.8**2) * times)
    force = 70.0 - 7.0 * 21.8**2 * swing
    record = PistonRecord(times, 0.059 + swing, force=force)
    found = measure_record_features(record, "linear", force=True)
    assert found.names == ("height", "period", "damping_ratio", "force")
    expected = (0.059, 2.0 * math.pi / 21.8, 0.8 / 21.8, 70.0)
    assert tuple(found.values) == pytest.approx(expected, rel=2e-3)
    assert found.values[:3] == pytest.approx(expected[:3], rel=1e-6)


def test_calibration_by_a_growing_motion_or_without_an_equilibrium_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Synthetic fit results are used."""
    model = load_model(SAVED)
    assert model.at_rest is not None
    grows = dataclasses.replace(model.at_rest, damping_ratio=-0.09)
    times = np.linspace(0.0, 2.0, 2000)
    record = PistonRecord(times, 0.059 + 1e-3 * np.cos(21.8 * times))
    for at_rest, words in (
        (grows, r"damping ratio is -0\.09, but it must be above 0; give a record that comes to rest"),
        (None, "has no equilibrium near the record"),
    ):
        made_up = dataclasses.replace(model, at_rest=at_rest)
        monkeypatch.setattr(
            f"{measure_record_features.__module__}.fit", lambda *_, found=made_up, **__: found
        )
        with pytest.raises(RecordError, match=words):
            measure_record_features(record)
