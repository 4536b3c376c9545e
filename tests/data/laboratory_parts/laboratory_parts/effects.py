"""A custom effect and a custom wall law."""

from granular import effect, quantity, wall_law


@effect
class BenchSpring:
    """A spring that pulls every grain down."""

    k: float = quantity("N/m", above=0.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * p.k * grain.y**2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k * grain.y


@wall_law
class BenchRubber:
    """A wall like a spring from 1 mm on."""

    k: float = quantity("N/m", above=0.0)

    @staticmethod
    def energy(p, w):
        return 0.5 * p.k * min(w - 1.0, 0.0) ** 2

    @staticmethod
    def force(p, w):
        return -p.k * min(w - 1.0, 0.0)

    @staticmethod
    def stiffness(p, w):
        return p.k if w < 1.0 else 0.0
