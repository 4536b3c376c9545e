"""Options shared by commands of all three packages."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from granular.commands.signature import Option, OptionReader
from granular.shared.errors import InputError, quote
from granular.shared.files import parse_toml

if TYPE_CHECKING:
    from granular.scene.scene import Scene
    from granular.studies.cases import CustomMeasure


def _parse_time_step(text: str) -> float | str:
    """Read a time step [s]: seconds, a quantity, or a multiple of "auto"."""
    from granular.schema.units import si_value

    return text if text.startswith("auto") else si_value(text, "s")


SceneName = Annotated[str, Option("name of a packaged scene, or path to a TOML file", "SCENE")]
RunDirectory = Annotated[str, Option("directory of a run", "RUN")]
TimeStep = Annotated[
    float | str,
    OptionReader(_parse_time_step),
    Option("time step [s], 'auto' (default), or a multiple such as auto/2"),
]
MethodName = Annotated[
    str, Option("integration method, by name (stormer-verlet); the command 'scenes --methods' lists them")
]
ThreadCount = Annotated[int | None, Option("number of threads; results are bitwise identical for any number")]
Accuracy = Annotated[
    str | None,
    Option(
        (
            "maximum error, such as '1e-3 rest height'; time step, method and pair sum are chosen to "
            "stay below it"
        ),
        "TEXT",
    ),
]
WorkerCount = Annotated[int | None, Option("number of processes (default: all processors)", "N")]


@dataclasses.dataclass(frozen=True)
class OutputOptions:
    """Options that control the output."""

    json: Annotated[bool, Option("print one JSON object")] = False
    quiet: Annotated[bool, Option("no progress bar")] = False

    @property
    def shows_progress(self) -> bool:
        """True if long work shows a progress bar."""
        return not self.quiet


@dataclasses.dataclass(frozen=True)
class UserCodeOptions:
    """Options that name Python files of the user, which are run before the command."""

    user_files: Annotated[
        tuple[str, ...],
        Option(
            "run your Python file first; its effects, methods and measures are then available by name "
            "(repeatable)",
            "FILE",
            name="--import",
        ),
    ] = ()

    def import_user_code(self) -> dict[str, CustomMeasure]:
        """Run the files, and return the user-defined measures by name."""
        from granular.user_code import import_user_code_and_collect_measures

        return import_user_code_and_collect_measures(self.user_files)


@dataclasses.dataclass(frozen=True)
class SceneChangeOptions(UserCodeOptions):
    """Options that change a scene; the changes may use custom effects."""

    changes: Annotated[
        tuple[str, ...],
        Option(
            "change the scene: dotted key and value, such as piston.mass=6.5 or "
            "'effects.drag.coefficient=0.2 kg/s'; 'none' removes a part (repeatable)",
            "KEY=VALUE",
            name="--set",
        ),
    ] = ()

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the changes."""
        return scene.replace(**self.values())

    def values(self) -> dict[str, Any]:
        """Parse the changes to a dict of values by dotted key."""
        values: dict[str, Any] = {}
        for key, value in _split_pairs("--set", self.changes, "KEY=VALUE", "for instance piston.mass=6.5"):
            try:
                values[key] = parse_toml(f"value = {value}")["value"]
            except ValueError:
                values[key] = value
        return values

    def load(self, name: str) -> Scene:
        """Run the user's code, then load a scene and apply the changes."""
        from granular.scene.named_scenes import load_scene

        self.import_user_code()
        return self.apply(load_scene(name))

    def load_scene_or_run(self, source: str) -> Scene | Path:
        """Load a scene with the changes, or return the directory of a run."""
        from granular.run.run_directory import is_run_directory

        path = Path(source)
        if not is_run_directory(path):
            return self.load(source)
        if self.changes:
            raise InputError(
                f"--set changes a scene, but {source} is a run, whose scene is fixed; remove --set"
            )
        return path


@dataclasses.dataclass(frozen=True)
class ToleranceOptions:
    """Options that give tolerances of the parts of a scene."""

    parts: Annotated[
        tuple[str, ...],
        Option(
            "standard deviation of one parameter of the scene: dotted key and tolerance, such as "
            "grains.remanence=2.5%% or 'cell.separation=0.05 mm' (repeatable)",
            "KEY=TOLERANCE",
            name="--part",
        ),
    ] = ()
    usual: Annotated[bool, Option("assume the usual tolerances of all parts named in the scene")] = False

    def __bool__(self) -> bool:
        return bool(self.parts) or self.usual

    def tolerances_by_key(self, scene: Scene | None) -> dict[str, str | float]:
        """Return the tolerances by key; a tolerance given by ``--part`` replaces the typical tolerance."""
        tolerances: dict[str, str | float] = {}
        if self.usual and scene is not None:
            from granular.studies.tolerances import usual_parts

            tolerances = usual_parts(scene)
        return tolerances | dict(_split_pairs("--part", self.parts, "KEY=TOLERANCE", "grains.remanence=2.5%"))


def _split_pairs(option: str, items: tuple[str, ...], form: str, example: str) -> Iterator[tuple[str, str]]:
    """Yield the key and value of each text ``KEY=VALUE`` given to an option."""
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key.strip():
            raise InputError(f"{option} {quote(item)} is not {form}; write {example}")
        yield key.strip(), value.strip()
