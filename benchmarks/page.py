"""Presentation of the results: tables on the console, tables and plots on a page."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmarks.compression import PUBLISHED
from benchmarks.sums import exponent
from granular.shared.blocks import Block, Heading, Picture, Table, block_text, make_cautions
from granular.shared.html_pages import Page
from granular.shared.plotting import figure
from validation.report_tasks import FAILED, Plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LINEAR_FROM = 1000
"""Minimum number of grains in the fit of the growth of the time."""

Row = Mapping[str, Any]


class Sheet(NamedTuple):
    """Presentation of a part.

    Attributes
    ----------
    title : str
    columns : tuple of (str, callable)
        Header, and function that makes a row's cell.
    label : str or None
        Key of the rows with the name of a curve of time against grains.
    """

    title: str
    columns: tuple[tuple[str, Callable[[Row], str]], ...]
    label: str | None = None


def _plain(key: str) -> tuple[str, Callable[[Row], str]]:
    return key, lambda row: str(row[key])


def _number(
    key: str, form: str = ".2f", header: str | None = None, scale: float = 1.0
) -> tuple[str, Callable[[Row], str]]:
    return header or key, lambda row: format(scale * row[key], form) if key in row else ""


def _bytes_a_grain(row: Row) -> str:
    return f"{(row['bytes'] - row['of 92 grains']) / row['grains']:.0f}"


_MICROSECONDS = _number("seconds", ".2f", "us", 1e6)


def _job_parts(row: Row) -> str:
    return ", ".join(f"{name} {seconds:.1f}" for name, seconds in row["parts"].items())


_SUMS = (
    _plain("sum"),
    _plain("grains"),
    _MICROSECONDS,
    _number("ns per pair", ".3f"),
    _number("times plain", ".3f", "times as fast as the plain loop"),
)

SHEETS: dict[str, Sheet] = {
    "sums": Sheet(
        "All pairs: one sum, or a step of another program",
        (
            *_SUMS,
            _number("over direct", ".2f", "time / the direct sum's"),
            _number("error", ".1e", "error / sum |f|"),
        ),
        "sum",
    ),
    "lists": Sheet("Pairs within 11.26 D, with lists rebuilt as grains move", _SUMS, "sum"),
    "methods": Sheet(
        "A whole step of the engine, by method of summing pairs",
        (
            _plain("method"),
            _plain("grains"),
            _MICROSECONDS,
            _number("times direct", ".2f", "times as fast as the direct sum"),
        ),
        "method",
    ),
    "errors": Sheet(
        "Errors of methods of summing pairs, against the direct sum",
        (
            _plain("method"),
            _plain("grains"),
            _number("force error", ".1e", "largest force error / rms sum |f|"),
            _number("energy drift", ".1e", "energy, over that turned over, in 2000 steps"),
        ),
    ),
    "rest": Sheet(
        "Forces of a bed at rest by approximate sums, and deviations from the direct sum",
        (
            _plain("method"),
            _plain("grains"),
            _number("piston_force", ".4f", "piston [N]"),
            *(
                _number(f"{side}_force off", "+.4f", f"{side} off [%]", 100.0)
                for side in ("piston", "left", "right", "bottom")
            ),
            _number("greatest_speed", ".1e", "maximum speed [m/s]"),
        ),
    ),
    "threads": Sheet(
        "A whole step with one thread and two",
        (
            _plain("method"),
            _plain("grains"),
            _plain("threads"),
            _MICROSECONDS,
            _number("times one", ".2f", "times as fast as one"),
            _plain("same bits"),
        ),
    ),
    "effects": Sheet(
        "A whole step with dipoles and walls, and time added by each effect",
        (
            _plain("effect"),
            _plain("grains"),
            _MICROSECONDS,
            _number("added", "+.2f", "added us", 1e6),
            _number("share", "+.1f", "added %", 100.0),
        ),
    ),
    "absent": Sheet(
        "A step of the engine and by hand, without the absent effects",
        (
            ("effects that act", lambda row: str(row["effects"])),
            _plain("grains"),
            _number("by hand", ".2f", "by hand us", 1e6),
            _number("engine", ".2f", "engine us", 1e6),
            _number("ratio", ".3f"),
        ),
    ),
    "own": Sheet(
        "A whole step with a custom spring, and later processes that run with it",
        (
            _plain("spring"),
            _number("grains", ".0f"),
            _MICROSECONDS,
            _number("ratio", ".3f", "over the built-in one"),
            _number("start", ".2f", "start [s]"),
            _number("later", "+.2f", "later than without [s]"),
        ),
    ),
    "memory": Sheet(
        "Peak memory of a process that runs a bed",
        (
            _plain("method"),
            _plain("grains"),
            _number("bytes", ".1f", "MB", 1e-6),
            _number("of 92 grains", ".1f", "MB before, with 92 grains", 1e-6),
            ("bytes a grain", _bytes_a_grain),
        ),
    ),
    "start": Sheet("Start on the command line", (_plain("start"), _number("seconds", ".2f", "s"))),
    "package": Sheet(
        "The wheel, and imports in separate processes",
        (_plain("what"), _number("bytes", ".0f", "kB", 1e-3), _number("seconds", ".0f", "ms", 1e3)),
    ),
    "study": Sheet(
        "A sweep over masses and starts of small dampers, in processes",
        (
            _plain("cases"),
            _plain("grains"),
            _plain("cores"),
            _number("seconds", ".1f", "wall time [s]"),
            _number("run alone", ".2f", "a run alone [s]"),
            _number("filled", ".2f", "fraction of the cores' time that is runs"),
            _plain("failed"),
        ),
    ),
    "protocol": Sheet(
        "The published protocol, 368 grains: relaxation 5 T, compression, expansion, relaxation",
        (
            _plain("seed"),
            _plain("far every"),
            _number("speed", ".4g", "speed [m/s]"),
            _number("seconds", ".1f", "wall time [s]"),
            _number("simulated", ".1f", "simulated [s]"),
            _plain("steps"),
            _number("ledger", ".1e", "energy, over that turned over"),
            _number("force", ".2f", f"force [N], published {PUBLISHED['force']}"),
            _number(
                "half distance", ".2f", f"half mean distance [D], published {PUBLISHED['half distance']}"
            ),
        ),
    ),
    "fits": Sheet(
        "A fit at 1 % noise: nothing compiled, in a later process, and again",
        (
            _plain("law"),
            _plain("samples"),
            _number("cold", ".2f", "cold [s]"),
            _number("next process", ".2f", "next process [s]"),
            _number("warm", ".3f", "warm [s]"),
            _number("error", ".1e"),
            _number("converged", ".2f", "converged starts"),
        ),
    ),
    "jobs": Sheet(
        "Whole jobs in separate processes",
        (
            _plain("job"),
            _number("seconds", ".1f", "wall time [s]"),
            _number("processor", ".1f", "processor time [s]"),
            _number("cores", ".2f", "busy processors"),
            ("parts [s of wall time]", _job_parts),
        ),
    ),
}

_GROWTH = Sheet(
    f"Growth of the time from {LINEAR_FROM} grains on: time ~ grains^",
    (
        _plain("part"),
        _plain("what"),
        _number("exponent", ".3f"),
        _number("interval", ".3f", "+- (95 %)"),
        _plain("counts"),
    ),
)


def rows_of(results: Sequence[Plain]) -> list[Row]:
    """Return the rows of a part's tasks that did not fail."""
    return [row for item in results if FAILED not in item for row in item["rows"]]


def growth(parts: Mapping[str, Sequence[Plain]]) -> list[dict[str, Any]]:
    """Return the exponents of time against the number of grains, with their 95 % intervals.

    They are fitted to counts from `LINEAR_FROM` grains, if there are three or more.
    """
    result = []
    for part, results in parts.items():
        label, rows = SHEETS[part].label, rows_of(results)
        if label is None:
            continue
        for name in dict.fromkeys(row[label] for row in rows):
            chosen = [row for row in rows if row[label] == name and row["grains"] >= LINEAR_FROM]
            if len(chosen) > 2:
                counts = np.array([row["grains"] for row in chosen], dtype=np.float64)
                slope, half = exponent(counts, np.array([row["seconds"] for row in chosen]))
                result.append(
                    {"part": part, "what": name, "exponent": slope, "interval": half, "counts": len(chosen)}
                )
    return result


def _table(sheet: Sheet, rows: Sequence[Row]) -> Table:
    return Table(
        [header for header, _ in sheet.columns], [[cell(row) for _, cell in sheet.columns] for row in rows]
    )


def _sections(result: Mapping[str, Any]) -> list[tuple[Sheet, list[Row], list[str]]]:
    """Return each part's sheet, its rows, and its failures."""
    sections = []
    for name, results in result["parts"].items():
        failures = [f"{item['label']} failed: {item[FAILED]}" for item in results if FAILED in item]
        sections.append((SHEETS[name], rows_of(results), failures))
    return [*sections, (_GROWTH, result["growth"], [])]


def benchmark_text(result: Mapping[str, Any]) -> str:
    """Return the tables for the console."""
    lines = []
    for sheet, rows, failures in _sections(result):
        if rows or failures:
            lines += [sheet.title, block_text(_table(sheet, rows)) if rows else "", *failures, ""]
    lines += [f"not measured: {item['what']}: {item['why']}" for item in result["missing"]]
    return "\n".join([*lines, _machine(result)])


def _machine(result: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in result["machine"].items())


def page(result: Mapping[str, Any]) -> Page:
    """Return the page."""
    when = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    kind = "full" if result["full"] else "quick"
    return Page(
        "Speed",
        "Minimum of several times, measured in turn; each table was measured in one run.",
        tuple(_blocks(result)),
        f"Made on {when} ({kind}) with {_machine(result)}",
    )


def _blocks(result: Mapping[str, Any]) -> Iterator[Block]:
    for sheet, rows, failures in _sections(result):
        if rows or failures:
            yield Heading(sheet.title)
            yield from make_cautions(failures)
        if rows:
            yield _table(sheet, rows)
            if sheet.label is not None:
                yield Picture(partial(_draw, sheet, rows), sheet.title)
    yield from make_cautions(f"Not measured: {item['what']}: {item['why']}." for item in result["missing"])


def _draw(sheet: Sheet, rows: Sequence[Row]) -> Figure:
    assert sheet.label is not None
    with figure() as (drawing, axes):
        for name in dict.fromkeys(row[sheet.label] for row in rows):
            chosen = [row for row in rows if row[sheet.label] == name]
            times = [1e6 * row["seconds"] for row in chosen]
            axes.loglog([row["grains"] for row in chosen], times, "o-", label=name)
        axes.set_xlabel("grains")
        axes.set_ylabel("time [us]")
        axes.legend(fontsize=7)
        return drawing
