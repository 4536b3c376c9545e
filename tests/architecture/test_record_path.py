"""The files that a record passes in a fit are few enough to be read one after the other."""

from __future__ import annotations

import dataclasses
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

import reduced_models
from granular import PistonRecord
from reduced_models import FitOptions, Parameter, fit

MESH_REACH = Path(reduced_models.__file__).parent
MOST_FILES = 18
TIME = np.linspace(0.0, 40.0, 2000)


def holds_record(value: object) -> bool:
    """Whether a value is a record, or data that hold one."""
    if isinstance(value, PistonRecord):
        return True
    if isinstance(value, str | np.ndarray):
        return False
    if isinstance(value, Mapping):
        return any(map(holds_record, value.values()))
    if isinstance(value, tuple | list):
        return any(map(holds_record, value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return any(holds_record(getattr(value, one.name)) for one in dataclasses.fields(value))
    return False


class Follower:
    """Notes each file of the package that has a function which was given a record."""

    def __init__(self) -> None:
        self.files: set[str] = set()
        self.seen: set[object] = set()

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or code in self.seen or not code.co_filename.startswith(str(MESH_REACH)):
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(holds_record(frame.f_locals.get(name)) for name in names):
            self.seen.add(code)
            self.files.add(str(Path(code.co_filename).relative_to(MESH_REACH)))


def passed(*fits: tuple[object, str, dict[str, object]]) -> set[str]:
    """The files that the records of some fits pass."""
    follower = Follower()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sys.setprofile(follower)
        try:
            for record, law, options in fits:
                fit(record, law, **options)  # type: ignore[call-overload]
        finally:
            sys.setprofile(None)
    return follower.files


def made() -> PistonRecord:
    noise = np.random.default_rng(0).normal(0.0, 0.01, len(TIME))
    return PistonRecord(TIME, 1.0 + np.exp(-0.05 * TIME) * np.cos(1.05 * TIME) + noise)


def test_files_that_a_record_passes() -> None:
    """Followed as it happens: functions whose argument is a record, or data that hold one.

    Functions that are given columns, samples on a grid or search vectors no longer see the record.
    """
    files = passed((made(), "linear", {}))
    assert len(files) <= MOST_FILES, sorted(files)


@pytest.mark.long
def test_files_that_records_pass_with_all_options() -> None:
    integer = made()
    hysteresis = "z'' + k*(z - rest) + c*z' + f*w = 0; w' = r*z' - r*Abs(z')*w"
    files = passed(
        (integer, "linear", {"intervals": "profile", "loss": "huber"}),
        (integer, "van-der-pol-like", {"options": FitOptions(drift=True)}),
        ([integer, integer], "linear", {"parameters": {"omega": Parameter(per_record=True)}, "starts": 4}),
        (
            integer.between(6.0, 40.0),
            hysteresis,
            {"options": FitOptions(initial=integer.between(0.0, 6.0)), "starts": 2},
        ),
        (integer, "z'' + c*z' + k*z = b*t", {"starts": 2, "noise": 0.01}),
    )
    assert len(files) <= MOST_FILES, sorted(files)
