"""Times of records where the piston is set higher at once, so that one time has two records.

A run stores both at the same time. Labelled data need times that grow: there the record behind the
jump stands at the next number of double precision, some 1e-15 s later.
"""

from __future__ import annotations

import numpy as np

LEAST = 1e-18
"""Between two records of one time near zero [s], where numbers of double precision lie denser."""


def parted(times: np.ndarray) -> np.ndarray:
    """Times (m,) [s] as stored, as times that grow."""
    found = np.array(times, dtype=np.float64)
    for k in np.flatnonzero(np.diff(found) <= 0.0):
        found[k + 1] = found[k] + _apart(found[k])
    return found


def joined(times: np.ndarray) -> np.ndarray:
    """Times (m,) [s] that grow, as they are stored."""
    found = np.array(times, dtype=np.float64)
    for k in np.flatnonzero(np.diff(found) <= 2.0 * _apart(found[:-1])):
        found[k + 1] = found[k]
    return found


def _apart(times: np.ndarray) -> np.ndarray:
    return np.maximum(np.spacing(times), LEAST)
