"""Hard cases: what became of each."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from granular.shared.html import Page
from validation.outcomes import ACCURATE, STOPPED, Outcome
from validation.parts import Plain
from validation.sections.common import Shown, note_failures, sound, tabulate
from validation.table import TextTable, table


def stability_section(page: Page, results: Sequence[Plain]) -> None:
    """The outcome of every hard case."""
    found = [Outcome.from_plain(one) for one in sound(results)]
    page.section("Hard cases")
    page.text(stability_verdict(found))
    for one in found:
        if not one.allowed:
            page.note(f"{one.case} ({one.method}, dt {one.dt}): {one.kind}. {one.said}")
    page.text(
        "Each run's ending and its error, in the unit of the second column; the third says up to "
        "what the case's own run counts as accurate (ten times that for other methods, sixteen "
        "for a step four times as long). An InputError says that a method does not suit the scene. "
        "All measurements are at the end of this page, with the messages."
    )
    tabulate(page, stability_matrix(found))
    note_failures(page, results)


def stability_verdict(found: Sequence[Outcome]) -> str:
    """What the catalogue shows, in two sentences."""
    accurate = sum(one.kind == ACCURATE for one in found)
    wrong = sum(not one.allowed for one in found)
    return (
        f"{accurate} of {len(found)} runs are accurate to the figure stated for them; "
        f"{len(found) - accurate - wrong} are degraded and say so, or are stopped with a typed "
        f"error where that is right. {wrong or 'None'} ended as a case must not."
    )


def stability_matrix(found: Sequence[Outcome]) -> TextTable:
    """Outcomes: a row a case, a column for its own settings and for each method and step."""
    own = "its own settings"
    rows: dict[str, dict[str, str]] = {}
    columns: dict[str, None] = {own: None}
    first: dict[str, Outcome] = {}
    for one in found:
        new = first.setdefault(one.case, one) is one
        column = own if new else _column(one)
        columns[column] = None
        rows.setdefault(one.case, {})[column] = _ending(one)
    return table(
        ("case", "error of what [unit]", "accurate up to", *columns),
        [
            (case, _with_unit(first[case].measured), f"{first[case].limit:.0e}",
             *(row.get(column, "") for column in columns))
            for case, row in rows.items()
        ],
    )  # fmt: skip


def _with_unit(words: str) -> str:
    return words if words.endswith("]") or not words else f"{words} [1]"


def _column(one: Outcome) -> str:
    return f"with {one.method}" if one.dt == "auto" else f"dt = {one.dt}"


def _ending(one: Outcome) -> str:
    wrong = "" if one.allowed else " (!)"
    if one.kind == STOPPED:
        return f"stopped: {one.said.split(':', 1)[0]}{wrong}"
    return f"{one.kind}: {one.error:.1g}{wrong}"


def stability_table(found: Sequence[Outcome]) -> TextTable:
    """One row an outcome."""
    rows = [
        (
            one.case, one.method, one.dt, one.kind if one.allowed else f"{one.kind} (!)",
            "" if one.error != one.error else f"{one.error:.1e}", f"{one.limit:.1e}",
            one.said, f"{one.seconds:.2g}",
        )
        for one in found
    ]  # fmt: skip
    header = ("case", "method", "dt", "outcome", "error", "limit", "said", "seconds")
    return table(header, rows)


def case_table(names: Collection[str]) -> TextTable:
    """What is hard about each case, and what its error is."""
    from validation.hard_cases import catalogue

    rows = [(one.name, one.what, one.accurate) for one in catalogue() if one.name in names]
    return table(("case", "what is hard", "error"), rows)


def _text(results: Sequence[Plain]) -> str:
    return stability_table([Outcome.from_plain(one) for one in results]).text()


def _verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [Outcome.from_plain(one) for one in results]
    return stability_verdict(found).rstrip("."), all(one.allowed for one in found)


def _measurements(page: Page, results: Sequence[Plain]) -> None:
    found = [Outcome.from_plain(one) for one in results]
    page.text("Hard cases.")
    tabulate(page, stability_table(found))
    page.text("What is hard, and what is measured.")
    tabulate(page, case_table({one.case for one in found}))


STABILITY = Shown(_text, _verdict, stability_section, _measurements)
