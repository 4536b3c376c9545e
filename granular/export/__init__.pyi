from .exporter import EXPORTERS, Exporter
from .extxyz import to_extxyz
from .gsd_file import to_gsd
from .lammps import to_lammps
from .tables import to_tables
from .vtk_files import to_vtk

__all__ = ["EXPORTERS", "Exporter", "to_extxyz", "to_gsd", "to_lammps", "to_tables", "to_vtk"]
