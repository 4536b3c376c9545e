"""Sums that threads share: the same bits in whatever order their parts are taken.

In plain Python, where no thread runs: parts that touched each other's numbers would show here.
"""

import numba
import numpy as np
import pytest

from granular.pairs import multilevel_mesh, stripes
from tests.granular.pairs import test_cut_off, test_far_field


def backwards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Part small beds, too, and let threaded loops begin with the last part."""
    for module in (multilevel_mesh, stripes):
        monkeypatch.setattr(module, "PARTED_FROM", 8)
    monkeypatch.setattr(numba, "prange", lambda parts: range(parts - 1, -1, -1))


def test_parts_of_a_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    backwards(monkeypatch)
    bed = test_far_field.Bed(92, differing=True)
    one = bed.far()
    assert one.mesh is not None
    assert len(one.mesh.part_sources) > 1
    bed.threaded = True
    several = bed.far()
    for name in ("fx", "fy", "load", "energy"):
        np.testing.assert_array_equal(getattr(several, name), getattr(one, name))


def test_parts_of_a_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    backwards(monkeypatch)
    one, several = (test_cut_off.Bed(test_cut_off.scattered(150, 5), 6.0, differing=True) for _ in range(2))
    assert one.stripes.ends.size > 1
    several.threaded = True
    np.testing.assert_array_equal(several.sums(), one.sums())
