"""Options that commands of all three packages share, and what reads them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import option, option_group
from granular.shared.errors import GranularError, InputError
from granular.shared.files import parse_toml
from granular.shared.message_text import quote

if TYPE_CHECKING:
    from granular.scene.scene import Scene

SCENE = option("scene", metavar="SCENE", help="name of a packaged scene, or path to a TOML file")
CHANGES = option(
    "--set",
    dest="changes",
    metavar="KEY=VALUE",
    action="append",
    default=[],
    help="change the scene: dotted key and value, such as piston.mass=6.5 or "
    "'effects.drag.coefficient=0.2 kg/s'; 'none' takes a part away (repeatable)",
)
IMPORT = option(
    "--import",
    dest="user_files",
    metavar="FILE",
    action="append",
    default=[],
    help="run this Python file of yours first: its effects, methods and measures are then "
    "known by their names (repeatable)",
)
RUN = option("run", metavar="RUN", help="directory that a run was written to")

DT = option("--dt", default="auto", help="time step [s], 'auto' (default), or a multiple such as auto/2")
METHOD = option(
    "--method",
    default="stormer-verlet",
    help="integration method, by name (stormer-verlet); the command 'scenes --methods' lists them",
)
THREADS = option(
    "--threads", type=int, help="number of threads; the result is the same to the last bit with any number"
)
ACCURACY = option(
    "--accuracy",
    metavar="TEXT",
    help="choose dt, method and sum over pairs for this error, such as '1e-3 rest height'",
)
ENGINE = option(
    "--engine", metavar="NAME", default="numba", help="what advances the bed: numba, or an installed engine"
)
WORKERS = option("--workers", type=int, metavar="N", help="processes (all processors)")


PARTS = option_group(
    option(
        "--part",
        dest="parts",
        metavar="KEY=TOLERANCE",
        action="append",
        default=[],
        help="standard deviation of a number of the scene: dotted key and tolerance, such as "
        "grains.remanence=2.5%% or 'cell.separation=0.05 mm' (repeatable)",
    ),
    option("--usual", action="store_true", help="usual tolerances of all parts that the scene names"),
)
OUTPUT = option_group(
    option("--json", action="store_true", help="print one JSON object"),
    option("--quiet", action="store_true", help="no progress bar"),
)


def scene_from_options(options: Any) -> Scene:
    """Load the scene that a command was given, with its changes, after the user's own code."""
    from granular.scene.loading import load_scene
    from granular.user_code import import_user_code

    import_user_code(getattr(options, "user_files", ()))
    return load_scene(options.scene).replace(**parse_changes(options.changes))


def scene_or_run_from_options(options: Any, source: str) -> Scene | Path:
    """Load the scene that a command was given, with its changes, or return the directory of a run."""
    from granular.run.run_directory import is_run_directory

    path = Path(source)
    if not is_run_directory(path):
        options.scene = source
        return scene_from_options(options)
    if options.changes:
        raise InputError(f"--set changes a scene; {source} is a run, whose scene is fixed")
    return path


def parse_changes(items: Sequence[str]) -> dict[str, Any]:
    """Parse the changes to a scene from ``KEY=VALUE`` texts."""
    changes: dict[str, Any] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--set {quote(item)} is not KEY=VALUE; write for instance piston.mass=6.5")
        try:
            changes[key.strip()] = parse_toml(f"value = {value}")["value"]
        except ValueError:
            changes[key.strip()] = value.strip()
    return changes


def parts_from_options(options: Any, scene: Scene | None) -> dict[str, str | float]:
    """Tolerances of a scene's parts by their keys: the usual ones, and those that a command was given."""
    result: dict[str, str | float] = {}
    if options.usual and scene is not None:
        from granular.studies.tolerance_parts import usual_parts

        result = usual_parts(scene)
    for item in options.parts:
        key, equals, tolerance = item.partition("=")
        if not equals or not key.strip():
            raise InputError(f"--part {quote(item)} is not KEY=TOLERANCE; write grains.remanence=2.5%")
        result[key.strip()] = tolerance.strip()
    return result


def quantity_reader(unit: str) -> Callable[[str], float]:
    """Make the reader of an option that holds a quantity."""

    def read(text: str) -> float:
        from granular.schema.units import si_value

        try:
            return si_value(text, unit)
        except GranularError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def parse_time_step(text: str) -> float | str:
    """Read a time step of the command line: seconds, a quantity, or a multiple of "auto" [s]."""
    from granular.schema.units import si_value

    return text if text.startswith("auto") else si_value(text, "s")
