"""Checks of a stored model's plain data, and conversion to its parts.

Model files are untrusted. Each entry is checked against the annotated type of its field before use; an
error names the path of the invalid entry.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from granular.shared.errors import InputError, sanitize
from granular.shared.files import read_text
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law
from reduced_models.models.plain_data import (
    Lines,
    NumberLimits,
    TextForm,
    field_annotations_of_class,
    plain_value,
    read_entries,
    read_value,
    wrong_value_error,
)
from reduced_models.models.quantities import Quality

FORMAT = 1
"""Version of the file format that is written and read."""

_MAXIMUM_BYTES = 8 * 2**20  # a hundred times the size of a model with notes
_LAW = {
    "equation": Lines,
    "units": Mapping[str, str],
    "positive": tuple[str, ...],
    "source": str,
    "inputs": tuple[str, ...],
    "resolution": Annotated[int, NumberLimits(1, 64)],
}
"""Fields of a law stored in a file, with their types."""
_IN_FILE = {
    **_LAW,
    "format": int,
    "law": str,
    "latex": Annotated[str, TextForm(100_000)],
    "covariance": tuple[tuple[float, ...], ...],
}
"""Types of the entries that are not fields of a model, or that are stored in another form."""
_MAP = {"shift": float, "scale": float, "fitted": bool}
_MAP_IN_LAW = "read from a file of an earlier version; its equation {0} is now part of the law"


def law_to_plain(law: Law) -> dict[str, Any]:
    """Return the name and the fields of a law as plain data."""
    return {"law": law.name, **{name: plain_value(getattr(law, name)) for name in _LAW}}


def fields_from_plain(data: object, kind: type) -> dict[str, Any]:
    """Return the fields of a model class from plain data; null ends of intervals become infinite."""
    line = None
    if isinstance(data, Mapping):  # models of earlier versions
        line = data.get("map")
        data = {key: item for key, item in data.items() if key not in ("map", "mapped")}
        data = _with_entries_missing_in_earlier_versions(_with_coordinate_unit("model", data))
    result = read_entries({**field_annotations_of_class(kind), **_IN_FILE}, "model", data)
    if result["format"] != FORMAT:
        wanted = f"{FORMAT}, the version that this release reads"
        raise wrong_value_error("model.format", result["format"], wanted)
    if line is not None:
        result = _with_height_line_in_law(result, read_entries(_MAP, "model.map", line))
    _check_signs_and_intervals(result)
    size = len(result["covariance_names"])
    if [len(row) for row in result["covariance"]] != [size] * size:
        rows = list(map(list, result["covariance"]))
        raise wrong_value_error("model.covariance", rows, "a row and a column for each name")
    result["law"] = _law_from_plain(result)
    result["covariance"] = np.reshape(result["covariance"], (size, size))
    result["quality"] = _with_infinite_test_error_restored(result["quality"])
    result["qualities"] = {
        name: _with_infinite_test_error_restored(item) for name, item in result["qualities"].items()
    }
    return {name: result[name] for name in field_annotations_of_class(kind)}


def _with_entries_missing_in_earlier_versions(data: Mapping[str, Any]) -> dict[str, Any]:
    """Add to plain data the entries that files of earlier versions lack."""
    since = {"observation": "", "quantile": 1.96, "cycles": [], "qualities": {}}
    data = {"sensor": None, "untold": [], "conventions": {}, **since, **data}
    if isinstance(data.get("quality"), Mapping):
        data["quality"] = {"rounded": False, "zero_drift": 0.0, "independent": None, **data["quality"]}
    if isinstance(data["qualities"], Mapping):
        data["qualities"] = {
            name: {"independent": None, **item} if isinstance(item, Mapping) else item
            for name, item in data["qualities"].items()
        }
    if isinstance(data.get("at_rest"), Mapping):
        rest = _with_coordinate_unit("model.at_rest", data["at_rest"])
        data["at_rest"] = {"calibration": {}, "coordinate_unit": data.get("coordinate_unit", "m"), **rest}
        if isinstance(equivalent := data["at_rest"].get("equivalent"), Mapping):
            data["at_rest"]["equivalent"] = {"own": False, **equivalent}
    return data


def _with_coordinate_unit(path: str, data: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the flag ``angle`` of earlier versions by the unit of the coordinate."""
    if "angle" not in data:
        return dict(data)
    angle = read_value(bool, f"{path}.angle", data["angle"])
    others = {key: item for key, item in data.items() if key != "angle"}
    return {"coordinate_unit": "rad" if angle else "m", **others}


def _with_height_line_in_law(result: dict[str, Any], line: Mapping[str, Any]) -> dict[str, Any]:
    """Move ``shift`` and ``scale``, which earlier versions stored separately, into the law's parameters."""
    values = {name: line[name] for name in ("shift", "scale")}
    if not values["scale"]:
        raise wrong_value_error("model.map.scale", 0.0, "another number")
    if not line["fitted"] and values == {"shift": 0.0, "scale": 1.0}:
        return result
    if set(values) & set(result["parameters"]):
        raise InputError(
            "the data are a model of an earlier version whose law has a parameter shift or scale "
            "in addition to the equation height = shift + scale*z; fit the law again"
        )
    text = "height = shift + scale*z"
    return {
        **result,
        "parameters": {**result["parameters"], **values},
        "intervals": {**{name: (value, value) for name, value in values.items()}, **result["intervals"]},
        "units": {**result["units"], **dict.fromkeys(values, "m")},
        "equation": f"{result['equation']}; {text}",
        "positive": (*result["positive"], *(["scale"] if values["scale"] > 0.0 else [])),
        "notes": (*result["notes"], _MAP_IN_LAW.format(text)),
    }


def _check_signs_and_intervals(result: Mapping[str, Any]) -> None:
    """Raise an error if a positive parameter is not above 0, or a number has no interval."""
    every = {**result["conventions"], **result["parameters"]}
    for name in result["positive"]:
        if not every.get(name, 0.0) > 0.0:
            raise wrong_value_error(f"model.parameters.{name}", every.get(name), "a number above 0")
    rest = result["at_rest"]
    needed = [("model", result["parameters"], result["intervals"])]
    if rest is not None:
        needed.append(("model.at_rest", ("height", "period", "damping_ratio"), rest.intervals))
        if (other := rest.equivalent) is not None:
            needed.append(("model.at_rest.equivalent", ("tenth_ratio", "friction"), other.intervals))
    for path, names, intervals in needed:
        for name in names:
            if name not in intervals:
                raise wrong_value_error(f"{path}.intervals.{name}", None, "a pair")


def _with_infinite_test_error_restored(quality: Quality) -> Quality:
    """Restore an infinite test error, which files cannot store."""
    diverged = quality.test_error is None and bool(quality.test_swings)
    return dataclasses.replace(quality, test_error=math.inf) if diverged else quality


def read_plain_model(path: Path) -> dict[str, Any]:
    """Return the unchecked plain data in a model's file."""
    text = read_text(path, _MAXIMUM_BYTES)
    try:
        plain = json.loads(
            text, parse_constant=_refuse_non_finite_constant, object_pairs_hook=_refuse_duplicate_keys
        )
    except (ValueError, RecursionError) as error:
        raise InputError(f"{sanitize(path)}: cannot be read as a model: {error}") from None
    if not isinstance(plain, dict):
        raise InputError(f"{sanitize(path)}: contains no model; give a saved model.json")
    return plain


def _refuse_non_finite_constant(constant: str) -> float:
    raise ValueError(f"{constant} is not a number in JSON; correct it")


def _refuse_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("an entry occurs twice; remove one")
    return result


def _law_from_plain(plain: Mapping[str, Any]) -> Law:
    """Return a law from plain data: a law of the package, or a user-defined one."""
    own = Law(name=plain["law"], **{name: plain[name] for name in _LAW})
    given = {**plain["conventions"], **plain["parameters"]}
    if set(own.parameters) != set(given):
        raise InputError(
            "the data are not a reduced model: the equation has the parameters "
            f"{', '.join(own.parameters) or 'none'}, but the data contain values for "
            f"{', '.join(map(sanitize, given)) or 'none'}; correct one of them"
        )
    packaged = (laws.load()[0].get(own.name) for laws in (LAWS, FORCE_LAWS))
    return next((law for law in packaged if law is not None and law.equation == own.equation), own)
