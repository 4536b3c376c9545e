"""How often the far field is met: by the scene's wish, the method, and whether grains rub."""

import pytest

from granular import Scene
from granular.methods import METHODS
from granular.scene.scene_in_natural_units import FAR_EVERY, scene_in_natural_units
from granular.shared.errors import InputError


def every(scene: Scene, wanted: int | None, method: str = "stormer-verlet") -> int | None:
    """Steps from impulse to impulse, of a scene on the mesh."""
    pairs: dict[str, object] = {"method": "mesh"}
    if wanted is not None:
        pairs["far_every"] = wanted
    system = scene_in_natural_units(scene.replace(pairs=pairs), method=METHODS[method])
    far = system.constants.acting.far
    assert far is not None
    return far.every


def test_the_far_field_is_met_as_often_as_is_asked_for(small_bed: Scene) -> None:
    free = small_bed.replace(**{"effects.friction": None})
    assert every(free, None) == FAR_EVERY
    assert every(free, 4) == 4
    assert every(free, 1) is None  # a part of every force


def test_the_direct_sum_is_split_where_that_is_asked_for(small_bed: Scene) -> None:
    def far_every(scene: Scene, method: str = "stormer-verlet") -> int | None:
        far = scene_in_natural_units(scene, method=METHODS[method]).constants.acting.far
        return None if far is None else far.every

    free = small_bed.replace(**{"effects.friction": None})
    asked = free.replace(**{"pairs.far_every": 8})
    assert far_every(free) is None
    assert far_every(asked) == 8
    assert far_every(asked.replace(**{"pairs.method": "direct"})) == 8
    assert far_every(free.replace(**{"pairs.far_every": 1})) is None
    with pytest.raises(InputError, match="'pefrl' cannot"):
        far_every(asked, "pefrl")


def test_a_method_without_impulses_meets_it_at_every_force(small_bed: Scene) -> None:
    free = small_bed.replace(**{"effects.friction": None})
    assert every(free, None, "pefrl") is None
    assert every(free, 1, "pefrl") is None
    with pytest.raises(InputError, match="'pefrl' cannot"):
        every(free, 2, "pefrl")
