"""How often the far field is met: by the scene's wish, the method, and whether grains rub."""

from __future__ import annotations

import pytest

from granular import Scene
from granular.engine.system import FAR_EVERY, natural_system
from granular.methods import METHODS
from granular.pairs.section import SPARED_FROM
from granular.scene.beds import mono_bed
from granular.shared.errors import InputError


def every(scene: Scene, wanted: int | None, method: str = "stormer-verlet") -> int | None:
    """Steps from impulse to impulse, of a scene on the mesh."""
    pairs: dict[str, object] = {"method": "mesh"}
    if wanted is not None:
        pairs["far_every"] = wanted
    system = natural_system(scene.replace(pairs=pairs), method=METHODS[method])
    far = system.constants.acting.far
    assert far is not None
    return far.every


def test_the_far_field_is_met_as_often_as_is_asked_for(small_bed: Scene) -> None:
    free = small_bed.replace(**{"effects.friction": None})
    assert every(free, None) == FAR_EVERY
    assert every(free, 4) == 4
    assert every(free, 1) is None  # a part of every force


def test_far_pairs_are_spared_where_that_pays() -> None:
    """By themselves in larger closed beds that do not rub; not where a direct sum is asked for."""

    def spared(scene: Scene, method: str = "stormer-verlet") -> int | None:
        far = natural_system(scene, method=METHODS[method]).constants.acting.far
        return None if far is None else far.every

    large = mono_bed(SPARED_FROM).replace(**{"effects.friction": None})
    assert spared(large) == FAR_EVERY
    assert spared(large, "pefrl") is None
    assert spared(mono_bed(SPARED_FROM - 1)) is None
    assert spared(large.replace(**{"effects.friction": {}})) is None
    assert spared(large.replace(**{"effects.walls.left": None})) is None
    assert spared(large.replace(**{"pairs.method": "direct"})) is None
    assert spared(large.replace(**{"pairs.far_every": 1})) is None


def test_a_method_without_impulses_meets_it_at_every_force(small_bed: Scene) -> None:
    free = small_bed.replace(**{"effects.friction": None})
    assert every(free, None, "pefrl") is None
    assert every(free, 1, "pefrl") is None
    with pytest.raises(InputError, match="'pefrl' cannot"):
        every(free, 2, "pefrl")
