"""Measures and effects from a Python file that the user names on the command line."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

from granular.effects.own import effects_of
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.files import read_text
from granular.shared.messages import visible
from granular.shared.own_files import module_of
from granular.studies.cases import measure_name

LONGEST_FILE = 2**20
"""Bytes: a file that is longer is a mistake."""


@dataclasses.dataclass(frozen=True)
class OwnMeasure:
    """A function of a user's file, with the file's text: any other process can have it so.

    Attributes
    ----------
    file : str
        Where the text was read.
    text : str
    name : str
        Of the function.
    known_as : str
        As `granular.studies.cases.measure_name` has it.
    """

    file: str
    text: str
    name: str
    known_as: str

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """What the function finds."""
        found: Mapping[str, Any] = _functions(self.file, self.text)[self.name](run)
        return found


def import_file(path: str | Path) -> str:
    """Run a Python file that the user names, once, so that scenes may name its effects; its text.

    Parameters
    ----------
    path : str or Path
        Whoever runs the command is who trusts the file.

    Raises
    ------
    InputError
        If the file cannot be read, or fails.
    """
    path = Path(path)
    text = read_text(path, LONGEST_FILE)
    try:
        effects_of(str(path), text)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{visible(path)} cannot be imported: {type(error).__name__}: {error}; mend it"
        ) from None
    return text


def own_measures(path: str | Path) -> dict[str, OwnMeasure]:
    """The functions that a Python file defines, by their names; see `import_file`."""
    text = import_file(path)
    return {
        name: OwnMeasure(str(path), text, name, measure_name(function))
        for name, function in _functions(str(path), text).items()
    }


def _functions(file: str, text: str) -> dict[str, FunctionType]:
    module = module_of(file, text)
    return {
        name: found
        for name, found in vars(module).items()
        if isinstance(found, FunctionType) and found.__module__ == module.__name__
    }
