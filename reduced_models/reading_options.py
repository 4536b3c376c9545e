"""How a record's file is read: the options of all commands that take one."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

from granular.readers.reading import Reading
from granular.schema.units import si_value
from granular.shared.errors import InputError, SceneError
from granular.shared.messages import quoted


def add_reading(parser: argparse.ArgumentParser) -> None:
    """What a user can say of a record's file; `reading_from` reads it."""
    one = parser.add_argument_group("how a record's file is read, where it is not to be guessed")
    one.add_argument(
        "--columns", default="", metavar="ROLE=NAME,...",
        help="which column is time, height, velocity, force: by name, or by number from 1",
    )  # fmt: skip
    one.add_argument("--units", default="", metavar="NAME=UNIT,...", help="such as height=mm")
    one.add_argument("--decimal", metavar="SIGN", help="sign of the decimals, . or ,")
    one.add_argument("--skip", type=int, default=0, metavar="N", help="leave N lines at the head")
    one.add_argument("--sheet", metavar="NAME", help="of a workbook, a group, or a variable")
    one.add_argument("--flip", action="store_true", help="the coordinate grows downwards")
    one.add_argument(
        "--between", metavar="T:T",
        help="only the samples between these times [s]; ':' for all, also those before a release, "
        "which are left out otherwise",
    )  # fmt: skip


def reading_from(options: Any) -> Reading:
    """What the command line says of a file.

    Raises
    ------
    InputError
        If an option is no such.
    """
    between = None
    if options.between is not None:
        start, colon, stop = options.between.partition(":")
        try:
            between = (_time(start, -math.inf), _time(stop, math.inf))
        except SceneError:
            colon = ""
        if not colon:
            raise InputError(
                f"--between {quoted(options.between)}; give two times, such as 0.5:6 or '5 ms:6 s'"
            )
    return Reading(
        columns=_pairs("--columns", options.columns.split(",")),
        units=_pairs("--units", options.units.split(",")),
        decimal=options.decimal, skip=options.skip, sheet=options.sheet, flip=options.flip,
        between=between,
    )  # fmt: skip


def _time(words: str, missing: float) -> float:
    return si_value(words, "s") if words.strip() else missing


def _pairs(option: str, items: Sequence[str]) -> dict[str, str]:
    found = {}
    for item in items:
        if not item.strip():
            continue
        name, equals, value = item.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {quoted(item)} is not NAME=VALUE; write height=dist")
        found[name.strip()] = value.strip()
    return found
