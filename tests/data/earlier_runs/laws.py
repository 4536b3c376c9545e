"""Effects and laws of a user as they were written for version 9aa5be2a, forces and bounds of slopes given."""

import math

from granular import effect, quantity, wall_law


@effect
class FormerBumpers:
    """A repulsion of pairs that ends smoothly at a distance."""

    k: float = quantity("N/m", default=2.0)
    end: float = quantity("m", default=0.012)

    @staticmethod
    def pair_energy(p, r, first, second):
        return first.moment * second.moment * p.k * max(p.end - r, 0.0) ** 4 / p.end**2

    @staticmethod
    def pair_force(p, r, first, second):
        return 4.0 * first.moment * second.moment * p.k * max(p.end - r, 0.0) ** 3 / p.end**2

    @staticmethod
    def pair_stiffness(p, r, first, second):
        return 12.0 * first.moment * second.moment * p.k * max(p.end - r, 0.0) ** 2 / p.end**2

    @staticmethod
    def reach(p):
        return p.end


@effect
class FormerSpring:
    """A spring that pulls every grain towards a height."""

    k: float = quantity("N/m", above=0.0)
    height: float = quantity("m", default=0.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * p.k * (grain.y - p.height) ** 2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k * (grain.y - p.height)

    @staticmethod
    def stiffness(p, grain, time):
        return p.k


@effect
class FormerOil:
    """A film of oil, which drags at every grain by its area."""

    drag: float = quantity("kg/s", above=0.0)

    @staticmethod
    def flow(p, grain, vx, vy, dt):
        left = math.exp(-p.drag * grain.moment / grain.mass * dt)
        return left * vx, left * vy


@wall_law
class FormerRubber:
    """A wall that pushes from a distance on, smoothly."""

    k: float = quantity("N/m", above=0.0)
    reach: float = quantity("m", above=0.0)

    @staticmethod
    def energy(p, w):
        return 0.25 * p.k * max(p.reach - w, 0.0) ** 4 / p.reach**2

    @staticmethod
    def force(p, w):
        return p.k * max(p.reach - w, 0.0) ** 3 / p.reach**2

    @staticmethod
    def stiffness(p, w):
        return 3.0 * p.k * max(p.reach - w, 0.0) ** 2 / p.reach**2
