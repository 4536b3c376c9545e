"""User-defined pair laws: cut-off, randomly scattered magnetic moments, and invalid laws."""

from typing import Any

import pytest

from granular import Scene, load_scene
from granular.scene.scene_in_natural_units import scene_in_natural_units
from granular.shared.errors import InputError


def bed_with(law: dict[str, Any], **changes: Any) -> Scene:
    plain = {"grains.count": 20, "piston": "none", "effects.walls": None, "effects.pair_law": [law]}
    return load_scene("bed").replace(**plain | changes)


def law_of(scene: Scene) -> Any:
    return next(law for law in scene_in_natural_units(scene).constants.acting.laws if hasattr(law, "near"))


def test_cut_off_of_a_pair_law_is_the_distance_beyond_which_only_its_power_law_tail_remains() -> None:
    law = {"energy": "c*q1*q2/r**3*(1 + (l/r)**4)", "tail": "c*q1*q2", "c": "3e-12 J m^3", "l": "6 mm"}
    assert 20.0 < law_of(bed_with(law)).near.reach < 60.0


def test_scattered_magnetic_moments_change_a_short_range_pair_law_only_if_its_formula_contains_them() -> None:
    law = {"energy": "k*q1*q2*max(l - r, 0)**4/l**2", "k": "1 N/m", "l": "0.8 D"}
    assert law_of(bed_with(law, **{"grains.spread": 0.1})).factor is not None
    law["energy"] = "k*max(l - r, 0)**4/l**2"
    assert law_of(bed_with(law, **{"grains.spread": 0.1})).factor is None


MIXED = [{"name": "a", "diameter": 6e-3, "share": 0.5}, {"name": "b", "diameter": 5e-3, "share": 0.5}]
SHORT = {"k": "1 N/m", "l": "0.8 D"}
FENE = {"energy": "-k*l**2*log(1 - (r/l)**2)", "k": "1 N/m", "l": "1.5 D"}
TAIL = {"energy": "c/r**3", "tail": "c", "c": "3e-12 J m^3"}


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize(
    ("law", "changes", "words"),
    [
        (SHORT | {"energy": "k*q1*max(l - r, 0)**4/l**2"}, {"grains.species": MIXED}, "symmetric in the two"),
        (SHORT | {"energy": "k*q1**2*q2**2*max(l - r, 0)**4/l**2"}, {"grains.spread": 0.1}, "proportional"),
        (FENE, {}, "not a number at 1.50. diameters; give a smaller reach"),
        (TAIL, {"grains.species": MIXED}, "not products of one positive number"),
        (TAIL, {"grains.spread": 0.1}, "is proportional to the scattered moments"),
        (TAIL, {"grains.magnets": "cylinders"}, "cannot be combined with"),
    ],
)
def test_pair_law_that_cannot_be_tabulated_is_an_error(
    law: dict[str, Any], changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        scene_in_natural_units(bed_with(law, **changes))


def test_pair_law_with_a_singularity_beyond_its_cut_off_is_accepted() -> None:
    assert law_of(bed_with(FENE | {"reach": "1.45 D"})).near.reach == pytest.approx(1.45)
