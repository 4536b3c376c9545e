"""The scene that a command was given, with its changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from granular.commands.console import changes_from

if TYPE_CHECKING:
    from granular.scene.scene import Scene


def scene_of(options: Any) -> Scene:
    """Load it; heavy imports wait until here."""
    from granular.scene.loading import load_scene

    return load_scene(options.scene).replace(**changes_from(options.changes))
