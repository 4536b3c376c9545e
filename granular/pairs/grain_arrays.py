"""Input and output arrays of every sum over pairs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import config, types
from numba.core.imputils import impl_ret_borrowed
from numba.extending import intrinsic

from granular.compiled import Array, compiled
from granular.pairs.simd import DISC_SCALE, SCALE
from granular.shared.array_types import Float

COMMON, TERM, CENTRE, FORCE_SCALE, FAR, STIFFNESS, LOAD_TERM, LOAD_FAR = range(8)
"""Coefficients of the sum over all pairs of discs, as defined in `granular.pairs.disc_law`:

- b of equal discs; c; g / `DISC_SCALE`;
- the factor, besides `STRENGTH`, by which sums of forces must still be multiplied;
- in the far field, the coefficient of r^-5 relative to the coefficient of r^-3;
- the maximum ratio, beyond the tables, of the stiffness to the stiffness of dipoles at the distance rho;
- for the load on the plates, d and the coefficient of r^-5.
"""


class GrainArrays(NamedTuple):
    """Positions and properties of grains, and sums over their pairs; a sum that is not requested is None."""

    x: Float[np.ndarray, "m"]  # padded [D]
    y: Float[np.ndarray, "m"]  # padded [D]
    fx: Float[np.ndarray, "m"]  # overwritten by the forces [F*]
    fy: Float[np.ndarray, "m"]  # overwritten by the forces [F*]
    moments: Float[np.ndarray, "m"] | None = None  # relative to the first species; None: all equal
    stiffness: Float[np.ndarray, "m"] | None = None  # sum_j q_j / r^5 [1/D^5]
    energy_and_closest: Float[np.ndarray, "2"] | None = None  # sum q_i q_j / r^3; largest r^-5
    load: Float[np.ndarray, "m"] | None = None  # sum_j weight_j / r^3 [1/D^3]
    weight: Float[np.ndarray, "m"] | None = None
    series: Float[np.ndarray, "8"] | None = None  # see `COMMON` to `LOAD_FAR`; None: dipoles
    shift: Float[np.ndarray, "m"] | None = None  # contribution of each grain to b; None: b is `COMMON` [D^2]


@compiled(inline=True)
def replace_sums(
    arrays: GrainArrays,
    fx: Array,
    fy: Array,
    stiffness: Array | None,
    energy_and_closest: Array | None,
    load: Array | None,
) -> GrainArrays:
    """Copy the arrays of the grains, with the given arrays in place of the sums."""
    x, y, moments, weight = arrays.x, arrays.y, arrays.moments, arrays.weight
    series, shift = arrays.series, arrays.shift
    return GrainArrays(x, y, fx, fy, moments, stiffness, energy_and_closest, load, weight, series, shift)


@compiled(inline=True)
def replace_energy_and_closest(arrays: GrainArrays, energy_and_closest: Array) -> GrainArrays:
    """Copy the arrays, with another array for the energy and the closest pair."""
    return replace_sums(arrays, arrays.fx, arrays.fy, arrays.stiffness, energy_and_closest, arrays.load)


# Numba prunes branches on arguments that are None, but not on fields: hence a kernel for each.


@compiled(inline=True)
def clear_array_if_given(values: Float[Array, "m"] | None) -> None:
    """Set an array to zero, if given."""
    if values is not None:
        values[:] = 0.0


@compiled(inline=True)
def clear_sums(arrays: GrainArrays) -> None:
    """Reset the computed sums to zero."""
    clear_array_if_given(arrays.fx)
    clear_array_if_given(arrays.fy)
    clear_array_if_given(arrays.stiffness)
    clear_array_if_given(arrays.energy_and_closest)
    clear_array_if_given(arrays.load)


@compiled(inline=True)
def scale_array_if_given(values: Float[Array, "m"] | None, factor: float) -> None:
    """Multiply an array by a factor, if given."""
    if values is not None:
        for i in range(values.size):
            values[i] *= factor


@compiled(inline=True)
def value_or_one(values: Float[Array, "m"] | None, i: int) -> float:
    """Return the value of one grain, or 1 if all grains are equal."""
    return 1.0 if values is None else values[i]


@compiled(inline=True)
def vectorized_sum_factor(series: Float[Array, "6"] | None) -> float:
    """Return the factor by which vectorized sums of energies, stiffnesses and loads must be multiplied."""
    return SCALE if series is None else DISC_SCALE


@compiled(inline=True)
def vectorized_force_factor(series: Float[Array, "6"] | None) -> float:
    """Return the factor to multiply sums of forces by, besides `granular.pairs.dipole_law.STRENGTH`."""
    return SCALE if series is None else series[FORCE_SCALE]


@compiled(inline=True)
def add_to_entry_if_given(values: Float[Array, "m"] | None, i: int, amount: float) -> None:
    """Add an amount to one grain's entry, if the array is given."""
    if values is not None:
        values[i] += amount


@compiled(inline=True)
def set_forces_to_nan(arrays: GrainArrays, grains: int) -> None:
    """Set the forces to NaN, as a sign that a position is not finite or that a list overflows."""
    arrays.fx[:grains] = np.nan
    arrays.fy[:grains] = np.nan


def _pure_python_array_if_requested(requested: Array | None, sums: Array | None) -> Array | None:
    return None if requested is None else sums


@intrinsic
def _compiled_array_if_requested(typing: Any, requested: Any, sums: Any) -> Any:
    kind = types.none if isinstance(requested, types.NoneType) else sums

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        if kind is types.none:
            return context.get_dummy_value()
        return impl_ret_borrowed(context, builder, kind, values[1])

    return kind(requested, sums), generate


array_if_requested = _pure_python_array_if_requested if config.DISABLE_JIT else _compiled_array_if_requested
"""Return the sums, or None if they are not requested; types decide this at compile time."""
