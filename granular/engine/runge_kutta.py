"""A step of an explicit Runge-Kutta method: not symplectic, the control of those that are."""

from __future__ import annotations

from granular.compiled import Array, compiled
from granular.effects.shaking import acceleration
from granular.engine.forces import compute_forces, measure_forces
from granular.engine.motion import Motion, outer_force, path
from granular.engine.piston import add_shaking_work, piston_energy
from granular.engine.state import DRAG, PISTON, WORK, Measurement, Rungs, State
from granular.engine.system import Constants, Resistance
from granular.pairs.vector import lane_sum


@compiled
def _rate(rate: float | None) -> float:
    return 0.0 if rate is None else rate


@compiled
def _resistance_rate(resistance: Resistance | None) -> float:
    return 0.0 if resistance is None else resistance.rate


@compiled
def _mass(charge: Array | None, i: int) -> float:
    return 1.0 if charge is None else charge[i]


@compiled
def _grain_slopes(slopes: Array, span: float, state: State, constants: Constants) -> None:
    """Slopes of positions and velocities; the loss to drag is entered with the weight ``span``."""
    rate = _rate(constants.acting.drag)
    for i in range(constants.grains):
        mass = _mass(constants.charge, i)
        vx, vy = state.vx[i], state.vy[i]
        slopes[0, i] = vx
        slopes[1, i] = vy
        slopes[2, i] = state.fx[i] / mass - rate * vx
        slopes[3, i] = state.fy[i] / mass - rate * vy
        state.push[i] = mass * (vx * vx + vy * vy)
    state.ledger[DRAG] += span * rate * lane_sum(state.push)


@compiled
def _piston_slopes(
    slopes: Array, span: float, time: float, start: float, state: State, constants: Constants,
    motion: Motion,
) -> None:  # fmt: skip
    if motion.free:
        _, swing = acceleration(constants.acting.shaking, start + time)
        outer = outer_force(motion, time)
        rate = _resistance_rate(constants.resistance)
        force = state.totals[3] - constants.weight + constants.mass * swing + outer
        speed = state.piston[1]
        slopes[0] = speed
        slopes[1] = force / constants.mass - rate * speed
        state.ledger[WORK] += span * outer * speed
        state.ledger[PISTON] += span * constants.mass * rate * speed * speed
    else:
        state.ledger[WORK] -= span * state.totals[3] * path(motion, time)[1]
    add_shaking_work(constants.acting.shaking, span, state, constants, start + time)


@compiled
def _store(state: State, rungs: Rungs, count: int) -> None:
    base = rungs.grains[-1]
    for i in range(count):
        base[0, i] = state.x[i]
        base[1, i] = state.y[i]
        base[2, i] = state.vx[i]
        base[3, i] = state.vy[i]
    rungs.piston[-1, 0] = state.piston[0]
    rungs.piston[-1, 1] = state.piston[1]


@compiled
def _climb(
    weights: Array, rungs: Rungs, h: float, time: float, state: State, count: int, motion: Motion
) -> None:
    """The state at a stage: the base and the weighted slopes so far."""
    base = rungs.grains[-1]
    for i in range(count):
        x, y, vx, vy = base[0, i], base[1, i], base[2, i], base[3, i]
        for j in range(weights.size):
            x += h * weights[j] * rungs.grains[j, 0, i]
            y += h * weights[j] * rungs.grains[j, 1, i]
            vx += h * weights[j] * rungs.grains[j, 2, i]
            vy += h * weights[j] * rungs.grains[j, 3, i]
        state.x[i], state.y[i], state.vx[i], state.vy[i] = x, y, vx, vy
    if motion.free:
        height, speed = rungs.piston[-1, 0], rungs.piston[-1, 1]
        for j in range(weights.size):
            height += h * weights[j] * rungs.piston[j, 0]
            speed += h * weights[j] * rungs.piston[j, 1]
        state.piston[0], state.piston[1] = height, speed
    else:
        state.piston[0], state.piston[1] = path(motion, time)


@compiled
def runge_kutta_step(
    tableau: Array, rungs: Rungs, h: float, time: float, start: float, state: State,
    constants: Constants, motion: Motion, measurement: Measurement | None,
) -> int:  # fmt: skip
    """See `granular.engine.step.make_step`; the work and the losses are integrated alike.

    Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (1993), II.1.
    """
    stages = tableau.shape[1]
    count = constants.grains
    outside = 0
    _store(state, rungs, count)
    before = piston_energy(state, constants, start + time)
    for k in range(stages):
        moment = time + h * tableau[k].sum()
        if k > 0:
            _climb(tableau[k, :k], rungs, h, moment, state, count, motion)
            outside += compute_forces(state, constants, start + moment)
        span = h * tableau[stages, k]
        _grain_slopes(rungs.grains[k], span, state, constants)
        _piston_slopes(rungs.piston[k], span, moment, start, state, constants, motion)
    end = time + h
    _climb(tableau[stages], rungs, h, end, state, count, motion)
    if not motion.free:
        state.ledger[WORK] += piston_energy(state, constants, start + end) - before
    if measurement is not None:
        outside += measure_forces(state, constants, start + end, measurement)
    else:
        outside += compute_forces(state, constants, start + end)
    return outside
