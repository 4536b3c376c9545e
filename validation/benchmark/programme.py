"""What ``python -m validation benchmark`` measures, writes and prints."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from granular.console import finite
from granular.plotting import figure
from validation.benchmark import c_kernel
from validation.benchmark.absent import cost_of_absence
from validation.benchmark.sums import cut_off_sums, direct_sums, exponent
from validation.parts import machine
from validation.table import Table, table

_LINEAR_FROM = 1000
"""Grains from which the growth of the time is fitted."""

_Rows = list[dict[str, Any]]


def _measurements(full: bool) -> Iterator[tuple[str, str, Callable[[], _Rows]]]:
    """Which table each adds to, what it is called, and how it is measured."""
    rounds = 100 if full else 40
    for count in (92, 368, 1472, 5888) if full else (92, 368, 1472):
        yield "direct", f"all pairs of {count}", partial(direct_sums, count, rounds)
    for count in (368, 1472, 5888, 23552, 94208) if full else (368, 1472, 5888):
        yield "cut-off", f"near pairs of {count}", partial(cut_off_sums, count, rounds // 4)
    yield "absent", "absent effects", partial(cost_of_absence, rounds=rounds // 2)


def _missing() -> list[dict[str, str]]:
    """What was not measured here, and why."""
    from importlib.util import find_spec

    reason = c_kernel.missing()
    found = [] if reason is None else [{"what": "C kernel", "why": reason}]
    if find_spec("jax") is None:
        found.append({"what": "plain JAX", "why": "JAX is not installed"})
    return found


def _growth(rows: _Rows) -> _Rows:
    """Exponents of time against the number of grains, with two standard errors."""
    found = []
    for name in dict.fromkeys(row["sum"] for row in rows):
        chosen = [row for row in rows if row["sum"] == name and row["grains"] >= _LINEAR_FROM]
        if len(chosen) > 2:
            counts = np.array([row["grains"] for row in chosen], dtype=np.float64)
            slope, error = exponent(counts, np.array([row["seconds"] for row in chosen]))
            found.append({"sum": name, "exponent": slope, "interval": 2.0 * error})
    return found


def benchmark(out: str | None, *, full: bool = False, progress: bool = True) -> dict[str, Any]:
    """Measure everything; a table, a plot and a JSON file go to ``out`` where it is given.

    Parameters
    ----------
    out : str, optional
        Directory for ``benchmark.json``, ``benchmark.txt`` and ``benchmark.svg``.
    full : bool
        More grains and more repeats: some minutes instead of about one.
    """
    from tqdm import tqdm

    found: dict[str, Any] = {"direct": [], "cut-off": [], "absent": []}
    for part, name, measure in (bar := tqdm(list(_measurements(full)), disable=not progress)):
        bar.set_description(name)
        found[part] += measure()
    found["growth"] = _growth(found["direct"] + found["cut-off"])
    found["missing"], found["machine"] = _missing(), machine()
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "benchmark.json").write_text(json.dumps(finite(found)), encoding="utf-8")
        (folder / "benchmark.txt").write_text(benchmark_text(found) + "\n", encoding="utf-8")
        _draw(found, folder / "benchmark.svg")
    return found


def _sums_table(rows: _Rows) -> Table:
    return table(
        ("sum", "grains", "us", "ns per pair", "times plain", "error / sum |f|"),
        [
            (row["sum"], row["grains"], f"{1e6 * row['seconds']:.2f}",
             f"{row['ns per pair']:.3f}", f"{row['times plain']:.2f}",
             f"{row['error']:.1e}" if "error" in row else "")
            for row in rows
        ],
    )  # fmt: skip


def benchmark_text(found: dict[str, Any]) -> str:
    """The tables, for people."""
    absent = table(
        ("effects that act", "grains", "by hand [us]", "engine [us]", "ratio"),
        [
            (row["effects"], row["grains"], f"{1e6 * row['by hand']:.2f}",
             f"{1e6 * row['engine']:.2f}", f"{row['ratio']:.3f}")
            for row in found["absent"]
        ],
    )  # fmt: skip
    growth = table(
        ("sum", "time ~ grains^"),
        [(row["sum"], f"{row['exponent']:.3f} +- {row['interval']:.3f}")
         for row in found["growth"]],
    )  # fmt: skip
    parts = [
        ("All pairs, one sum", _sums_table(found["direct"]).text()),
        ("Pairs within 11.26 D, lists made anew as grains move", _sums_table(
            found["cut-off"]).text()),
        ("A step of the engine and by hand, without the effects left out", absent.text()),
        ("Growth", growth.text()),
    ]  # fmt: skip
    lines = [f"{title}\n{text}\n" for title, text in parts if text.count("\n")]
    lines += [f"not measured: {one['what']}: {one['why']}" for one in found["missing"]]
    return "\n".join([*lines, ", ".join(f"{key} {val}" for key, val in found["machine"].items())])


def _draw(found: dict[str, Any], path: Path) -> None:
    with figure() as (drawing, axes):
        rows = found["direct"] + found["cut-off"]
        for name in dict.fromkeys(row["sum"] for row in rows):
            chosen = [row for row in rows if row["sum"] == name]
            counts = [row["grains"] for row in chosen]
            axes.loglog(counts, [1e6 * row["seconds"] for row in chosen], "o-", label=name)
        axes.set_xlabel("grains")
        axes.set_ylabel("time of a sum [us]")
        axes.legend(fontsize=7)
        drawing.savefig(path)
