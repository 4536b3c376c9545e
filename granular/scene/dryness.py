"""What is dry in a scene: what stops at a threshold, and cannot be undone backward in time."""

from __future__ import annotations

from granular.scene.scene import Scene


def dry_parts(scene: Scene) -> tuple[str, ...]:
    """Names of the dry parts that act: of the bed, and of a piston that is free to move.

    Contact is among them: its dashpots are solved pair by pair, like friction.
    """
    found = [name for name in ("friction", "contact") if getattr(scene.effects, name) is not None]
    piston = scene.piston
    if piston is not None and piston.mass is not None and piston.friction > 0.0:
        found.append("piston.friction")
    return tuple(found)
