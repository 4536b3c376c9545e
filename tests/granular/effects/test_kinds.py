"""Every effect is of the kind that its law's hooks are of: a force, a flow or a frame."""

from __future__ import annotations

import pytest

from granular.effects import dissipative_effect, force_effect, moving_frame_effect
from granular.effects.effect import Effect
from granular.effects.registry import all_effects
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import scene_in_natural_units

KINDS = {
    force_effect.ForceEffect: force_effect.HOOKS,
    dissipative_effect.DissipativeEffect: dissipative_effect.HOOKS,
    moving_frame_effect.MovingFrameEffect: moving_frame_effect.HOOKS,
}
EVERY = {hook for hooks in KINDS.values() for hook in hooks}


def hooks_of(law: object) -> set[str]:
    """Return the hooks that a law's class has."""
    return {hook for hook in EVERY if hasattr(type(law), hook)}


def test_eight_hooks_are_all() -> None:
    assert len(EVERY) == sum(map(len, KINDS.values())) == 8


@pytest.mark.parametrize("key", sorted(all_effects()))
def test_an_effect_is_what_its_base_says(key: str) -> None:
    kind = all_effects()[key]
    bases = [base for base in KINDS if issubclass(kind, base)]
    assert bases, f"{key} is neither a force, nor a flow, nor a frame"
    assert Effect not in kind.__bases__


def test_laws_have_hooks_of_their_kind_alone(small_damper: Scene) -> None:
    plate = {"conductivity": "6e7 S/m", "thickness": "1 mm", "distance": "4 mm"}
    shaken = {"amplitude": "0.1 mm", "frequency": "5 Hz"}
    changes = {"effects.eddy": plate, "effects.shaking": shaken, "effects.friction": {}}
    system = scene_in_natural_units(small_damper.replace(**changes))
    with_hooks = 0
    for effect, law in zip(system.effects, system.constants.acting.laws, strict=True):
        bases = [base for base in KINDS if isinstance(effect, base)]
        allowed = {hook for base in bases for hook in KINDS[base]}
        if isinstance(effect, moving_frame_effect.MovingFrameEffect):
            allowed |= set(force_effect.HOOKS)
        present = hooks_of(law)
        with_hooks += bool(present)
        assert present <= allowed, effect.key
    assert with_hooks >= 5
