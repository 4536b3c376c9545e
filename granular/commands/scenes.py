"""The commands ``scenes``, ``show`` and ``schema``: scenes before they are run."""

from __future__ import annotations

import json
from pathlib import Path
from textwrap import indent
from typing import Any

from granular.commands.console import command, option, pick_options, print_result, refuse_options
from granular.commands.options import (
    ACCURACY,
    CHANGES,
    DT,
    IMPORT,
    METHOD,
    OUTPUT,
    SCENE,
    THREADS,
    parse_changes,
    parse_time_step,
    scene_from_options,
)
from granular.shared.errors import InputError


@command(
    "scenes",
    "list the packaged scenes",
    option("--methods", action="store_true", help="list the integration methods instead"),
    option(
        "--warm-up",
        metavar="SCENE",
        nargs="*",
        help="compile what these scenes need, once and for all later starts: names or TOML files "
        "(all packaged scenes)",
    ),
    CHANGES,
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s
  %(prog)s --methods
  %(prog)s --warm-up          # all packaged scenes; for images and continuous integration
  %(prog)s --warm-up damper my-bed.toml --set effects.friction=true""",
)
def scenes(options: Any) -> None:
    """List the packaged scenes or the methods, or compile what scenes need."""
    from granular.user_code import import_user_code

    import_user_code(options.user_files)
    if options.warm_up is not None:
        _warm_up(options)
        return
    refuse_options(options, "a list", changes="--set")
    if options.methods:
        _list_methods(options)
    else:
        _list_scenes(options)


def _list_scenes(options: Any) -> None:
    """List the packaged scenes, and what scenes can name."""
    from granular.effects.registry import effect_names
    from granular.methods.registry import GROUP as METHOD_GROUP
    from granular.methods.tables import METHODS
    from granular.observables.catalogue import GROUP as OBSERVABLE_GROUP
    from granular.observables.catalogue import OBSERVABLES
    from granular.scene.loading import SCENES, scene_names
    from granular.shared.registry import entry_point_names

    first = {}
    for name in scene_names():
        lines = (SCENES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
        comment = [line[1:].strip() for line in lines if line.startswith("#")]
        first[name] = " ".join(comment)
    width = max(map(len, first))
    lines = [f"{name:{width}}  {text}" for name, text in first.items()]
    known = {
        "effects": effect_names(),
        "methods": (*METHODS, *entry_point_names(METHOD_GROUP)),
        "observables": (*OBSERVABLES, *entry_point_names(OBSERVABLE_GROUP)),
    }
    more = [f"{what}: {', '.join(some)}" for what, some in known.items()]
    print_result(first, "\n".join([*lines, "", *more]), options.json)


def _list_methods(options: Any) -> None:
    """List the methods that are built in, those of the user's own, and those installed."""
    from granular.methods.registry import all_methods

    methods = all_methods()
    print_result({name: method.to_plain() for name, method in methods.items()}, repr(methods), options.json)


def _warm_up(options: Any) -> None:
    """Compile what scenes need."""
    from granular.compiled.cache_folder import kernel_cache_folder
    from granular.run.simulation import compile_and_cache_kernels
    from granular.scene.loading import load_scene, scene_names

    changes = parse_changes(options.changes)
    scenes = [load_scene(name).replace(**changes) for name in options.warm_up or scene_names()]
    seconds = compile_and_cache_kernels(scenes)
    folder = kernel_cache_folder()
    if folder is None:
        raise InputError(
            "there is no folder to keep compiled code in; name one of your own in NUMBA_CACHE_DIR"
        )
    lines = [f"{name}: {time:.1f} s" for name, time in seconds.items()]
    print_result(
        {"seconds": seconds, "folder": str(folder)},
        "\n".join([*lines, f"compiled code is in {folder}"]),
        options.json,
    )


@command(
    "show",
    "tell what a scene holds, in SI and in natural units, and how it is run",
    SCENE,
    CHANGES,
    DT,
    METHOD,
    ACCURACY,
    THREADS,
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s damper --set piston.mass=6.5
  %(prog)s damper --accuracy '1 %% period'     # method, step and sum over pairs for it""",
)
def show(options: Any) -> None:
    """Print the values of a scene in SI and in natural units, and the plan of its run."""
    from granular.run.plan import plan
    from granular.run.summary import derived_scene_values, scene_text

    scene = scene_from_options(options)
    dt = parse_time_step(options.dt)
    chosen = plan(scene, dt, **pick_options(options, "method", "accuracy", "threads"))
    figures = {"scene": scene.to_plain(), "figures": derived_scene_values(scene), "plan": chosen.to_plain()}
    print_result(figures, f"{scene_text(scene)}\nrun by\n{indent(str(chosen), '  ')}", options.json)


@command(
    "schema",
    "print the JSON schema of scene or study files, for editors",
    option("--of", choices=("scene", "study"), default="scene", help="kind of file"),
    option("-o", "--out", metavar="FILE", help="write it there instead of printing it"),
    examples="""\
examples:
  %(prog)s -o scene.schema.json
  %(prog)s --of study -o study.schema.json""",
)
def schema(options: Any) -> None:
    """Print the JSON schema of scene or study files, or write it to a file."""
    from granular.scene.json_schema import scene_schema, study_schema
    from granular.shared.files import write_text

    plain = {"scene": scene_schema, "study": study_schema}[options.of]()
    text = json.dumps(plain, indent=2, ensure_ascii=False)
    if options.out is None:
        print(text)
        return
    write_text(Path(options.out), text + "\n")
    print(options.out)
