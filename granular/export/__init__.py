"""Export of runs to files for other programs.

OVITO reads GSD and extended XYZ, ASE reads extended XYZ, and ParaView reads VTK. Further formats are tables
in CSV and Parquet, and input decks of LAMMPS.

>>> from granular.export import to_gsd
>>> to_gsd("runs/light-piston", "bed.gsd")
"""

import lazy_loader

# The names listed in __init__.pyi are imported when first used, so that unused formats cost nothing.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
