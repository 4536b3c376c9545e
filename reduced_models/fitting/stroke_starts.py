"""Find start vectors of a fit along a prescribed stroke, for which no equation of motion is solved.

Most parameters are factors of terms in the force. They follow from linear least squares if the other
parameters are known. The other parameters are drawn at random, about sizes estimated by dimensional
analysis. The best draws start the search.

A law may contain smaller laws: the law without the terms that an input multiplies, or with hidden states
that follow their input without lag. The smaller laws are fitted first, and the fit of the larger law starts
from their fits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from granular.shared.array_types import Float
from reduced_models.fitting.natural_sizes import natural_sizes
from reduced_models.fitting.parameter import SearchUnknowns
from reduced_models.fitting.problem import FitProblem
from reduced_models.fitting.residuals import compiled_residuals_or_normal_equations, rms
from reduced_models.fitting.start_values import parameters_linear_in
from reduced_models.records.inputs import STROKE, TIME, input_column

_DRAWS = 512
_LOW, _HIGH = -4.0, 4.0  # logarithm of the ratio of a drawn value to its natural size
_POSITIVE = 0.85  # fraction of positive draws of a parameter that may have either sign
_NEAR = 0.1  # spread of the logarithm of values that are given
_LEAST = 1e-3  # minimum contribution of a positive factor, as a fraction of the signal
_TINY = 1e-12  # positive factor that is nearly zero, as a fraction of its natural size
_AT_ONCE = 2.0  # lag of a state without lag, in steps of the coarse grid


class NestedLaw(NamedTuple):
    """A law with some parameters held at values that reduce it to a smaller law."""

    held: Mapping[str, float]

    def problem_with_held_parameters(self, problem: FitProblem) -> FitProblem:
        """Return a problem in which the held parameters of the smaller law are fixed."""
        edges = {name: (value, value) for name, value in self.held.items()}
        return problem.with_data(
            dataclasses.replace(data, bounds={**data.bounds, **edges}) for data in problem.data
        )


def nested_laws(problem: FitProblem) -> tuple[NestedLaw, ...]:
    """Return smaller laws within a law, smallest first: without inputs, then with inputs but without lag."""
    import sympy

    law, parsed = problem.law, problem.law.parsed_equation
    taken = {*problem.bounds, *problem.start, *problem.data[0].bounds, *problem.data[0].per_record}
    inputs = {sympy.Symbol(name) for name in law.inputs if name not in (*STROKE, TIME)}
    step = _AT_ONCE * max(data.grid.step for data in problem.data)
    drives, lags = set(inputs), dict[str, float]()
    for name, rate in parsed.hidden.items():
        slope = -rate.diff(sympy.Symbol(name))
        symbols = [item.name for item in slope.free_symbols]
        if len(symbols) != 1 or symbols[0] not in law.parameters or not rate.free_symbols & inputs:
            continue
        drives.add(sympy.Symbol(name))
        is_time = slope == 1 / sympy.Symbol(symbols[0])
        if (is_time or slope == sympy.Symbol(symbols[0])) and symbols[0] not in taken:
            lags[symbols[0]] = step if is_time else 1.0 / step
    still = dict.fromkeys(drives, 0)
    formulas = [*parsed.acceleration_and_hidden_rates, *parsed.observations.values()]
    factors = {
        name: 0.0
        for name in law.parameters
        if name not in (*taken, *law.positive, *lags)
        and all(formula.diff(sympy.Symbol(name)).subs(still) == 0 for formula in formulas)
    }
    stages = [{**factors, **lags}] * bool(factors) + [lags] * bool(lags)
    return tuple(NestedLaw(held) for held in stages if len(held) < len(law.parameters))


@dataclasses.dataclass(frozen=True, eq=False)
class StrokeStartDraws:
    """Random draws of a force law's parameters, and the units in which the parameters are searched."""

    unknowns: SearchUnknowns
    theta: Float[np.ndarray, "s q"]  # best draws of the law itself
    sizes: Mapping[str, float]

    @classmethod
    def draw_for_problem(cls, problem: FitProblem) -> StrokeStartDraws:
        """Draw parameters for a problem; keep the best draws."""
        unknowns, law = problem.unknowns, problem.law
        record = problem.data[0].record
        signals = {name: 1.0 for name in law.inputs if name not in (*STROKE, TIME)}
        signals = {name: rms(input_column(record, name)) or 1.0 for name in signals}
        signals |= {data.unknowns.observation: data.unknowns.signal for data in problem.data}
        sizes = natural_sizes(law.parsed_equation, unknowns.amplitude, unknowns.speed, signals)
        draws = _SearchVectorDraws(problem, sizes)
        values = draws.best_draws_after_linear_fit(
            draws.draw_entries(draws.rows_of_nearly_zero_values(_DRAWS), draws.nonlinear), problem.starts
        )
        units = tuple(
            1.0 if name in law.positive else abs(values[0, k]) or sizes[name]
            for k, name in zip(problem.data[0].joint_vector_indices, law.parameters, strict=False)
        )
        hidden = tuple(sizes[name] for name in law.hidden)
        unknowns = dataclasses.replace(unknowns, units=units, hidden_sizes=hidden)
        return cls(unknowns, draws.with_units(unknowns).search_vectors(values), sizes)

    def best_draws_as_search_vectors(self, problem: FitProblem) -> Float[np.ndarray, "s q"]:
        """Return the best draws of a smaller law as search vectors."""
        draws = _SearchVectorDraws(problem, self.sizes)
        return draws.search_vectors(
            draws.best_draws_after_linear_fit(
                draws.draw_entries(draws.rows_of_nearly_zero_values(_DRAWS), draws.nonlinear), problem.starts
            )
        )

    def start_vectors_of_larger_law(
        self, problem: FitProblem, released: Sequence[str], theta: Float[np.ndarray, "s q"]
    ) -> Float[np.ndarray, "s q"]:
        """Turn fits of a smaller law into start vectors of a larger one; draw its additional parameters."""
        draws = _SearchVectorDraws(problem, self.sizes)
        count = len(theta)
        values = np.repeat(draws.si_values(theta), max(1, _DRAWS // count), axis=0)
        names = [k for k in draws.nonlinear if draws.names[k] in released]
        fresh = draws.fit_linear_factors(draws.draw_entries(values, names))
        # Each unchanged fit is also a candidate next to its draws, so that no start is worse than its fit.
        shape = (count, -1, values.shape[1])
        several = np.concatenate([draws.si_values(theta)[:, None], fresh.reshape(shape)], axis=1)
        flat = several.reshape(-1, values.shape[1])
        costs = np.concatenate(
            [draws.costs(part) for part in (several[:, 0], several[:, 1:].reshape(-1, flat.shape[1]))]
        )
        costs = np.concatenate([costs[:count, None], costs[count:].reshape(count, -1)], axis=1)
        return draws.search_vectors(several[np.arange(count), np.argmin(costs, axis=1)])


class _SearchVectorDraws:
    """Values (draws, q) of all entries of a search vector, in SI units."""

    def __init__(self, problem: FitProblem, sizes: Mapping[str, float]) -> None:
        self.problem, self.law, self.sizes = problem, problem.law, sizes
        self.unknowns, self.random = problem.unknowns, np.random.default_rng(problem.seed)
        self.low, self.high = problem.search_bounds
        # Some parameters have a separate entry for each record.
        self.names = {
            int(k): name
            for data in problem.data
            for k, name in zip(data.joint_vector_indices, self.law.parameters, strict=False)
        }
        self.logs = np.array([self.names.get(k) in self.law.positive for k in range(len(self.low))])
        self.units = self._units_of_entries()
        law = self.law
        known = {
            str(symbol)
            for rate in law.parsed_equation.acceleration_and_hidden_rates
            for symbol in rate.free_symbols
        }
        linear = parameters_linear_in(law.parsed_equation.observations[self.unknowns.observation], law, known)
        open_ones = [k for k in self.names if self.low[k] < self.high[k]]
        self.linear = [k for k in open_ones if self.names[k] in linear and self.names[k] not in problem.start]
        self.nonlinear = [k for k in open_ones if k not in self.linear]

    def _units_of_entries(self) -> np.ndarray:
        units = np.ones(len(self.low))
        for data in self.problem.data:
            here = data.joint_vector_indices[: len(self.law.parameters)]
            units[here] = self.unknowns.units
        return units

    def with_units(self, unknowns: SearchUnknowns) -> _SearchVectorDraws:
        """Return these draws with the scales of other unknowns."""
        return _SearchVectorDraws(self.problem.with_scales(unknowns), self.sizes)

    def rows_of_nearly_zero_values(self, count: int) -> np.ndarray:
        """Return rows of zeros, except for fixed entries (kept) and positive factors (tiny values)."""
        held = self.low == self.high
        here = np.where(held, np.where(self.logs, np.exp(np.where(held, self.low, 0.0)), self.low), 0.0)
        here[held] *= np.where(self.logs, 1.0, self.units)[held]
        tiny = [k for k in self.linear if self.logs[k]]
        here[tiny] = [_TINY * self.sizes[self.names[k]] for k in tiny]
        return np.tile(here, (count, 1))

    def si_values(self, theta: np.ndarray) -> np.ndarray:
        """Return the values, in SI units, of search vectors."""
        return np.where(self.logs, np.exp(np.where(self.logs, theta, 0.0)), theta * self.units)

    def search_vectors(self, values: np.ndarray) -> np.ndarray:
        """Return the search vectors of values in SI units, clipped to the bounds."""
        logs = np.log(np.where(self.logs, np.maximum(values, 1e-300), 1.0))
        return np.clip(np.where(self.logs, logs, values / self.units), self.low, self.high)

    def draw_entries(self, values: np.ndarray, entries: Sequence[int]) -> np.ndarray:
        """Draw entries near given start values, or else about sizes from dimensional analysis."""
        from scipy.stats.qmc import LatinHypercube

        if not entries:
            return values
        values, count = values.copy(), len(values)
        cube = LatinHypercube(len(entries), rng=self.random).random(count)
        for k, column in zip(entries, cube.T, strict=True):
            name = self.names[k]
            if name in self.problem.start:
                spread = _NEAR * self.random.normal(size=count) * (np.arange(count) > 0)
                values[:, k] = self.problem.start[name] * np.exp(spread)
                continue
            values[:, k] = self.sizes[name] * np.exp(_LOW + (_HIGH - _LOW) * column)
            if name not in self.law.positive:
                values[:, k] *= np.where(self.random.uniform(size=count) < _POSITIVE, 1.0, -1.0)
        return values

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Return the residuals (n, draws); very large if the signal is not finite."""
        vectors = self.search_vectors(values)
        left = [
            compiled_residuals_or_normal_equations(data.unknowns, "several")(
                vectors[:, data.joint_vector_indices], data.samples, data.unknowns.scales
            )
            for data in self.problem.data
        ]
        return np.nan_to_num(np.concatenate(left), nan=1e9, posinf=1e9, neginf=-1e9)

    def costs(self, values: np.ndarray) -> np.ndarray:
        """Return the sums of squared residuals (draws,)."""
        return np.asarray((self.residuals(values) ** 2).sum(axis=0))

    def fit_linear_factors(self, values: np.ndarray) -> np.ndarray:
        """Fit the linear factors of the force by least squares; keep the other values."""
        if not self.linear:
            return values
        values = values.copy()
        sizes = np.array([self.sizes[self.names[k]] for k in self.linear])
        logs = self.logs[self.linear]
        values[:, self.linear] = np.where(logs, _TINY * sizes, 0.0)
        left, columns = self.residuals(values), []
        for k, size in zip(self.linear, sizes, strict=True):
            changed = values.copy()
            changed[:, k] += size
            columns.append(self.residuals(changed) - left)
        matrices = np.stack(columns, axis=-1)
        for draw in range(len(values)):
            matrix = matrices[:, draw]
            scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
            steps = -np.linalg.lstsq(matrix / scale, left[:, draw], rcond=1e-9)[0] / scale
            least = _LEAST * np.linalg.norm(left[:, draw]) / scale
            steps = np.where(logs, np.maximum(steps, least), steps)
            values[draw, self.linear] += sizes * steps
        return values

    def best_draws_after_linear_fit(self, values: np.ndarray, count: int) -> np.ndarray:
        """Fit the linear factors of the draws; return the best draws."""
        values = self.fit_linear_factors(values)
        order = np.argsort(self.costs(values), kind="stable")
        return values[order[np.arange(count) % len(order)]]
