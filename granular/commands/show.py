"""The command ``show``: what a scene holds."""

from __future__ import annotations

from typing import Any

from granular.commands.console import Parser, add_import, add_output, add_scene, emit
from granular.commands.given_scene import scene_of

WHAT = "tell what a scene holds, in SI and in natural units"
EXAMPLES = """\
example:
  %(prog)s damper --set piston.mass=6.5"""


def add_options(one: Parser) -> None:
    """The command's options."""
    add_scene(one)
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Tell what a scene holds."""
    from granular.own import import_own
    from granular.run.summary import scene_figures, scene_text

    import_own(options.own_files)
    scene = scene_of(options)
    emit(
        {"scene": scene.to_plain(), "figures": scene_figures(scene)},
        scene_text(scene),
        options.json,
    )
