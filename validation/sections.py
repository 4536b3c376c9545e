"""The parts of the report as sections of a page, from their plain data."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.shared.html import Page
from granular.shared.plotting import COLOURS, GREY, STYLES, figure
from validation.cost import LEVELS, WorkPrecision
from validation.energy import EnergyStudy
from validation.energy import summary as energy_table
from validation.order import CLEAR, HIGH_ORDER, ConvergenceResult, convergence_table
from validation.outcomes import ACCURATE, STOPPED, Outcome
from validation.outside import ORDERS
from validation.parts import FAILED, Plain
from validation.source_experiment import COMPENSATED, PLAIN, PRINTED_PEAKS, SourceExperiment
from validation.table import TextTable, table
from validation.trend import SIGNIFICANCE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = 40
WIDTH = 5.6
"""Of a figure [inch]: narrow enough for its letters to be read on a phone."""

TOLERANCES = {2: 0.02, 6: 0.1, 10: 0.3}
"""How far a slope may be from the declared order, by orders up to which it holds."""

WHOLE = 0.99
"""Decades of steps that a slope is to span, for orders up to six; numbers of steps are whole."""

OUTSIDE_REACH = 1e-12
"""How near an outside reference must come to the exact place [m]."""


def _sound(results: Sequence[Plain]) -> list[Plain]:
    return [one for one in results if FAILED not in one]


def _note_failures(page: Page, results: Sequence[Plain]) -> None:
    for one in results:
        if FAILED in one:
            page.note(f"{one['label']} failed: {one[FAILED]}")


def _tabulate(page: Page, shown: TextTable) -> None:
    page.table(shown.header, [tuple(map(_unbroken, row)) for row in shown.rows])


def _unbroken(cell: str) -> str:
    """A cell that begins with a number stays on one line: 1e-06 is not broken at its sign."""
    if "," in cell or not cell.lstrip("+-")[:1].isdigit():
        return cell
    return cell.replace("-", "\u2011").replace(" ", "\u00a0")


# Convergence ------------------------------------------------------------------------------------


def convergence_section(page: Page, results: Sequence[Plain]) -> None:
    """Slopes, and a plot for each problem."""
    found = [ConvergenceResult.from_plain(one) for one in _sound(results)]
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
    _tabulate(page, slopes(found))
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
            _legend(axes)
            page.figure(drawing, f"{name}: error at the end over the time step.")
    _note_failures(page, results)


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


def _legend(axes: Axes, columns: int = 2) -> None:
    # Below the axes, so that a narrow page leaves the figure wide enough to be read.
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=columns)


# The source's experiment ------------------------------------------------------------------------


def source_section(page: Page, results: Sequence[Plain]) -> None:
    """Errors over the step, and the peaks, with and without rounding."""
    page.section("The source's test of its method")
    _note_failures(page, results)
    for one in map(SourceExperiment.from_plain, _sound(results)):
        clean, plain = one.of(COMPENSATED)[-1], one.of(PLAIN)[-1]
        page.text(
            "A grain of 5 mm bounces for 2 s from 40 D [D, 2.3.4]. With compensated sums the error "
            f"against the exact height falls with the slope {one.slope(COMPENSATED):.4f}, to "
            f"{clean.error:.1e} m at a step of {clean.step:g} s. In the plain position form it is "
            f"{plain.error:.1e} m there, all but {clean.error:.0e} m of it rounding: what a plot "
            "of it shows below 1e-6 s is rounding. The greatest difference of two peaks is "
            f"{plain.peak_difference:.1e} m there (the source prints {PRINTED_PEAKS:g} m) and "
            f"{clean.peak_difference:.1e} m compensated. The toolkit's velocity form is the same "
            "sequence: its heights, compensated, differ from those of the position form by "
            f"{one.agreement():.1g} m at most."
        )
        page.text(
            "The source sees its points scatter about the line, and ascribes that to errors that "
            "are relative to the finest step. That alone makes a slope of "
            f"{one.slope_to_finest(COMPENSATED):.3f}, with points within "
            f"{one.scatter_to_finest(COMPENSATED):.0%} of the line, as the compensated sums show. "
            f"In the plain position form rounding makes it {one.slope_to_finest(PLAIN):.2f}, with "
            f"points off the line by up to {one.scatter_to_finest(PLAIN):.0%}."
        )
        with figure(width=WIDTH, height=5.2) as (drawing, axes):
            one.plot(axes)
            _legend(axes, columns=1)
            page.figure(
                drawing,
                "Error of the height after 2 s: against the exact one (dots), and relative to the "
                "finest step (rings).",
            )
        with figure(2, 1, width=WIDTH, height=5.6) as (drawing, (above, below)):
            one.plot_path(above)
            one.plot_peaks(below)
            above.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
            below.legend(fontsize=8, loc="center right")
            page.figure(
                drawing,
                "Height over time at the finest step, and how far each peak is from the start's "
                "height.",
            )
        _tabulate(page, one.table())


# Energy -----------------------------------------------------------------------------------------


def energy_section(page: Page, results: Sequence[Plain]) -> None:
    """Trends, the error over time, and phase portraits."""
    found = [EnergyStudy.from_plain(one) for one in _sound(results)]
    page.section("Energy over long runs")
    page.text(
        "Error of the energy over the energy turned over. A trend is claimed where it stands out "
        f"against stationary noise and against a random walk, at p below {SIGNIFICANCE:g}. "
        "Symplectic methods, and reversible variable steps, should show none; the controls gain "
        "(explicit Euler) or lose (Runge-Kutta)."
    )
    _tabulate(page, energy_table(found))
    for one in found:
        if not energy_holds(one):
            page.note(
                f"{one.method} on the {one.system} {one.trend.verdict()} energy by "
                f"{one.trend.drift:.1e} (p = {one.trend.p_value:.1g}), unlike its kind."
            )
    for system in dict.fromkeys(one.system for one in found):
        _energy_figures(page, system, [one for one in found if one.system == system])
    _note_failures(page, results)


CONTROLS = {"explicit-euler": "gains", "runge-kutta-4": "loses"}
"""What the trend of each control should be."""


def energy_holds(one: EnergyStudy) -> bool:
    """Whether a run is of its kind: without a trend, or with a control's.

    Of a user's method that is not symplectic nothing is claimed.
    """
    if not one.keeps and one.method not in CONTROLS:
        return True
    return one.trend.verdict() == ("none" if one.keeps else CONTROLS[one.method])


def _energy_figures(page: Page, system: str, group: Sequence[EnergyStudy]) -> None:
    for kind, keeps in (("symplectic or reversible", True), ("controls", False)):
        ones = [one for one in group if one.keeps is keeps]
        if not ones:
            continue
        with figure(width=WIDTH, height=4.2) as (drawing, axes):
            for k, one in enumerate(ones):
                axes.semilogy(
                    *_envelope(one),
                    color=COLOURS[k % len(COLOURS)],
                    linestyle=STYLES[k // len(COLOURS)],
                    label=f"{one.method}, {one.steps:.2g} steps",
                )
            low, high = axes.get_ylim()
            axes.set_ylim(min(low, 0.1 * high), 2.0 * high)  # what hardly changes looks so
            axes.set_ylabel("greatest energy error")
            axes.set_xlabel("share of the run")
            _legend(axes)
            page.figure(
                drawing,
                f"{system}, {kind}: greatest error of the energy in each {BINS}th of the run (of "
                f"{_lengths(ones)}), over the energy turned over.",
            )
    portraits = [one for one in group if one.heights]
    if portraits:
        _phase_portraits(page, system, portraits)


def _lengths(ones: Sequence[EnergyStudy]) -> str:
    lengths = sorted({f"{one.times[-1]:.3g}" for one in ones}, key=float)
    return f"{lengths[0]} s" if len(lengths) == 1 else f"{lengths[0]} to {lengths[-1]} s"


def _envelope(one: EnergyStudy) -> tuple[np.ndarray, np.ndarray]:
    """Middle of each part of the run, over its length, and the greatest error in it."""
    bins = min(BINS, len(one.errors))
    greatest = np.array([part.max() for part in np.array_split(np.abs(one.errors), bins)])
    middles = np.array([part.mean() for part in np.array_split(np.array(one.times), bins)])
    return middles / one.times[-1], np.where(greatest > 0.0, greatest, np.nan)


def _phase_portraits(page: Page, system: str, group: Sequence[EnergyStudy]) -> None:
    chosen = [one for one in group if one.method in _PORTRAYED] or list(group[:1])
    with figure(2, len(chosen), height=5.0, width=2.6 * len(chosen) + 0.8, squeeze=False) as (
        drawing,
        panels,
    ):
        for column, one in zip(panels.T, chosen, strict=True):
            for axes in column:
                axes.plot(one.heights, one.velocities, ".", color=COLOURS[0], markersize=1.2)
            column[0].set_title(one.method, fontsize=9)
            _zoom(column[1], one)
            column[1].set_xlabel("height [D]")
        panels[0, 0].set_ylabel("velocity [m/s]")
        panels[1, 0].set_ylabel("velocity [m/s], zoom")
        page.figure(drawing, f"{system}: phase portraits, and a zoom at the upper turning point.")


_PORTRAYED = ("stormer-verlet", "stormer-verlet+compensated", "explicit-euler", "runge-kutta-4")


def _zoom(axes: Axes, one: EnergyStudy) -> None:
    """The upper turning point, wide enough for a drift of a hundredth."""
    top, fastest = one.heights[0], max(map(abs, one.velocities))
    axes.set_xlim(0.98 * top, 1.02 * top)
    axes.set_ylim(-0.25 * fastest, 0.25 * fastest)
    axes.axvline(top, color=GREY, linewidth=0.8)


# Work and precision -----------------------------------------------------------------------------


def studies(results: Sequence[Plain]) -> list[WorkPrecision]:
    """The studies of all pieces."""
    return [WorkPrecision.from_plain(plain) for one in results for plain in one["studies"]]


def work_precision_section(page: Page, results: Sequence[Plain]) -> None:
    """A picture and a table a quantity, and which setting to take."""
    found = studies(_sound(results))
    page.section("What accuracy costs")
    page.text(
        "Error over wall time, warm, the least of the repeats. The broad line joins the settings "
        "that none beats in both. What to take for 1 % and for 1e-6 is ringed, and named at the "
        "dotted lines: the fastest setting behind which every shorter step is as accurate. The "
        "shaded band is the scatter over random starts, below which accuracy buys nothing. The "
        "toolkit's seconds hold its records, ledger and start-up; those of SciPy and diffrax "
        "(thin, dotted) the bare integration. The last column is the time over that of the default "
        "setting, stormer-verlet at dt = auto."
    )
    _tabulate(page, choices(found))
    for one in found:
        with figure(width=WIDTH, height=5.0) as (drawing, axes):
            one.plot(axes)
            _legend(axes)
            until = "" if one.horizon is None else f" over {one.horizon:g} s"
            page.figure(drawing, f"{one.quantity} of {one.scene}{until}, against {one.reference}.")
    _note_failures(page, results)


def choices(found: Sequence[WorkPrecision]) -> TextTable:
    """Which setting to take for 1 % and for 1e-6, and what it takes beside the default one."""
    rows = []
    for one in found:
        usual = one.usual()
        seconds = math.nan if usual is None else usual.seconds
        rows += [
            (one.scene, one.quantity, words, *_chosen(one, level, seconds))
            for words, level in LEVELS.items()
        ]
    header = ("scene", "quantity", "to", "take", "dt", "error", "seconds", "of the default's")
    return table(header, rows)


def _chosen(one: WorkPrecision, level: float, usual: float) -> tuple[str, ...]:
    best = one.cheapest(level)
    if best is None:
        why = "below the scatter of starts" if level < one.floor else "none reaches it"
        return (why, "", "", "", "")
    ratio = best.seconds / usual
    return (
        best.setting.family, str(best.setting.dt), f"{best.error:.2g}", f"{best.seconds:.3g}",
        "" if math.isnan(ratio) else f"{ratio:.2f}",
    )  # fmt: skip


# Hard cases -------------------------------------------------------------------------------------


def stability_section(page: Page, results: Sequence[Plain]) -> None:
    """The outcome of every hard case."""
    found = [Outcome.from_plain(one) for one in _sound(results)]
    page.section("Hard cases")
    page.text(stability_verdict(found))
    for one in found:
        if not one.allowed:
            page.note(f"{one.case} ({one.method}, dt {one.dt}): {one.kind}. {one.said}")
    page.text(
        "Error of each run over the figure that counts as accurate for its case (ten times that "
        "for other methods, sixteen for a step four times as long): below 1 it is accurate. An "
        "InputError says that a method does not suit the scene. All measurements are at the end "
        "of this page, with the figures and messages."
    )
    _tabulate(page, stability_matrix(found))
    _note_failures(page, results)


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
    for one in found:
        first = one.case not in rows
        row = rows.setdefault(one.case, {})
        column = own if first else _column(one)
        columns[column] = None
        row[column] = _ending(one)
    return table(
        ("case", *columns),
        [(case, *(row.get(column, "") for column in columns)) for case, row in rows.items()],
    )


def _column(one: Outcome) -> str:
    return one.method if one.dt == "auto" else one.dt


def _ending(one: Outcome) -> str:
    wrong = "" if one.allowed else " (!)"
    if one.kind == STOPPED:
        return f"{one.said.split(':', 1)[0]}{wrong}"
    share = one.error / one.limit if one.limit > 0.0 else one.error
    return f"{share:.1g}{wrong}" if one.kind == ACCURATE else f"{one.kind}{wrong}"


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


SECTIONS = {
    "convergence": convergence_section,
    "source-experiment": source_section,
    "energy": energy_section,
    "work-precision": work_precision_section,
    "stability": stability_section,
}


# All measurements -------------------------------------------------------------------------------


def measurements(page: Page, results: Mapping[str, Sequence[Plain]]) -> None:
    """The tables behind the pictures, which few will read."""
    page.section("All measurements")
    if ones := _sound(results.get("convergence", ())):
        page.text("Orders of convergence.")
        _tabulate(page, convergence_table([ConvergenceResult.from_plain(one) for one in ones]))
    for one in studies(_sound(results.get("work-precision", ()))):
        page.text(f"Cost of the {one.quantity} of {one.scene}; a star marks the best of all.")
        _tabulate(page, one.table())
    if ones := _sound(results.get("stability", ())):
        found = [Outcome.from_plain(one) for one in ones]
        page.text("Hard cases.")
        _tabulate(page, stability_table(found))
        page.text("What is hard, and what is measured.")
        _tabulate(page, case_table({one.case for one in found}))
