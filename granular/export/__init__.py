"""Runs as files for other programs.

GSD and extended XYZ for OVITO and ASE, VTK for ParaView, tables in CSV and Parquet, de Paula's
``.dat`` files, and input decks of LAMMPS.

>>> from granular.export import to_gsd
>>> to_gsd("runs/light-piston", "bed.gsd")
"""

from __future__ import annotations

from granular.export.depaula import to_depaula_files
from granular.export.extxyz import to_extxyz
from granular.export.gsd_file import to_gsd
from granular.export.lammps import to_lammps
from granular.export.tables import to_tables
from granular.export.vtk_files import to_vtk

__all__ = ["to_depaula_files", "to_extxyz", "to_gsd", "to_lammps", "to_tables", "to_vtk"]
