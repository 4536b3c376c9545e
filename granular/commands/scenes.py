"""The command ``scenes``: which scenes the package holds."""

from __future__ import annotations

from typing import Any

from granular.commands.console import Parser, add_output, emit

WHAT = "list the packaged scenes"
EXAMPLES = "example:\n  %(prog)s"


def add_options(one: Parser) -> None:
    """The command's options."""
    add_output(one)


def carry_out(options: Any) -> None:
    """List the packaged scenes, and what scenes can name."""
    from granular.effects.registry import names
    from granular.methods.named import GROUP as METHOD_GROUP
    from granular.methods.tables import METHODS
    from granular.observables.named import GROUP as OBSERVABLE_GROUP
    from granular.observables.named import OBSERVABLES
    from granular.scene.loading import SCENES, scene_names
    from granular.shared.offered import names_offered

    first = {}
    for name in scene_names():
        lines = (SCENES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
        comment = [line[1:].strip() for line in lines if line.startswith("#")]
        first[name] = " ".join(comment)
    width = max(map(len, first))
    lines = [f"{name:{width}}  {text}" for name, text in first.items()]
    known = {
        "effects": names(),
        "methods": (*METHODS, *names_offered(METHOD_GROUP)),
        "observables": (*OBSERVABLES, *names_offered(OBSERVABLE_GROUP)),
    }
    more = [f"{what}: {', '.join(some)}" for what, some in known.items()]
    emit(first, "\n".join([*lines, "", *more]), options.json)
