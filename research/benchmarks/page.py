"""Page of the benchmarks, which compares the errors of the fits with published errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from granular.shared.blocks import Block, Caution, Heading, Picture, Printout, Table, Text, blocks_text
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, figure
from research.benchmarks.benchmark import Benchmark, LawFitOutcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Results = Mapping[Benchmark, Sequence[LawFitOutcome] | None]
"""Outcomes of each benchmark; None if its files are absent."""


def results_blocks(results: Results) -> Iterator[Block]:
    """Table, laws and pictures of each benchmark."""
    for benchmark, outcomes in results.items():
        yield Heading(benchmark.name)
        if outcomes is None:
            files = ", ".join(benchmark.files)
            yield Caution(f"absent: {files}; get it from {benchmark.get_it}")
            continue
        yield Text(f"{benchmark.split}. Error: {benchmark.measure}.")
        yield Table(
            ("method", "kind", *benchmark.tests, "source"),
            [*map(_row_of_fit, outcomes), *(_row_of_published_method(item) for item in benchmark.published)],
        )
        for outcome in outcomes:
            numbers = ", ".join(f"{name} = {value:.6g}" for name, value in outcome.parameters.items())
            yield Printout(f"{outcome.name}: {outcome.law}\n{numbers}")
            yield Picture(
                partial(_draw_curves_and_difference, benchmark, outcome),
                f"{benchmark.name}, {outcome.name}: measured and simulated signal of a part of the test, and "
                "the difference below.",
            )


def _row_of_fit(outcome: LawFitOutcome) -> tuple[str, ...]:
    here = f"this fit, {outcome.seconds:.0f} s of processor, {outcome.agreeing} starts agree"
    return outcome.name, "grey box", *(f"{error:.3g}" for error in outcome.errors), here


def _row_of_published_method(item: Any) -> tuple[str, ...]:
    return item.method, item.kind, *(error or "not given" for error in item.errors), item.source


def _draw_curves_and_difference(benchmark: Benchmark, outcome: LawFitOutcome) -> Figure:
    curve = outcome.curve
    with figure(2, 1, height=4.0, sharex=True, height_ratios=(2, 1)) as (drawing, (above, below)):
        above.plot(curve.time, curve.measured, color=COLOURS[0], label="measured")
        above.plot(curve.time, curve.simulated, "--", color=COLOURS[1], label="simulated")
        above.legend(fontsize="x-small")
        below.plot(curve.time, curve.simulated - curve.measured, color=COLOURS[2])
        below.set(xlabel="time [s]", ylabel="difference")
        above.set_title(f"{benchmark.name}: {outcome.name}")
    return drawing


def results_page(results: Results) -> Page:
    """Page of the results."""
    lead = "Each law is fitted by one call of fit with default settings; the errors are of free runs."
    return Page("Public benchmarks", lead, tuple(results_blocks(results)))


def results_text(results: Results) -> str:
    """Results for the console."""
    return blocks_text(results_blocks(results))


def results_as_plain_data(results: Results) -> dict[str, Any]:
    """Results as plain data."""
    return {
        benchmark.name: None
        if outcomes is None
        else [
            {
                "law": outcome.law,
                "name": outcome.name,
                "parameters": outcome.parameters,
                "errors": dict(zip(benchmark.tests, outcome.errors, strict=True)),
                "starts that agree": outcome.agreeing,
                "seconds": outcome.seconds,
            }
            for outcome in outcomes
        ]
        for benchmark, outcomes in results.items()
    }
