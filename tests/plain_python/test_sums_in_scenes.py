"""Pair sums in plain Python: discs by each method, components of forces, and division for threads."""

from typing import Any

import numba
import numpy as np
import pytest

from granular import load_scene, simulate
from granular.pairs import multilevel_mesh, stripes
from granular.shared.errors import OutsideError
from tests.granular.observables.test_compression import CHANGES, check_parts
from tests.granular.pairs import test_cut_off, test_far_field
from tests.physics.test_discs import discs


@pytest.mark.parametrize("changes", CHANGES[1:], ids=str)
def test_force_components_by_effect_add_up_to_the_total_force(
    changes: dict[str, Any], random: np.random.Generator
) -> None:
    check_parts(changes, random)


@pytest.mark.filterwarnings("ignore")
def test_strongly_overlapping_discs_stop_the_run() -> None:
    scene = discs(load_scene("bed"), **{"effects.contact.modulus": "1 kPa", "grains.count": 2}).replace(
        **{
            "arrangement": {
                "positions": [["10 D", "3 D"], ["11.05 D", "3 D"]],
                "velocities": [[8.0, 0.0], [-8.0, 0.0]],
            }
        }
    )
    with pytest.raises(OutsideError, match=r"limit is 0\.98.*effects\.contact\.modulus"):
        simulate(scene, dt=2e-6, t_end=2e-4, progress=False)


def backwards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Divide small beds for threads too, and run threaded loops in reverse order."""
    for module in (multilevel_mesh, stripes):
        monkeypatch.setattr(module, "MIN_GRAINS_FOR_PARTS", 8)
    monkeypatch.setattr(numba, "prange", lambda parts: range(parts - 1, -1, -1))


def test_mesh_sum_is_bit_identical_for_any_order_of_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    backwards(monkeypatch)
    bed = test_far_field.Bed(92, differing=True)
    one = bed.far()
    assert one.mesh is not None
    assert len(one.mesh.part_sources) > 1
    bed.threaded = True
    several = bed.far()
    for name in ("fx", "fy", "load", "energy"):
        np.testing.assert_array_equal(getattr(several, name), getattr(one, name))


def test_cut_off_sum_is_bit_identical_for_any_order_of_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    backwards(monkeypatch)
    one, several = (test_cut_off.Bed(test_cut_off.scattered(150, 5), 6.0, differing=True) for _ in range(2))
    assert one.stripes.ends.size > 1
    several.threaded = True
    np.testing.assert_array_equal(several.sums(), one.sums())
