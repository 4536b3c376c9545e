"""The commands ``look`` and ``example``, and options and sources of all commands that take a record."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import Option, command, option, option_group, print_result
from granular.commands.options import OUTPUT
from granular.readers.read_options import ALL
from granular.shared.errors import CautionWarning, InputError, SceneError
from granular.shared.message_text import quote

if TYPE_CHECKING:
    from granular.readers.read_options import ReadOptions
    from granular.run.piston_record import PistonRecord


def repeated_option(*names: str, **settings: Any) -> Option:
    """Declare an option that may be given several times."""
    return option(*names, action="append", default=[], **settings)


A_SOURCE = "a scene (name or TOML file), a run directory, or a record as an instrument wrote it"
SOURCES = option("sources", nargs="*", metavar="SOURCE", help=A_SOURCE)

_PAIRS = re.compile(r",(?=[^,=]+=)")
"""Commas between pairs, and not in a heading as it stands in a file."""

READING = option_group(
    repeated_option(
        "--columns",
        metavar="ROLE=NAME,...",
        help="which column is time, height (or angle; or stroke, where it is prescribed and the force "
        "is measured), velocity, force, acceleration, base_height, base_acceleration, or an input that "
        "is called so: by name, or by number from 1",
    ),
    option("--units", action="append", default=[], metavar="NAME=UNIT,...", help="such as height=mm"),
    option("--decimal", metavar="SIGN", help="sign of the decimals, . or ,"),
    option("--skip", type=int, default=0, metavar="N", help="leave N lines at the head"),
    option("--sheet", metavar="NAME", help="of a workbook, a group, or a variable"),
    option("--flip", action="store_true", help="the coordinate grows downwards"),
    option(
        "--between",
        metavar="T:T",
        help="only the samples between these times [s]; ':' for all, also those before a release, "
        "which are left out otherwise",
    ),
    repeated_option(
        "--scale",
        metavar="[COLUMN=]SCALE",
        help="calibration of the height, or of a COLUMN, such as '2.4894 +- 0.003 mm/V' (repeatable)",
    ),
    repeated_option(
        "--zero", metavar="[COLUMN=]VALUE", help="the column's number at the height 0: '2.513 V' (repeatable)"
    ),
    repeated_option(
        "--calibration",
        metavar="[COLUMN=]FILE",
        help="instead of a scale, a file of points with the columns raw, value and uncertainty, "
        "through which a straight line is laid (repeatable)",
    ),
    option(
        "--release",
        metavar="N",
        help="which of several releases in a file: its number, or 'all' of them together (for fit, "
        "compare and discover); the first if not given",
    ),
    option("--rate", metavar="RATE", help="sampling rate of a file without times: '610.35 Hz'"),
    option(
        "--sort",
        action="store_true",
        help="put the rows in the order of their times, those of one time as their mean",
    ),
    title="how a record's file is read, where it is not to be guessed",
)


def parse_reading_options(options: Any) -> ReadOptions:
    """Options of reading a file, from the options of the command line."""
    from granular.readers.read_options import ReadOptions

    between = None
    if options.between is not None:
        start, colon, stop = options.between.partition(":")
        try:
            between = (_parse_time(start, -math.inf), _parse_time(stop, math.inf))
        except SceneError:
            colon = ""
        if not colon:
            raise InputError(
                f"--between {quote(options.between)}; give two times, such as 0.5:6 or '5 ms:6 s'"
            )
    return ReadOptions(
        columns=_parse_pairs("--columns", options.columns),
        units=_parse_pairs("--units", options.units),
        decimal=options.decimal,
        skip=options.skip,
        sheet=options.sheet,
        flip=options.flip,
        between=between,
        scale=_parse_by_column("--scale", options.scale),
        zero=_parse_by_column("--zero", options.zero),
        calibration={
            column: {"points": file}
            for column, file in (_parse_by_column("--calibration", options.calibration) or {}).items()
        },
        release=options.release,
        rate=options.rate,
        sort=options.sort,
    )


def _parse_by_column(option: str, items: Sequence[str]) -> dict[str, str] | None:
    """Read texts with a column's name before them, or that of the height without."""
    result: dict[str, str] = {}
    for item in items:
        column, equals, text = item.rpartition("=")
        name = column.strip() if equals else "height"
        if not name:
            raise InputError(f"{option} {quote(item)} is not COLUMN=VALUE; write height=...")
        if name in result:
            raise InputError(f"{option}: {quote(name)} is given twice; leave one out")
        result[name] = text.strip()
    return result or None


def _parse_time(words: str, missing: float) -> float:
    from granular.schema.units import si_value

    return si_value(words, "s") if words.strip() else missing


def _parse_pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    pairs = {}
    for item in (item for text in texts for item in _PAIRS.split(text)):
        if not item.strip():
            continue
        name, equals, value = item.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {quote(item)} is not NAME=VALUE; write height=dist")
        pairs[name.strip()] = value.strip()
    return pairs


def load_records(sources: Sequence[str], options: Any) -> list[PistonRecord]:
    """Return the records of some sources, scenes simulated first; all releases of a file where asked."""
    from reduced_models.records.sources import (
        is_record_file,
        load_record,
        open_source,
        options_with_description,
        read_releases,
    )

    said = parse_reading_options(options)
    records: list[PistonRecord] = []
    for source in sources:
        path = Path(source)
        if is_record_file(path) and options_with_description(path, said).release == ALL:
            records += read_releases(path, **said.to_plain())
        else:
            records.append(load_record(open_source(source, said), not options.quiet))
    return records


def leave_cautions_to_print_out(options: Any) -> None:
    """Silence the warnings that a print-out for people repeats."""
    if not options.json:
        warnings.simplefilter("ignore", CautionWarning)


def print_result_and_report_path(result: Any, options: Any, text: str | None = None) -> None:
    """Print a result, in other words than its own where these are given; and its report's place."""
    text = str(result) if text is None else text
    if options.out is not None:
        text += f"\nreport: {options.out}/report.html"
    print_result(result.to_plain(), text, options.json)


@command(
    "look",
    "show what is understood of a record's file, before anything is fitted",
    option("file", metavar="FILE", help="a record as an instrument wrote it"),
    option("--plot", metavar="FILE", help="draw the motion to this file (.png, .svg)"),
    option(
        "--write",
        metavar="FILE",
        help="write what was understood to this TOML file, which every command takes as a record",
    ),
    READING,
    OUTPUT,
    examples="""\
examples:
  %(prog)s lab.csv
  %(prog)s lab.csv --columns time=t,height=dist --units height=mm --flip --between 0.5:6
  %(prog)s lab.csv --decimal , --skip 12 --write record.toml    # then: identify record.toml""",
)
def look(options: Any) -> None:
    """Show what was understood, and keep it if asked."""
    from granular.readers.read_options import (
        ReadOptions,
        is_record_description,
        read_record_description,
        write_record_description,
    )
    from reduced_models.records.record_overview import overview_of_record_file, plot_overview

    said, path = parse_reading_options(options), Path(options.file)
    seen = overview_of_record_file(path, said)
    if options.plot is not None:
        from granular.render import save_picture

        save_picture(plot_overview(seen), options.plot, overwrite=True)
    if options.write is not None:
        if is_record_description(path):
            path, described = read_record_description(path)
            said = described.merge(said)
        columns = {role: name for role, name in seen.meaning.source.items() if name}
        understood = ReadOptions(columns=columns, units=seen.meaning.units)
        write_record_description(Path(options.write), path, understood.merge(said))
    text = str(seen)
    if options.write is not None:
        text += f"\nwritten to {options.write}"
    print_result(seen.to_plain() | {"description": options.write}, text, options.json)


@command(
    "example",
    "write records as instruments write them, made ones and a real one, to try the other commands on",
    option(
        "-o", "--out", default="lab", metavar="DIR", help="directory for them (lab); nothing is overwritten"
    ),
    OUTPUT,
    examples="""\
examples:
  %(prog)s
  %(prog)s -o somewhere        # then: identify somewhere/lvdt.toml --law linear""",
)
def example(options: Any) -> None:
    """Write the example records."""
    from reduced_models.records.example_records import write_example_records

    truths = write_example_records(options.out)
    lines = [f"written to {options.out}, each with a .toml that says how it is read:"]
    lines += [f"  {name:18} {truth}" for name, truth in truths.items()]
    print_result({"directory": options.out, "records": truths}, "\n".join(lines), options.json)
