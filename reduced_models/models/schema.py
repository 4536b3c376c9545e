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
from granular.schema.sections import unknown
from granular.shared.errors import InputError
from granular.shared.files import read_text
from granular.shared.messages import quote, sanitize
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.law import Law
from reduced_models.models.quality import Quality
from reduced_models.records.inputs import INTERPOLATIONS
from reduced_models.records.sensor import Quantity

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


def _number(least: float = -_LARGEST, most: float = _LARGEST) -> Check:
    def check(where: str, value: Any) -> float:
        try:
            number = float(value) if isinstance(value, int | float) else math.nan
        except OverflowError:
            number = math.nan
        if isinstance(value, bool) or not least <= number <= most:
            raise _wrong_value_error(where, value, f"a number from {least:g} to {most:g}")
        return number

    return check


def _integer(least: int, most: int) -> Check:
    def check(where: str, value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise _wrong_value_error(where, value, f"an integer from {least} to {most}")
        return value

    return check


def _flag(where: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise _wrong_value_error(where, value, "true or false")
    return value


def _text(longest: int = _LONGEST, *, lines: bool = False) -> Check:
    def check(where: str, value: Any) -> str:
        if not isinstance(value, str) or len(value) > longest:
            raise _wrong_value_error(where, value, f"a text of at most {longest} characters")
        if not (" ".join(value.split()) if lines else value).isprintable():
            raise _wrong_value_error(where, value, "a text that can be printed")
        return value

    return check


def _one_of(known: Sequence[str]) -> Check:
    def check(where: str, value: Any) -> str:
        if value not in known:
            raise _wrong_value_error(where, value, f"one of {', '.join(known)}")
        return str(value)

    return check


def _format(where: str, value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value != FORMAT:
        raise _wrong_value_error(where, value, f"{FORMAT}, the one that this release reads,")
    return value


def _null_or(check: Check) -> Check:
    """Null, or what another check wants."""
    return lambda where, value: None if value is None else check(where, value)


def _list(element: Check, most: int = _MOST_ITEMS) -> Check:
    def check(where: str, value: Any) -> list[Any]:
        if not isinstance(value, list | tuple) or len(value) > most:
            raise _wrong_value_error(where, value, f"a list of at most {most} items")
        return [element(f"{where}.{index}", item) for index, item in enumerate(value)]

    return check


def _pair(where: str, value: Any) -> tuple[float, float]:
    """Two numbers in order; null stands for an infinite one."""
    ends = _list(_null_or(_number(-math.inf, math.inf)), 2)(where, value)
    if len(ends) != 2:
        raise _wrong_value_error(where, value, "a pair")
    low, high = -math.inf if ends[0] is None else ends[0], math.inf if ends[1] is None else ends[1]
    if low > high:
        raise _wrong_value_error(where, value, "a pair in order")
    return low, high


def _table(element: Check) -> Check:
    def check(where: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping) or len(value) > _MOST_ITEMS:
            raise _wrong_value_error(where, value, f"a table of at most {_MOST_ITEMS} entries")
        return {_text(200)(where, key): element(f"{where}.{key}", item) for key, item in value.items()}

    return check


def _shape(known: Mapping[str, Check]) -> Check:
    """Table with given keys."""

    def check(where: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise _wrong_value_error(where, value, "a table")
        for key in value:
            if key not in known:
                raise InputError(
                    "the data are not those of a reduced model: "
                    f"{sanitize(where)}: {unknown(str(key), tuple(known), 'key')}"
                )
        for key in known:
            if key not in value:
                raise InputError(
                    f"the data are not those of a reduced model: {sanitize(where)}: {key!r} is "
                    "missing; give the file that was saved"
                )
        return {key: known[key](f"{where}.{key}", item) for key, item in value.items()}

    return check


_SIZE = _number(0.0)
_MODEL = _shape(
    {
        "format": _format,
        "law": _text(MAX_CHARACTERS),
        "equation": _text(MAX_CHARACTERS, lines=True),
        "parameters": _table(_number()),
        "units": _table(_text(200)),
        "positive": _list(_text(200)),
        "mapped": _flag,
        "source": _text(),
        "intervals": _table(_pair),
        "confidence": _number(0.0, 1.0),
        "map": _shape({"shift": _number(), "scale": _number(), "fitted": _flag}),
        "initial": _list(_number(), 2),
        "at_rest": _null_or(
            _shape(
                {
                    "height": _number(),
                    "period": _SIZE,
                    "damping_ratio": _number(),
                    "intervals": _shape(dict.fromkeys(("height", "period", "damping_ratio"), _pair)),
                    "equivalent": _null_or(
                        _shape(
                            {
                                "amplitude": _SIZE,
                                "tenth_ratio": _number(),
                                "friction": _number(),
                                "intervals": _shape(dict.fromkeys(("tenth_ratio", "friction"), _pair)),
                            }
                        )
                    ),
                    "peaks": _null_or(_shape(dict.fromkeys(("mean", "low", "high", "noise"), _number()))),
                    "calibration": _table(_number(0.0, math.inf)),
                }
            )
        ),
        "quality": _shape(
            {
                "residual": _SIZE,
                "relative": _SIZE,
                "test_error": _null_or(_number(0.0, math.inf)),
                "test_swings": _list(_pair),
                "starts": _integer(0, 10**9),
                "converged": _integer(0, 10**9),
                "samples": _integer(0, 10**12),
                "solver_error": _SIZE,
                "test_error_at_rest": _null_or(_SIZE),
                "test_standard_error": _null_or(_SIZE),
                "shifts": _table(_SIZE),
                "noise": _SIZE,
                "correlation": _SIZE,
                "collocation": _one_of(("none", "same", "worse", "better")),
                "whiteness": _number(0.0, 1.0),
                "signs": _number(0.0, 1.0),
                "lag": _number(),
                "slow": _SIZE,
                "swinging": _SIZE,
                "drift": _SIZE,
            }
        ),
        "undetermined": _list(_shape({"powers": _table(_number()), "spread": _SIZE})),
        "domain": _table(_pair),
        "notes": _list(_text()),
        "latex": _text(100_000),
        "inputs": _list(_text(200)),
        "resolution": _integer(1, _MOST_RESOLUTION),
        "provenance": _table(_text()),
        "hidden": _table(_number()),
        "input_interpolation": _one_of(INTERPOLATIONS),
        "angle": _flag,
        "covariance_names": _list(_text(200)),
        "covariance": _list(_list(_number())),
        "no_swing": _text(200),
        "sensor": _null_or(
            _shape(
                {
                    "quantity": _one_of(get_args(Quantity)),
                    "gain": _number(),
                    "offset": _number(),
                    **dict.fromkeys(("low_pass", "high_pass", "damping_ratio"), _null_or(_SIZE)),
                    "absolute": _flag,
                    "column": _null_or(_text(200)),
                }
            )
        ),
        "untold": _list(_text(200)),
    }
)


def check_plain_model(data: object) -> dict[str, Any]:
    """Plain data of a model, if they are such; pairs with infinite ends for null.

    Raises
    ------
    InputError
        If they are not; the message says which entry, what it is, and what is wanted.
    """
    if isinstance(data, Mapping):  # models of earlier versions
        data = {"sensor": None, "untold": [], **data}
        if isinstance(data.get("at_rest"), Mapping):
            data["at_rest"] = {"calibration": {}, **data["at_rest"]}
    result: dict[str, Any] = _MODEL("model", data)
    parameters = result["parameters"]
    for name in result["positive"]:
        if not parameters.get(name, 0.0) > 0.0:
            raise _wrong_value_error(f"model.parameters.{name}", parameters.get(name), "a number above 0")
    fitted = ("shift", "scale") if result["map"]["fitted"] else ()
    for name in (*parameters, *fitted):
        if name not in result["intervals"]:
            raise _wrong_value_error(f"model.intervals.{name}", None, "a pair")
    if not result["map"]["scale"]:
        raise _wrong_value_error("model.map.scale", 0.0, "another number")
    size = len(result["covariance_names"])
    if [len(row) for row in result["covariance"]] != [size] * size:
        raise _wrong_value_error("model.covariance", result["covariance"], "a row and a column for each name")
    if len(result["initial"]) != 2:
        raise _wrong_value_error("model.initial", result["initial"], "a pair")
    return result


def read_model(path: Path) -> dict[str, Any]:
    """Plain data in a model's file, not checked yet.

    Raises
    ------
    InputError
        If there is no such file, or it holds no JSON object.
    """
    text = read_text(path, _MOST_BYTES)
    try:
        plain = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_refuse_duplicate_keys)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{sanitize(path)}: cannot be read as a model: {error}") from None
    if not isinstance(plain, dict):
        raise InputError(f"{sanitize(path)}: holds no model; give the model.json that was saved")
    return plain


def _refuse_constant(constant: str) -> float:
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
        mapped=plain["mapped"],
        source=plain["source"],
        inputs=tuple(plain["inputs"]),
        resolution=plain["resolution"],
    )
    if set(own.parameters) != set(plain["parameters"]):
        raise InputError(
            "the data are not those of a reduced model: the equation has the parameters "
            f"{', '.join(own.parameters) or 'none'}, and values are given of "
            f"{', '.join(map(sanitize, plain['parameters'])) or 'none'}; correct one of them"
        )
    packaged = LAWS.get(own.name)
    return packaged if packaged is not None and packaged.equation == own.equation else own


def quality_from_plain(plain: Mapping[str, Any]) -> Quality:
    """Quality of a model; an infinite error, which no file holds, is put back."""
    quality = Quality(**plain)
    if quality.test_error is None and quality.test_swings:
        return dataclasses.replace(quality, test_error=math.inf)
    return quality
