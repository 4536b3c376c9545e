"""What a run is made with that stands neither in the toolkit nor in the scene."""

from __future__ import annotations

from granular.scene.scene import Scene


def own_sources(scene: Scene) -> list[str]:
    """Digests of a user's own functions, and of what is derived from formulas, in a scene."""
    return sorted(one for effect in scene.effects.laws for one in effect.sources)
