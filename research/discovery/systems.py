"""Fourteen oscillators with known laws, synthetic records of them, and motions from held-out starts.

All motions are solved by SciPy, independently of the tested code.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.formulas import algebra
from granular.records.record import PistonRecord
from granular.shared.errors import InputError, quote
from reduced_models.discovery.terms import parse_term_expressions, state_symbols, terms_with_coefficients

if TYPE_CHECKING:
    import sympy

DURATION = 50.0
"""Duration of a record, and of a free run [s]: about eight cycles."""
SAMPLES = 1000
STEEPNESS = 1000.0
"""Factor k in tanh(k z'), which replaces sign(z') because a solver needs a continuous function. The motions
here do not differ."""
INPUT = "push"
_MOST_CALLS = 200_000
_FAR = 1e3
_SLOWLY = 0.05  # [s] maximum step, so that the input is resolved

Rates = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class System(NamedTuple):
    """An oscillator z'' = f(z, z', push).

    Attributes
    ----------
    name : str
    terms : mapping of str to float
        Terms of f, with their coefficients.
    library : str
        Named library that contains the terms.
    start : float
        Height from which the recorded motion is released [m].
    unseen : tuple of float
        Height and velocity of the held-out start.
    driven : bool
        True if it has an input.
    same : tuple of frozenset of str
        Other sums of terms equal to the same function.
    """

    name: str
    terms: Mapping[str, float]
    library: str
    start: float
    unseen: tuple[float, float]
    driven: bool = False
    same: tuple[frozenset[str], ...] = ()

    @property
    def law(self) -> str:
        """Text of the equation."""
        return "z'' = " + " ".join(f"{value:+g}*{term}" for term, value in self.terms.items())


_BILINEAR = (frozenset({"z'", "z", "max(0, -z)"}), frozenset({"z'", "max(0, z)", "max(0, -z)"}))

SYSTEMS = (
    System("linear", {"z": -1.1, "z'": -0.1}, "polynomial", 1.0, (0.3, 0.7)),
    System("van der Pol", {"z": -1.0, "z'": 0.5, "z**2*z'": -0.5}, "polynomial", 0.5, (1.5, 0.5)),
    System("hard Duffing", {"z": -1.0, "z**3": -0.5, "z'": -0.1}, "polynomial", 1.5, (-1.2, 0.3)),
    System("soft Duffing", {"z": -1.0, "z**3": 0.3, "z'": -0.05}, "polynomial", 1.3, (-1.0, 0.3)),
    System("two wells", {"z": 1.0, "z**3": -1.0, "z'": -0.1}, "polynomial", 1.8, (0.4, 0.0)),
    System("pendulum", {"sin(z)": -2.0, "z'": -0.15}, "trigonometric", 2.5, (-2.0, 0.5)),
    System("cubic drag", {"z": -1.0, "z'**3": -0.1}, "polynomial", 1.5, (1.0, 0.8)),
    System("quadratic drag", {"z": -1.0, "abs(z')*z'": -0.1}, "dry friction", 1.5, (1.0, 0.8)),
    System("Coulomb friction", {"z": -1.0, "sign(z')": -0.04}, "dry friction", 1.5, (1.0, 0.8)),
    System("quintic spring", {"z": -1.0, "z**5": -0.5, "z'": -0.1}, "polynomial", 1.3, (-1.1, 0.3)),
    System("power-law spring", {"1": -1.0, "z**-2.5": 1.0, "z'": -0.1}, "rational", 1.8, (0.75, 0.2)),
    System(
        "bilinear spring",
        {"z": -1.0, "max(0, z)": -1.5, "z'": -0.05},
        "contact",
        1.0,
        (0.5, 0.6),
        same=_BILINEAR,
    ),
    System("parametric", {"z": -1.0, "z*u": -0.4, "z'": -0.1}, "driven", 1.0, (0.6, 0.6), driven=True),
    System(
        "driven Duffing",
        {"z": -1.0, "z**3": -0.5, "z'": -0.1, "u": 0.5},
        "driven",
        0.0,
        (0.5, -0.5),
        driven=True,
    ),
)


def system_named(name: str) -> System:
    """Return the system of that name.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    for item in SYSTEMS:
        if item.name == name:
            return item
    known = ", ".join(quote(item.name) for item in SYSTEMS)
    raise InputError(f"unknown system {quote(name)}; the systems are {known}")


def equivalent_term_sets(system: System) -> tuple[frozenset[str], ...]:
    """Return the sums of terms equal to the law, as texts of a candidate's terms."""
    forms = (frozenset(system.terms), *system.same)
    return tuple(frozenset(text for item in form for text in _texts_of_expanded_term(item)) for form in forms)


def _texts_of_expanded_term(term: str) -> list[str]:
    result = terms_with_coefficients(parse_term_expressions([term], INPUT)[0])
    assert result is not None
    return [item.text for item in result]


def make_noisy_record(system: System, noise: float, seed: int) -> PistonRecord:
    """Make a record of a system, with white noise as a fraction of the motion's standard deviation."""
    time, height = times_and_heights_of_noiseless_record(system.name)
    position = [item.name for item in SYSTEMS].index(system.name)
    random = np.random.default_rng([position, seed, round(1e6 * noise)])
    noisy = height + random.normal(0.0, noise * height.std(), len(height))
    extra = {INPUT: input_of_records(time)} if system.driven else {}
    return PistonRecord(time, noisy, extra=extra)


@functools.cache
def times_and_heights_of_noiseless_record(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times and heights of a record without noise."""
    system = system_named(name)
    time = np.linspace(0.0, DURATION, SAMPLES)
    return time, solve_heights(acceleration_of_system(system), time, (system.start, 0.0), input_of_records)


@functools.cache
def times_and_heights_of_held_out_motion(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return times and heights of the motion from the held-out start, under a held-out input."""
    system = system_named(name)
    time = np.linspace(0.0, DURATION, SAMPLES)
    return time, solve_heights(acceleration_of_system(system), time, system.unseen, input_of_held_out_motion)


def acceleration_of_system(system: System) -> sympy.Expr:
    """Return z'' in the symbols of a discovered equation."""
    import sympy

    parts = zip(system.terms.values(), parse_term_expressions(list(system.terms), INPUT), strict=True)
    return sympy.Add(*(sympy.Float(value) * term for value, term in parts))


def input_of_records(time: np.ndarray) -> np.ndarray:
    """Return the input of the records."""
    return np.asarray(np.sin(0.9 * time) + 0.5 * np.sin(2.3 * time + 1.0))


def input_of_held_out_motion(time: np.ndarray) -> np.ndarray:
    """Return the input of free runs."""
    return np.asarray(np.sin(0.9 * time + 2.0) + 0.5 * np.sin(2.3 * time))


def solve_heights(
    law: sympy.Expr, time: np.ndarray, start: tuple[float, float], drive: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return heights (n,) of a law's motion; NaN once it diverges, or takes too long to solve."""
    import sympy
    from scipy.integrate import solve_ivp

    z, v, u = state_symbols()
    smooth = law.replace(sympy.sign, lambda inner: sympy.tanh(STEEPNESS * inner))
    field = algebra.compile_expressions((z, v, u), smooth)
    calls = 0

    def rates(t: float, state: np.ndarray) -> list[float]:
        nonlocal calls
        calls += 1
        if calls > _MOST_CALLS or not np.abs(state).max() < _FAR:
            raise FloatingPointError
        with np.errstate(all="ignore"):
            return [state[1], float(field(state[0], state[1], drive(np.asarray(t))))]

    result = np.full(len(time), np.nan)
    try:
        motion = solve_ivp(
            rates, (time[0], time[-1]), start, "LSODA", time, rtol=1e-8, atol=1e-10, max_step=_SLOWLY
        )
    except (FloatingPointError, OverflowError, ValueError, ZeroDivisionError, TypeError):
        return result
    result[: len(motion.t)] = motion.y[0]
    return result
