"""Measures and effects from a Python file that the user names on the command line."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import FunctionType
from typing import Any

from granular.observables.frame import observable_of
from granular.observables.over_frames import per_frame
from granular.run.trajectory import Trajectory
from granular.shared.own_file import OwnFile, contents
from granular.studies.cases import measure_name


@dataclasses.dataclass(frozen=True)
class OwnMeasure:
    """A function of a user's file, with the file's text: any other process can have it so.

    Attributes
    ----------
    file : OwnFile
    name : str
        Of the function, or of an observable, whose value at the end of a run it is.
    known_as : str
        As `granular.studies.cases.measure_name` has it.
    """

    file: OwnFile
    name: str
    known_as: str

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """What the function finds."""
        found = contents(self.file)[self.name]
        if (marked := observable_of(found)) is not None:
            return {marked.name: per_frame(run, found).values[-1].tolist()}
        figures: Mapping[str, Any] = found(run)
        return figures


def own_measures(file: OwnFile) -> dict[str, OwnMeasure]:
    """The functions and observables that a user's file defines, by their names."""
    return {
        name: OwnMeasure(file, name, measure_name(function))
        for name, function in _functions(file).items()
    }


def _functions(file: OwnFile) -> dict[str, FunctionType]:
    return {
        name: found
        for name, found in contents(file).items()
        if isinstance(found, FunctionType) and found.__module__ == file.module
    }
