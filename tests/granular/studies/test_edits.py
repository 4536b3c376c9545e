"""Every random edit of a user's file leads to new runs, new compiled code and new studies."""

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import granular.studies.cases
from granular import Scene, evaluate, load_scene, simulate, sweep
from granular.run.simulation import custom_code_digests
from granular.shared.errors import StoreError
from granular.shared.user_file import user_definitions
from granular.studies.cases import CustomMeasure, last_values, make_cases, measure_identity
from granular.user_code import import_user_code_and_collect_measures

EDITS = 40

FILE = '''"""A push of all grains, by numbers that stand in every kind of place that a file has for one."""

import dataclasses
import functools

import numba
import numpy as np

from granular import effect, quantity

CONSTANT = <1.25>
TABLE = np.array([*np.linspace(0.0, 1.0, 1500), <0.5>, *np.linspace(0.0, 1.0, 1500)])
TUPLE = (np.array([*np.linspace(0.0, 1.0, 1500), <0.125>, *np.linspace(0.0, 1.0, 1500)]), <0.75>)
DEEP = <0.0625>


@numba.njit
def deeper(x):
    return x + DEEP


@numba.njit
def helper(x):
    return deeper(x) * <2.0>


def enclose(numbers, scale):
    @numba.njit
    def inside(x):
        return x * numbers[1500] * scale

    return inside


ENCLOSED = enclose(np.array([*np.linspace(0.0, 1.0, 1500), <1.5>, *np.zeros(1500)]), <0.875>)
SHORT = numba.njit(lambda x: x * <1.125>)


@numba.njit
def strength(more=<0.1875>):
    table = TABLE[1500] + TUPLE[0][1500] + TUPLE[1]
    return more + CONSTANT + table + helper(1.0) + ENCLOSED(1.0) + SHORT(1.0) + <0.25>


@effect
class Push:
    """A force downwards."""

    k: float = quantity("N", default="1 mN")

    @staticmethod
    def energy(p, grain, time):
        return p.k * grain.y * strength()

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k * strength()


WORDS = {"a": <1.75>, "b": [<2.5>, {<3.5>, 4.5}]}


def plain_helper(x, factor=<3.0>, *, offset=<0.375>):
    return factor * x + offset


@dataclasses.dataclass
class Calibration:
    slope: float = <2.25>
    zero = <0.03125>

    def apply(self, x):
        return (self.slope * x + self.zero) * <1.0625>


class Meter:
    def __init__(self, gain):
        self.gain = gain

    def read(self, x):
        return self.gain * x


PARTIAL = functools.partial(plain_helper, factor=<4.0>)
METER = Meter(<4.25>)


@functools.lru_cache
def remembered(x):
    return x * <5.0>


def nested(x):
    def inside(y):
        return y * <5.5>

    return inside(x)


def figures(run, factor=<6.0>, *, more=<7.0>):
    listed = [step * <8.0> for step in range(3)][1] + (lambda x: x + <9.0>)(1.0)
    called = PARTIAL(1.0) + remembered(1.0) + plain_helper(1.0) + nested(1.0)
    held = Calibration().apply(1.0) + METER.read(1.0)
    named = WORDS["a"] + WORDS["b"][0] + sum(WORDS["b"][1]) + float(TABLE[1500])
    return {"number": listed + held + called + named + strength() + factor + more + <10.0>}
'''
"""Edits change the numbers in angle brackets."""

PLACE = re.compile(r"<([\d.]+)>")
PLACES = len(PLACE.findall(FILE))
OF_EFFECT = len(PLACE.findall(FILE.partition("WORDS")[0]))
"""Number of leading places that belong to functions of the effect or to code that these use."""

SETTINGS = {"dt": 1e-4, "t_end": None, "method": "stormer-verlet"}


def text_with(changed: int | None = None, value: float = 0.0) -> str:
    """Return the text of the file, with one of its numbers changed."""
    numbers = iter(range(PLACES))
    return PLACE.sub(lambda found: repr(value) if next(numbers) == changed else found[1], FILE)


def imported(folder: Path, text: str) -> dict[str, CustomMeasure]:
    """Import a text from a file that always has the same name, and return its measures."""
    (folder / "mine.py").write_text(text)
    return import_user_code_and_collect_measures([folder / "mine.py"])


def pushed() -> Scene:
    """Return a scene of a grain pushed by the custom effect for 0.01 s."""
    stage = {"kind": "hold", "name": "fall", "duration": 0.01}
    changes = {"protocol": [stage], "output.scalars": 1e-3, "output.frames": 1e-2}
    return load_scene("single-particle").replace(**changes, effects={"push": {}})


def drawn_edits() -> list[tuple[int, float]]:
    random = np.random.default_rng(65)
    return [(int(random.integers(PLACES)), float(random.uniform(11.0, 12.0))) for _ in range(EDITS)]


def test_every_random_edit_of_a_user_file_changes_the_digests_of_its_functions(tmp_path: Path) -> None:
    before = imported(tmp_path, text_with())
    measure, effect_digests = measure_identity(before["figures"]), custom_code_digests(pushed())
    again = imported(tmp_path, "# a comment\n" + text_with())
    assert measure_identity(again["figures"]) == measure
    assert custom_code_digests(pushed()) == effect_digests
    seen = {measure}
    for place, value in drawn_edits():
        edited = imported(tmp_path, text_with(place, value))
        seen.add(measure_identity(edited["figures"]))
        assert (custom_code_digests(pushed()) != effect_digests) is (place < OF_EFFECT), place
    assert len(seen) == 1 + EDITS
    imported(tmp_path, text_with())
    assert custom_code_digests(pushed()) == effect_digests  # undo the edit


@pytest.mark.long  # the quick tests check the digests, above
def test_every_random_edit_of_a_user_file_leads_to_new_runs_compiled_code_and_studies(tmp_path: Path) -> None:
    def force() -> float:
        return float(evaluate(pushed(), np.array([[0.05, 0.05]])).force[0, 1])

    before, run, study = imported(tmp_path, text_with()), tmp_path / "run", tmp_path / "study"
    unedited = pushed()
    simulate(unedited, dt=1e-4, t_end=0.005, out=run, progress=False)
    with ThreadPoolExecutor(1) as pool:
        more: dict[str, Any] = {"cases": [{}], "dt": 1e-4, "out": study, "executor": pool, "progress": False}
        sweep(unedited, measure=before["figures"], **more)
        for place, value in drawn_edits():
            edited = imported(tmp_path, text_with(place, value))
            strength = user_definitions(edited["figures"].file)["strength"]
            assert force() == pytest.approx(-1e-3 * strength(), rel=1e-12)
            if place < OF_EFFECT:
                with pytest.raises(StoreError, match="functions of a custom effect have changed"):
                    simulate(pushed(), dt=1e-4, out=run, resume=True, progress=False)
            result = sweep(unedited, measure=edited["figures"], **more)
            assert (result.reused, result.failed) == (0, ())
            assert result.outcomes[0].figures == edited["figures"](cast("Any", None))
        again = imported(tmp_path, text_with())
        assert sweep(pushed(), measure=again["figures"], **more).reused == 1


def test_keys_of_study_cases_differ_between_versions_of_the_toolkit(monkeypatch: pytest.MonkeyPatch) -> None:
    def key() -> str:
        return make_cases(load_scene("bed"), {}, [{}], SETTINGS, last_values)[0].key

    before = key()
    monkeypatch.setattr(granular.studies.cases, "__version__", "0.0.1")
    assert key() != before
