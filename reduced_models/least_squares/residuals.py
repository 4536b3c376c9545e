"""Residuals of a law's solution on a record, and their normal equations, compiled.

All starts, with their sensitivities, go through the same compiled loop side by side. A solution
that diverges costs no more than one that does not.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from granular.run.piston_record import PistonRecord
from reduced_models.jax_setup import jax
from reduced_models.laws.equation import PROGRAMS, compile_rates
from reduced_models.laws.solution import hermite_interpolate, solve_on_grid
from reduced_models.least_squares.levenberg_marquardt import Normal
from reduced_models.least_squares.samples import Samples, samples_on_grid
from reduced_models.least_squares.sensor_signal import solution_signal
from reduced_models.least_squares.unknowns import Unknowns, physical_values, sensor_values
from reduced_models.records.inputs import Interpolation, StepGrid

jnp = jax.numpy

LossName = Literal["linear", "soft_l1", "huber"]
LOSSES: tuple[LossName, ...] = ("linear", "soft_l1", "huber")

BLOWN_UP = 1e3
"""Residual of a sample that a solution does not reach, in amplitudes."""


class Loss(NamedTuple):
    """Cost of a residual r.

    Attributes
    ----------
    name : str
        ``"linear"``: r^2; ``"soft_l1"``: 2 c^2 (sqrt(1 + r^2/c^2) - 1); ``"huber"``: r^2 up to c,
        then 2 c |r| - c^2 (Huber 1964, doi:10.1214/aoms/1177703732).
    scale : float
        c, in amplitudes.
    """

    name: LossName = "linear"
    scale: float = math.inf

    @property
    def compiled_arguments(self) -> np.ndarray:
        """Data as compiled code takes them."""
        huber = self.name == "huber"
        return np.array([self.scale if self.name != "linear" else np.inf, float(huber)])


def cost_and_weight(residuals: Any, loss: Any, np_: Any) -> tuple[Any, Any]:
    """Costs of residuals, and the weights with which their squares have the same slope.

    Huber (1964), doi:10.1214/aoms/1177703732; the soft modulus 2 (sqrt(1 + r^2) - 1) is that of SciPy's
    ``soft_l1``.

    Parameters
    ----------
    residuals : float64 (...)
        Residuals, in residual units.
    loss : float64 (2,)
        Scale in residual units, and 1 for the loss of Huber or 0 for the soft modulus.
    np_ : module
        NumPy, or that of JAX.

    Returns
    -------
    cost : float64 (...)
        Cost of each residual: its square where it is far below the scale.
    weight : float64 (...)
        Derivative of the cost over that of the square.
    """
    size = np_.abs(residuals)
    root = np_.sqrt(1.0 + (residuals / loss[0]) ** 2)
    soft = 2.0 * residuals**2 / (1.0 + root)
    # Where the scale is infinite, both are the plain square.
    far = size > loss[0]
    reach = np_.where(far, loss[0], size)
    huber = reach * (2.0 * size - reach)
    weight = np_.where(far, reach / np_.where(far, size, 1.0), 1.0)
    return np_.where(loss[1] > 0.0, huber, soft), np_.where(loss[1] > 0.0, weight, 1.0 / root)


def half_cost_curvature(residuals: np.ndarray, loss: Loss) -> np.ndarray:
    """Half the second derivative (n,) of what residuals cost.

    Parameters
    ----------
    residuals : float64 (n,)
        Residuals, in residual units.
    loss : Loss
        Loss with its scale in residual units.

    Returns
    -------
    float64 (n,)
        Half the second derivative of the cost by each residual, dimensionless.
    """
    if loss.name == "linear":
        return np.ones_like(residuals)
    if loss.name == "huber":
        return (np.abs(residuals) <= loss.scale).astype(float)
    return np.asarray((1.0 + (residuals / loss.scale) ** 2) ** -1.5)


def remove_random_walk(residuals: np.ndarray, gain: float) -> np.ndarray:
    """Residuals (n, ...) less what exponential smoothing of the ones before them foresees.

    Exponential smoothing is the steady Kalman filter of a random walk in white noise (Muth 1960,
    doi:10.1080/01621459.1960.10482064).

    Parameters
    ----------
    residuals : float64 (n, ...)
        Residuals or their derivatives, in any unit.
    gain : float
        Gain of the smoothing, from 0 (no random walk) to 1.

    Returns
    -------
    float64 (n, ...)
        Innovations in the same unit.
    """
    if gain == 0.0:
        return residuals
    from scipy.signal import lfilter  # its import takes longer than a small fit

    return np.asarray(lfilter([1.0, -1.0], [1.0, gain - 1.0], residuals, axis=0))


def add_random_walk(left: np.ndarray, gain: float) -> np.ndarray:
    """Residuals (n,) of which `remove_random_walk` leaves these.

    Parameters
    ----------
    left : float64 (n,)
        Innovations, in any unit.
    gain : float
        Gain of the smoothing, from 0 (no random walk) to 1.

    Returns
    -------
    float64 (n,)
        Residuals in the same unit: the inverse filter of `remove_random_walk`.
    """
    if gain == 0.0:
        return left
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0, gain - 1.0], [1.0, -1.0], left))


Kind = Literal["normal", "linear", "residual"]
Selection = int | np.ndarray | None
"""Samples of a record: the first so many, those of a mask (n,), or all."""


class SensorForm(NamedTuple):
    """Form of a sensor's signal, for which code is compiled.

    Attributes
    ----------
    derivative : int
        Of the coordinate, that is measured.
    is_open : (bool, bool)
        Gain and offset are entries of the search vector.
    entries : int
        Number of entries of the sensor, at the end of the search vector.
    """

    derivative: int
    is_open: tuple[bool, bool]
    entries: int


def residual_function(unknowns: Unknowns, kind: Kind) -> Callable[..., Any]:
    """Compiled function of search vectors.

    Parameters
    ----------
    unknowns : Unknowns
    kind : str
        ``"normal"``: (theta (s, p), samples, scales, loss) -> cost (s,), gradient J'r (s, p),
        matrix J'J (s, p, p). ``"linear"``: (theta (p,), samples, scales) -> weighted residuals
        (n,), in amplitudes, and their derivatives (p, n). ``"residual"``: the residuals alone.

    Returns
    -------
    callable
        Function compiled by JAX, one for all laws' equations, forms of sensors and kinds that are
        alike.
    """
    law = unknowns.law
    sensor = None
    if unknowns.sensor is not None:
        sensor = SensorForm(
            unknowns.sensor.derivative_order, unknowns.open_gain_and_offset, unknowns.sensor_entry_count
        )
    fits_map = unknowns.map is None
    return _compile_residuals(
        kind, law.equation, law.inputs, unknowns.logarithmic_parameters, fits_map, sensor
    )


def normal_equations(unknowns: Unknowns, samples: Samples, loss: Loss) -> Normal:
    """Return the normal equations of samples, for many search vectors side by side.

    Parameters
    ----------
    unknowns : Unknowns
        Law and scales of the search vector.
    samples : Samples
        Samples on a grid.
    loss : Loss
        Loss of the residuals.

    Returns
    -------
    callable
        From search vectors (s, p) to costs (s,), gradients J'r (s, p) and matrices J'J (s, p, p),
        dimensionless.
    """
    function, scales = residual_function(unknowns, "normal"), unknowns.scales
    return lambda theta: function(theta, samples, scales, loss.compiled_arguments)


@functools.lru_cache(maxsize=3 * PROGRAMS)
def _compile_residuals(
    kind: Kind,
    equation: str,
    inputs: tuple[str, ...],
    logarithmic: tuple[bool, ...],
    fits_map: bool,
    sensor: SensorForm | None,
) -> Callable[..., Any]:
    field = compile_rates(equation, inputs)

    def residuals(vectors: jax.Array, samples: Samples, scales: jax.Array) -> jax.Array:
        """Residuals (n, s) of search vectors that are columns (p, s)."""
        step, point, fraction, height, weight, drive, chunks, tables = samples
        split = len(vectors) - (0 if sensor is None else sensor.entries)
        values, shift, scale, z0, v0, hidden = physical_values(
            vectors[:split], scales, logarithmic, fits_map, jnp
        )
        grid = solve_on_grid(field, (z0, v0, *hidden), values, drive, step, chunks)
        if sensor is None:
            z = hermite_interpolate(*grid, step, point, fraction[:, None])
            result = (shift + scale * z - height[:, None]) / scales[1]
        else:
            gain, offset, states = sensor_values(vectors[split:], scales, sensor.is_open)
            assert tables is not None
            signal = solution_signal(grid, step, point, sensor.derivative, tables, states, shift, scale)
            result = (gain * signal + offset - height[:, None]) / scales[-3]
        return jnp.where(jnp.abs(result) < BLOWN_UP, result, BLOWN_UP) * weight[:, None]

    def both(theta: jax.Array, samples: Samples, scales: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Residuals (n, s) of search vectors (s, p), and their derivatives (p, n, s)."""
        # Starts side by side in the last axis, directions before them: that vectorises best.
        vectors = theta.T
        directions = jnp.eye(len(vectors))[:, :, None] * jnp.ones_like(vectors)

        def slope(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda value: residuals(value, samples, scales), (vectors,), (direction,))

        left, jacobian = jax.vmap(slope, out_axes=(None, 0))(directions)
        return left, jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)

    def residual(theta: jax.Array, samples: Samples, scales: jax.Array) -> jax.Array:
        return residuals(theta[:, None], samples, scales)[:, 0]

    def linear(theta: jax.Array, samples: Samples, scales: jax.Array) -> tuple[jax.Array, jax.Array]:
        left, jacobian = both(theta[None], samples, scales)
        return left[:, 0], jacobian[:, :, 0]

    def normal_equations(
        theta: jax.Array, samples: Samples, scales: jax.Array, loss: jax.Array
    ) -> tuple[jax.Array, ...]:
        left, jacobian = both(theta, samples, scales)
        cost, weight = cost_and_weight(left, loss, jnp)
        return (
            cost.sum(axis=0),
            jnp.einsum("pns,ns->sp", jacobian, weight * left),
            jnp.einsum("pns,qns->spq", weight * jacobian, jacobian),
        )

    functions: dict[Kind, Callable[..., Any]] = {
        "normal": normal_equations,
        "linear": linear,
        "residual": residual,
    }
    return jax.jit(functions[kind])


@dataclasses.dataclass(frozen=True, eq=False)
class GriddedRecord:
    """A record on a grid, with the compiled residuals of some unknowns.

    Attributes
    ----------
    unknowns : Unknowns
    record : PistonRecord
        That starts at time 0.
    grid : StepGrid
    samples : Samples
    interpolation : str
        Interpolation of the inputs.
    weights : float64 (n,)
        Weights of the residuals.
    loss : Loss
    gain : float
        Gain of the filter that takes a drift out of the residuals; 0 for none.
    """

    unknowns: Unknowns
    record: PistonRecord
    grid: StepGrid
    samples: Samples
    interpolation: Interpolation
    weights: np.ndarray
    loss: Loss
    gain: float = 0.0

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Residuals (n,) of all samples, in amplitudes; not weighted.

        Parameters
        ----------
        theta : float64 (p,)
            Search vector, dimensionless.

        Returns
        -------
        float64 (n,)
            Solution minus data over the residual unit, not weighted.
        """
        linear = residual_function(self.unknowns, "linear")
        left = linear(theta, self._selected_samples(None, weighted=False), self.unknowns.scales)[0]
        return np.asarray(left)[: len(self.record)]

    def fitted_signal(self, theta: np.ndarray) -> np.ndarray:
        """Signal (n,), or heights [m], by a search vector.

        Parameters
        ----------
        theta : float64 (p,)
            Search vector, dimensionless.

        Returns
        -------
        float64 (n,)
            Signal by the law, in the unit of the record: heights [m] without a sensor.
        """
        return self.record.height + self.unknowns.residual_unit * self.residuals(theta)

    def fitted_heights(self, theta: np.ndarray) -> np.ndarray:
        """Heights (n,) [m] by a search vector.

        Parameters
        ----------
        theta : float64 (p,)
            Search vector, dimensionless.

        Returns
        -------
        float64 (n,)
            Heights by the law [m], also where a sensor's signal is fitted.
        """
        unknowns = self.unknowns
        if unknowns.sensor is None:
            return self.fitted_signal(theta)
        plain = dataclasses.replace(
            self,
            unknowns=dataclasses.replace(unknowns, sensor=None),
            samples=self.samples._replace(sensor=None),
        )
        # About rest, since residuals of far numbers are cut.
        plain = plain.with_heights(np.full(len(self.record), unknowns.rest))
        return plain.fitted_signal(theta[: len(theta) - unknowns.sensor_entry_count])

    def linearised_residuals(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted residuals (n,) without drift of all samples, and their derivatives (n, p).

        Parameters
        ----------
        theta : float64 (p,)
            Search vector, dimensionless.

        Returns
        -------
        left : float64 (n,)
            Weighted residuals over the residual unit, a random walk taken out.
        slopes : float64 (n, p)
            Their derivatives by the search vector.
        """
        return self._linearised_samples(theta, self._selected_samples(None), slice(None))

    def _linearised_samples(
        self, theta: np.ndarray, seen: Samples, here: slice | np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        linear = residual_function(self.unknowns, "linear")
        left, slopes = linear(theta, seen, self.unknowns.scales)
        count = len(self.record)
        value = np.asarray(left)[:count][here], np.asarray(slopes).T[:count][here]
        return remove_random_walk(value[0], self.gain), remove_random_walk(value[1], self.gain)

    def normal_equations(self, selection: Selection = None) -> Normal:
        """Return the normal equations of some samples.

        Those of several vectors together leave a drift in; over samples that are left out, it stays
        as it is.

        Parameters
        ----------
        selection : int, bool (n,) or None
            So many first samples, a mask of them, or all.

        Returns
        -------
        callable
            From search vectors (s, p) to costs (s,), gradients (s, p) and matrices J'J (s, p, p),
            dimensionless.
        """
        seen = self._selected_samples(selection)
        here = selection if isinstance(selection, np.ndarray) else slice(selection)
        several = normal_equations(self.unknowns, seen, self.loss)

        def single(theta: np.ndarray) -> tuple[np.ndarray, ...]:
            left, slopes = self._linearised_samples(theta[0], seen, here)
            cost, weight = cost_and_weight(left, self.loss.compiled_arguments, np)
            weighted = weight[:, None] * slopes
            return cost.sum()[None], (left @ weighted)[None], (slopes.T @ weighted)[None]

        return lambda theta: single(theta) if len(theta) == 1 else several(theta)

    def _selected_samples(self, selection: Selection, *, weighted: bool = True) -> Samples:
        weight = np.zeros_like(self.samples.weight)
        here = selection if isinstance(selection, np.ndarray) else slice(selection)
        weight[: len(self.record)][here] = self.weights[here] if weighted else 1.0
        return self.samples.with_weights(weight)

    def with_heights(self, height: np.ndarray) -> GriddedRecord:
        """Return the same with other heights (n,).

        Parameters
        ----------
        height : float64 (n,)
            Heights, or signal of a sensor, in the unit of the record.

        Returns
        -------
        GriddedRecord
            Copy with these heights on the same grid.
        """
        padded = self.samples.height.copy()
        padded[: len(height)] = height
        record = dataclasses.replace(self.record, height=height)
        samples = self.samples._replace(height=padded)
        return dataclasses.replace(self, record=record, samples=samples)

    def with_column_deviation(self, name: str, deviation: np.ndarray) -> GriddedRecord:
        """Return the same with a deviation (n,) added to a column of the record.

        Parameters
        ----------
        name : str
            Name of a column of the record.
        deviation : float64 (n,)
            Deviation in the unit of the column.

        Returns
        -------
        GriddedRecord
            Copy with the deviation added to the column.
        """
        record = self.record
        if name in record.extra:
            record = dataclasses.replace(record, extra={**record.extra, name: record.extra[name] + deviation})
        else:
            record = dataclasses.replace(record, **{name: getattr(record, name) + deviation})
        return dataclasses.replace(self, record=record).on_grid(self.grid)

    def on_grid(self, grid: StepGrid, interpolation: Interpolation | None = None) -> GriddedRecord:
        """Return the same on another grid, or with inputs that are something else between samples.

        Parameters
        ----------
        grid : StepGrid
            Step [s] and number of steps.
        interpolation : str, optional
            Course of the inputs between samples; that of before if not given.

        Returns
        -------
        GriddedRecord
            Copy on that grid.
        """
        how = interpolation or self.interpolation
        samples = samples_on_grid(self.record, grid, self.unknowns.law.inputs, how)
        samples = samples.through_sensor(self.unknowns.sensor, self.record, grid)
        return dataclasses.replace(self, grid=grid, samples=samples, interpolation=how)


def record_on_grid(
    unknowns: Unknowns,
    record: PistonRecord,
    grid: StepGrid,
    how: Interpolation = "spline",
    weights: np.ndarray | None = None,
    loss: Loss = Loss(),  # noqa: B008
) -> GriddedRecord:
    """Put all samples of a record that starts at time 0 on a grid.

    Parameters
    ----------
    unknowns : Unknowns
        Law and scales of the search vector.
    record : PistonRecord
        Record from time 0 on [s], heights in m.
    grid : StepGrid
        Step [s] and number of steps.
    how : str
        Course of the inputs between samples.
    weights : float64 (n,), optional
        Weight of each residual; ones if not given.
    loss : Loss
        Loss of the residuals.

    Returns
    -------
    GriddedRecord
        Record on the grid, with the compiled residuals of the unknowns.
    """
    samples = samples_on_grid(record, grid, unknowns.law.inputs, how)
    samples = samples.through_sensor(unknowns.sensor, record, grid)
    given = np.ones(len(record)) if weights is None else weights
    return GriddedRecord(unknowns, record, grid, samples, how, given, loss)
