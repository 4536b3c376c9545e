"""Tests of de Paula's qualitative statements on the damper, regression and experiment."""

from __future__ import annotations

from research.published.measures import samples_under_common_protocol
from research.published.plan import GAMMAS, MASSES, SOURCE_DRAG, damper_series_name
from research.published.results import PublishedResults
from research.published.statement import StatementCheck


def check_symbolic_regression_finds_oscillator(results: PublishedResults) -> StatementCheck | None:
    misfit, length = (results.calculated_number("symbolic", name) for name in ("misfit", "length"))
    if misfit is None or length is None:
        return None
    return StatementCheck(
        misfit < 1e-3,
        f"pyoperon finds an expression of {length:.0f} symbols with a relative residual of {misfit:.1e}; de "
        f"Paula prints no settings of PySR, which needs Julia",
    )


def van_der_pol_like_and_linear_misfit(results: PublishedResults, drag: float) -> tuple[float, float] | None:
    name = damper_series_name(MASSES[1], drag)
    result = [results.figure_sample(name, item) for item in ("free_misfit", "free_linear_misfit")]
    if result[0] is None or result[1] is None:
        return None
    return float(result[0].values.mean()), float(result[1].values.mean())


def check_van_der_pol_like_law_beats_linear_law(results: PublishedResults) -> StatementCheck | None:
    rows = [(drag, van_der_pol_like_and_linear_misfit(results, drag)) for drag in GAMMAS]
    at_source = van_der_pol_like_and_linear_misfit(results, SOURCE_DRAG)
    if at_source is None:
        return None
    listed = ", ".join(
        f"{100.0 * item[0]:.1f} and {100.0 * item[1]:.1f} % at {drag:g}"
        for drag, item in rows
        if item is not None
    )
    return StatementCheck(
        at_source[0] < 0.5 * at_source[1], f"residuals of both, relative to the oscillation: {listed} kg/s"
    )


def check_van_der_pol_like_law_beats_linear_law_at_printed_drag(
    results: PublishedResults,
) -> StatementCheck | None:
    result = van_der_pol_like_and_linear_misfit(results, GAMMAS[0])
    if result is None:
        return None
    return StatementCheck(
        result[0] < 0.5 * result[1],
        f"{100.0 * result[0]:.2f} and {100.0 * result[1]:.2f} % of the oscillation are residuals",
    )


def check_scattered_moments_reduce_order(results: PublishedResults) -> StatementCheck | None:
    names = [
        "pressed, R = 1",
        "pressed, R = 1, moments ± 0.1",
        "pressed, R = 0",
        "pressed, R = 0, moments ± 0.1",
    ]
    result = samples_under_common_protocol(names, "hexagons_pressed", results)
    if result is None:
        return None
    even, uneven, zero, zero_uneven = (float(item.values.mean()) for item in result)
    return StatementCheck(
        uneven < even - 0.05,
        f"at 110 N the fraction of hexagons at R = 1 is {even:.2f} with equal moments, "
        f"{uneven:.2f} with a scatter of 10 % (R = 0: {zero:.2f} and {zero_uneven:.2f})",
    )
