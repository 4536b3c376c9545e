"""Plain data of a stored model: checked before anything is made of them, then its parts.

A file of a model may come from anybody. Each check reads one value and gives it back; what does not
fit is named by the path that leads to it.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from granular.formulas import MAX_CHARACTERS
from granular.schema.field_kinds import unknown_word_message
from granular.shared.errors import InputError
from granular.shared.files import read_text
from granular.shared.message_text import quote, sanitize
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law
from reduced_models.models.at_rest import AtRest, EquivalentDamping
from reduced_models.models.harmonic_cycle import HarmonicCycle
from reduced_models.models.quality import Quality
from reduced_models.records.envelope import PeakDamping
from reduced_models.records.inputs import INTERPOLATIONS
from reduced_models.records.sensor import SensorQuantity

FORMAT = 1
"""Version of the files that are written and read."""

_MOST_BYTES = 8 * 2**20  # a hundred times a model with all its notes
_MOST_ITEMS = 200
_LONGEST = 4000  # characters of a note
_LARGEST = 1e100  # of a number: its square and cube are numbers still
_MOST_RESOLUTION = 64

Check = Callable[[str, Any], Any]


def _wrong_value_error(where: str, value: object, wanted: str) -> InputError:
    return InputError(
        f"the data are not those of a reduced model: {sanitize(where)} is {quote(value)}; {wanted} is wanted"
    )


def _number_checker(least: float = -_LARGEST, most: float = _LARGEST) -> Check:
    def check(where: str, value: Any) -> float:
        try:
            number = float(value) if isinstance(value, int | float) else math.nan
        except OverflowError:
            number = math.nan
        if isinstance(value, bool) or not least <= number <= most:
            raise _wrong_value_error(where, value, f"a number from {least:g} to {most:g}")
        return number

    return check


def _integer_checker(least: int, most: int) -> Check:
    def check(where: str, value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise _wrong_value_error(where, value, f"an integer from {least} to {most}")
        return value

    return check


def _check_flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise _wrong_value_error(where, value, "true or false")
    return value


def _text_checker(longest: int = _LONGEST, *, lines: bool = False) -> Check:
    def check(where: str, value: Any) -> str:
        if not isinstance(value, str) or len(value) > longest:
            raise _wrong_value_error(where, value, f"a text of at most {longest} characters")
        if not (" ".join(value.split()) if lines else value).isprintable():
            raise _wrong_value_error(where, value, "a text that can be printed")
        return value

    return check


def _one_of_checker(known: Sequence[str]) -> Check:
    def check(where: str, value: Any) -> str:
        if value not in known:
            raise _wrong_value_error(where, value, f"one of {', '.join(known)}")
        return str(value)

    return check


def _check_format(where: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value != FORMAT:
        raise _wrong_value_error(where, value, f"{FORMAT}, the one that this release reads,")
    return value


def _null_or_checker(check: Check) -> Check:
    """Null, or what another check wants."""
    return lambda where, value: None if value is None else check(where, value)


def _list_checker(element: Check, most: int = _MOST_ITEMS) -> Check:
    def check(where: str, value: Any) -> list[Any]:
        if not isinstance(value, list | tuple) or len(value) > most:
            raise _wrong_value_error(where, value, f"a list of at most {most} items")
        return [element(f"{where}.{index}", item) for index, item in enumerate(value)]

    return check


def _check_pair(where: str, value: Any) -> tuple[float, float]:
    """Two numbers in order; null stands for an infinite one."""
    ends = _list_checker(_null_or_checker(_number_checker(-math.inf, math.inf)), 2)(where, value)
    if len(ends) != 2:
        raise _wrong_value_error(where, value, "a pair")
    low, high = -math.inf if ends[0] is None else ends[0], math.inf if ends[1] is None else ends[1]
    if low > high:
        raise _wrong_value_error(where, value, "a pair in order")
    return low, high


def _table_checker(element: Check) -> Check:
    def check(where: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping) or len(value) > _MOST_ITEMS:
            raise _wrong_value_error(where, value, f"a table of at most {_MOST_ITEMS} entries")
        return {
            _text_checker(200)(where, key): element(f"{where}.{key}", item) for key, item in value.items()
        }

    return check


def _keyed_table_checker(known: Mapping[str, Check]) -> Check:
    """Table with given keys."""

    def check(where: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise _wrong_value_error(where, value, "a table")
        for key in value:
            if key not in known:
                raise InputError(
                    "the data are not those of a reduced model: "
                    f"{sanitize(where)}: {unknown_word_message(str(key), tuple(known), 'key')}"
                )
        for key in known:
            if key not in value:
                raise InputError(
                    f"the data are not those of a reduced model: {sanitize(where)}: {key!r} is "
                    "missing; give the file that was saved"
                )
        return {key: known[key](f"{where}.{key}", item) for key, item in value.items()}

    return check


_SIZE = _number_checker(0.0)
_QUALITY = _keyed_table_checker(
    {
        "residual": _SIZE,
        "relative": _SIZE,
        "test_error": _null_or_checker(_number_checker(0.0, math.inf)),
        "test_swings": _list_checker(_check_pair),
        "starts": _integer_checker(0, 10**9),
        "converged": _integer_checker(0, 10**9),
        "samples": _integer_checker(0, 10**12),
        "solver_error": _SIZE,
        "test_error_at_rest": _null_or_checker(_SIZE),
        "test_standard_error": _null_or_checker(_SIZE),
        "shifts": _table_checker(_SIZE),
        "noise": _SIZE,
        "correlation": _SIZE,
        "collocation": _one_of_checker(("none", "same", "worse", "better")),
        "whiteness": _number_checker(0.0, 1.0),
        "signs": _number_checker(0.0, 1.0),
        "lag": _number_checker(),
        "slow": _SIZE,
        "swinging": _SIZE,
        "drift": _SIZE,
        "rounded": _check_flag,
        "zero_drift": _SIZE,
    }
)
_CYCLE = _keyed_table_checker(
    {
        **dict.fromkeys(
            ("amplitude", "frequency", "centre", "stiffness", "damping", "energy"), _number_checker()
        ),
        "errors": _list_checker(_null_or_checker(_SIZE), 3),
        "measured": _integer_checker(0, 10**12),
    }
)
_MODEL = _keyed_table_checker(
    {
        "format": _check_format,
        "law": _text_checker(MAX_CHARACTERS),
        "equation": _text_checker(MAX_CHARACTERS, lines=True),
        "parameters": _table_checker(_number_checker()),
        "units": _table_checker(_text_checker(200)),
        "positive": _list_checker(_text_checker(200)),
        "source": _text_checker(),
        "intervals": _table_checker(_check_pair),
        "confidence": _number_checker(0.0, 1.0),
        "initial": _list_checker(_number_checker(), 2),
        "at_rest": _null_or_checker(
            _keyed_table_checker(
                {
                    "height": _number_checker(),
                    "period": _SIZE,
                    "damping_ratio": _number_checker(),
                    "intervals": _keyed_table_checker(
                        dict.fromkeys(("height", "period", "damping_ratio"), _check_pair)
                    ),
                    "equivalent": _null_or_checker(
                        _keyed_table_checker(
                            {
                                "amplitude": _SIZE,
                                "tenth_ratio": _number_checker(),
                                "friction": _number_checker(),
                                "intervals": _keyed_table_checker(
                                    dict.fromkeys(("tenth_ratio", "friction"), _check_pair)
                                ),
                                "own": _check_flag,
                            }
                        )
                    ),
                    "peaks": _null_or_checker(
                        _keyed_table_checker(
                            dict.fromkeys(("mean", "low", "high", "noise"), _number_checker())
                        )
                    ),
                    "calibration": _table_checker(_number_checker(0.0, math.inf)),
                    "angle": _check_flag,
                }
            )
        ),
        "quality": _QUALITY,
        "undetermined": _list_checker(
            _keyed_table_checker({"powers": _table_checker(_number_checker()), "spread": _SIZE})
        ),
        "domain": _table_checker(_check_pair),
        "notes": _list_checker(_text_checker()),
        "latex": _text_checker(100_000),
        "inputs": _list_checker(_text_checker(200)),
        "resolution": _integer_checker(1, _MOST_RESOLUTION),
        "provenance": _table_checker(_text_checker(lines=True)),
        "hidden": _table_checker(_number_checker()),
        "input_interpolation": _one_of_checker(INTERPOLATIONS),
        "angle": _check_flag,
        "covariance_names": _list_checker(_text_checker(200)),
        "covariance": _list_checker(_list_checker(_number_checker())),
        "no_swing": _text_checker(200),
        "sensor": _null_or_checker(
            _keyed_table_checker(
                {
                    "quantity": _one_of_checker(get_args(SensorQuantity)),
                    "gain": _number_checker(),
                    "offset": _number_checker(),
                    **dict.fromkeys(("low_pass", "high_pass", "damping_ratio"), _null_or_checker(_SIZE)),
                    "absolute": _check_flag,
                    "column": _null_or_checker(_text_checker(200)),
                }
            )
        ),
        "untold": _list_checker(_text_checker(200)),
        "conventions": _table_checker(_number_checker()),
        "observation": _text_checker(200),
        "quantile": _SIZE,
        "cycles": _list_checker(_CYCLE),
        "qualities": _table_checker(_QUALITY),
    }
)


def check_plain_model(data: object) -> dict[str, Any]:
    """Check that plain data are those of a model, and put infinite ends in place of null."""
    if isinstance(data, Mapping):  # models of earlier versions
        data = _with_map_in_law(data)
        since = {"observation": "", "quantile": 1.96, "cycles": [], "qualities": {}}
        data = {"sensor": None, "untold": [], "conventions": {}, **since, **data}
        if isinstance(data.get("quality"), Mapping):
            data["quality"] = {"rounded": False, "zero_drift": 0.0, **data["quality"]}
        if isinstance(data.get("at_rest"), Mapping):
            data["at_rest"] = {"calibration": {}, "angle": data.get("angle", False), **data["at_rest"]}
            if isinstance(equivalent := data["at_rest"].get("equivalent"), Mapping):
                data["at_rest"]["equivalent"] = {"own": False, **equivalent}
    result: dict[str, Any] = _MODEL("model", data)
    parameters = result["parameters"]
    every = {**result["conventions"], **parameters}
    for name in result["positive"]:
        if not every.get(name, 0.0) > 0.0:
            raise _wrong_value_error(f"model.parameters.{name}", every.get(name), "a number above 0")
    for name in parameters:
        if name not in result["intervals"]:
            raise _wrong_value_error(f"model.intervals.{name}", None, "a pair")
    size = len(result["covariance_names"])
    if [len(row) for row in result["covariance"]] != [size] * size:
        raise _wrong_value_error("model.covariance", result["covariance"], "a row and a column for each name")
    if len(result["initial"]) != 2:
        raise _wrong_value_error("model.initial", result["initial"], "a pair")
    return result


_MAP = _keyed_table_checker({"shift": _number_checker(), "scale": _number_checker(), "fitted": _check_flag})
_MAP_IN_LAW = "read from an earlier version's file: the map of the height is now part of the law, {0}"


def _with_map_in_law(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return plain data with the map of the height, which stood beside the law, as two of its parameters."""
    result = {key: value for key, value in data.items() if key not in ("map", "mapped")}
    if data.get("map") is None:
        return result
    line = _MAP("model.map", data["map"])
    values = {name: line[name] for name in ("shift", "scale")}
    if not values["scale"]:
        raise _wrong_value_error("model.map.scale", 0.0, "another number")
    if not line["fitted"] and values == {"shift": 0.0, "scale": 1.0}:
        return result
    if set(values) & {*(result.get("parameters") or ())}:
        raise InputError(
            "the data are those of an earlier version's model whose law has a parameter shift or scale "
            "beside its map; fit the law again"
        )
    text = "height = shift + scale*z"
    given = {name: (value, value) for name, value in values.items()}
    for key, more in (("parameters", values), ("intervals", given), ("units", dict.fromkeys(values, "m"))):
        present = _table_checker(lambda _, value: value)(f"model.{key}", result.get(key))
        result[key] = {**more, **present} if key == "intervals" else {**present, **more}
    result["equation"] = f"{result.get('equation')}; {text}"
    result["positive"] = [*(result.get("positive") or ()), *(["scale"] if values["scale"] > 0.0 else [])]
    result["notes"] = [*(result.get("notes") or ()), _MAP_IN_LAW.format(text)]
    return result


def read_plain_model(path: Path) -> dict[str, Any]:
    """Plain data in a model's file, not checked yet."""
    text = read_text(path, _MOST_BYTES)
    try:
        plain = json.loads(
            text, parse_constant=_refuse_non_finite_constant, object_pairs_hook=_refuse_duplicate_keys
        )
    except (ValueError, RecursionError) as error:
        raise InputError(f"{sanitize(path)}: cannot be read as a model: {error}") from None
    if not isinstance(plain, dict):
        raise InputError(f"{sanitize(path)}: holds no model; give the model.json that was saved")
    return plain


def _refuse_non_finite_constant(constant: str) -> float:
    raise ValueError(f"{constant} is no number in JSON; correct it")


def _refuse_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("an entry is there twice; drop one")
    return result


def law_from_plain(plain: Mapping[str, Any]) -> Law:
    """Law of the package, or one of the user's own, from its equation."""
    own = Law(
        name=plain["law"],
        equation=plain["equation"],
        positive=tuple(plain["positive"]),
        units=plain["units"],
        source=plain["source"],
        inputs=tuple(plain["inputs"]),
        resolution=plain["resolution"],
    )
    given = {**plain["conventions"], **plain["parameters"]}
    if set(own.parameters) != set(given):
        raise InputError(
            "the data are not those of a reduced model: the equation has the parameters "
            f"{', '.join(own.parameters) or 'none'}, and values are given of "
            f"{', '.join(map(sanitize, given)) or 'none'}; correct one of them"
        )
    packaged = (LAWS.get(own.name), FORCE_LAWS.get(own.name))
    return next((law for law in packaged if law is not None and law.equation == own.equation), own)


def at_rest_from_plain(plain: Mapping[str, Any]) -> AtRest:
    """Small motions about the level of rest."""
    kinds = {"equivalent": EquivalentDamping, "peaks": PeakDamping}
    parts = {name: None if plain[name] is None else kind(**plain[name]) for name, kind in kinds.items()}
    return AtRest(**{**plain, **parts})


def cycle_from_plain(plain: Mapping[str, Any]) -> HarmonicCycle:
    """Cycle of a force; errors that are not known, which no file holds, are put back."""
    errors = tuple(math.nan if error is None else error for error in plain["errors"])
    return HarmonicCycle(**{**plain, "errors": errors})


def quality_from_plain(plain: Mapping[str, Any]) -> Quality:
    """Quality of a model; an infinite error, which no file holds, is put back."""
    quality = Quality(**plain)
    if quality.test_error is None and quality.test_swings:
        return dataclasses.replace(quality, test_error=math.inf)
    return quality
