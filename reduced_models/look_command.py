"""The command ``look``: what was understood of a record's file."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from granular.readers.description import is_description, read_description, write_description
from granular.readers.reading import Reading
from granular.scene.units import si_value
from granular.shared.console import add_output, emit
from granular.shared.errors import InputError, SceneError
from granular.shared.messages import quoted

EXAMPLES = """\
examples:
  %(prog)s lab.csv
  %(prog)s lab.csv --columns time=t,height=dist --units height=mm --flip --between 0.5:6
  %(prog)s lab.csv --decimal , --skip 12 --write record.toml    # then: identify record.toml"""


def add_look(one: argparse.ArgumentParser) -> None:
    """The command's grammar."""
    one.add_argument("file", metavar="FILE", help="a record as an instrument wrote it")
    one.add_argument(
        "--columns", default="", metavar="ROLE=NAME,...",
        help="which column is time, height, velocity, force: by name, or by number from 1",
    )  # fmt: skip
    one.add_argument("--units", default="", metavar="NAME=UNIT,...", help="such as height=mm")
    one.add_argument("--decimal", metavar="SIGN", help="sign of the decimals, . or ,")
    one.add_argument("--skip", type=int, default=0, metavar="N", help="leave N lines at the head")
    one.add_argument("--sheet", metavar="NAME", help="of a workbook, a group, or a variable")
    one.add_argument("--flip", action="store_true", help="the coordinate grows downwards")
    one.add_argument("--between", metavar="T:T", help="only the samples between these times [s]")
    one.add_argument("--plot", metavar="FILE", help="draw the motion to this file (.png, .svg)")
    one.add_argument(
        "--write", metavar="FILE",
        help="write what was understood to this TOML file, which every command takes as a record",
    )  # fmt: skip
    add_output(one)


def run_look(options: Any) -> None:
    """Show what was understood, and keep it if asked."""
    from reduced_models.records.look import look, plot_look

    said, path = reading_from(options), Path(options.file)
    found = look(path, said)
    if options.plot is not None:
        from granular.render import save

        save(plot_look(found), options.plot, overwrite=True)
    if options.write is not None:
        if is_description(path):
            path, described = read_description(path)
            said = described.and_then(said)
        columns = {role: name for role, name in found.meaning.source.items() if name}
        understood = Reading(columns=columns, units=found.meaning.units)
        write_description(Path(options.write), path, understood.and_then(said))
    text = str(found)
    if options.write is not None:
        text += f"\nwritten to {options.write}"
    emit(found.to_plain() | {"description": options.write}, text, options.json)


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
