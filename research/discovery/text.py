"""Results of the benchmark as text and tables, for the console and for a page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from granular.shared.blocks import Table
from research.campaign import markdown_of_console_table
from research.discovery.cases import LIBRARIES, METHODS, NOISES, OURS, PEERS, SEEDS, TUNED
from research.discovery.judging import USABLE
from research.discovery.peers import PYOPERON, PYOPERON_TUNED, PYSINDY, TUNED_PERIODS
from research.discovery.results import DiscoveryRate, DiscoveryResults
from research.discovery.systems import SYSTEMS

SHOWN_NOISE = 0.01
"""Noise level at which every system is shown."""
NOT_RUN = "not run"
_PEER_WORDS = (
    (PEERS, "With the settings of their guides, the better of the other tools is"),
    (TUNED, "With smoothing tuned on these records, the better of the other tools is"),
)
_LIBRARY_WORDS = {"named": "named library", "default": "default library"}


def tables_and_summary_text(result: DiscoveryResults) -> str:
    """Return both tables, and their summary."""
    return "\n\n".join(
        (
            str(rate_table_by_method(result)),
            str(found_runs_table_by_system(result)),
            conclusion_text(result),
            peer_settings_text(),
        )
    )


def tables_and_summary_markdown(result: DiscoveryResults) -> str:
    """Return tables and summary for a page."""
    made = result.made
    parts = [
        conclusion_text(result),
        markdown_of_console_table(rate_table_by_method(result)),
        definition_of_found_text(),
        markdown_of_console_table(found_runs_table_by_system(result)),
        peer_settings_text(),
    ]
    if made:
        parts.append(
            f"Made by `{made.get('command', '')}` on {made.get('date', '')}, {made.get('processor', '')}."
        )
    return "\n\n".join(parts)


def rates_and_rows_as_plain_data(result: DiscoveryResults) -> dict[str, Any]:
    """Return rates and rows as plain data."""
    return result.to_plain()


def rate_table_by_method(result: DiscoveryResults) -> Table:
    """Return the rates of each method by noise and library, over all systems; empty if none was run."""
    header = ["noise", "library", *METHODS, "usable: " + METHODS[0], "median CPU s"]
    rows = []
    for noise in NOISES:
        for library in LIBRARIES:
            rates = [result.rate_of_method(method, library, noise) for method in METHODS]
            if not any(rate.run for rate in rates):
                continue
            rows.append(
                [
                    f"{100 * noise:g} %",
                    library,
                    *map(rate_text, rates),
                    NOT_RUN if not rates[0].run else f"{rates[0].usable} of {rates[0].run}",
                    ", ".join("—" if item.seconds is None else f"{item.seconds:.2g}" for item in rates),
                ]
            )
    return Table(header, rows)


def found_runs_table_by_system(result: DiscoveryResults) -> Table:
    """Return the table of runs that found each system at `SHOWN_NOISE`, and the number of exact ones."""
    header = ["system", *(f"{method}, {library}" for library in LIBRARIES for method in METHODS)]
    rows = [
        [
            item.name,
            *(
                rate_text(result.rate_of_method(method, library, SHOWN_NOISE, [item.name]))
                for library in LIBRARIES
                for method in METHODS
            ),
        ]
        for item in SYSTEMS
    ]
    return Table(header, rows)


def rate_text(rate: DiscoveryRate) -> str:
    """Return a text such as "66 of 70 (60 exact)", with the number of runs that are missing."""
    if not rate.run:
        return NOT_RUN
    words = f"{rate.found} of {rate.run} ({rate.exact} exact)"
    left = rate.planned - rate.run
    return f"{words}, {left} {NOT_RUN}" if left else words


def conclusion_text(result: DiscoveryResults) -> str:
    """Return the text on the fractions found at `SHOWN_NOISE`, on crashes and on missing runs."""
    sentences = []
    for library in LIBRARIES:
        rates = {method: result.rate_of_method(method, library, SHOWN_NOISE) for method in METHODS}
        ours = rates[OURS]
        if ours.found_fraction is None:
            continue
        sentence = (
            f"At {SHOWN_NOISE * 100:g} % noise and with the {_LIBRARY_WORDS[library]}, `discover` "
            f"finds the law in {100 * ours.found_fraction:.0f} % of {ours.run} runs."
        )
        for methods, how in _PEER_WORDS:
            known = [(rates[name].found_fraction or 0.0, name) for name in methods if rates[name].run]
            if known:
                fraction, name = max(known)
                tool = name.removesuffix(", tuned")
                sentence += f" {how} {tool}, which finds the law in {100 * fraction:.0f} %."
        sentences.append(f"- {sentence}")
    ours_rows = [row for case, row in result.rows.items() if case.method == OURS]
    crashes = sum("crash" in row for row in ours_rows)
    sentences.append(f"- Crashes of `discover`: {crashes} in {len(ours_rows)} runs.")
    planned = len(SYSTEMS) * len(LIBRARIES) * len(METHODS) * len(NOISES) * SEEDS
    if len(result.rows) < planned:
        noises = _percentages(case.noise for case in result.rows)
        sentences.append(
            f"- {planned - len(result.rows)} of {planned} planned runs were {NOT_RUN}: noise levels of "
            f"{_percentages(NOISES)} were planned, and only {noises} was run."
        )
    return "\n".join(sentences)


def _percentages(noises: Iterable[float]) -> str:
    """Return the different levels of noise in a text such as "0.1, 1 %", or "none"."""
    levels = [f"{100 * noise:g}" for noise in sorted(set(noises))]
    return f"{', '.join(levels)} %" if levels else "none"


def definition_of_found_text() -> str:
    """Return the definition of "found"."""
    return (
        "A law counts as found if it contains exactly the terms of the true law. It also counts as found if "
        "its solution for an initial state that was not fitted deviates from the true motion by at most "
        f"{100 * USABLE:g} % (rms, relative to the motion's standard deviation). The next table is for "
        f"{100 * SHOWN_NOISE:g} % noise and {SEEDS} seeds:"
    )


def peer_settings_text() -> str:
    """Return the settings of the peers."""
    tuned = f"a window of {TUNED_PERIODS:g} periods, the best of three that were tried here"
    helped = {name: value for name, value in PYOPERON_TUNED.items() if value != PYOPERON[name]}
    return "\n".join(
        (
            f"- PySINDy: {_setting_text(PYSINDY)}.",
            f"- PySINDy, tuned: {tuned}.",
            f"- pyoperon: {_setting_text(PYOPERON)}.",
            f"- pyoperon, tuned: {_setting_text(helped)}.",
        )
    )


def _setting_text(result: Mapping[str, object]) -> str:
    return "; ".join(f"{name} {_value_text(value)}" for name, value in result.items())


def _value_text(value: object) -> str:
    return (
        ", ".join(map(str, value))
        if isinstance(value, Sequence) and not isinstance(value, str)
        else str(value)
    )
