"""The command ``warm-up``: compile what scenes need."""

from __future__ import annotations

from typing import Any

from granular.commands.console import (
    Parser,
    add_changes,
    add_import,
    add_output,
    changes_from,
    emit,
)
from granular.shared.errors import InputError

WHAT = "compile what scenes need, once and for all later starts"
EXAMPLES = """\
examples:
  %(prog)s                    # all packaged scenes; for images and continuous integration
  %(prog)s damper my-bed.toml --set effects.friction=true"""


def add_options(one: Parser) -> None:
    """The command's options."""
    one.add_argument(
        "scenes", metavar="SCENE", nargs="*", help="names or TOML files (all packaged scenes)"
    )
    add_changes(one)
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """Compile what scenes need."""
    from granular.compiled.cache import cache_folder
    from granular.own import import_own
    from granular.run.warm_up import warm_up
    from granular.scene.loading import load_scene, scene_names

    import_own(options.own_files)
    changes = changes_from(options.changes)
    scenes = [load_scene(name).replace(**changes) for name in options.scenes or scene_names()]
    seconds = warm_up(scenes)
    folder = cache_folder()
    if folder is None:
        raise InputError(
            "there is no folder to keep compiled code in; name one of your own in NUMBA_CACHE_DIR"
        )
    lines = [f"{name}: {time:.1f} s" for name, time in seconds.items()]
    emit(
        {"seconds": seconds, "folder": str(folder)},
        "\n".join([*lines, f"compiled code is in {folder}"]),
        options.json,
    )
