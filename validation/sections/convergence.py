"""Orders of convergence: slopes, and a picture for each problem."""

from __future__ import annotations

from collections.abc import Sequence

from granular.shared.html import Page
from granular.shared.plotting import COLOURS, STYLES, figure
from validation.convergence_result import CLEAR, ConvergenceResult, convergence_table
from validation.order import HIGH_ORDER
from validation.outside import ORDERS
from validation.parts import Plain
from validation.sections.common import WIDTH, Shown, legend, note_failures, sound, tabulate
from validation.table import TextTable, table

TOLERANCES = {2: 0.02, 6: 0.1, 10: 0.3}
"""How far a slope may be from the declared order, by orders up to which it holds."""

WHOLE = 0.99
"""Decades of steps that a slope is to span, for orders up to six; numbers of steps are whole."""

OUTSIDE_REACH = 1e-12
"""How near an outside reference must come to the exact place [m]."""


def convergence_section(page: Page, results: Sequence[Plain]) -> None:
    """Slopes, and a plot for each problem."""
    found = [ConvergenceResult.from_plain(one) for one in sound(results)]
    page.section("Order of convergence")
    page.text(
        "Error at the end against the exact solution (closed forms, or quadrature of the energy "
        "integral to thirty digits), over the time step. The slope is fitted over the finest "
        f"decade of steps whose error is at least {CLEAR:g} times the measured rounding; its "
        "interval says how straight the line is. A motion that is not smooth (friction stops the "
        "grain) limits every method to order two. Methods of order six and more run with "
        "compensated sums, so that a decade of steps lies above rounding; SciPy and diffrax are "
        "outside references, on forces of their own, which must reach the same exact solution. "
        "An empty cell: the method does not suit the problem, or was not run on it."
    )
    tabulate(page, slopes(found))
    wrong = [one for one in found if not convergence_holds(one)]
    for one in wrong:
        page.note(f"{one.method} on {one.problem} does not show its order {one.order}.")
    for name in dict.fromkeys(one.problem for one in found):
        group = [one for one in found if one.problem == name and not one.exact]
        if not group:
            page.text(f"On {name} every method shown is exact to rounding.")
            continue
        with figure(width=WIDTH, height=5.2) as (drawing, axes):
            for k, one in enumerate(group):
                style = STYLES[k // len(COLOURS) % len(STYLES)]
                one.plot(axes, color=COLOURS[k % len(COLOURS)], linestyle=style, linewidth=1.0)
            legend(axes)
            page.figure(drawing, f"{name}: error at the end over the time step.")
    note_failures(page, results)


def slopes(found: Sequence[ConvergenceResult]) -> TextTable:
    """Measured slopes: a row a method, a column a problem."""
    problems = tuple(dict.fromkeys(one.problem for one in found))
    declared = {one.method: one.order for one in found}
    cells = {(one.method, one.problem): _slope(one) for one in found}
    rows = [
        (method, order, *(cells.get((method, problem), "") for problem in problems))
        for method, order in sorted(declared.items(), key=lambda pair: pair[1])
    ]
    return table(("method", "order", *problems), rows)


def _slope(one: ConvergenceResult) -> str:
    wrong = "" if convergence_holds(one) else " (!)"
    if one.fit is None:
        return f"{'exact' if one.exact else 'too few steps'}{wrong}"
    return f"{one.fit.value:.3f}{wrong}"


def convergence_holds(one: ConvergenceResult) -> bool:
    """Whether a slope is as declared over a decade, or the method is exact on the problem."""
    if not one.smooth:
        return one.fit is not None and abs(one.fit.value - min(one.order, 2)) <= 0.1
    if one.method in ORDERS:
        # Their order is not the toolkit's to prove; they must reach the exact solution.
        return min(one.errors) <= OUTSIDE_REACH
    if one.fit is None and one.order > HIGH_ORDER:
        return True  # errors of order eight are rounding before they have fallen for half a decade
    clear = one.exact or one.decades >= WHOLE or one.order > HIGH_ORDER
    if one.order in (3, 5, 7, 9) and one.fit is not None and one.fit.value > one.order:
        # On a motion that is symmetric in time the leading error of an odd order may cancel.
        return clear and one.fit.value < one.order + 1 + _tolerance(one.order)
    return clear and one.holds(_tolerance(one.order))


def _tolerance(order: int) -> float:
    return next(room for highest, room in TOLERANCES.items() if order <= highest)


def _text(results: Sequence[Plain]) -> str:
    return convergence_table([ConvergenceResult.from_plain(one) for one in results]).text()


def _verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [ConvergenceResult.from_plain(one) for one in results]
    right = sum(map(convergence_holds, found))
    return f"{right} of {len(found)} slopes are as declared", right == len(found)


def _measurements(page: Page, results: Sequence[Plain]) -> None:
    page.text("Orders of convergence.")
    tabulate(page, convergence_table([ConvergenceResult.from_plain(one) for one in results]))


CONVERGENCE = Shown(_text, _verdict, convergence_section, _measurements)
