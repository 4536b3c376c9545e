"""Discovery of equations of driven oscillators and whirling pendulums, and from records of a coarse
solver.
"""

import re
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.result import Discovery
from reduced_models.discovery.term_libraries import library_terms
from reduced_models.discovery.weak_form import (
    estimate_smoothed_motion,
    make_weak_form,
    rotates_two_or_more_turns,
)
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import moved, noise, noisy

Acceleration = Callable[[float, float, float], float]


class Case(NamedTuple):
    """A law z'' = f(t, z, z'), its terms, a motion, and the angular frequencies of its drives [rad/s]."""

    law: Acceleration
    terms: tuple[str, ...]
    start: tuple[float, float]
    duration: float
    samples: int
    drives: tuple[float, ...] = ()


DRIVEN = {
    "linear": Case(
        lambda t, z, v: -z - 0.1 * v + 0.5 * np.sin(1.7 * t), ("z", "z'", "sin"), (1, 0), 60, 1500, (1.7,)
    ),
    "slow cosine": Case(
        lambda t, z, v: -4 * z - 0.2 * v + 1.2 * np.cos(1.1 * t),
        ("z", "z'", "cos"),
        (0.5, 0),
        50,
        1500,
        (1.1,),
    ),
    "phase": Case(
        lambda t, z, v: -4 * z - 0.3 * v + np.sin(3.1 * t) + 0.7 * np.cos(3.1 * t),
        ("z", "z'", "sin", "cos"),
        (0.5, 0),
        50,
        1500,
        (3.1,),
    ),
    "Duffing": Case(
        lambda t, z, v: -z - 0.5 * z**3 - 0.15 * v + 0.6 * np.cos(1.3 * t),
        ("z", "z**3", "z'", "cos"),
        (1, 0),
        60,
        2000,
        (1.3,),
    ),
    "stiff Duffing": Case(
        lambda t, z, v: -z - z**3 - 0.2 * v + 0.8 * np.sin(2.2 * t),
        ("z", "z**3", "z'", "sin"),
        (0.2, 0),
        60,
        2000,
        (2.2,),
    ),
    "van der Pol": Case(
        lambda t, z, v: -z + 0.5 * v - 0.5 * z**2 * v + 0.4 * np.sin(1.9 * t),
        ("z", "z'", "z'*z**2", "sin"),
        (0.5, 0),
        60,
        2000,
        (1.9,),
    ),
    "pendulum": Case(
        lambda t, z, v: -2 * np.sin(z) - 0.15 * v + 0.6 * np.cos(0.9 * t),
        ("sin(z)", "z'", "cos"),
        (1, 0),
        60,
        2000,
        (0.9,),
    ),
    "quadratic drag": Case(
        lambda t, z, v: -1.5 * z - 0.3 * abs(v) * v + 0.5 * np.sin(1.5 * t),
        ("z", "z'*Abs(z')", "sin"),
        (1, 0),
        60,
        2000,
        (1.5,),
    ),
    "cubic drag": Case(
        lambda t, z, v: -z - 0.2 * v**3 + 0.5 * np.cos(0.6 * t),
        ("z", "z'**3", "cos"),
        (1.2, 0),
        80,
        2000,
        (0.6,),
    ),
    "two drives": Case(
        lambda t, z, v: -2 * z - 0.2 * v + 0.5 * np.sin(0.8 * t) + 0.4 * np.sin(2.3 * t),
        ("z", "z'", "sin", "sin"),
        (0.5, 0),
        80,
        2500,
        (0.8, 2.3),
    ),
    "two wells": Case(
        lambda t, z, v: z - z**3 - 0.25 * v + 0.3 * np.cos(t),
        ("z", "z**3", "z'", "cos"),
        (1.2, 0),
        60,
        2000,
        (1.0,),
    ),
    "asymmetric spring": Case(
        lambda t, z, v: -z - 0.3 * z**2 - 0.2 * v + 0.3 * np.sin(1.6 * t),
        ("z", "z**2", "z'", "sin"),
        (0.5, 0),
        60,
        2000,
        (1.6,),
    ),
}
WHIRLING = {
    "slowing down": Case(lambda t, z, v: -2 * np.sin(z) - 0.02 * v, ("sin(z)", "z'"), (0.3, 6), 30, 2000),
    "torque": Case(lambda t, z, v: -2 * np.sin(z) - 0.1 * v + 0.6, ("sin(z)", "z'", "1"), (0.3, 5), 30, 2000),
    "drag": Case(
        lambda t, z, v: -3 * np.sin(z) - 0.03 * abs(v) * v, ("sin(z)", "z'*Abs(z')"), (0, 8), 25, 2000
    ),
    "bias": Case(
        lambda t, z, v: -2 * np.sin(z) - np.cos(z) - 0.03 * v, ("sin(z)", "cos(z)", "z'"), (0, 6), 30, 2000
    ),
    "torque and drag": Case(
        lambda t, z, v: -4 * np.sin(z) - 0.08 * abs(v) * v + 1,
        ("sin(z)", "z'*Abs(z')", "1"),
        (0.5, 6),
        25,
        2000,
    ),
    "running": Case(lambda t, z, v: -2 * np.sin(z) - 0.2 * v + 1.5, ("sin(z)", "z'", "1"), (0, 3), 30, 2000),
}
COARSE = {
    "linear": Case(lambda t, z, v: -4.5 * z - 0.43 * v, ("z", "z'"), (1, 0), 10, 500),
    "linear, long": Case(lambda t, z, v: -z - 0.1 * v, ("z", "z'"), (1, 0), 40, 1000),
    "hardening": Case(lambda t, z, v: -z - 0.5 * z**3 - 0.1 * v, ("z", "z**3", "z'"), (1.5, 0), 30, 1000),
    "softening": Case(lambda t, z, v: -z + 0.3 * z**3 - 0.05 * v, ("z", "z**3", "z'"), (1.3, 0), 40, 1000),
    "van der Pol": Case(
        lambda t, z, v: -z + 0.5 * v - 0.5 * z**2 * v, ("z", "z'", "z'*z**2"), (0.5, 0), 40, 1000
    ),
    "pendulum": Case(lambda t, z, v: -2 * np.sin(z) - 0.15 * v, ("sin(z)", "z'"), (2.5, 0), 30, 1000),
    "quadratic drag": Case(lambda t, z, v: -z - 0.1 * abs(v) * v, ("z", "z'*Abs(z')"), (1.5, 0), 40, 1000),
    "dry friction": Case(lambda t, z, v: -z - 0.04 * np.tanh(100 * v), ("z", "sign(z')"), (1.5, 0), 30, 1000),
    "two wells": Case(lambda t, z, v: z - z**3 - 0.1 * v, ("z", "z**3", "z'"), (1.8, 0), 40, 1000),
    "quintic": Case(lambda t, z, v: -z - 0.5 * z**5 - 0.1 * v, ("z", "z**5", "z'"), (1.3, 0), 40, 1000),
    "cubic drag": Case(lambda t, z, v: -z - 0.1 * v**3, ("z", "z'**3"), (1.5, 0), 40, 1000),
    "weight": Case(lambda t, z, v: -4 * z - 0.2 * v + 9.8, ("1", "z", "z'"), (3, 0), 20, 800),
}
_WAVE = re.compile(r"(sin|cos)\(([\d.]*)\*?t\)")


def record_of(case: Case, seed: int = 1) -> PistonRecord:
    """Return the motion with noise: 1 % of the rms for driven oscillators, 0.01 rad for pendulums."""
    time = np.linspace(0.0, case.duration, case.samples)
    height = moved(case.law, time, *case.start)
    return noisy(time, height, 0.01 * height.std() if case.drives else 0.01, seed)


def coarse_record(case: Case) -> PistonRecord:
    """Return the motion as `solve_ivp` computes it by default, with a relative tolerance of 1e-3."""
    time = np.linspace(0.0, case.duration, case.samples)
    solved = solve_ivp(lambda t, y: [y[1], case.law(t, *y)], (0.0, case.duration), case.start, t_eval=time)
    return PistonRecord(time, solved.y[0])


def is_right(found: Discovery, case: Case) -> bool:
    """Return whether the terms are the true ones, and the frequencies agree to 0.1 %."""
    texts = [term.text for term in found.best.terms or ()]
    waves = [match for text in texts if (match := _WAVE.fullmatch(text))]
    names = [match[1] if (match := _WAVE.fullmatch(text)) else text for text in texts]
    frequencies = {float(match[2] or 1.0) for match in waves}
    near = all(min(abs(one / true - 1.0) for true in case.drives) < 1e-3 for one in frequencies)
    return Counter(names) == Counter(case.terms) and near


@pytest.mark.long  # quick: one of each list, below, and `test_drive`
def test_discovery_finds_the_equations_of_eleven_of_twelve_driven_oscillators() -> None:
    right = [is_right(discover(record_of(case), "sindy"), case) for case in DRIVEN.values()]
    assert sum(right) >= 11, dict(zip(DRIVEN, right, strict=True))


@pytest.mark.long
def test_discovery_finds_the_equations_of_six_whirling_pendulums() -> None:
    right = [is_right(discover(record_of(case), "sindy"), case) for case in WHIRLING.values()]
    assert all(right), dict(zip(WHIRLING, right, strict=True))


@pytest.mark.long
def test_discovery_finds_eleven_of_twelve_equations_in_records_of_a_coarse_solver() -> None:
    right = [is_right(discover(coarse_record(case), "sindy"), case) for case in COARSE.values()]
    assert sum(right) >= 11, dict(zip(COARSE, right, strict=True))


def test_two_drives_of_similar_strength_are_found() -> None:
    """Only both drives together reduce the residual by the factor that is required for accepting drives."""
    case = DRIVEN["two drives"]._replace(duration=60, samples=1200)
    found = discover(record_of(case), "sindy", options=DiscoveryOptions(polish=0))
    waves = [match for term in found.best.terms or () if (match := _WAVE.fullmatch(term.text))]
    assert {1 + (float(wave[2]) > 1.5) for wave in waves} == {1, 2}
    assert all(min(abs(float(wave[2]) / true - 1.0) for true in case.drives) < 1e-3 for wave in waves)
    assert "two drives" in found.notes[0]


def test_numerical_errors_in_a_record_do_not_add_terms_to_the_discovered_equation() -> None:
    """Errors of 1.5e-4 of the displacement add terms only if such small effects are requested."""
    case = COARSE["linear"]
    options = DiscoveryOptions(polish=1)
    assert is_right(
        discover(coarse_record(case), "sindy", library="physical", degree=1, options=options), case
    )
    weak = make_weak_form(estimate_smoothed_motion(coarse_record(case), HeightLine()), least_effect=1e-3)
    assert weak.least_effect_sum_of_squares > 1e3
    with pytest.raises(InputError, match=r"least_effect = 1\.5"):
        discover(coarse_record(case), "sindy", least_effect=1.5)


def test_discovery_treats_the_coordinate_of_a_whirling_pendulum_as_an_angle() -> None:
    """The estimated period is the time of one turn, although the angle never returns to its initial value."""
    record = record_of(WHIRLING["slowing down"])
    assert rotates_two_or_more_turns(record)
    assert estimate_smoothed_motion(record, HeightLine()).period < 2.0
    assert not rotates_two_or_more_turns(record_of(DRIVEN["Duffing"]))
    found = discover(record, "sindy", options=DiscoveryOptions(polish=0))
    assert found.line == HeightLine()
    assert {"sin(z)", "z'"} <= {term.text for term in found.best.terms or ()}


def test_a_library_contains_the_products_of_its_functions_with_an_input() -> None:
    """For example, a support that moves changes the spring of a pendulum."""
    texts = {term.text for term in library_terms("trigonometric", (), 3, "u")}
    assert {"u", "u*sin(z)", "u*cos(z)"} <= texts
    assert "u*z" in {term.text for term in library_terms("polynomial", (), 3, "push")}
    time = np.linspace(0.0, 40.0, 2000)
    push = np.sin(2.9 * time)
    height = moved(lambda t, z, v: -(2.0 + 0.8 * np.sin(2.9 * t)) * np.sin(z) - 0.1 * v, time, 1.5)
    record = PistonRecord(time, height + noise(2000, 0.01), extra={"push": push})
    options = DiscoveryOptions(polish=0)
    found = discover(record, "sindy", library="trigonometric", input="push", options=options)
    assert {term.text for term in found.best.terms or ()} == {"sin(z)", "u*sin(z)", "z'"}
