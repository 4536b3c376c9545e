"""The search for the numbers of a force's law: draws, factors by least squares, and all together.

Most parameters stand in the force as factors; for random draws of the others these follow from
linear least squares. The best draws start a Levenberg-Marquardt search on fewer samples and longer
steps of the hidden states, whose best ends are fitted to all samples, with steps that are halved
until the hidden states are solved to a fraction of what the fit leaves.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.piston_record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.fitting.problem import Pairs
from reduced_models.jax_setup import jax, jit
from reduced_models.laws.equation import PROGRAMS
from reduced_models.laws.force_law import ForceLaw
from reduced_models.laws.law import Law
from reduced_models.least_squares.joint_records import joint_normal_equations
from reduced_models.least_squares.levenberg_marquardt import Bounds as Edges
from reduced_models.least_squares.levenberg_marquardt import (
    Normal,
    Prior,
    agreeing_cost_limit,
    levenberg_marquardt,
)
from reduced_models.least_squares.residuals import BLOWN_UP
from reduced_models.least_squares.stroke import (
    FINE,
    Stroke,
    compiled_force_function,
    force_function,
    stroke_of_record,
)

if TYPE_CHECKING:
    from jaxtyping import Float

jnp = jax.numpy

_DRAWS = 256
_SEARCH_TRAVEL, _SEARCH_SAMPLES = 0.1, 1200  # of a step, in half strokes; of all records
POLISHED = 3
"""Vectors side by side, the best that the search ends at, for which code is compiled."""
_LOW, _HIGH = -4.0, 2.0  # logarithm of what is drawn, over its natural size
_NEAR = 0.1  # spread of the logarithm of values that are given
_LEAST = 1e-3  # of the force: least part of a factor that is above zero
# A factor of e^3 = 20 either way: it holds what records leave open, and moves nothing that they tell.
_PRIOR_SPREAD = 3.0
_SOLVED = 0.1  # of the residual: error of the hidden states' steps
_MOST_HALVINGS = 3

_POWERS = {
    "m": (1, 0, 0), "1/m": (-1, 0, 0), "m/s": (0, 1, 0), "s/m": (0, -1, 0), "s": (1, -1, 0),
    "1/s": (-1, 1, 0), "rad/s": (-1, 1, 0), "1": (0, 0, 0), "N": (0, 0, 1), "N/m": (-1, 0, 1),
    "N s/m": (0, -1, 1), "kg": (1, -2, 1),
}  # fmt: skip
"""Powers of half a stroke, of its greatest speed and of the force that make a unit."""


class ScaledStrokeData(NamedTuple):
    """A record as compiled code takes it: forces count in their size, parameters in their units."""

    stroke: Stroke
    force: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    units: Float[np.ndarray, "p"]
    size: float  # [N]


@dataclasses.dataclass(frozen=True, eq=False)
class ForceFitProblem:
    """Records with their forces, and what is asked."""

    law: ForceLaw
    field: Law  # law whose z'' is the force
    records: tuple[PistonRecord, ...]
    forces: tuple[np.ndarray, ...]  # that move the strokes [N]
    bounds: Pairs
    starts: int
    seed: int

    @functools.cached_property
    def stroke_speed_and_force_scales(self) -> tuple[float, float, float]:
        """Half a stroke [m], its greatest speed [m/s], and rms of the forces [N]."""
        length = max(0.5 * float(np.ptp(record.height)) for record in self.records)
        speed = max(float(np.gradient(item.height, item.time).std()) for item in self.records)
        force = math.sqrt(float(np.mean([force.var() for force in self.forces])))
        return length, math.sqrt(2.0) * speed, force

    @property
    def logarithmic_parameters(self) -> np.ndarray:
        """True for each parameter that is searched for by its logarithm."""
        return np.array([name in self.law.positive for name in self.field.parameters])

    @property
    def search_vector_entries(self) -> tuple[np.ndarray, ...]:
        """Entries of the search vector for each record: parameters, then its own hidden states."""
        count, hidden = len(self.field.parameters), len(self.field.hidden)
        return tuple(
            np.r_[:count, count + k * hidden : count + (k + 1) * hidden] for k in range(len(self.records))
        )

    def with_fewer_samples(self) -> ForceFitProblem:
        """Return the problem with every so many samples."""
        every = max(1, sum(map(len, self.records)) // _SEARCH_SAMPLES)
        return dataclasses.replace(
            self,
            records=tuple(record.select(slice(None, None, every)) for record in self.records),
            forces=tuple(force[::every] for force in self.forces),
        )

    def scaled_strokes(
        self, strokes: Sequence[Stroke], units: Float[np.ndarray, "p"]
    ) -> list[ScaledStrokeData]:
        """Return each record as compiled code takes it."""
        size = self.stroke_speed_and_force_scales[2]
        pairs = zip(strokes, self.forces, strict=True)
        return [
            ScaledStrokeData(stroke, force / size, np.ones(len(force)), units, size)
            for stroke, force in pairs
        ]

    def strokes_of_records(self, travel: float = FINE) -> list[Stroke]:
        """Stroke of each record."""
        return [stroke_of_record(record, self.field, travel) for record in self.records]

    def search_bounds(self, units: Float[np.ndarray, "p"]) -> Edges:
        """Least and greatest entries of the search vector."""
        size = 1 + int(self.search_vector_entries[-1].max())
        edges = np.full((2, size), [[-np.inf], [np.inf]])
        for k, name in enumerate(self.field.parameters):
            for side, value in enumerate(self.bounds.get(name, ())):
                if self.logarithmic_parameters[k]:
                    edges[side, k] = math.log(value) if value > 0.0 else -np.inf
                else:
                    edges[side, k] = value / units[k]
        return Edges(edges[0], edges[1])

    def prior(self) -> Prior:
        """Prior about a start, which keeps what the records leave open from running away."""
        size = 1 + int(self.search_vector_entries[-1].max())
        return Prior(np.full(size, _PRIOR_SPREAD**-2), float(sum(map(len, self.records))))

    def normal_equations(self, data: Sequence[ScaledStrokeData]) -> Normal:
        """Return the normal equations of all records."""
        function = self._compiled_functions()[0]
        return joint_normal_equations(
            [functools.partial(function, data=item) for item in data], self.search_vector_entries
        )

    def linearised_residuals(
        self, data: Sequence[ScaledStrokeData], theta: Float[np.ndarray, "q"]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals (n,) of each record in units of the force's size, and their derivatives (n, p)."""
        function = self._compiled_functions()[1]
        both = [
            function(theta[here][None], data=item)
            for item, here in zip(data, self.search_vector_entries, strict=True)
        ]
        return [(np.asarray(left)[:, 0], np.asarray(slopes)[:, :, 0].T) for left, slopes in both]

    def _compiled_functions(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        return _compile_normal_equations(
            self.field.equation, self.field.inputs, tuple(self.logarithmic_parameters.tolist())
        )


@functools.lru_cache(maxsize=PROGRAMS)
def _compile_normal_equations(
    equation: str, inputs: tuple[str, ...], logarithmic: tuple[bool, ...]
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Compile the normal equations of search vectors (s, p), and their residuals with derivatives."""
    forces, count = force_function(equation, inputs), len(logarithmic)

    def residuals(vectors: jax.Array, data: ScaledStrokeData) -> Any:
        values = tuple(
            jnp.exp(vectors[k]) if log else data.units[k] * vectors[k] for k, log in enumerate(logarithmic)
        )
        result = forces(values, vectors[count:], data.stroke) / data.size - data.force[:, None]
        return jnp.where(jnp.abs(result) < BLOWN_UP, result, BLOWN_UP) * data.weight[:, None]

    def linear(theta: jax.Array, data: ScaledStrokeData) -> tuple[jax.Array, jax.Array]:
        vectors = theta.T
        directions = jnp.eye(len(vectors))[:, :, None] * jnp.ones_like(vectors)

        def slope(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda value: residuals(value, data), (vectors,), (direction,))

        left, jacobian = jax.vmap(slope, out_axes=(None, 0))(directions)
        return left, jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)

    def normal_equations(theta: jax.Array, data: ScaledStrokeData) -> tuple[jax.Array, ...]:
        left, jacobian = linear(theta, data)
        return (
            (left**2).sum(axis=0),
            jnp.einsum("pns,ns->sp", jacobian, left),
            jnp.einsum("pns,qns->spq", jacobian, jacobian),
        )

    return jit(normal_equations), jit(linear)


class ForceSearchResult(NamedTuple):
    """Result of a search."""

    theta: Float[np.ndarray, "q"]  # parameters or logarithms, then each record's hidden states
    units: Float[np.ndarray, "p"]  # of the parameters that are no logarithms
    data: list[ScaledStrokeData]
    starts: int
    converged: int  # starts that led to the best fit
    solver_error: float  # by steps of half the length, in the size of the forces


def search_force_parameters(problem: ForceFitProblem, near: Mapping[str, float]) -> ForceSearchResult:
    """Fit the parameters of a force's law to all records together."""
    # Starts by Latin hypercube sampling, factors by linear least squares, then Levenberg-Marquardt steps
    # (Marquardt 1963, doi:10.1137/0111030).
    thin = problem.with_fewer_samples()
    strokes = thin.strokes_of_records(_SEARCH_TRAVEL)
    values = _start_values(thin, strokes, near)
    units = np.where(problem.logarithmic_parameters, 1.0, np.abs(values[0]))
    units = np.where(
        units > 0.0, units, [_natural_parameter_size(problem, name) for name in problem.field.parameters]
    )
    parameters = np.where(
        problem.logarithmic_parameters,
        np.log(np.where(problem.logarithmic_parameters, values, 1.0)),
        values / units,
    )
    states = np.zeros((len(values), len(problem.records) * len(problem.field.hidden)))
    edges = problem.search_bounds(units)
    theta, cost = levenberg_marquardt(
        thin.normal_equations(thin.scaled_strokes(strokes, units)),
        np.hstack([parameters, states]),
        thin.prior(),
        1e-4,
        edges,
    )
    converged = int((cost <= agreeing_cost_limit(cost, thin.prior().samples)).sum())
    theta = theta[np.argsort(cost, kind="stable")[:POLISHED]]
    travel, error = FINE, 0.0
    for _ in range(1 + _MOST_HALVINGS):
        data = problem.scaled_strokes(problem.strokes_of_records(travel), units)
        theta, cost = levenberg_marquardt(
            problem.normal_equations(data), theta, problem.prior(), 1e-11, edges, damping=1e-6, patience=2
        )
        best = theta[int(np.argmin(cost))]
        left = math.sqrt(float(cost.min()) / problem.prior().samples)
        if not left < BLOWN_UP:
            raise InputError(
                f"no start led to a finite force of {quote(problem.law.name)}; try another law or more starts"
            )
        if not problem.field.hidden:
            break
        finer = problem.scaled_strokes(problem.strokes_of_records(0.5 * travel), units)
        pairs = zip(
            problem.linearised_residuals(data, best), problem.linearised_residuals(finer, best), strict=True
        )
        error = max(float(np.abs(coarse[0] - fine[0]).max()) for coarse, fine in pairs)
        if error < _SOLVED * max(left, 1e-6):
            break
        travel *= 0.5
    return ForceSearchResult(best, units, data, len(values), converged, error)


def _natural_parameter_size(
    problem: ForceFitProblem, name: str, random: np.random.Generator | None = None
) -> float:
    """Natural size of a parameter by its unit; of one without a unit a random one, or 1."""
    unit = problem.law.units.get(name)
    length, speed, force = problem.stroke_speed_and_force_scales
    powers = _POWERS.get(unit or "")
    if powers is None:
        powers = (0, 0, 0) if random is None else (*random.integers(-1, 2, 2), 0)
    return float(length ** powers[0] * speed ** powers[1] * force ** powers[2])


def _start_values(
    problem: ForceFitProblem, strokes: Sequence[Stroke], near: Mapping[str, float]
) -> np.ndarray:
    """Values (starts, p) of the parameters, the best of many draws, factors from least squares."""
    names = problem.field.parameters
    held = {name: low for name, (low, high) in problem.bounds.items() if low == high}
    factors = [
        names.index(name) for name in _parameters_linear_in_force(problem.field) if name not in {*held, *near}
    ]
    others = [k for k in range(len(names)) if k not in factors and names[k] not in held]
    values = _draw_start_values(problem, others, near)
    values[:, [names.index(name) for name in held]] = list(held.values())
    function = compiled_force_function(problem.field.equation, problem.field.inputs)
    states = np.zeros((len(problem.field.hidden), len(values)))

    def forces(values: np.ndarray) -> np.ndarray:
        parts = [np.asarray(function(tuple(values.T), states, stroke)) for stroke in strokes]
        return np.nan_to_num(np.concatenate(parts), nan=1e9, posinf=1e9, neginf=-1e9)

    target = np.concatenate(problem.forces)
    left = target[:, None] - forces(values)
    columns = []
    for k in factors:
        changed = values.copy()
        changed[:, k] = 1.0
        columns.append(forces(changed) - target[:, None] + left)
    for draw in range(len(values) if factors else 0):
        matrix = np.stack([column[:, draw] for column in columns], axis=1)
        values[draw, factors] = _solve_bounded_factors(problem, factors, matrix, left[:, draw])
        left[:, draw] -= matrix @ values[draw, factors]
    return values[np.argsort((left**2).sum(axis=0), kind="stable")[: problem.starts]]


def _draw_start_values(
    problem: ForceFitProblem, drawn: Sequence[int], near: Mapping[str, float]
) -> np.ndarray:
    """Values (draws, p) of some parameters about their natural sizes, or near given values."""
    from scipy.stats.qmc import LatinHypercube

    names, random = problem.field.parameters, np.random.default_rng(problem.seed)
    count = max(_DRAWS, problem.starts) if drawn else 1
    values = np.zeros((count, len(names)))
    cube = LatinHypercube(max(1, len(drawn)), rng=random).random(count)
    for k, column in zip(drawn, cube.T, strict=False):
        name = names[k]
        if name in near:
            spread = _NEAR * random.normal(size=count) * (np.arange(count) > 0)
            values[:, k] = near[name] * np.exp(spread)
            continue
        size = np.array([_natural_parameter_size(problem, name, random) for _ in range(count)])
        values[:, k] = size * np.exp(_LOW + (_HIGH - _LOW) * column)
        if name not in problem.law.positive:
            values[:, k] *= random.choice([-1.0, 1.0], count)
        values[:, k] = np.clip(values[:, k], *problem.bounds.get(name, (-math.inf, math.inf)))
    return values


def _solve_bounded_factors(
    problem: ForceFitProblem, factors: Sequence[int], matrix: np.ndarray, target: np.ndarray
) -> np.ndarray:
    """Values of factors by their columns (n, k), within their bounds and signs."""
    names = [problem.field.parameters[k] for k in factors]
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    values = np.linalg.lstsq(matrix / scale, target, rcond=1e-9)[0] / scale
    least = _LEAST * np.linalg.norm(target) / scale
    values = np.where([name in problem.law.positive for name in names], np.maximum(values, least), values)
    low, high = np.array([problem.bounds.get(name, (-math.inf, math.inf)) for name in names]).T
    return np.asarray(np.clip(values, low, high))


def _parameters_linear_in_force(field: Law) -> list[str]:
    """Parameters in which the force is linear together, and which no hidden state knows."""
    import sympy

    parsed = field.parsed_equation
    chosen: list[Any] = []
    for name in field.parameters:
        symbol = sympy.Symbol(name)
        slope = parsed.acceleration.diff(symbol)
        if slope.has(symbol, *chosen) or any(rate.has(symbol) for rate in parsed.hidden.values()):
            continue
        chosen.append(symbol)
    return [str(symbol) for symbol in chosen]
