"""The commands ``scenes``, ``show`` and ``schema``: scenes before they are run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from textwrap import indent
from typing import Annotated, Literal

from granular.commands.console import command, print_result, refuse_options
from granular.commands.options import (
    Accuracy,
    MethodName,
    OutputOptions,
    SceneChangeOptions,
    SceneName,
    ThreadCount,
    TimeStep,
)
from granular.commands.signature import Option
from granular.shared.errors import InputError


@command("""\
examples:
  %(prog)s
  %(prog)s --methods
  %(prog)s --warm-up          # all packaged scenes, for example when building an image
  %(prog)s --warm-up damper my-bed.toml --set effects.friction=true""")
def scenes(
    *,
    methods: Annotated[bool, Option("list the integration methods instead")] = False,
    warm_up: Annotated[
        tuple[str, ...] | None,
        Option(
            "compile and cache the code for these scenes: names or TOML files (default: all packaged scenes)",
            "SCENE",
            nargs="*",
        ),
    ] = None,
    changes: SceneChangeOptions,
    output: OutputOptions,
) -> None:
    """List the packaged scenes."""
    changes.import_user_code()
    if warm_up is not None:
        _compile_kernels_of_scenes(warm_up, changes, output)
        return
    refuse_options("a list", set=changes.changes)
    if methods:
        _print_methods(output)
    else:
        _print_scenes_and_parts(output)


def _print_scenes_and_parts(output: OutputOptions) -> None:
    """List the packaged scenes, and the available parts of scenes."""
    from granular.effects.effect import EFFECTS, WALL_LAWS
    from granular.effects.walls import LAWS
    from granular.methods.tables import METHODS
    from granular.observables.catalogue import OBSERVABLES
    from granular.run.engines import ENGINES
    from granular.scene.named_scenes import SCENES, scene_names

    first = {}
    for name in scene_names():
        lines = (SCENES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
        comment = [line[1:].strip() for line in lines if line.startswith("#")]
        first[name] = " ".join(comment)
    width = max(map(len, first))
    lines = [f"{name:{width}}  {text}" for name, text in first.items()]
    known: dict[str, Iterable[str]] = {
        "effects": EFFECTS,
        "laws of walls": (*LAWS, *WALL_LAWS),
        "methods": METHODS,
        "engines": ENGINES,
        "observables": OBSERVABLES,
    }
    more = [f"{kind}: {', '.join(names)}" for kind, names in known.items()]
    print_result(first, "\n".join([*lines, "", *more]), output.json)


def _print_methods(output: OutputOptions) -> None:
    """List the built-in, custom and installed methods."""
    from granular.methods.tables import METHODS

    plain = {name: method.to_plain() for name, method in METHODS.usable_parts().items()}
    print_result(plain, repr(METHODS), output.json)


def _compile_kernels_of_scenes(
    names: tuple[str, ...], changes: SceneChangeOptions, output: OutputOptions
) -> None:
    """Compile and cache the kernels of scenes."""
    from granular.compiled.numba_insides import kernel_cache_folder
    from granular.run.simulation import compile_and_cache_kernels
    from granular.scene.named_scenes import load_scene, scene_names

    scenes = [changes.apply(load_scene(name)) for name in names or scene_names()]
    seconds = compile_and_cache_kernels(scenes)
    folder = kernel_cache_folder()
    if folder is None:
        raise InputError(
            "no folder for compiled code is available; set NUMBA_CACHE_DIR to a folder in which you can write"
        )
    lines = [f"{name}: {time:.1f} s" for name, time in seconds.items()]
    print_result(
        {"seconds": seconds, "folder": str(folder)},
        "\n".join([*lines, f"compiled code is in {folder}"]),
        output.json,
    )


@command("""\
examples:
  %(prog)s damper --set piston.mass=6.5
  %(prog)s damper --accuracy '1 %% period'     # with the settings for this accuracy""")
def show(
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    dt: TimeStep = "auto",
    method: MethodName = "stormer-verlet",
    accuracy: Accuracy = None,
    threads: ThreadCount = None,
    output: OutputOptions,
) -> None:
    """Describe a scene, in SI and in natural units, and the plan of its run."""
    from granular.run.plan import plan
    from granular.run.summary import derived_scene_values, scene_text

    loaded = changes.load(scene)
    chosen = plan(loaded, dt, method=method, accuracy=accuracy, threads=threads)
    values = derived_scene_values(loaded)
    figures = {"scene": loaded.to_plain(), "figures": values, "plan": chosen.to_plain()}
    print_result(figures, f"{scene_text(loaded)}\nrun by\n{indent(str(chosen), '  ')}", output.json)


@command("""\
examples:
  %(prog)s -o scene.schema.json
  %(prog)s --of study -o study.schema.json""")
def schema(
    *,
    of: Annotated[Literal["scene", "study"], Option("kind of file")] = "scene",
    out: Annotated[str | None, Option("file for the schema, instead of printing it", "FILE", "-o")] = None,
) -> None:
    """Print the JSON schema of scene or study files, for editors."""
    from granular.scene.json_schema import scene_schema, study_schema
    from granular.shared.files import write_text

    plain = {"scene": scene_schema, "study": study_schema}[of]()
    text = json.dumps(plain, indent=2, ensure_ascii=False)
    if out is None:
        print(text)
        return
    write_text(Path(out), text + "\n")
    print(out)
