"""Run hard cases and classify their endings.

A run may be accurate, or degraded with a warning, or stopped with one of the toolkit's typed errors. Two
endings are always wrong: a silent failure, which gives wrong results without a warning, and a crash, which is
any other error.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Collection, Sequence
from functools import partial

from granular.methods.method import COMPENSATED
from granular.shared.blocks import Block, Caution, Table, Text
from granular.shared.errors import GranularError
from validation.hard_case import BROKEN, HardCase
from validation.hard_cases import hard_case_catalogue
from validation.report_tasks import PlainData, Section, Task

ACCURATE, DEGRADED, STOPPED = "accurate", "degraded, with warning", "stopped"
SILENT, CRASHED = "SILENT FAILURE", "CRASH"
OVERLAP = "less than a diameter"
"""Part of the warning about grains that overlap without a contact law. This warning concerns the
physics, not the accuracy."""


@dataclasses.dataclass(frozen=True)
class HardCaseOutcome(PlainData):
    """Ending of the run of a hard case.

    Attributes
    ----------
    case, method, dt : str
        Name of the case, and the method and time step of the run.
    kind : str
        `ACCURATE`, `DEGRADED`, `STOPPED`, `SILENT` or `CRASHED`.
    error : float
        Measured error; NaN if the run did not finish.
    limit : float
        Maximum error of an accurate run.
    said : str
        Class and message of the typed error, or the warnings.
    allowed : bool
        True if the case may end in this way.
    seconds : float
        Wall time [s], including the compilation of a new kind of scene.
    measured : str
        Quantity whose error is measured, with its unit.
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
    """Run a case and classify its ending.

    Parameters
    ----------
    case : HardCase
        Case of the catalogue.
    method : str
        Name of the method, one of `granular.methods.METHODS`.
    dt : float or str, optional
        Time step [s], or a rule such as ``"auto"``; the step of the case if not given.
    full : bool
        Run for the full duration of the case instead of the quick one.

    Returns
    -------
    HardCaseOutcome
        Kind of ending, error in the case's unit, and wall time [s]. A run that raises an error is also an
        outcome.
    """
    dt = case.dt if dt is None else dt
    started = time.perf_counter()
    kind, error, said = _ending_error_and_message_of_case(case, method, dt, case.times[full])
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


def _ending_error_and_message_of_case(
    case: HardCase, method: str, dt: float | str, until: float
) -> tuple[str, float, str]:
    from granular import simulate

    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            run = simulate(case.scene(), dt=dt, t_end=until, method=method, progress=False)
            error = float(case.measure.error(run))
        except GranularError as stop:
            return STOPPED, math.nan, f"{type(stop).__name__}: {stop}"
        except Exception as crash:  # any error belongs in the table
            return CRASHED, math.nan, f"{type(crash).__name__}: {crash}"
    said = "; ".join(str(warning.message) for warning in caught)
    doubts = [warning for warning in caught if OVERLAP not in str(warning.message)]
    if error <= case.limit:
        return ACCURATE, error, said
    return (DEGRADED if doubts else SILENT), error, said


# In the report ----------------------------------------------------------------------------------


def outcome_blocks(outcomes: Sequence[HardCaseOutcome]) -> list[Block]:
    """Make the blocks: summary, a caution for each wrong ending, and the matrix of endings."""
    wrong = [
        Caution(f"{outcome.case} ({outcome.method}, dt {outcome.dt}): {outcome.kind}. {outcome.said}")
        for outcome in outcomes
        if not outcome.allowed
    ]
    legend = Text(
        "The cells give each run's ending and its error, in the unit of the second column. The third column "
        "is the error limit of an accurate run; the limit is ten times as large for other methods, and "
        "sixteen times for a step four times as long. An InputError means that a method does not suit the "
        "scene. All measurements and messages are at the end of this page."
    )
    return [Text(outcome_summary(outcomes)), *wrong, legend, outcome_matrix(outcomes)]


def outcome_summary(outcomes: Sequence[HardCaseOutcome]) -> str:
    """Return two sentences with the numbers of runs that are accurate, degraded, stopped or wrong."""
    accurate = sum(outcome.kind == ACCURATE for outcome in outcomes)
    wrong = sum(not outcome.allowed for outcome in outcomes)
    return (
        f"{accurate} of {len(outcomes)} runs are accurate within their error limit; "
        f"{len(outcomes) - accurate - wrong} are degraded and warn, or are stopped with a typed error as "
        f"expected. {wrong or 'None'} ended in a way that the case does not allow."
    )


def outcome_matrix(outcomes: Sequence[HardCaseOutcome]) -> Table:
    """Make the matrix of outcomes: one row per case, one column per method and step."""
    own = "settings of the case"
    rows: dict[str, dict[str, str]] = {}
    for outcome in outcomes:
        step = f"with {outcome.method}" if outcome.dt == "auto" else f"dt = {outcome.dt}"
        unit = "" if outcome.measured.endswith("]") or not outcome.measured else " [1]"
        first = {"error measure [unit]": outcome.measured + unit, "accurate up to": f"{outcome.limit:.0e}"}
        row = rows.setdefault(outcome.case, first)
        row[step if own in row else own] = _ending_text(outcome)
    columns = dict.fromkeys(column for row in rows.values() for column in row)
    cells = [(case, *(row.get(column, "") for column in columns)) for case, row in rows.items()]
    return Table(("case", *columns), cells)


def _ending_text(outcome: HardCaseOutcome) -> str:
    wrong = "" if outcome.allowed else " (!)"
    if outcome.kind == STOPPED:
        return f"stopped: {outcome.said.split(':', 1)[0]}{wrong}"
    return f"{outcome.kind}: {outcome.error:.1g}{wrong}"


def outcome_table(outcomes: Sequence[HardCaseOutcome]) -> Table:
    """Make the table of outcomes, one row per run."""
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
    return Table(("case", "method", "dt", "outcome", "error", "limit", "said", "seconds"), rows)


def hard_case_descriptions(names: Collection[str]) -> Table:
    """Return a table with the difficulty and the error measure of each case."""
    rows = [
        (case.name, case.difficulty, case.measure.description)
        for case in hard_case_catalogue()
        if case.name in names
    ]
    return Table(("case", "difficulty", "error"), rows)


VARIATIONS = (
    (f"stormer-verlet{COMPENSATED}", "auto", 1.0),
    ("adaptive-verlet", "auto", 10.0),
    ("blanes-moan-4", "auto", 10.0),
    ("stormer-verlet", "auto*4", 16.0),
    ("stormer-verlet", "auto/4", 1.0),
)
"""Other methods and steps for the hard cases, and factors by which the error limit of a case is multiplied. A
step four times as long has sixteen times the error, and errors differ between methods."""


def stability_tasks(full: bool) -> list[Task]:
    """Return the tasks that run the catalogue of hard cases."""
    cases = hard_case_catalogue()
    variations = [
        _hard_case_task(_loosen_case_limits(case, times), method, dt, False)
        for method, dt, times in (VARIATIONS if full else ())
        for case in cases
        if case.dt == "auto"
    ]
    return [*(_hard_case_task(case, "stormer-verlet", None, full) for case in cases), *variations]


def _hard_case_task(case: HardCase, method: str, dt: float | str | None, full: bool) -> Task:
    key = {"case": case.name, "method": method, "dt": str(dt), "full": full}
    return Task(case.name, key, partial(run_hard_case, case, method, dt, full=full))


def _loosen_case_limits(case: HardCase, times: float) -> HardCase:
    """Return a case whose error limit is ``times`` as large, and whose run may warn or stop."""
    return dataclasses.replace(
        case, limit=case.limit * times, may_degrade=True, errors=(*case.errors, *BROKEN, "InputError")
    )


def _outcome_verdict_and_passed(outcomes: Sequence[HardCaseOutcome]) -> tuple[str, bool]:
    return outcome_summary(outcomes).rstrip("."), all(outcome.allowed for outcome in outcomes)


def _outcome_details(outcomes: Sequence[HardCaseOutcome]) -> list[Block]:
    names = {outcome.case for outcome in outcomes}
    meanings = Text("Difficulty and error measure of each case.")
    return [Text("Hard cases."), outcome_table(outcomes), meanings, hard_case_descriptions(names)]


def outcome_count_table(outcomes: Sequence[HardCaseOutcome]) -> Table:
    """Tabulate in one row how many hard cases have each ending."""
    counts = [sum(outcome.kind == kind for outcome in outcomes) for kind in (ACCURATE, DEGRADED, STOPPED)]
    wrong = [outcome.case for outcome in outcomes if not outcome.allowed]
    header = ("hard cases", ACCURATE, DEGRADED, "stopped by a typed error", "ended as not allowed")
    return Table(header, [(len(outcomes), *counts, ", ".join(wrong) or "none")])


STABILITY = Section(
    "stability",
    "Hard cases",
    stability_tasks,
    HardCaseOutcome,
    _outcome_verdict_and_passed,
    outcome_blocks,
    _outcome_details,
)
