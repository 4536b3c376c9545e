"""Measures that a study records of each run: those of the package, and those of a user's files."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import FunctionType
from typing import Any

from granular.observables.catalogue import per_frame
from granular.observables.frame import observable_metadata
from granular.run.dataset_variables import scalar_variables
from granular.run.trajectory import Trajectory
from granular.shared.registry import Registry
from granular.shared.user_file import UserFile, user_definitions
from granular.studies.cases import Measure, keep_measure_name, measure_identity


@keep_measure_name("granular.studies.measures:last_values#9d0c241c")
def last_values(run: Trajectory) -> Mapping[str, Any]:
    """Last value of every scalar record, and height and end of each stage, in SI [s, m]."""
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
    """Columns of the piston's record as lists [s, m, m/s, N], for `PistonRecord.from_columns`."""
    return {name: values.tolist() for name, values in run.piston().columns.items()}


MEASURES = Registry[Measure](
    "measure",
    "granular.measures",
    {"last-values": last_values},
    lambda _, measure: callable(measure),
    "a function",
    from_files=True,
)
"""Measures by their names, without those of a user's files."""


def find_measure(name: str, user_measures: Mapping[str, Measure] | None = None) -> Measure:
    """Find a measure by its name: "last-values", one of the user's own, or an installed entry point."""
    # A name is looked up and never imported: no study's file decides which code runs.
    known = {**(user_measures or {}), "last-values": last_values}
    return known[name] if name in known else MEASURES.find(name)


@dataclasses.dataclass(frozen=True)
class CustomMeasure:
    """A function of a user's file, with the file's text: any other process can have it so."""

    file: UserFile
    name: str
    keep_measure_name: str

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """Return the function's figures of a run."""
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
    """Make measures of the functions and observables that a user's file defines."""
    return {
        name: CustomMeasure(file, name, measure_identity(function))
        for name, function in user_definitions(file).items()
        if isinstance(function, FunctionType) and function.__module__ == file.module_name
    }
