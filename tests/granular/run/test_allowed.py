"""One rule says what a scene can be run with; `simulate` and those who choose settings ask it."""

from __future__ import annotations

from typing import Any

import pytest

from granular import Scene, simulate
from granular.methods import METHODS
from granular.run.allowed import is_allowed
from granular.run.time_step import checked_step, doubled, halved
from granular.scene.dryness import dry_parts
from granular.shared.errors import InputError

CONTACT = {"effects.contact": {"modulus": 1e7}}


@pytest.mark.parametrize(
    ("changes", "dry"),
    [
        ({}, ()),
        ({"effects.friction": {}}, ("friction",)),
        ({"effects.friction": {}, **CONTACT}, ("friction", "contact")),
        ({"piston.friction": 0.1}, ()),  # the bed's piston has no mass: it is never free
        ({"piston.friction": 0.1, "piston.mass": 1.0}, ("piston.friction",)),
        ({"piston": None, "effects.walls.top": None, "arrangement.height": 0.03}, ()),
    ],
)
def test_what_is_dry(small_bed: Scene, changes: dict[str, Any], dry: tuple[str, ...]) -> None:
    assert dry_parts(small_bed.replace(**changes)) == dry


@pytest.mark.parametrize(
    "changes",
    [{}, {"effects.friction": {}}, CONTACT, {"piston.friction": 0.1, "piston.mass": 1.0},
     {"effects.walls.top": {"law": "slab"}}],
)  # fmt: skip
def test_simulate_refuses_what_is_not_allowed(small_bed: Scene, changes: dict[str, Any]) -> None:
    """Before anything is compiled: a scene without an end is refused last."""
    endless = small_bed.replace(**changes, protocol=[{"kind": "hold", "name": "wait"}])
    seen = set()
    for method in (*METHODS, "stormer-verlet+compensated"):
        for dt in ("auto", "auto*4", 1e-4):
            allowed = is_allowed(endless, dt, method)
            seen.add(allowed)
            with pytest.raises(InputError) as refused:
                simulate(endless, dt=dt, method=method, progress=False)
            assert ("has no end" in str(refused.value)) == allowed
    assert seen == {True, False}


def test_longer_steps_are_allowed_as_far_as_they_are_stable(small_bed: Scene) -> None:
    """Where grains rub by themselves the automatic step is four times longer already."""
    rubbing = small_bed.replace(**{"effects.friction": {}})
    assert is_allowed(small_bed, "auto*8", "stormer-verlet")
    assert is_allowed(rubbing, "auto*2", "stormer-verlet")
    assert not is_allowed(rubbing, "auto*4", "stormer-verlet")
    regularised = rubbing.replace(**{"effects.friction.scheme": "regularised"})
    assert is_allowed(regularised, "auto*8", "stormer-verlet")
    assert is_allowed(rubbing.replace(**CONTACT), "auto*8", "stormer-verlet")


@pytest.mark.parametrize("dt", ["auto", "auto*2", "auto/3", "auto*1.5", 1e-5])
def test_twice_half_a_step_is_the_step(dt: float | str) -> None:
    step, back = checked_step(dt), checked_step(doubled(halved(dt)))
    assert back.seconds == step.seconds
    assert back.factor == pytest.approx(step.factor, rel=1e-15)
