"""What fits leave in memory, which discoveries make hundreds of: programs of JAX, of a law each."""

from __future__ import annotations

import subprocess
import sys

import pytest

from reduced_models.laws.equation import PROGRAMS

PROGRAM = """
import resource, sys
import numpy as np
from granular import PistonRecord
from reduced_models import fit

time = np.linspace(0.0, 3.0, 400)
noise = np.random.default_rng(0).normal(0.0, 1e-6, 400)
record = PistonRecord(time, 0.06 + 2e-3 * np.exp(-0.3 * time) * np.cos(10.0 * time) + noise)
UNIT = 2**20 if sys.platform == "darwin" else 2**10

def memory(laws, times=1):
    for k in laws:
        for _ in range(times):
            fit(record, f"z'' + {k}.5*c*z' + k*(z - r) = 0", starts=2, test_fraction=0.0)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / UNIT

kept = int(sys.argv[1])
print(memory(range(kept + 2)), memory(range(kept + 2, kept + 10)), memory([kept + 9], 40))
"""


@pytest.mark.long
def test_fits_leave_little_in_memory() -> None:
    """Of eight more laws than are kept, each of which takes 20 to 40 MB; of forty fits of one."""
    said = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, str(PROGRAMS)],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    print(said)
    first, second, third = map(float, said.split())  # MB
    assert second - first < 8 * 8.0
    assert third - second < 10.0
