"""Linearise a law: small oscillation about equilibrium, and harmonic cycles of any amplitude.

Stiffness and damping of a harmonic cycle, z = centre + A cos(omega t), are the first harmonics of
the law's force (describing functions; Krylov & Bogoliubov 1943, Gelb & Vander Velde 1968). The
damping ratio is the damping divided by twice the square root of the stiffness. It equals the energy
dissipated per cycle divided by 4 pi times the energy of the oscillation.
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
    compile_derivative_matrix,
    compile_jacobian,
    compile_rates,
    parse_equation,
)
from reduced_models.laws.law import Law

if TYPE_CHECKING:
    import sympy

_MOST_NEWTON_STEPS = 50
_JUMP_SPEED = 1e-9  # speed on either side of a jump: above rounding, below any oscillation
_NEGLIGIBLE = 1e-9  # fraction of a matrix's largest entry: smaller values count as zero
Field = Callable[[np.ndarray], np.ndarray]
"""Function of a state (z, its velocity, hidden states) that returns the rates of all its entries except z."""
Rates = Callable[..., Sequence[Any]]
"""Function of z, velocity and hidden states that returns z'' and the rates of the hidden states."""

# Nodes per cycle. The damping of dry friction, which jumps at zero speed, is then accurate to
# (pi/256)^2/6 = 2.5e-5.
_NODES = 256
# Cycles after which a hidden state is assumed periodic: with a relaxation time of one period, e^-2 of its
# initial value remains before the last cycle.
_CYCLE_COUNT = 3
_MOST_ROUNDS = 60
_SETTLED = 1e-11
# Difference and maximum step of Newton's method for a centre, in amplitudes.
_DIFFERENCE_STEP, _MAXIMUM_STEP = 1e-4, 0.3


class SmallOscillation(NamedTuple):
    """Oscillation so small that the law is linear, with all inputs zero."""

    z: float
    period: float  # [s]
    damping_ratio: float  # infinite if the force jumps with the sign of the velocity
    faster: tuple[tuple[float, float], ...] = ()  # periods [s] and damping ratios of faster modes
    hidden: tuple[float, ...] = ()  # hidden states at rest


class NoOscillationReason(NamedTuple):
    """Reason why a law has no small oscillation."""

    reason: str


_NO_EQUILIBRIUM = NoOscillationReason("no isolated equilibrium is found near the record")
FORCE_JUMPS = NoOscillationReason("the force jumps at rest, as dry friction does")
_NO_RESTORING_FORCE = NoOscillationReason("the force at the equilibrium is not restoring")
_UNSTABLE = NoOscillationReason("the equilibrium is not stable")
_OVERDAMPED = NoOscillationReason("the motion is overdamped and returns to equilibrium without oscillation")


def small_oscillation(law: Law, values: Sequence[float], z: float) -> SmallOscillation | NoOscillationReason:
    """Return the small oscillation of a law with given parameter values about the equilibrium near z."""
    # Hidden states follow their equations. They are at zero if any value is possible at rest, as with
    # hysteresis.
    inputs = (0.0,) * len(law.inputs)
    rates = compile_rates(law.equation, law.inputs, "numpy")
    slopes = compile_jacobian(law.equation, law.inputs)
    return _oscillation_with_velocity_jump(
        lambda state: np.array(rates(*state, *inputs, *values), dtype=float),
        lambda state: slopes(*state, *inputs, *values),
        np.array([z, 0.0, *(0.0,) * len(law.hidden)]),
    )


def small_oscillation_of_equation(equation: sympy.Eq, z: float) -> SmallOscillation | NoOscillationReason:
    """Return the small oscillation of an equation in z(t) without free symbols; see `small_oscillation`."""
    from granular.formulas.algebra import compile_expressions

    rate, state = acceleration_and_other_symbols(equation)
    force, slopes = compile_expressions(state, rate), compile_derivative_matrix([rate], state, state)
    return _oscillation_with_velocity_jump(
        lambda state: np.array([force(*state)], dtype=float), lambda state: slopes(*state), np.array([z, 0.0])
    )


def acceleration_and_other_symbols(equation: sympy.Eq) -> tuple[sympy.Expr, list[sympy.Symbol]]:
    """Solve an equation in z(t) for the acceleration; return it with the symbols of z and z'."""
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
def compile_dry_friction_coefficient(
    equation: str, inputs: tuple[str, ...] = ()
) -> Callable[..., Any] | None:
    """Compile the coefficient of sign(z') or tanh(z'/v) as a function of parameters; None if absent."""
    import sympy

    from granular.formulas.algebra import compile_expressions

    parsed = parse_equation(equation, inputs)
    sign, v = sympy.Symbol("sign of z'"), parsed.symbol_v

    def jumps_with_velocity(item: sympy.Expr) -> bool:
        return item == sympy.sign(v) or (isinstance(item, sympy.tanh) and not (item.args[0] / v).has(v))

    rate = parsed.acceleration.replace(jumps_with_velocity, lambda _: sign)
    coefficient, parameters = -rate.diff(sign), [sympy.Symbol(name) for name in parsed.parameters]
    if coefficient == 0 or not coefficient.free_symbols <= set(parameters):
        return None
    return compile_expressions(parameters, coefficient)


def _oscillation_with_velocity_jump(
    rates: Field, slopes: Field, state: np.ndarray
) -> SmallOscillation | NoOscillationReason:
    """Return the small oscillation; a force that jumps at zero velocity is averaged over both directions."""
    # Dry friction jumps at rest: its damping ratio for small motions is infinite, and the mean gives the
    # stiffness.
    result = _oscillation_about_rest_state(rates, slopes, state)
    if result is not FORCE_JUMPS or len(state) > 2:
        return result
    jump_offset = np.array([0.0, _JUMP_SPEED])

    def mean_across_jump(function: Field) -> Field:
        return lambda at: 0.5 * (function(at + jump_offset) + function(at - jump_offset))

    result = _oscillation_about_rest_state(mean_across_jump(rates), mean_across_jump(slopes), state)
    return result._replace(damping_ratio=math.inf) if isinstance(result, SmallOscillation) else result


def _oscillation_about_rest_state(
    rates: Field, slopes: Field, state: np.ndarray
) -> SmallOscillation | NoOscillationReason:
    """Return the small oscillation about the equilibrium that Newton's method finds."""
    state = state.copy()
    with np.errstate(all="ignore"):
        for _ in range(_MOST_NEWTON_STEPS):
            rates_at_state, matrix = rates(state), slopes(state)
            free = np.delete(matrix, 1, axis=1)
            if not np.isfinite(rates_at_state).all():
                return _NO_EQUILIBRIUM
            if not np.isfinite(free).all():
                return FORCE_JUMPS
            least = _NEGLIGIBLE * np.abs(matrix).max()
            moving = list(range(len(rates_at_state)))
            if np.linalg.matrix_rank(free, tol=least) < len(rates_at_state):
                # Hidden states that are arbitrary at rest stay unchanged.
                moving = [0] + [k for k in moving[1:] if abs(free[k, k]) > least]
            try:
                change = np.linalg.solve(free[np.ix_(moving, moving)], rates_at_state[moving])
            except np.linalg.LinAlgError:
                return _NO_EQUILIBRIUM
            for k, step in zip(moving, change, strict=True):
                state[k + (k > 0)] -= step
            if not np.isfinite(state).all() or np.abs(change).max() <= 1e-15 * max(1.0, np.abs(state).max()):
                break
        if not np.isfinite(state).all():
            return _NO_EQUILIBRIUM
        matrix = slopes(state)
    if not np.isfinite(matrix).all():
        return FORCE_JUMPS
    if len(matrix) == 1:
        stiffness, damping = -matrix[0]
        if not stiffness > 0.0:
            return _NO_RESTORING_FORCE
        omega = math.sqrt(stiffness)
        return SmallOscillation(float(state[0]), 2.0 * math.pi / omega, damping / (2.0 * omega))
    return _oscillation_with_hidden_states(state, matrix)


def _oscillation_with_hidden_states(
    state: np.ndarray, matrix: np.ndarray
) -> SmallOscillation | NoOscillationReason:
    """Return the small oscillation of the slowest complex eigenvalues whose eigenvectors contain z."""
    size = len(state)
    full = np.zeros((size, size))
    full[0, 1] = 1.0
    full[1:] = matrix
    values, vectors = np.linalg.eig(full)
    if values.real.max() > _NEGLIGIBLE * np.abs(values).max() and not (values.imag > 0.0).any():
        return _UNSTABLE
    scale = np.abs(vectors).max(axis=0)
    oscillating = (values.imag > _NEGLIGIBLE * np.abs(values).max()) & (
        np.abs(vectors[0]) > _NEGLIGIBLE * scale
    )
    if not oscillating.any():
        return _OVERDAMPED
    modes = []
    for value in sorted(values[oscillating], key=abs):
        omega = abs(value)
        ratio = float(-value.real / omega)
        modes.append((2.0 * math.pi / omega, ratio if abs(ratio) > _NEGLIGIBLE else 0.0))
    return SmallOscillation(float(state[0]), *modes[0], tuple(modes[1:]), tuple(map(float, state[2:])))


class HarmonicCycles(NamedTuple):
    """Harmonic cycles; forces are divided by the mass."""

    centre: Float[np.ndarray, "n"]  # centre of the cycle in z, for which no mean force is needed
    frequency: Float[np.ndarray, "n"]  # angular [rad/s]
    stiffness: Float[np.ndarray, "n"]  # [1/s^2]
    damping: Float[np.ndarray, "n"]  # [1/s]

    @property
    def damping_ratio(self) -> np.ndarray:
        """Fraction of critical damping; NaN if the force is not restoring."""
        with np.errstate(all="ignore"):
            return np.asarray(self.damping / (2.0 * np.sqrt(self.stiffness)))

    def equivalent_friction(self, amplitude: Any) -> Float[np.ndarray, "n"]:
        """Return the constant friction, per unit mass, that dissipates the same energy per cycle."""
        # Friction F dissipates 4 F A per cycle, damping c dissipates pi c omega A^2.
        return np.asarray(0.25 * math.pi * amplitude * self.frequency * self.damping)


def make_rates_of_law(law: Law, values: Sequence[Any]) -> Rates:
    """Return the rates of a law as a function of the state, for given parameters and zero inputs."""
    field, still = compile_rates(law.equation, law.inputs, "numpy"), (0.0,) * len(law.inputs)
    return lambda *state: field(*state, *still, *values)


def make_acceleration_of_equation(equation: sympy.Eq) -> Rates:
    """Return the acceleration of an equation in z(t) as a function; all its parameters must be numbers."""
    from granular.formulas.algebra import compile_expressions

    rate, state = acceleration_and_other_symbols(equation)
    return compile_expressions(state, [rate])


def solve_harmonic_balance(
    rates: Rates, hidden: int, amplitude: Any, centre: Any, omega: Any, *, free: bool = True
) -> HarmonicCycles:
    """Find cycles of amplitudes (n,), from guesses of their centres and angular frequencies [rad/s]."""
    # Harmonic balance with one harmonic, or describing function (Krylov and Bogoliubov 1947, Introduction
    # to Non-Linear Mechanics). A free cycle has the frequency at which the stiffness balances the inertia.
    amplitude, centre, omega = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (amplitude, centre, omega))
    )
    for _ in range(_MOST_ROUNDS):
        moved, stiffness, damping = shifted_centres_stiffness_and_damping(
            rates, hidden, amplitude, centre, omega
        )
        has_restoring_force = stiffness > 0.0
        faster = np.sqrt(np.where(has_restoring_force, stiffness, omega**2)) if free else omega
        changed = np.maximum(abs(moved - centre) / amplitude, abs(faster / omega - 1.0))
        centre, omega = moved, faster
        if not (has_restoring_force & (changed > _SETTLED)).any():
            break
    return HarmonicCycles(centre, omega, stiffness, damping)


def shifted_centres_stiffness_and_damping(
    rates: Rates,
    hidden: int,
    amplitude: Float[np.ndarray, "n"],
    centre: Float[np.ndarray, "n"],
    omega: Float[np.ndarray, "n"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centres after a secant step towards zero mean force; stiffness and damping at given centres."""
    step = _DIFFERENCE_STEP * amplitude
    positions = np.stack([centre, centre + step])
    mean, stiffness, damping = mean_force_stiffness_and_damping_of_cycles(
        rates, hidden, amplitude, positions, omega
    )
    with np.errstate(all="ignore"):
        change = mean[0] * step / (mean[1] - mean[0])
    change = np.clip(np.nan_to_num(change), -_MAXIMUM_STEP * amplitude, _MAXIMUM_STEP * amplitude)
    return centre - change, stiffness[0], damping[0]


def mean_force_stiffness_and_damping_of_cycles(
    rates: Rates,
    hidden: int,
    amplitude: Float[np.ndarray, "..."],
    centre: Float[np.ndarray, "..."],
    omega: Float[np.ndarray, "..."],
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Return mean force, stiffness [1/s^2] and damping [1/s] per unit mass of cycles; ``omega`` in rad/s."""
    # First Fourier coefficients of the force along z = centre + amplitude cos(omega t). No node is at zero
    # velocity, whose sign would be rounding.
    angles = 2.0 * math.pi * (np.arange(_NODES) + 0.5) / _NODES

    def motion(angle: float) -> tuple[np.ndarray, np.ndarray]:
        return centre + amplitude * math.cos(angle), -amplitude * omega * math.sin(angle)

    still = np.zeros(np.broadcast_shapes(*map(np.shape, (amplitude, centre, omega))))
    states, half = [still] * hidden, math.pi / _NODES
    sums = [still] * 3
    with np.errstate(all="ignore"):
        for cycle in range(_CYCLE_COUNT if states else 1):
            last = cycle == (_CYCLE_COUNT if states else 1) - 1
            for angle in angles:
                force, *slopes = rates(*motion(angle), *states)
                if last:
                    parts = (-0.5, -math.cos(angle), math.sin(angle))
                    sums = [value + part * force for value, part in zip(sums, parts, strict=True)]
                if states:
                    # Explicit midpoint rule for hidden states along the given cycle of z.
                    middle = [w + half * slope / omega for w, slope in zip(states, slopes, strict=True)]
                    _, *slopes = rates(*motion(angle + half), *middle)
                    states = [w + 2.0 * half * slope / omega for w, slope in zip(states, slopes, strict=True)]
    mean, stiffness, damping = (2.0 / _NODES * value for value in sums)
    return mean, stiffness / amplitude, damping / (amplitude * omega)
