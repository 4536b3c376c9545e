"""Linearisation of a law: its small swing about the level of rest, and harmonic cycles of any size.

Stiffness and damping of a harmonic cycle, z = centre + A cos(omega t), are the first harmonics of
the law's force (describing functions; Krylov & Bogoliubov 1943, Gelb & Vander Velde 1968): damping
over twice the root of stiffness is the energy that a cycle dissipates, over 4 pi that of its swing.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from reduced_models.laws.equation import (
    COMPILED,
    compile_jacobian,
    compile_rates,
    jacobian_function,
    parse_equation,
)
from reduced_models.laws.law import Law

if TYPE_CHECKING:
    import sympy

_MOST_NEWTON_STEPS = 50
_CREEP = 1e-9  # a speed on either side of a jump: more than rounding, less than any swing
_FLAT = 1e-9  # of a matrix's greatest entry: less is none
Field = Callable[[np.ndarray], np.ndarray]
"""Map from a state, z, its velocity and hidden states, to the rates of all but the first."""
Rates = Callable[..., Sequence[Any]]
"""Map from z, its velocity and hidden states to z'' and the rates of the hidden states."""

# Of a cycle. The damping of dry friction, which jumps at zero speed, is then right to (pi/256)^2/6 = 2.5e-5.
_NODES = 256
# Of a cycle, after which a hidden state is taken to repeat itself: relaxation over a period leaves e^-2 of
# its start before the last one.
_TURNS = 3
_MOST_ROUNDS = 60
_SETTLED = 1e-11
_STEP, _FARTHEST = 1e-4, 0.3  # of Newton's method for a centre, in amplitudes


class SmallOscillation(NamedTuple):
    """A motion so small that the law is linear; inputs are at zero."""

    z: float
    period: float  # [s]
    damping_ratio: float  # infinite if the law jumps with the sign of the velocity
    faster: tuple[tuple[float, float], ...] = ()  # periods [s] and damping ratios of further modes
    hidden: tuple[float, ...] = ()  # hidden states at rest


class NoOscillation(NamedTuple):
    """Why a law has no small swing, in words that follow "none, "."""

    reason: str


_NO_LEVEL = NoOscillation("no one level of rest is found near the record")
JUMPS = NoOscillation("the law jumps at rest, as dry friction does")
_PUSHES = NoOscillation("what pushes it away from there does not pull it back")
_UNSTABLE = NoOscillation("the level of rest is not stable")
_CREEPS = NoOscillation("it creeps back there without a swing")


def small_oscillation(law: Law, values: Sequence[float], z: float) -> SmallOscillation | NoOscillation:
    """Small swing of a law with values of its parameters, about the level of rest near z."""
    # Hidden states move as their equations say, and are at zero if the law leaves them open at rest, as
    # hysteresis does.
    inputs = (0.0,) * len(law.inputs)
    rates = compile_rates(law.equation, law.inputs, "numpy")
    slopes = compile_jacobian(law.equation, law.inputs)
    return _oscillation_with_velocity_jump(
        lambda state: np.array(rates(*state, *inputs, *values), dtype=float),
        lambda state: slopes(*state, *inputs, *values),
        np.array([z, 0.0, *(0.0,) * len(law.hidden)]),
    )


def small_oscillation_of_equation(equation: sympy.Eq, z: float) -> SmallOscillation | NoOscillation:
    """Small swing of an equation in z(t) with numbers for all parameters; see `small_oscillation`."""
    from granular.formulas.algebra import compile_function

    rate, state = acceleration_expression(equation)
    force, slopes = compile_function(state, rate), jacobian_function([rate], state, state)
    return _oscillation_with_velocity_jump(
        lambda state: np.array([force(*state)], dtype=float), lambda state: slopes(*state), np.array([z, 0.0])
    )


def acceleration_expression(equation: sympy.Eq) -> tuple[sympy.Expr, list[sympy.Symbol]]:
    """Acceleration by an equation in z(t), all symbols but those of z and z' set to zero."""
    import sympy

    t = sympy.Symbol("t")
    motion = sympy.Function("z")(t)
    height, speed, acceleration = sympy.symbols("z v a", real=True)
    plain = (equation.lhs - equation.rhs).xreplace(
        {motion.diff(t, 2): acceleration, motion.diff(t): speed, motion: height}
    )
    still = dict.fromkeys(plain.free_symbols - {height, speed, acceleration}, 0.0)
    plain = plain.subs(still)
    return -plain.subs(acceleration, 0) / plain.diff(acceleration), [height, speed]


@functools.lru_cache(maxsize=COMPILED)
def dry_friction_coefficient(equation: str, inputs: tuple[str, ...] = ()) -> Callable[..., Any] | None:
    """Compile what stands before sign(z'), or a tanh that rounds it, by a law's parameters; None if none."""
    import sympy

    from granular.formulas.algebra import compile_function

    parsed = parse_equation(equation, inputs)
    sign, v = sympy.Symbol("sign of z'"), parsed.symbol_v

    def jumps(item: sympy.Expr) -> bool:
        return item == sympy.sign(v) or (isinstance(item, sympy.tanh) and not (item.args[0] / v).has(v))

    rate = parsed.acceleration.replace(jumps, lambda _: sign)
    coefficient, parameters = -rate.diff(sign), [sympy.Symbol(name) for name in parsed.parameters]
    if coefficient == 0 or not coefficient.free_symbols <= set(parameters):
        return None
    return compile_function(parameters, coefficient)


def _oscillation_with_velocity_jump(
    rates: Field, slopes: Field, state: np.ndarray
) -> SmallOscillation | NoOscillation:
    """Swing; where the law jumps with the sign of the velocity, that of the mean of both."""
    # Dry friction jumps at rest: its damping of a small motion is infinite, its stiffness that of the mean.
    result = _find_rest_state(rates, slopes, state)
    if result is not JUMPS or len(state) > 2:
        return result
    creep = np.array([0.0, _CREEP])

    def mean(function: Field) -> Field:
        return lambda at: 0.5 * (function(at + creep) + function(at - creep))

    result = _find_rest_state(mean(rates), mean(slopes), state)
    return result._replace(damping_ratio=math.inf) if isinstance(result, SmallOscillation) else result


def _find_rest_state(rates: Field, slopes: Field, state: np.ndarray) -> SmallOscillation | NoOscillation:
    """Return the rest state by Newton's method, and the eigenvalues of the linear motion there."""
    state = state.copy()
    with np.errstate(all="ignore"):
        for _ in range(_MOST_NEWTON_STEPS):
            left, matrix = rates(state), slopes(state)
            free = np.delete(matrix, 1, axis=1)
            if not np.isfinite(left).all():
                return _NO_LEVEL
            if not np.isfinite(free).all():
                return JUMPS
            least = _FLAT * np.abs(matrix).max()
            moving = list(range(len(left)))
            if np.linalg.matrix_rank(free, tol=least) < len(left):
                # Hidden states that may be anything at rest stay where they are.
                moving = [0] + [k for k in moving[1:] if abs(free[k, k]) > least]
            try:
                change = np.linalg.solve(free[np.ix_(moving, moving)], left[moving])
            except np.linalg.LinAlgError:
                return _NO_LEVEL
            for k, step in zip(moving, change, strict=True):
                state[k + (k > 0)] -= step
            if not np.isfinite(state).all() or np.abs(change).max() <= 1e-15 * max(1.0, np.abs(state).max()):
                break
        if not np.isfinite(state).all():
            return _NO_LEVEL
        matrix = slopes(state)
    if not np.isfinite(matrix).all():
        return JUMPS
    if len(matrix) == 1:
        stiffness, damping = -matrix[0]
        if not stiffness > 0.0:
            return _PUSHES
        omega = math.sqrt(stiffness)
        return SmallOscillation(float(state[0]), 2.0 * math.pi / omega, damping / (2.0 * omega))
    return _oscillation_with_hidden_states(state, matrix)


def _oscillation_with_hidden_states(
    state: np.ndarray, matrix: np.ndarray
) -> SmallOscillation | NoOscillation:
    """Small swing of a law with hidden states, by its slowest complex eigenvalues that move z."""
    size = len(state)
    full = np.zeros((size, size))
    full[0, 1] = 1.0
    full[1:] = matrix
    values, vectors = np.linalg.eig(full)
    if values.real.max() > _FLAT * np.abs(values).max() and not (values.imag > 0.0).any():
        return _UNSTABLE
    scale = np.abs(vectors).max(axis=0)
    swinging = (values.imag > _FLAT * np.abs(values).max()) & (np.abs(vectors[0]) > _FLAT * scale)
    if not swinging.any():
        return _CREEPS
    modes = []
    for value in sorted(values[swinging], key=abs):
        omega = abs(value)
        ratio = float(-value.real / omega)
        modes.append((2.0 * math.pi / omega, ratio if abs(ratio) > _FLAT else 0.0))
    return SmallOscillation(float(state[0]), *modes[0], tuple(modes[1:]), tuple(map(float, state[2:])))


class HarmonicCycles(NamedTuple):
    """Harmonic cycles, per unit of mass."""

    centre: Float[np.ndarray, "n"]  # of z, at which no mean force is needed
    frequency: Float[np.ndarray, "n"]  # angular [rad/s]
    stiffness: Float[np.ndarray, "n"]  # [1/s^2]
    damping: Float[np.ndarray, "n"]  # [1/s]

    @property
    def damping_ratio(self) -> np.ndarray:
        """Fraction of critical damping; NaN where nothing pulls back."""
        with np.errstate(all="ignore"):
            return np.asarray(self.damping / (2.0 * np.sqrt(self.stiffness)))

    def equivalent_friction(self, amplitude: Any) -> Float[np.ndarray, "n"]:
        """Constant friction, per unit of mass, that takes as much energy from such a cycle."""
        # Friction F takes 4 F A a cycle, damping pi c omega A^2.
        return np.asarray(0.25 * math.pi * amplitude * self.frequency * self.damping)


def law_rates(law: Law, values: Sequence[Any]) -> Rates:
    """Rates of a law with values of its parameters, numbers or arrays; inputs are at zero."""
    field, still = compile_rates(law.equation, law.inputs, "numpy"), (0.0,) * len(law.inputs)
    return lambda *state: field(*state, *still, *values)


def equation_rates(equation: sympy.Eq) -> Rates:
    """Rate of an equation in z(t) with numbers for all parameters."""
    from granular.formulas.algebra import compile_function

    rate, state = acceleration_expression(equation)
    return compile_function(state, [rate])


def harmonic_cycles(
    rates: Rates, hidden: int, amplitude: Any, centre: Any, omega: Any, *, free: bool = True
) -> HarmonicCycles:
    """Cycles of amplitudes (n,), from guesses of their centres and angular frequencies [rad/s]."""
    # Harmonic balance with one harmonic, or the describing function (Krylov and Bogoliubov 1947, Introduction
    # to Non-Linear Mechanics). A free cycle has the frequency at which the stiffness carries the inertia.
    amplitude, centre, omega = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (amplitude, centre, omega))
    )
    for _ in range(_MOST_ROUNDS):
        moved, stiffness, damping = centre_cycles(rates, hidden, amplitude, centre, omega)
        swings = stiffness > 0.0
        faster = np.sqrt(np.where(swings, stiffness, omega**2)) if free else omega
        changed = np.maximum(abs(moved - centre) / amplitude, abs(faster / omega - 1.0))
        centre, omega = moved, faster
        if not (swings & (changed > _SETTLED)).any():
            break
    return HarmonicCycles(centre, omega, stiffness, damping)


def centre_cycles(
    rates: Rates,
    hidden: int,
    amplitude: Float[np.ndarray, "n"],
    centre: Float[np.ndarray, "n"],
    omega: Float[np.ndarray, "n"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres moved to no mean force; stiffness [1/s^2], damping [1/s] before that; omega [rad/s]."""
    step = _STEP * amplitude
    positions = np.stack([centre, centre + step])
    mean, stiffness, damping = harmonic_coefficients(rates, hidden, amplitude, positions, omega)
    with np.errstate(all="ignore"):
        change = mean[0] * step / (mean[1] - mean[0])
    change = np.clip(np.nan_to_num(change), -_FARTHEST * amplitude, _FARTHEST * amplitude)
    return centre - change, stiffness[0], damping[0]


def harmonic_coefficients(
    rates: Rates,
    hidden: int,
    amplitude: Float[np.ndarray, "..."],
    centre: Float[np.ndarray, "..."],
    omega: Float[np.ndarray, "..."],
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Mean force, stiffness [1/s^2] and damping [1/s] of cycles, per unit of mass; omega [rad/s]."""
    # First Fourier coefficients of the force along z = centre + amplitude cos(omega t).
    # None of them where the velocity is zero, and its sign rounding.
    angles = 2.0 * math.pi * (np.arange(_NODES) + 0.5) / _NODES

    def motion(angle: float) -> tuple[np.ndarray, np.ndarray]:
        return centre + amplitude * math.cos(angle), -amplitude * omega * math.sin(angle)

    still = np.zeros(np.broadcast_shapes(*map(np.shape, (amplitude, centre, omega))))
    states, half = [still] * hidden, math.pi / _NODES
    sums = [still] * 3
    with np.errstate(all="ignore"):
        for turn in range(_TURNS if states else 1):
            last = turn == (_TURNS if states else 1) - 1
            for angle in angles:
                force, *slopes = rates(*motion(angle), *states)
                if last:
                    parts = (-0.5, -math.cos(angle), math.sin(angle))
                    sums = [value + part * force for value, part in zip(sums, parts, strict=True)]
                if states:
                    # The explicit midpoint rule: the cycle of z is given.
                    middle = [w + half * slope / omega for w, slope in zip(states, slopes, strict=True)]
                    _, *slopes = rates(*motion(angle + half), *middle)
                    states = [w + 2.0 * half * slope / omega for w, slope in zip(states, slopes, strict=True)]
    mean, stiffness, damping = (2.0 / _NODES * value for value in sums)
    return mean, stiffness / amplitude, damping / (amplitude * omega)
