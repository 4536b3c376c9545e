"""Formats in which runs are written for other programs, by their names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from granular.shared.registry import Registry


class Exporter(NamedTuple):
    """A format in which runs are written.

    Attributes
    ----------
    write : function
        Of a run and a path, with the keywords ``overwrite`` and ``progress``; returns its file or files.
    contents : str
        Contents of the files, in words.
    of_scenes : bool
        Whether it writes scenes too, and takes ``dt`` [s] or "auto" in place of ``progress``.
    next_step : str
        Command that takes the files, in words.
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
"""Formats by the names that the command ``export`` takes."""
