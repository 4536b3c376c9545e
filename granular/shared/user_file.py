"""Python file that a user gives on the command line; the toolkit executes no other text from users."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from granular.shared.errors import InputError, sanitize
from granular.shared.files import read_text

LONGEST_FILE = 2**20
"""Maximum size of a user's file [bytes]."""


class UserFile(NamedTuple):
    """Path and text of a user's file, so that other processes can run the same text."""

    path: str
    text: str

    @property
    def module_name(self) -> str:
        """Name under which the file is imported as a module."""
        return f"imported_{Path(self.path).stem}"


def run_user_file(path: str | Path) -> UserFile:
    """Read a user's Python file, and run it once."""
    file = UserFile(str(path), read_text(Path(path), LONGEST_FILE))
    try:
        user_definitions(file)
    except (Exception, SystemExit) as error:  # a file that exits is an error
        raise InputError(
            f"{sanitize(path)} cannot be imported: {type(error).__name__}: {error}; correct the file"
        ) from None
    return file


@functools.lru_cache
def user_definitions(file: UserFile) -> dict[str, Any]:
    """Return the definitions in a user's file by name; the file is run once per process."""
    module = ModuleType(file.module_name)
    module.__file__ = file.path
    sys.modules[module.__name__] = module  # needed by data classes in the file
    exec(compile(file.text, file.path, "exec"), vars(module))
    return vars(module)
