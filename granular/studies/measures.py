"""What a study writes down of each run."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from granular.studies.cases import Measure, known_as


def last_values(run: Trajectory) -> Mapping[str, Any]:
    """Every scalar record at the end of the run, in SI; height and end of each stage."""
    data = run.dataset
    figures = {
        str(name): float(data[name][-1])
        for name in data.data_vars
        if data[name].dims == ("time",) and name != "stage"
    }
    for stage in run.stages:
        figures[f"{stage.name}.end"] = stage.end
        if run.scene.piston is not None:
            figures[f"{stage.name}.height"] = stage.height
    return figures


@known_as("reduced_models.simulated:piston_columns#85abaa33")
def piston_columns(run: Trajectory) -> Mapping[str, Any]:
    """The piston's record of a run as lists; `PistonRecord.from_columns` makes it one again."""
    return {name: values.tolist() for name, values in run.piston().columns.items()}


def measure_named(name: str) -> Measure:
    """``"last-values"``, or a function by ``"module:function"``.

    Raises
    ------
    InputError
        If there is none.
    """
    if name == "last-values":
        return last_values
    module, _, function = name.partition(":")
    if not function:
        raise InputError(f"measure {quoted(name)}; give 'last-values', or 'module:function'")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise InputError(f"measure {quoted(name)} cannot be imported: {error}") from None
    if not callable(found):
        raise InputError(f"measure {quoted(name)} is no function")
    return found
