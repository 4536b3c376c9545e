"""Measures from a Python file that the user names on the command line."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import FunctionType
from typing import Any

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
        Of the function.
    known_as : str
        As `granular.studies.cases.measure_name` has it.
    """

    file: OwnFile
    name: str
    known_as: str

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """What the function finds."""
        found: Mapping[str, Any] = contents(self.file)[self.name](run)
        return found


def own_measures(file: OwnFile) -> dict[str, OwnMeasure]:
    """The functions that a user's file defines, by their names."""
    return {
        name: OwnMeasure(file, name, measure_name(found))
        for name, found in contents(file).items()
        if isinstance(found, FunctionType) and found.__module__ == file.module
    }
