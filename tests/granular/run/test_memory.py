"""What runs leave in memory."""

import subprocess
import sys

import pytest

PROGRAM = """
import resource, sys
from granular import load_scene, simulate

scene = load_scene("bed").replace(**{"grains.count": 23, "cell.width": "15 D",
    "piston.height": "6 D", "arrangement.height": "5.5 D"})
UNIT = 2**20 if sys.platform == "darwin" else 2**10

def memory(times):
    for _ in range(times):
        simulate(scene, t_end=0.005, progress=False)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / UNIT

print(memory(30), memory(150))
"""


@pytest.mark.long
def test_runs_leave_nothing_in_memory() -> None:
    said = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True).stdout
    print(said)
    first, second = map(float, said.split())  # MB
    assert second - first < 5.0
