"""What a law's solution leaves over of a record: residuals and normal equations, compiled.

All starts, with their sensitivities, go through the same compiled loop side by side. A solution
that blows up costs no more than one that does not.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from reduced_models.jax_setup import jax
from reduced_models.laws.law import PROGRAMS, compiled_field, parse
from reduced_models.laws.solution import between, on_grid
from reduced_models.least_squares.levenberg_marquardt import Normal
from reduced_models.least_squares.samples import Samples, samples_on_grid
from reduced_models.least_squares.unknowns import Unknowns, physical
from reduced_models.records.inputs import drive_on_grid

jnp = jax.numpy

BLOWN_UP = 1e3
"""Residual of a sample that a solution does not reach, in amplitudes."""


class ResidualFunctions(NamedTuple):
    """Compiled functions of search vectors.

    Attributes
    ----------
    normal : callable
        (theta (s, p), samples, scales) -> cost (s,), gradient J'r (s, p), matrix J'J (s, p, p).
    residual : callable
        (theta (p,), samples, scales) -> weighted residuals (n,), in amplitudes.
    """

    normal: Callable[..., tuple[jax.Array, ...]]
    residual: Callable[..., jax.Array]

    def of(self, samples: Samples, scales: np.ndarray) -> Normal:
        """The normal equations of given data."""
        return lambda theta: self.normal(theta, samples, scales)


def residual_functions(unknowns: Unknowns) -> ResidualFunctions:
    """The compiled residuals of some unknowns."""
    law = unknowns.law
    return _compiled(law.equation, law.inputs, unknowns.logarithmic, unknowns.map is None)


@functools.lru_cache(maxsize=PROGRAMS)
def _compiled(
    equation: str, inputs: tuple[str, ...], logarithmic: tuple[bool, ...], fits_map: bool
) -> ResidualFunctions:
    field = compiled_field(equation, inputs)
    hidden = len(parse(equation, inputs).hidden)

    def residuals(vectors: jax.Array, samples: Samples, scales: jax.Array) -> jax.Array:
        """Residuals (n, s) of search vectors that are columns (p, s)."""
        step, place, share, height, weight, drive = samples
        values, shift, scale, z0, v0 = physical(vectors, scales, logarithmic, fits_map, jnp)
        start = (z0, v0, *(jnp.zeros_like(z0) for _ in range(hidden)))
        grid = on_grid(field, start, values, drive, step)
        z = between(*grid, step, place, share[:, None])
        found = (shift + scale * z - height[:, None]) / scales[1]
        return jnp.where(jnp.abs(found) < BLOWN_UP, found, BLOWN_UP) * weight[:, None]

    def residual(theta: jax.Array, samples: Samples, scales: jax.Array) -> jax.Array:
        return residuals(theta[:, None], samples, scales)[:, 0]

    def normal(theta: jax.Array, samples: Samples, scales: jax.Array) -> tuple[jax.Array, ...]:
        # Starts side by side in the last axis, directions before them: that vectorises best.
        vectors = theta.T
        directions = jnp.eye(len(vectors))[:, :, None] * jnp.ones_like(vectors)

        def slope(direction: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(lambda each: residuals(each, samples, scales), (vectors,), (direction,))

        left, jacobian = jax.vmap(slope, out_axes=(None, 0))(directions)
        jacobian = jnp.where(jnp.isfinite(jacobian), jacobian, 0.0)
        return (
            (left**2).sum(axis=0),
            jnp.einsum("pns,ns->sp", jacobian, left),
            jnp.einsum("pns,qns->spq", jacobian, jacobian),
        )

    return ResidualFunctions(jax.jit(normal), jax.jit(residual))


@dataclasses.dataclass(frozen=True, eq=False)
class GriddedRecord:
    """A record on a grid, with the compiled residuals of some unknowns.

    Attributes
    ----------
    unknowns : Unknowns
    record : PistonRecord
        That starts at time 0.
    steps : int
    functions : ResidualFunctions
    samples : Samples
    """

    unknowns: Unknowns
    record: PistonRecord
    steps: int
    functions: ResidualFunctions
    samples: Samples

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        """Residuals (n,) of all samples, in amplitudes."""
        found = self.functions.residual(theta, self.samples, self.unknowns.scales)
        return np.asarray(found)[: len(self.record)]

    def normal(self, count: int | None = None) -> Normal:
        """The normal equations of the first ``count`` samples, or of all."""
        weight = np.zeros_like(self.samples.weight)
        weight[: len(self.record) if count is None else count] = 1.0
        return self.functions.of(self.samples._replace(weight=weight), self.unknowns.scales)

    def with_heights(self, height: np.ndarray) -> GriddedRecord:
        """The same with other heights (n,)."""
        padded = self.samples.height.copy()
        padded[: len(height)] = height
        record = dataclasses.replace(self.record, height=height)
        samples = self.samples._replace(height=padded)
        return dataclasses.replace(self, record=record, samples=samples)


def gridded(unknowns: Unknowns, record: PistonRecord, steps: int) -> GriddedRecord:
    """All of a record that starts at time 0, on a grid."""
    drive = drive_on_grid(record, unknowns.law.inputs, steps)
    samples = samples_on_grid(record.time, record.height, steps, drive)
    return GriddedRecord(unknowns, record, steps, residual_functions(unknowns), samples)
