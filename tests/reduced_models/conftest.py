"""Motions of the built-in laws with known parameters, at 1 % noise."""

import functools
from collections.abc import Callable

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models.laws import LAWS
from reduced_models.laws.solution import solve_law
from tests.reduced_models.made import noisy

TIME = np.linspace(0.0, 40.0, 2000)
TRUE = {
    "linear": ({"lam": 0.05, "omega": 1.05, "g0": -1.0}, 1.0),
    "van-der-pol-like": ({"alpha": 0.17, "omega": 1.05, "g0": -1.0, "shift": 0.0, "scale": 1.0}, 1.0),
    "van-der-pol": ({"mu": 0.5, "rest": 0.3, "width": 1.0, "omega": 1.05}, 0.5),
    "duffing": ({"lam": 0.05, "k": 1.1025, "rest": 0.5, "beta": 0.8}, 2.0),
    "polynomial-spring": ({"lam": 0.05, "k1": 1.1, "rest": 0.5, "k2": -0.3, "k3": 0.3}, 2.5),
    "power-law-spring": ({"lam": 0.05, "weight": 1.0, "rest": 3.0, "power": 2.8}, 5.0),
    "relaxing-column": ({"lam": 0.15, "weight": 1.0, "rest": 3.0, "power": 2.8, "relaxation": 0.8}, 5.0),
    "quadratic-drag": ({"c": 0.1, "omega": 1.05, "g0": -1.0}, 1.5),
    "coulomb": ({"friction": 0.06, "omega": 1.05, "g0": -1.0}, 1.5),
    "viscous-coulomb": ({"lam": 0.03, "friction": 0.03, "omega": 1.05, "g0": -1.0}, 1.5),
    "viscous-quadratic": ({"lam": 0.03, "c": 0.05, "omega": 1.05, "g0": -1.0}, 1.5),
    "pendulum-coulomb": ({"lam": 0.03, "friction": 0.02, "omega": 1.05, "rest": 0.2}, 2.0),
    "pendulum-quadratic": ({"lam": 0.03, "c": 0.05, "omega": 1.05, "rest": 0.2}, 2.0),
    "bouc-wen": ({"omega": 1.05, "friction": 0.5, "rho": 1.0, "sigma": 0.8, "g0": -1.0}, 3.0),
    "rubbing-bed": ({"lam": 0.03, "omega": 1.05, "rest": 0.5, "bend": -0.05, "travel": 0.1}, 3.0),
    "elastoplastic-bed": (
        {"lam": 0.05, "weight": 1.0, "rest": 3.0, "power": 2.5, "modulus": 1.0, "strength": 0.1},
        5.0,
    ),
    "annealing-bed": (
        {"lam": 0.05, "weight": 1.0, "rest": 3.0, "power": 2.5, "modulus": 1.0, "strength": 0.1},
        5.0,
    ),
}


class Made:
    """Maker of records of a law. The motion without noise is solved only once."""

    def __init__(self) -> None:
        self.true = {name: values for name, (values, _) in TRUE.items()}

    @functools.cache  # noqa: B019  # one for a session
    def clean(self, name: str, start: float) -> np.ndarray:
        law = LAWS[name]
        found = solve_law(law, TIME, start, 0.0, [self.true[name][key] for key in law.parameters], 1.0)
        assert found.ending == "complete"
        return found.z

    def __call__(
        self, name: str, seed: int = 0, level: float = 0.01, start: float | None = None
    ) -> PistonRecord:
        """Return a record of 2000 samples over 40 time units."""
        clean = self.clean(name, TRUE[name][1] if start is None else start)
        return noisy(TIME, clean, level * clean.std(), seed)


@pytest.fixture(scope="session")
def made() -> Callable[..., PistonRecord]:
    return Made()
