"""The quarter period K(m) beyond the working precision, as the sum of two floats.

A remainder of u by K loses u eps, since K itself is rounded: ten million periods away only eight
digits of sn would be left. A pair of floats keeps them. The error of a sum is Knuth's, and factors
are cut in halves as in Dekker 1971 (doi:10.1007/BF01397083).

Compilers may contract a product and a sum into one operation that rounds once. Here every product
that is subtracted from something near it is exact, so that this changes nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from reduced_models.jax_setup import jax

jnp = jax.numpy

Pair = tuple[Any, Any]

_UPPER_BITS = np.int64(-(2**27))
_HALF_PI = (1.5707963267948966, 6.123233995736766e-17)
_STEPS = 10  # of the arithmetic-geometric mean, for 1 - m from 1e-17 on


def quarter_period_pair(m: Any) -> Pair:
    """K(m) for 0 <= m < 1 as a pair, to about 1e-23; no derivative passes through it."""
    m = jax.lax.stop_gradient(m)
    zero = jnp.zeros_like(m)
    # XLA folds sums of constants, and with them the error of 1 - m; behind a barrier it does not.
    barrier: Any = jax.lax.optimization_barrier
    one = barrier(jnp.ones_like(m))
    start = (one, zero), _root(_two_sum(one, -m))
    a, _ = jax.lax.fori_loop(0, _STEPS, _mean_step, start)
    return _quotient((zero + _HALF_PI[0], zero + _HALF_PI[1]), a)


def _mean_step(_: Any, state: tuple[Pair, Pair]) -> tuple[Pair, Pair]:
    a, b = state
    return _halved(_sum(a, b)), _root(_product(a, b))


def less_product(total: Any, a: Any, b: Pair) -> Any:
    """Total - a b, for a product near the total; no derivative passes through it."""
    total, a = jax.lax.stop_gradient((total, a))
    return _less(total, a, b[0]) - a * b[1]


def _less(total: Any, a: Any, b: Any) -> Any:
    (a1, a2), (b1, b2) = _split(a), _split(b)
    return (((total - a1 * b1) - a1 * b2) - a2 * b1) - a2 * b2


def _split(a: Any) -> Pair:
    """The upper half of the digits, and the rest."""
    bits = jax.lax.bitcast_convert_type(a, jnp.int64)
    high = jax.lax.bitcast_convert_type(bits & _UPPER_BITS, jnp.float64)
    return high, a - high


def _two_sum(a: Any, b: Any) -> Pair:
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _halved(a: Pair) -> Pair:
    return 0.5 * a[0], 0.5 * a[1]


def _sum(a: Pair, b: Pair) -> Pair:
    total, error = _two_sum(a[0], b[0])
    return _two_sum(total, error + (a[1] + b[1]))


def _product(a: Pair, b: Pair) -> Pair:
    (a1, a2), (b1, b2) = _split(a[0]), _split(b[0])
    minor = (a1 * b2 + a2 * b1) + (a2 * b2 + a[0] * b[1] + a[1] * b[0])
    return _two_sum(a1 * b1, minor)


def _root(a: Pair) -> Pair:
    near = jnp.sqrt(a[0])
    return _two_sum(near, (_less(a[0], near, near) + a[1]) / (2.0 * near))


def _quotient(a: Pair, b: Pair) -> Pair:
    near = a[0] / b[0]
    return _two_sum(near, (_less(a[0], near, b[0]) + a[1] - near * b[1]) / b[0])
