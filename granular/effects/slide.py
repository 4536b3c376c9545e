"""Motion under a constant force, viscous drag and dry friction together: the velocity after a duration.

Along a line the solution is exact: what slides may stop within the duration, stays while the force is
at most that of static friction, and is set off by a larger one for the time that remains. In a plane,
friction acts against the mean direction of the motion. One after the other, force and friction would
stop for good what is pushed on, and give what creeps more energy in each step than it has.
"""

from __future__ import annotations

import math

from granular.compiled import compiled, entry

Flow = tuple[float, float, float, float, float]
"""The values of `granular.effects.drag.drag_flow_coefficients`."""

Slide = tuple[float, float, float, float]
"""Velocity x, y [D/tau]; energies lost to drag and to friction [F* D]."""


@compiled(inline=True)
def vector_length(x: float, y: float) -> float:
    """Length of a vector. `math.hypot`, which guards against overflow, took a third of a step."""
    return math.sqrt(x * x + y * y)


@compiled
def slide(
    rate: float,
    dt: float,
    flow: Flow,
    mass: float,
    velocity: tuple[float, float],
    force: tuple[float, float],
    static: float,
    dynamic: float,
    load: float,
) -> Slide:
    """Slide for dt [tau]; rate [1/tau], mass [m], velocity [D/tau], force and load [F*]."""
    vx, vy = velocity
    fx, fy = force
    speed = vector_length(vx, vy)
    if speed == 0.0:
        return _set_off(rate, dt, flow, mass, force, static, dynamic, load)
    against = -(vx * fx + vy * fy)
    # It must not be carried through rest to the other side: dynamic friction would release it there, though
    # static friction holds it.
    stops = against > 0.0 and speed * mass <= dt * (against / speed + dynamic * load)
    if not (stops and vector_length(fx, fy) <= static * load):
        decay, gain = flow[:2]
        ax, ay = fx / mass, fy / mass
        # Direction of v before plus v after. If they cancel, it turns within dt, so it stops on the way.
        ux, uy = (1.0 + decay) * vx + gain * ax, (1.0 + decay) * vy + gain * ay
        length = vector_length(ux, uy)
        if length > 0.0:
            ux, uy = ux / length, uy / length
            brake = dynamic * load / mass
            ax, ay = ax - brake * ux, ay - brake * uy
            wx, wy, dragged = move_with_drag(flow, vx, vy, ax, ay)
            if vx * ux + vy * uy >= 0.0 and wx * ux + wy * uy > 0.0:
                path = _displacement(rate, dt, gain, vx * ux + vy * uy, ax * ux + ay * uy)
                return wx, wy, mass * dragged, dynamic * load * path
    against = -(vx * fx + vy * fy) / speed
    brake = (dynamic * load + against) / mass
    path = _stopping_distance(rate, speed, brake)
    left = max(dt - _stopping_time(rate, speed, brake), 0.0)
    dragged = 0.5 * mass * speed * speed - mass * brake * path
    vx, vy, later, rubbed = _set_off(
        rate, left, drag_flow_coefficients(rate, left), mass, force, static, dynamic, load
    )
    return vx, vy, dragged + later, dynamic * load * path + rubbed


@compiled
def _set_off(
    rate: float,
    dt: float,
    flow: Flow,
    mass: float,
    force: tuple[float, float],
    static: float,
    dynamic: float,
    load: float,
) -> Slide:
    """Slide from rest along the force, if that is above static friction."""
    size = vector_length(force[0], force[1])
    if size <= static * load:
        return 0.0, 0.0, 0.0, 0.0
    fraction = 1.0 - dynamic * load / size
    vx, vy, dragged = move_with_drag(flow, 0.0, 0.0, fraction * force[0] / mass, fraction * force[1] / mass)
    path = _displacement(rate, dt, flow[1], 0.0, fraction * size / mass)
    return vx, vy, mass * dragged, dynamic * load * path


@compiled(inline=True)
def move_with_drag(flow: Flow, vx: float, vy: float, ax: float, ay: float) -> tuple[float, float, float]:
    """Velocity [D/tau] under an acceleration [D/tau^2] and drag; loss per mass [D^2/tau^2]."""
    decay, gain, a, b, c = flow
    lost = a * (vx * vx + vy * vy) + b * (vx * ax + vy * ay) + c * (ax * ax + ay * ay)
    return decay * vx + gain * ax, decay * vy + gain * ay, lost


@entry
def drag_flow_coefficients(rate: float, dt: float) -> tuple[float, float, float, float, float]:
    """Decay, gain [tau], A, B [tau] and C [tau^2] of the exact flow of kick and drag over dt [tau]."""
    z = rate * dt
    decay = math.exp(-z)
    gain = -math.expm1(-z) / rate if z != 0.0 else dt
    a = -0.5 * math.expm1(-2.0 * z)
    b = rate * gain * gain
    # Series of C: at 1e-2 it errs by 1e-12, the closed form by up to 1.4e-11, and more below (2e-9 at 1e-3).
    if abs(z) < 1e-2:
        bent = 1.0 / 3.0 - z * (1.0 / 4.0 - z * (7.0 / 60.0 - z * (1.0 / 24.0 - z * 31.0 / 2520.0)))
        c = rate * dt * dt * dt * bent
    else:
        c = (dt - 2.0 * gain + a / rate) / rate
    return decay, gain, a, b, c


@compiled
def _displacement(rate: float, dt: float, gain: float, speed: float, push: float) -> float:
    """Displacement under drag and a push [D]; rate [1/tau], dt, gain [tau], speed [D/tau], push [D/tau^2]."""
    # Below, rate dt/3 < 4e-7 of it is neglected; above, the difference keeps nine digits.
    bend = (dt - gain) / rate if rate * dt > 1e-6 else 0.5 * dt * dt
    return gain * speed + bend * push


@compiled
def _stopping_distance(rate: float, speed: float, brake: float) -> float:
    """Distance to rest under drag and a brake [D]; rate [1/tau], speed [D/tau], brake [D/tau^2]."""
    # Neglects 7e-7 of it at most; above, the difference with the logarithm keeps nine digits.
    if rate * speed <= 1e-6 * brake:
        return 0.5 * speed * speed / brake
    if brake <= 0.0:
        return speed / rate
    # At rest after t: e^(c t) = 1 + c v/brake, and the distance is v/c - brake t/c.
    return (speed - brake / rate * math.log1p(rate * speed / brake)) / rate


@compiled
def _stopping_time(rate: float, speed: float, brake: float) -> float:
    """Time log(1 + c v/brake)/c to rest [tau]; rate [1/tau], speed [D/tau], brake [D/tau^2]."""
    if rate * speed <= 1e-6 * brake:
        return speed / brake
    return math.log1p(rate * speed / brake) / rate
