"""What is dry in a scene: what stops at a threshold, and cannot be undone backward in time."""

from __future__ import annotations

from granular.scene.scene import Scene


def dry_parts(scene: Scene) -> tuple[str, ...]:
    """Names of the dry parts that act: of the bed, and of a piston that is free to move."""
    found = [effect.key for effect in scene.effects.laws if effect.dry]
    piston = scene.piston
    if piston is not None and piston.mass is not None and piston.friction > 0.0:
        found.append("piston.friction")
    return tuple(found)
