"""A model written as code, in the language that a file's ending names."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from granular.shared.errors import InputError
from granular.shared.files import write_text
from granular.shared.messages import quoted, visible
from reduced_models.models.export import numpy_source
from reduced_models.models.export_c import c_source
from reduced_models.models.export_matlab import matlab_source
from reduced_models.models.export_modelica import modelica_source
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.fmu import write_fmu

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,59}")

_WORDS = {
    "break", "case", "catch", "continue", "do", "else", "elseif", "end", "equation", "for",
    "function", "global", "if", "model", "otherwise", "parfor", "persistent", "return", "spmd",
    "switch", "try", "until", "while",
}  # fmt: skip

Source = Callable[[FittedLaw, str], str]
SOURCES: dict[str, tuple[str, Source]] = {
    ".py": ("a Python module that needs NumPy alone", lambda model, _: numpy_source(model)),
    ".c": ("C99", lambda model, _: c_source(model)),
    ".m": ("a function for MATLAB and Octave", matlab_source),
    ".mo": ("a Modelica model", modelica_source),
}
"""What each ending stands for, and what writes it, from a model and the file's name."""


def write_code(model: FittedLaw, path: Path) -> str:
    """Write a model as code; says in words what was written.

    Raises
    ------
    InputError
        If the ending is none of those known, the file's name cannot be that of a function, or it
        cannot be written.
    """
    if path.suffix == ".fmu":
        write_fmu(model, path)
        return "an FMU (FMI 2.0, co-simulation)"
    if path.suffix not in SOURCES:
        known = ", ".join([*SOURCES, ".fmu"])
        raise InputError(f"{visible(path)} ends in {quoted(path.suffix)}; give one of {known}")
    named = path.suffix in (".m", ".mo")
    if named and (_NAME.fullmatch(path.stem) is None or path.stem in _WORDS):
        raise InputError(
            f"{quoted(path.name)} cannot be a function's name; give letters, digits and underscores"
        )
    what, source = SOURCES[path.suffix]
    write_text(path, source(model, path.stem))
    return what
