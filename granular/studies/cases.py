"""Cases of a study, with a key that identifies each computation, and their outcomes."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

from granular.methods.tables import method_as_run_setting, resolve_method
from granular.observables.catalogue import per_frame
from granular.observables.frame import observable_metadata
from granular.run.dataset import scalar_variables
from granular.run.plan import parse_time_step
from granular.run.summary import custom_code_digests
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.errors import InputError, quote
from granular.shared.files import ResultCache, digest
from granular.shared.function_digest import functions_digest
from granular.shared.registry import Registry
from granular.shared.user_file import UserFile, user_definitions
from granular.shared.version import __version__

Measure = Callable[[Trajectory], Mapping[str, Any]]
M = TypeVar("M", bound=Measure)

KEY_LENGTH = 20  # 80 bits: a collision among a million cases has a probability of 4e-13


@dataclasses.dataclass(frozen=True)
class Case:
    """One case of a study."""

    changes: dict[str, Any]  # changed values, by dotted key or name of a setting
    scene: Scene
    settings: dict[str, Any]  # keyword arguments of `simulate`
    key: str  # digest of scene, settings and measure


MACHINE = "machine"
"""Cause of an error due to disk, memory or processes; the same case may succeed later."""
PROGRAM = "program"
"""Cause of an error in the measure or the toolkit; the case fails until the error is corrected."""
ELSEWHERE = "elsewhere"
"""Cause of a missing result if another sweep is computing the case."""


@dataclasses.dataclass(frozen=True)
class CaseOutcome:
    """Outcome of a case. Only results, and errors due to the physics of the case, are stored on disk.

    Attributes
    ----------
    figures : mapping of str to numbers
        Results of the measure; empty for a failed case.
    error : str or None
        Class and message of the error of a failed case.
    warning : str or None
        Warning of a case that succeeded.
    cause : str or None
        Cause of an error that is not due to the physics, and is therefore not stored: `MACHINE`, `PROGRAM`
        or `ELSEWHERE`.
    """

    figures: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    error: str | None = None
    warning: str | None = None
    cause: str | None = None


@dataclasses.dataclass(frozen=True)
class OutcomeCache:
    """Outcomes in the directory of a study, each in a file named after the key of its case."""

    directory: Path

    @property
    def files(self) -> ResultCache:
        """Cache of the files with the outcomes."""
        return ResultCache(self.directory / "cases")

    def read(self, key: str, *, warn: bool = True) -> CaseOutcome | None:
        """Read the outcome of a case, or return None if there is no stored outcome."""
        plain = self.files.read(key, warn=warn)
        return None if plain is None else CaseOutcome(plain["figures"], plain["error"], plain.get("warning"))

    def store(self, key: str, outcome: CaseOutcome) -> None:
        """Store the outcome of a case."""
        warning = {} if outcome.warning is None else {"warning": outcome.warning}
        self.files.store(key, {"figures": outcome.figures, "error": outcome.error, **warning})


def keep_measure_name(name: str) -> Callable[[M], M]:
    """Give a measure a fixed name, by which stored results are found; change the name if results change."""

    def named(measure: M) -> M:
        measure.keep_measure_name = name  # type: ignore[attr-defined]  # functions may have any
        return measure

    return named


def measure_identity(measure: Measure) -> str:
    """Return a string that identifies a measure: its fixed name, or its name and a digest of its code."""
    if hasattr(measure, "keep_measure_name"):
        return str(measure.keep_measure_name)
    name = getattr(measure, "__qualname__", type(measure).__qualname__)
    return f"{measure.__module__}:{name}#{functions_digest({'measure': measure})}"


def make_cases(
    scene: Scene,
    grid: Mapping[str, Iterable[Any]],
    cases: Sequence[Mapping[str, Any]],
    settings: Mapping[str, Any],
    measure: Measure,
) -> list[Case]:
    """Make the cases of a study: all combinations of the grid, followed by the individual cases."""
    values = {name: _values_list(name, listed) for name, listed in grid.items()}
    combined = [dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())]
    all_changes = [*(combined if values else []), *map(dict, cases)]
    if not all_changes:
        raise InputError("the study has no cases; add a grid or a list of cases")
    identity = measure_identity(measure)
    result = [_make_case(scene, changes, dict(settings), identity) for changes in all_changes]
    seen: dict[str, Case] = {}
    for case in result:
        if case.key in seen:
            raise InputError(f"two cases are the same: {seen[case.key].changes} and {case.changes}")
        seen[case.key] = case
    return result


def _values_list(name: str, values: Iterable[Any]) -> list[Any]:
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise InputError(f"grid {quote(name)} = {quote(values)} must be a list of values")
    return list(values)


def _make_case(scene: Scene, changes: dict[str, Any], settings: dict[str, Any], identity: str) -> Case:
    case_settings = {name: value for name, value in changes.items() if name in settings}
    settings = settings | case_settings
    parse_time_step(settings["dt"])
    method = resolve_method(settings["method"])
    settings["method"] = method_as_run_setting(method)
    if "method" in case_settings:
        changes = changes | {"method": method.name}
    changed = scene.replace(**{name: changes[name] for name in changes if name not in case_settings})
    content = {"scene": changed.to_plain(), "settings": settings, "measure": identity, "version": __version__}
    if user_code := custom_code_digests(changed):
        content["own"] = user_code
    return Case(changes, changed, settings, digest(content, KEY_LENGTH))


@keep_measure_name("granular.studies.cases:last_values#9d0c241c")
def last_values(run: Trajectory) -> Mapping[str, Any]:
    """Return the last value of every scalar record, and height [m] and end [s] of each stage, in SI."""
    data = run.dataset
    names = [scalar_variable.name for scalar_variable in scalar_variables(run.scene)]
    figures = {name: float(data[name][-1]) for name in names}
    for stage in run.stages:
        figures[f"{stage.name}.end"] = stage.end
        if run.scene.piston is not None:
            figures[f"{stage.name}.height"] = stage.height
    return figures


@keep_measure_name("reduced_models.simulated:piston_columns#85abaa33")
def piston_columns(run: Trajectory) -> Mapping[str, Any]:
    """Return the piston's record as lists in SI by column, as `PistonRecord.from_columns` takes them."""
    return {name: values.tolist() for name, values in run.piston().columns.items()}


MEASURES = Registry[Measure](
    "measure",
    "granular.measures",
    {"last-values": last_values},
    lambda _, measure: callable(measure),
    "a function",
    from_files=True,
)
"""Built-in measures by name."""


def find_measure(name: str, user_measures: Mapping[str, Measure] | None = None) -> Measure:
    """Find a measure by name: "last-values", or a measure from a user's file or an installed package."""
    # Names are looked up and never imported, so that a study file cannot choose the code that runs.
    known = {**(user_measures or {}), "last-values": last_values}
    return known[name] if name in known else MEASURES.find(name)


@dataclasses.dataclass(frozen=True)
class CustomMeasure:
    """Function from a user's file, with the text of the file, so that other processes can define it too."""

    file: UserFile
    name: str
    keep_measure_name: str

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """Evaluate the function on a run."""
        result = user_definitions(self.file)[self.name]
        if (marked := observable_metadata(result)) is not None:
            last = per_frame(run, result)[-1]
            if "label" not in last.dims:
                return {marked.name: last.values.tolist()}
            labels = map(str, last["label"].values)
            return {f"{marked.name}.{k}": part.values.tolist() for k, part in zip(labels, last, strict=True)}
        figures: Mapping[str, Any] = result(run)
        return figures


def custom_measures(file: UserFile) -> dict[str, CustomMeasure]:
    """Make measures from the functions and observables defined in a user's file."""
    return {
        name: CustomMeasure(file, name, measure_identity(function))
        for name, function in user_definitions(file).items()
        if isinstance(function, FunctionType) and function.__module__ == file.module_name
    }
