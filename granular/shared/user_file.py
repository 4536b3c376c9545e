"""A Python file of the user's own, named on the command line: the only text that is run."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from granular.shared.errors import InputError, sanitize
from granular.shared.files import read_text

LONGEST_FILE = 2**20
"""Bytes: a file that is longer is a mistake."""


class UserFile(NamedTuple):
    """A file and its text, so that any other process can have the same."""

    path: str
    text: str

    @property
    def module_name(self) -> str:
        """Name of the module that the file is run as."""
        return f"imported_{Path(self.path).stem}"


def run_user_file(path: str | Path) -> UserFile:
    """Read a Python file of the user's own, and run it once."""
    file = UserFile(str(path), read_text(Path(path), LONGEST_FILE))
    try:
        user_definitions(file)
    except (Exception, SystemExit) as error:  # a file that ends the process is no success
        raise InputError(
            f"{sanitize(path)} cannot be imported: {type(error).__name__}: {error}; correct it"
        ) from None
    return file


@functools.lru_cache
def user_definitions(file: UserFile) -> dict[str, Any]:
    """Definitions in a user's file, which is run once in a process."""
    module = ModuleType(file.module_name)
    module.__file__ = file.path
    sys.modules[module.__name__] = module  # data classes in the file look it up there
    exec(compile(file.text, file.path, "exec"), vars(module))
    return vars(module)
