"""The commands ``look`` and ``example``, and options of all commands that take a record."""

from __future__ import annotations

import dataclasses
import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from granular.commands.console import command, print_result
from granular.commands.options import OutputOptions
from granular.commands.signature import Option
from granular.records.options import ALL
from granular.shared.errors import CautionWarning, InputError, SceneError, quote

if TYPE_CHECKING:
    from granular.records.options import ReadOptions
    from granular.records.record import PistonRecord


_A_SOURCE = Option("a scene (name or TOML file), a run directory, or a record from an instrument", "SOURCE")
Source = Annotated[str, _A_SOURCE]
Sources = Annotated[tuple[str, ...], _A_SOURCE]

_PAIRS = re.compile(r",(?=[^,=]+=)")
"""Pattern that matches a comma between two COLUMN=VALUE pairs, but no comma within a column's heading."""


@dataclasses.dataclass(frozen=True)
class ReadingOptions:
    """Options for reading a record's file, as texts from the command line."""

    title: ClassVar[str] = "how to read a record's file, if the automatic reading is wrong"

    columns: Annotated[
        tuple[str, ...],
        Option(
            "role of a column, and its name or its number from 1; roles are time, height (or angle; or "
            "stroke, if it is prescribed and the force is measured), velocity, force, acceleration, "
            "base_height, base_acceleration, and names of inputs",
            "ROLE=NAME,...",
        ),
    ] = ()
    units: Annotated[tuple[str, ...], Option("units of columns, such as height=mm", "NAME=UNIT,...")] = ()
    decimal: Annotated[str | None, Option("decimal sign, . or ,", "SIGN")] = None
    skip: Annotated[int, Option("skip N lines at the start", "N")] = 0
    sheet: Annotated[str | None, Option("sheet of a workbook, or group or variable of a file", "NAME")] = None
    flip: Annotated[bool, Option("the coordinate increases downwards")] = False
    between: Annotated[
        str | None,
        Option(
            "only the samples between these times [s]; ':' for all, including samples before a release, "
            "which are excluded by default",
            "T:T",
        ),
    ] = None
    scale: Annotated[
        tuple[str, ...],
        Option(
            "calibration of the height, or of a COLUMN, such as '2.4894 +- 0.003 mm/V' (repeatable)",
            "[COLUMN=]SCALE",
        ),
    ] = ()
    zero: Annotated[
        tuple[str, ...], Option("reading of the column at height 0: '2.513 V' (repeatable)", "[COLUMN=]VALUE")
    ] = ()
    calibration: Annotated[
        tuple[str, ...],
        Option(
            "instead of a scale, a file of calibration points with the columns raw, value and uncertainty, "
            "to which a straight line is fitted (repeatable)",
            "[COLUMN=]FILE",
        ),
    ] = ()
    release: Annotated[
        str | None,
        Option(
            "which of several releases in a file: a number, or 'all' (for fit, compare "
            "and discover); by default the first",
            "N",
        ),
    ] = None
    rate: Annotated[str | None, Option("sampling rate of a file without times: '610.35 Hz'", "RATE")] = None
    sort: Annotated[bool, Option("sort the rows by time, and average rows of equal time")] = False

    def parse(self) -> ReadOptions:
        """Return the reading options that the texts describe."""
        from granular.records.options import ReadOptions

        calibrations = _parse_column_values("--calibration", self.calibration) or {}
        return ReadOptions(
            columns=_parse_name_value_pairs("--columns", self.columns),
            units=_parse_name_value_pairs("--units", self.units),
            between=_parse_time_range(self.between),
            scale=_parse_column_values("--scale", self.scale),
            zero=_parse_column_values("--zero", self.zero),
            calibration={column: {"points": file} for column, file in calibrations.items()},
            **{name: getattr(self, name) for name in _AS_TYPED},
        )

    def load(self, sources: Sequence[str], output: OutputOptions) -> list[PistonRecord]:
        """Load the records of some sources, optionally all releases of a file; scenes are simulated first."""
        from reduced_models.records.sources import (
            is_record_file,
            load_record,
            open_source,
            options_with_description,
            read_releases,
        )

        said = self.parse()
        records: list[PistonRecord] = []
        for source in sources:
            path = Path(source)
            if is_record_file(path) and options_with_description(path, said).release == ALL:
                records += read_releases(path, **said.to_plain())
            else:
                records.append(load_record(open_source(source, said), output.shows_progress))
        return records


_AS_TYPED = ("decimal", "skip", "sheet", "flip", "release", "rate", "sort")


def _parse_time_range(text: str | None) -> tuple[float, float] | None:
    """Return the two times [s] in a text; a missing time is infinite."""
    if text is None:
        return None
    start, colon, stop = text.partition(":")
    try:
        if colon:
            return _parse_time(start, -math.inf), _parse_time(stop, math.inf)
    except SceneError:
        pass
    raise InputError(f"--between {quote(text)}; give two times, such as 0.5:6 or '5 ms:6 s'")


def _parse_column_values(option: str, items: Sequence[str]) -> dict[str, str] | None:
    """Return values by column from options COLUMN=VALUE; an option without COLUMN is for the height."""
    result: dict[str, str] = {}
    for item in items:
        column, equals, text = item.rpartition("=")
        name = column.strip() if equals else "height"
        if not name:
            raise InputError(f"{option} {quote(item)} is not COLUMN=VALUE; write height=...")
        if name in result:
            raise InputError(f"{option}: {quote(name)} is given twice; remove one")
        result[name] = text.strip()
    return result or None


def _parse_time(words: str, missing: float) -> float:
    from granular.schema.units import si_value

    return si_value(words, "s") if words.strip() else missing


def _parse_name_value_pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    pairs = {}
    for item in (item for text in texts for item in _PAIRS.split(text)):
        if not item.strip():
            continue
        name, equals, value = item.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {quote(item)} is not NAME=VALUE; write height=dist")
        pairs[name.strip()] = value.strip()
    return pairs


def silence_caution_warnings_of_text_output(output: OutputOptions) -> None:
    """Silence warnings that the text print-out repeats."""
    if not output.json:
        warnings.simplefilter("ignore", CautionWarning)


def print_result_and_report_path(
    result: Any, out: str | None, output: OutputOptions, text: str | None = None
) -> None:
    """Print a result, or a given text instead, and the path of its report."""
    text = str(result) if text is None else text
    if out is not None:
        text += f"\nreport: {out}/report.html"
    print_result(result.to_plain(), text, output.json)


@command("""\
examples:
  %(prog)s lab.csv
  %(prog)s lab.csv --columns time=t,height=dist --units height=mm --flip --between 0.5:6
  %(prog)s lab.csv --decimal , --skip 12 --write record.toml    # then: identify record.toml""")
def look(
    file: Annotated[str, Option("a record from an instrument", "FILE")],
    *,
    plot: Annotated[str | None, Option("draw the motion to this file (.png, .svg)", "FILE")] = None,
    write: Annotated[
        str | None,
        Option("write the interpretation to this TOML file, which every command takes as a record", "FILE"),
    ] = None,
    reading: ReadingOptions,
    output: OutputOptions,
) -> None:
    """Show the interpretation of a record's file, without a fit."""
    from granular.records.options import (
        ReadOptions,
        is_record_description,
        read_described_path_and_options,
        write_record_description,
    )
    from reduced_models.records.record_overview import overview_of_record_file, plot_overview

    said, path = reading.parse(), Path(file)
    seen = overview_of_record_file(path, said)
    if plot is not None:
        from granular.render import save_picture

        save_picture(plot_overview(seen), plot, overwrite=True)
    if write is not None:
        if is_record_description(path):
            path, described = read_described_path_and_options(path)
            said = described.merge(said)
        columns = {role: name for role, name in seen.meaning.source.items() if name}
        understood = ReadOptions(columns=columns, units=seen.meaning.units)
        write_record_description(Path(write), path, understood.merge(said))
    text = str(seen)
    if write is not None:
        text += f"\nwritten to {write}"
    print_result(seen.to_plain() | {"description": write}, text, output.json)


@command("""\
examples:
  %(prog)s
  %(prog)s -o somewhere        # then: identify somewhere/lvdt.toml --law linear""")
def example(
    *,
    out: Annotated[
        str, Option("directory for the files (lab); existing files are not overwritten", "DIR", "-o")
    ] = "lab",
    output: OutputOptions,
) -> None:
    """Write example records in the formats of instruments, one real and the others simulated."""
    from reduced_models.records.example_records import write_example_records

    truths = write_example_records(out)
    lines = [f"written to {out}, each with a .toml file that describes it:"]
    width = max(map(len, truths))
    lines += [f"  {name:{width}} {truth}" for name, truth in truths.items()]
    print_result({"directory": out, "records": truths}, "\n".join(lines), output.json)
