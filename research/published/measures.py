"""Computation of our values from the results of one or several series of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from granular.shared.errors import InputError
from research.published.finding import Finding
from research.published.results import FigureSample, PublishedResults

Measure = Callable[[PublishedResults], Finding | None]


def make_mean_measure(
    name: str, figure: str, scale: float = 1.0, pool: Sequence[str] = (), protocol: str | None = None
) -> Measure:
    """Make the measure of mean and deviation of a figure of one series.

    The deviation is pooled over all series of ``pool``, whose starts have equal scatter: from three starts
    alone it would be too uncertain to show most differences.
    """

    def measure(results: PublishedResults) -> Finding | None:
        sample = results.figure_sample(name, figure, protocol)
        if sample is None:
            return None
        result = sample._replace(values=scale * sample.values).finding()
        pooled = pooled_deviation_and_freedom(results, pool, figure, sample.protocol)
        if pooled is None:
            return result
        spread, freedom = scale * pooled[0], pooled[1]
        error = spread / math.sqrt(len(sample.values))
        return result._replace(spread=spread, error=error, freedom=float(freedom))

    return measure


def pooled_deviation_and_freedom(
    results: PublishedResults, names: Sequence[str], figure: str, protocol: str
) -> tuple[float, int] | None:
    """Return the pooled deviation of single starts of several series, and its degrees of freedom."""
    samples = [results.figure_sample(name, figure, protocol) for name in names]
    values = [item.values for item in samples if item is not None and len(item.values) > 1]
    freedom = sum(len(item) - 1 for item in values)
    if not freedom:
        return None
    return math.sqrt(sum(len(item) * float(item.var()) for item in values) / freedom), freedom


def make_calculation_measure(name: str, figure: str) -> Measure:
    """Make the measure of a number that needs no simulated bed."""

    def measure(results: PublishedResults) -> Finding | None:
        value = results.calculated_number(name, figure)
        return None if value is None else Finding(value)

    return measure


def samples_under_common_protocol(
    names: Sequence[str], figure: str, results: PublishedResults, protocol: str | None = None
) -> list[FigureSample] | None:
    """Return a figure of several series under one protocol, the best that is planned for all."""
    chosen = results.best_common_protocol(*names) if protocol is None else protocol
    if chosen is None:
        return None
    result = [results.figure_sample(name, figure, chosen) for name in names]
    integer = [item for item in result if item is not None]
    return integer if len(integer) == len(result) else None


def make_list_force_loss_measure(count: int) -> Measure:
    """Make the measure of the force with the list minus the direct sum's, in % of the former."""

    def measure(results: PublishedResults) -> Finding | None:
        result = samples_under_common_protocol([f"direct {count}", f"list {count}"], "force", results)
        if result is None:
            return None
        direct, listed = (item.finding() for item in result)
        return _finding_of_function_of_ratio(direct, listed, lambda ratio: 100.0 * (1.0 - ratio), 100.0)

    return measure


def _finding_of_function_of_ratio(
    item: Finding, other: Finding, value: Callable[[float], float], slope: float
) -> Finding:
    """Return a function of the ratio of two findings; ``slope`` is its derivative by the ratio."""
    ratio = item.value / other.value

    def combined_error_of_ratio(first: float | None, second: float | None) -> float | None:
        if first is None or second is None:
            return None
        return slope * ratio * math.hypot(first / item.value, second / other.value)

    spread, error = (
        combined_error_of_ratio(item.spread, other.spread),
        combined_error_of_ratio(item.error, other.error),
    )
    freedom = item.freedom + other.freedom if error is not None else 0.0
    return Finding(value(ratio), spread, item.starts + other.starts, item.protocol, item.step, error, freedom)


class ForceOverSizeLine:
    """The line of the mean force over the number of grains, as in [D, Table 5.1]."""

    def __init__(self, way: str, sizes: Sequence[int]) -> None:
        self.way, self.sizes = way, tuple(sizes)

    def slope(self, results: PublishedResults) -> Finding | None:
        return self._fitted_coefficient(results, 0)

    def intercept(self, results: PublishedResults) -> Finding | None:
        return self._fitted_coefficient(results, 1)

    def r_squared(self, results: PublishedResults) -> Finding | None:
        """Return the fraction of the means' variance explained by the line."""
        result = self._force_samples_by_size(results)
        if result is None:
            return None
        means = np.array([item.values.mean() for item in result])
        left = means - self._least_squares_matrix() @ (np.linalg.pinv(self._least_squares_matrix()) @ means)
        value = 1.0 - float(left @ left) / float(np.square(means - means.mean()).sum())
        return finding_without_error(value, result)

    def _force_samples_by_size(self, results: PublishedResults) -> list[FigureSample] | None:
        return samples_under_common_protocol([f"{self.way} {n}" for n in self.sizes], "force", results)

    def _least_squares_matrix(self) -> np.ndarray:
        return np.stack([np.array(self.sizes, dtype=float), np.ones(len(self.sizes))], axis=1)

    def _fitted_coefficient(self, results: PublishedResults, position: int) -> Finding | None:
        result = self._force_samples_by_size(results)
        if result is None:
            return None
        row = np.linalg.pinv(self._least_squares_matrix())[position]
        value = float(row @ [item.values.mean() for item in result])
        errors = np.array([item.finding().error or 0.0 for item in result])
        starts = sum(len(item.values) for item in result)
        return Finding(
            value,
            None,
            starts,
            result[0].protocol,
            result[0].step,
            float(np.linalg.norm(row * errors)),
            float(starts - len(result)),
        )


def finding_without_error(value: float, result: Sequence[FigureSample]) -> Finding:
    """Return a finding from samples without a known error."""
    starts = sum(len(item.values) for item in result)
    return Finding(value, None, starts, result[0].protocol, result[0].step)


def make_asymptotic_list_loss_measure(direct: ForceOverSizeLine, listed: ForceOverSizeLine) -> Measure:
    """Make the measure of the list's loss [%] in a very large bed, by two lines [D, eq. 5.5]."""

    def measure(results: PublishedResults) -> Finding | None:
        item, other = direct.slope(results), listed.slope(results)
        if item is None or other is None:
            return None
        return _finding_of_function_of_ratio(item, other, lambda ratio: 100.0 * (1.0 - ratio), 100.0)

    return measure


def make_time_exponent_measure(sizes: Sequence[int], way: str) -> Measure:
    """Make the measure of b in time per sum = a n^b, by the plain loops."""

    def measure(results: PublishedResults) -> Finding | None:
        times = [results.calculated_number("loop_times", f"{way} {n}") for n in sizes]
        known = [item for item in times if item is not None]
        if len(known) < len(times):
            return None
        slope, errors = np.polyfit(np.log(sizes), np.log(known), 1, cov=True)
        error = float(np.sqrt(errors[0, 0]))
        return Finding(float(slope[0]), protocol="timed", error=error, freedom=len(sizes) - 2.0)

    return measure


def make_time_saving_measure(count: int) -> Measure:
    """Make the measure of the fraction of the plain loop's time saved by the plain list."""

    def measure(results: PublishedResults) -> Finding | None:
        direct = results.calculated_number("loop_times", f"direct {count}")
        listed = results.calculated_number("loop_times", f"list {count}")
        if direct is None or listed is None:
            return None
        return Finding(1.0 - listed / direct, protocol="timed")

    return measure


def make_smallest_sufficient_radius_measure(radii: Sequence[float], reference: str) -> Measure:
    """Make the measure of the smallest list radius with a force within a deviation of the direct sum's.

    De Paula chooses its radius by this rule [D, Fig. 5.2]. A list that loses so many pairs that the energy
    ledger stops every start has no force, and lies outside.
    """

    def measure(results: PublishedResults) -> Finding | None:
        protocol = results.best_common_protocol(
            reference, *(_name_of_list_series(radius) for radius in radii)
        )
        if protocol is None:
            return None
        left = [
            radius
            for radius in radii
            if not results.are_all_starts_stopped(_name_of_list_series(radius), protocol)
        ]
        names = [_name_of_list_series(radius) for radius in left]
        result = samples_under_common_protocol([reference, *names], "force", results, protocol)
        if result is None:
            return None
        band = result[0].finding()
        for radius, item in zip(left, result[1:], strict=True):
            if abs(item.values.mean() - band.value) <= (band.spread or 0.0):
                return finding_without_error(radius, result)
        return None

    return measure


def _name_of_list_series(radius: float) -> str:
    return f"list of radius {radius:g} D"


def make_force_deviation_measure(name: str) -> Measure:
    """Make the measure of the deviation over starts of the force at full compression [N]."""

    def measure(results: PublishedResults) -> Finding | None:
        sample = results.figure_sample(name, "force")
        if sample is None or len(sample.values) < 2:
            return None
        return _finding_of_deviation(float(sample.values.std(ddof=1)), sample)

    return measure


def make_maximum_relative_force_deviation_measure(name: str) -> Measure:
    """Make the measure of the maximum deviation of the force in the cycle, over the mean maximum force."""

    def measure(results: PublishedResults) -> Finding | None:
        sample = results.figure_sample(name, "force")
        courses = [np.array(results.figure_lists_by_start(name, way)) for way in ("down", "up")]
        if sample is None or any(item.ndim != 2 or len(item) < 2 for item in courses):
            return None
        trajectory = np.concatenate(courses, axis=1)
        value = float(trajectory.std(axis=0, ddof=1).max() / trajectory.max(axis=1).mean())
        return _finding_of_deviation(value, sample)

    return measure


def _finding_of_deviation(value: float, sample: FigureSample) -> Finding:
    """Return a deviation, with the standard error for normally distributed samples."""
    free = len(sample.values) - 1
    error = value / math.sqrt(2.0 * free)
    return sample.finding()._replace(value=value, spread=None, error=error, freedom=float(free))


def make_maximum_equal_force_speed_measure(
    speeds: Sequence[float], reference: str, allowed: float
) -> Measure:
    """Make the measure of the maximum speed [mm/s] with the reference's force within ``allowed``."""

    def measure(results: PublishedResults) -> Finding | None:
        names = [f"speed {v:g}" for v in speeds]
        result = samples_under_common_protocol([reference, *names], "force", results)
        if result is None:
            return None
        base = result[0].values.mean()
        reached = 0.0
        for speed, item in zip(speeds, result[1:], strict=True):
            if abs(item.values.mean() / base - 1.0) > allowed:
                break
            reached = speed
        return finding_without_error(reached, result)

    return measure


def make_order_correlation_measure(names: Sequence[str]) -> Measure:
    """Make the measure of Pearson's correlation of Psi6 and hexagon fraction at full compression."""

    def measure(results: PublishedResults) -> Finding | None:
        from granular.observables import pearson_correlation

        orders = samples_under_common_protocol(names, "psi6_full", results)
        fractions = samples_under_common_protocol(names, "hexagons_full", results)
        if orders is None or fractions is None:
            return None
        pairs = [np.concatenate([item.values for item in some]) for some in (orders, fractions)]
        try:
            value = pearson_correlation(pairs[0], pairs[1]).coefficient
        except InputError:
            return None
        # Fisher's standard error of a correlation.
        free = len(pairs[0]) - 3.0
        error = (1.0 - value**2) / math.sqrt(free)
        return finding_without_error(value, orders)._replace(error=error, freedom=free)

    return measure


def make_minimum_measure(measures: Sequence[Measure]) -> Measure:
    """Make the measure of the smallest available finding."""

    def measure(results: PublishedResults) -> Finding | None:
        result = [item for item in (entry(results) for entry in measures) if item is not None]
        return min(result, key=lambda item: item.value) if result else None

    return measure


def make_force_ratio_measure(name: str, last: str) -> Measure:
    """Make the measure of a mixture's force over the force of its small grains alone."""

    def measure(results: PublishedResults) -> Finding | None:
        result = samples_under_common_protocol([name, last], "force", results)
        if result is None:
            return None
        item, other = (entry.finding() for entry in result)
        return _finding_of_function_of_ratio(item, other, lambda ratio: ratio, 1.0)

    return measure


def make_force_over_published_curve_measure(
    curve: Callable[[float], float], ratios: Sequence[float], names: Sequence[str]
) -> Measure:
    """Make the measure of F(R)/F(1) over a published curve, at the R of the most significant difference."""

    def measure(results: PublishedResults) -> Finding | None:
        result = samples_under_common_protocol(names, "force", results)
        if result is None:
            return None
        last = result[ratios.index(1.0)].finding()
        forces = [item.finding() for r, item in zip(ratios, result, strict=True) if r != 1.0]
        printed = [curve(r) for r in ratios if r != 1.0]
        over = [
            _finding_of_function_of_ratio(item, last, partial(_divide_by, at), 1.0 / at)
            for item, at in zip(forces, printed, strict=True)
        ]
        return max(over, key=lambda item: abs(item.value - 1.0) / (item.error or math.inf))

    return measure


def _divide_by(divisor: float, value: float) -> float:
    return value / divisor


def make_maximum_start_difference_measure(names: Sequence[str]) -> Measure:
    """Make the measure of the maximum force difference between two starts of the same bed [N]."""

    def measure(results: PublishedResults) -> Finding | None:
        result = samples_under_common_protocol(names, "force", results)
        if result is None:
            return None
        value = max(float(np.ptp(item.values[:2])) for item in result)
        return finding_without_error(value, result)

    return measure
