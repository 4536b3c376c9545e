"""Endings of hard cases: accurate, degraded and said so, stopped with a typed error, or worse.

The worst is a run that ends as if all were well with figures that are not: a silent failure. An
error that is not one of the toolkit's own is as bad for a user, and is called a crash.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from granular.methods.method import COMPENSATED
from granular.shared.errors import GranularError
from validation.hard_cases import hard_case_catalogue
from validation.hard_cases.hard_case import BROKEN, HardCase
from validation.report_tasks import PlainData, Section, Task
from validation.text_tables import TextTable, add_table_to_page, text_table

if TYPE_CHECKING:
    from granular.shared.html_pages import HtmlPage

ACCURATE, DEGRADED, STOPPED = "accurate", "degraded and said so", "stopped"
SILENT, CRASHED = "SILENT FAILURE", "CRASH"
OVERLAP = "less than a diameter"
"""Part of the warning that two grains overlap where no contact is: physics, not accuracy."""


@dataclasses.dataclass(frozen=True)
class HardCaseOutcome(PlainData):
    """Ending of a case.

    Attributes
    ----------
    case, method, dt : str
    kind : str
        `ACCURATE`, `DEGRADED`, `STOPPED`, `SILENT` or `CRASHED`.
    error : float
        As measured; NaN where the run did not end.
    limit : float
    said : str
        The typed error's class and message, or the warnings.
    allowed : bool
        Whether the case may end like this.
    seconds : float
        Wall time, the compilation of a new kind of scene included.
    measured : str
        What the error is of, with its unit.
    """

    case: str
    method: str
    dt: str
    kind: str
    error: float
    limit: float
    said: str
    allowed: bool
    seconds: float
    measured: str = ""


def run_hard_case(
    case: HardCase, method: str = "stormer-verlet", dt: float | str | None = None, *, full: bool = False
) -> HardCaseOutcome:
    """Run a case and judge how it ended.

    Parameters
    ----------
    case : HardCase
        Case of the catalogue.
    method : str
        Name of the method, one of `granular.methods.METHODS`.
    dt : float or str, optional
        Time step [s], or a rule such as ``"auto"``; the case's own if not given.
    full : bool
        Run up to the case's full time instead of the quick one.

    Returns
    -------
    HardCaseOutcome
        How the run ended, its error in the case's unit, and its wall time [s]. A run that raises an
        error is an outcome too.
    """
    dt = case.dt if dt is None else dt
    started = time.perf_counter()
    kind, error, said = _run_case(case, method, dt, case.full_time if full else case.quick_time)
    name = said.split(":", 1)[0]
    allowed = (
        kind == ACCURATE
        or (kind == DEGRADED and case.may_degrade)
        or (kind == STOPPED and name in case.errors)
    )
    return HardCaseOutcome(
        case.name,
        method,
        str(dt),
        kind,
        error,
        case.limit,
        said,
        allowed,
        time.perf_counter() - started,
        case.measure.description,
    )


def _run_case(case: HardCase, method: str, dt: float | str, until: float) -> tuple[str, float, str]:
    from granular import simulate

    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            run = simulate(case.scene(), dt=dt, t_end=until, method=method, progress=False)
            error = float(case.measure.error(run))
        except GranularError as stop:
            return STOPPED, math.nan, f"{type(stop).__name__}: {stop}"
        except Exception as crash:  # whatever it is, it belongs into the table
            return CRASHED, math.nan, f"{type(crash).__name__}: {crash}"
    said = "; ".join(str(warning.message) for warning in caught)
    doubts = [warning for warning in caught if OVERLAP not in str(warning.message)]
    if error <= case.limit:
        return ACCURATE, error, said
    return (DEGRADED if doubts else SILENT), error, said


# In the report ----------------------------------------------------------------------------------


def show_outcomes_section(page: HtmlPage, outcomes: Sequence[HardCaseOutcome]) -> None:
    """Add the outcome of every hard case to a page."""
    page.add_paragraph(outcome_summary(outcomes))
    for outcome in outcomes:
        if not outcome.allowed:
            page.add_warning(
                f"{outcome.case} ({outcome.method}, dt {outcome.dt}): {outcome.kind}. {outcome.said}"
            )
    page.add_paragraph(
        "Each run's ending and its error, in the unit of the second column; the third says up to "
        "what the case's own run counts as accurate (ten times that for other methods, sixteen "
        "for a step four times as long). An InputError says that a method does not suit the scene. "
        "All measurements are at the end of this page, with the messages."
    )
    add_table_to_page(page, outcome_matrix(outcomes))


def outcome_summary(outcomes: Sequence[HardCaseOutcome]) -> str:
    """Summary of the outcomes in two sentences: accurate, degraded or stopped, and wrong ones."""
    accurate = sum(outcome.kind == ACCURATE for outcome in outcomes)
    wrong = sum(not outcome.allowed for outcome in outcomes)
    return (
        f"{accurate} of {len(outcomes)} runs are accurate to the figure stated for them; "
        f"{len(outcomes) - accurate - wrong} are degraded and say so, or are stopped with a typed "
        f"error where that is right. {wrong or 'None'} ended as a case must not."
    )


def outcome_matrix(outcomes: Sequence[HardCaseOutcome]) -> TextTable:
    """Matrix of outcomes: a row a case, a column for each method and step."""
    own = "its own settings"
    rows: dict[str, dict[str, str]] = {}
    columns: dict[str, None] = {own: None}
    first: dict[str, HardCaseOutcome] = {}
    for outcome in outcomes:
        new = first.setdefault(outcome.case, outcome) is outcome
        step = f"with {outcome.method}" if outcome.dt == "auto" else f"dt = {outcome.dt}"
        column = own if new else step
        columns[column] = None
        rows.setdefault(outcome.case, {})[column] = _ending_text(outcome)
    return text_table(
        ("case", "error of what [unit]", "accurate up to", *columns),
        [
            (
                case,
                _with_unit(first[case].measured),
                f"{first[case].limit:.0e}",
                *(row.get(column, "") for column in columns),
            )
            for case, row in rows.items()
        ],
    )


def _with_unit(words: str) -> str:
    return words if words.endswith("]") or not words else f"{words} [1]"


def _ending_text(outcome: HardCaseOutcome) -> str:
    wrong = "" if outcome.allowed else " (!)"
    if outcome.kind == STOPPED:
        return f"stopped: {outcome.said.split(':', 1)[0]}{wrong}"
    return f"{outcome.kind}: {outcome.error:.1g}{wrong}"


def outcome_table(outcomes: Sequence[HardCaseOutcome]) -> TextTable:
    """Table of outcomes, one row a run."""
    rows = [
        (
            outcome.case,
            outcome.method,
            outcome.dt,
            outcome.kind if outcome.allowed else f"{outcome.kind} (!)",
            "" if outcome.error != outcome.error else f"{outcome.error:.1e}",
            f"{outcome.limit:.1e}",
            outcome.said,
            f"{outcome.seconds:.2g}",
        )
        for outcome in outcomes
    ]
    header = ("case", "method", "dt", "outcome", "error", "limit", "said", "seconds")
    return text_table(header, rows)


def hard_case_descriptions(names: Collection[str]) -> TextTable:
    """Return a table of what is hard about each case, and of what its error is."""
    rows = [
        (case.name, case.difficulty, case.measure.description)
        for case in hard_case_catalogue()
        if case.name in names
    ]
    return text_table(("case", "what is hard", "error"), rows)


VARIATIONS = (
    (f"stormer-verlet{COMPENSATED}", "auto", 1.0),
    ("adaptive-verlet", "auto", 10.0),
    ("blanes-moan-4", "auto", 10.0),
    ("stormer-verlet", "auto*4", 16.0),
    ("stormer-verlet", "auto/4", 1.0),
)
"""Other methods and steps for the hard cases, and how many times the case's own error they may
leave: a step four times as long leaves sixteen times the error, and methods differ in theirs."""


def stability_tasks(full: bool) -> list[Task]:
    """Tasks that run the catalogue of hard cases."""

    def task(case: HardCase, method: str, dt: float | str | None, *, late: bool) -> Task:
        return Task(
            case.name,
            {"case": case.name, "method": method, "dt": str(dt), "full": late},
            lambda: run_hard_case(case, method, dt, full=late).to_plain(),
        )

    cases = hard_case_catalogue()
    tasks = [task(case, "stormer-verlet", None, late=full) for case in cases]
    if full:
        tasks += [
            task(_vary_settings(case, times), method, dt, late=False)
            for method, dt, times in VARIATIONS
            for case in cases
            if case.dt == "auto"
        ]
    return tasks


def _vary_settings(case: HardCase, times: float) -> HardCase:
    """Case with other settings than its own, which may end it, but never silently."""
    return dataclasses.replace(
        case, limit=case.limit * times, may_degrade=True, errors=(*case.errors, *BROKEN, "InputError")
    )


def _outcome_verdict(outcomes: Sequence[HardCaseOutcome]) -> tuple[str, bool]:
    return outcome_summary(outcomes).rstrip("."), all(outcome.allowed for outcome in outcomes)


def _outcome_tables(outcomes: Sequence[HardCaseOutcome]) -> list[tuple[str, TextTable]]:
    return [
        ("Hard cases.", outcome_table(outcomes)),
        (
            "What is hard, and what is measured.",
            hard_case_descriptions({outcome.case for outcome in outcomes}),
        ),
    ]


STABILITY = Section(
    "stability",
    "Hard cases",
    stability_tasks,
    HardCaseOutcome.from_plain,
    _outcome_tables,
    _outcome_verdict,
    show_outcomes_section,
)
