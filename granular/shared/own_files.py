"""Python files that a user names on the command line: the one door by which own code comes in.

Whoever runs the command is who trusts the file. No scene, study or run file leads here.
"""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from types import ModuleType


@functools.lru_cache
def module_of(file: str, text: str) -> ModuleType:
    """The module that a file's text makes; it is run once in a process."""
    module = ModuleType(f"imported_{Path(file).stem}")
    module.__file__ = file
    sys.modules[module.__name__] = module  # data classes in the file look it up there
    exec(compile(text, file, "exec"), vars(module))
    return module
