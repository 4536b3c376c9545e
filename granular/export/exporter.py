"""Export formats for other programs, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from granular.shared.registry import Registry


class Exporter(NamedTuple):
    """An export format.

    Attributes
    ----------
    write : function
        Function that writes a run to a path, with the keywords ``overwrite`` and ``progress``; it returns the
        path or paths of the written files.
    contents : str
        Description of the files.
    of_scenes : bool
        True if the format also exports scenes; ``write`` then has the keyword ``dt`` ([s] or "auto") instead
        of ``progress``.
    next_step : str
        Command that uses the written files.
    """

    write: Callable[..., Path | tuple[Path, ...]]
    contents: str
    of_scenes: bool = False
    next_step: str = ""


EXPORTERS = Registry[Exporter](
    "format",
    "granular.exporters",
    {
        "gsd": "granular.export.gsd_file:GSD",
        "extxyz": "granular.export.extxyz:EXTXYZ",
        "vtk": "granular.export.vtk_files:VTK",
        "csv": "granular.export.tables:CSV",
        "parquet": "granular.export.tables:PARQUET",
        "lammps": "granular.export.lammps:LAMMPS",
    },
    lambda _, exporter: isinstance(exporter, Exporter),
    "a granular.export.Exporter",
    lambda exporter: exporter.contents,
)
"""Formats by their names in the command ``export``."""
