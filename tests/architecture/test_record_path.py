"""During a fit, the record is passed to functions in only a few files."""

import dataclasses
import sys
from collections.abc import Mapping
from pathlib import Path
from types import FrameType

import numpy as np

from granular import PistonRecord

PACKAGE = Path(__file__).parents[2] / "reduced_models"
MOST_FILES = 18


def holds_record(value: object) -> bool:
    """Return True if a value is a record, or a container with a record in it."""
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
    """Trace function that lists the files whose functions are called with a record."""

    def __init__(self) -> None:
        self.files: set[str] = set()
        self.seen: set[object] = set()

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or code in self.seen or not code.co_filename.startswith(str(PACKAGE)):
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(holds_record(frame.f_locals.get(name)) for name in names):
            self.seen.add(code)
            self.files.add(str(Path(code.co_filename).relative_to(PACKAGE)))


def test_a_fit_passes_the_record_to_functions_in_few_files() -> None:
    """A record inside a container that is passed as an argument counts too."""
    from reduced_models import fit

    time = np.linspace(0.0, 40.0, 2000)
    noise = np.random.default_rng(0).normal(0.0, 0.01, len(time))
    record = PistonRecord(time, 1.0 + np.exp(-0.05 * time) * np.cos(1.05 * time) + noise)
    follower = Follower()
    sys.setprofile(follower)
    try:
        fit(record, "linear")
    finally:
        sys.setprofile(None)
    assert 1 < len(follower.files) <= MOST_FILES, sorted(follower.files)
