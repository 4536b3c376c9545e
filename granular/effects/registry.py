"""Effects and laws of walls that a scene can name: those of the files here, and others."""

from __future__ import annotations

from granular.effects.effect import Effect
from granular.schema.sections import Section
from granular.shared.registry import Registry

EFFECTS = Registry[type[Effect]](
    "effect",
    "granular.effects",
    {
        "bath": "granular.effects.langevin_bath:Bath",
        "contact": "granular.effects.contact:Contact",
        "dipole": "granular.effects.dipole:Dipole",
        "drag": "granular.effects.drag:Drag",
        "eddy": "granular.effects.eddy_drag:Eddy",
        "field": "granular.effects.formula:ForceFields",
        "friction": "granular.effects.friction:Friction",
        "gradient": "granular.effects.magnetic_gradient:Gradient",
        "gravity": "granular.effects.gravity:Gravity",
        "host": "granular.effects.host_structure:Host",
        "pair_law": "granular.effects.formula:PairLaws",
        "shaking": "granular.effects.shaking:Shaking",
        "wall_friction": "granular.effects.wall_friction:WallFriction",
        "walls": "granular.effects.walls:Walls",
    },
    lambda key, made: isinstance(made, type) and issubclass(made, Effect) and made.key == key,
    "an effect of that key",
    from_files=True,
)
"""Effects by their keys."""

WALL_LAWS = Registry[type[Section]](
    "law of a wall",
    "granular.wall_laws",
    {"formula": "granular.effects.formula:WallFormula"},
    lambda _, made: isinstance(made, type) and issubclass(made, Section),
    "a law made by granular.wall_law",
    from_files=True,
)
"""Laws of walls, but for those that `granular.effects.walls` has itself."""
