"""A reader of records with one time and height in each line."""

import numpy as np

from granular.records.formats import FileFormat
from granular.records.sheet import sheet_from_table


def read_bench(content, options):
    """Read the columns of a file."""
    time, height = np.array([line.split() for line in content.decode().splitlines()], dtype=float).T
    return sheet_from_table({"time [s]": time, "height [mm]": height})


BENCH = FileFormat(read_bench)
