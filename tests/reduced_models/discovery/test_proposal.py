"""Libraries that a record speaks for, what a term buys, and what the data cannot tell."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.result import Discovery
from reduced_models.discovery.term_libraries import cause_text, parse_custom_terms
from reduced_models.discovery.terms import Term, physical_library_terms
from reduced_models.laws.law import HeightLine

TIME = np.linspace(0.0, 40.0, 1000)
UNPOLISHED = DiscoveryOptions(polish=0)


def record(law: Callable[[float, float], float], start: float, fraction: float) -> PistonRecord:
    """Of z'' = law(z, z'), released at a height, with that fraction of noise."""
    found = solve_ivp(
        lambda _, y: [y[1], law(*y)],
        (0.0, TIME[-1]),
        [start, 0.0],
        "DOP853",
        TIME,
        rtol=1e-9,
        atol=1e-11,
        max_step=0.05,
    )
    z = found.y[0]
    noise = np.random.default_rng(0).normal(0.0, fraction * z.std(), len(z))
    return PistonRecord(TIME, z + noise)


@functools.cache
def spring_and_discovery() -> tuple[PistonRecord, Discovery]:
    """A spring that stiffens, with 1 % noise."""
    spring = record(lambda z, v: -0.1 * v - z - 0.5 * z**3, 1.5, 0.01)
    return spring, discover(spring, "sindy", options=UNPOLISHED)


def pendulum(fraction: float) -> PistonRecord:
    """A pendulum released at 56 degrees."""
    return record(lambda z, v: -0.05 * v - 9.0 * np.sin(z), np.deg2rad(56.0), fraction)


def test_a_pendulum_has_no_linear_spring() -> None:
    """Friction that falls with the speed calls for sin(z) next to z, which is none."""
    usual = physical_library_terms(3)
    (sine,) = parse_custom_terms(["sin(z)"], None)
    spring, friction = Term(1), Term(0, 0, True)
    assert (
        cause_text("trigonometric", (sine, friction), usual) == "sin(z), a pendulum, whose height is an angle"
    )
    assert cause_text("trigonometric", (sine, friction, spring), usual) == "sin(z)"


@pytest.mark.parametrize(
    ("law", "start", "library", "terms"),
    [
        (lambda z, v: -0.15 * v - 2.0 * np.sin(z), 2.5, "trigonometric", {"sin(z)", "z'"}),
        pytest.param(
            lambda z, v: -0.1 * v - z - 1.5 * max(z, 0.0),
            1.0,
            "contact",
            {"z", "max(0, z)", "z'"},
            marks=pytest.mark.long,
        ),
        pytest.param(
            lambda z, v: z**-2.5 - 1.0 - 0.1 * v,
            1.8,
            "rational",
            {"1", "z'", "z**(-5/2)"},
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_record_speaks_for_its_library(
    law: Callable[[float, float], float], start: float, library: str, terms: set[str]
) -> None:
    found = discover(record(law, start, 0.01), "sindy", options=UNPOLISHED)
    assert any(f"library {library!r}" in note for note in found.notes)
    assert {term.text for term in found.best.terms or ()} == terms


def test_a_plain_swing_speaks_for_no_other_library() -> None:
    """Nor does one about a level far from zero, which is then seen from its rest."""
    plain, found = spring_and_discovery()
    assert {term.text for term in found.best.terms or ()} == {"z", "z'", "z**3"}
    assert not any("library" in note for note in found.notes)
    lifted = PistonRecord(TIME, 5.0 + 0.1 * plain.height)
    found = discover(lifted, "sindy", options=UNPOLISHED)
    assert found.line != HeightLine()
    assert {"z", "z'", "z**3"} <= {term.text for term in found.best.terms or ()}


@pytest.mark.long  # quick: the plain swing, whose degree stays
def test_the_degree_grows_with_the_spring() -> None:
    quintic = record(lambda z, v: -0.1 * v - z - 0.5 * z**5, 1.3, 0.01)
    found = discover(quintic, "sindy", options=UNPOLISHED)
    assert {term.text for term in found.best.terms or ()} == {"z", "z'", "z**5"}


@pytest.mark.long  # quick: the pendulum among the libraries
def test_a_pendulum_of_56_degrees_is_a_sine() -> None:
    found = discover(pendulum(0.003), "sindy", options=UNPOLISHED)
    values = {term.text: value for term, value in (found.best.terms or {}).items()}
    assert values == pytest.approx({"sin(z)": -9.0, "z'": -0.05}, rel=0.02)


@pytest.mark.long  # quick: terms have their price
def test_noise_hides_whether_it_is_a_sine_or_a_cubic() -> None:
    found = discover(pendulum(0.1), "sindy", options=UNPOLISHED)
    assert "the data cannot tell" in " ".join(found.notes)


def test_custom_terms_mean_the_height_beside_the_proposed_library() -> None:
    time = TIME[:400]
    lifted = PistonRecord(time, 5.0 + 0.1 * np.cos(time))
    found = discover(lifted, "sindy", terms=["sin(3*z)"], options=UNPOLISHED)
    assert found.line == HeightLine()


def test_terms_have_their_price() -> None:
    """The more a term does, the more it costs to leave it out."""
    found = spring_and_discovery()[1]
    assert set(found.criterion_increases) == {"z", "z'", "z**3"}
    assert min(found.criterion_increases.values()) > 10.0
    assert max(found.criterion_increases, key=lambda name: found.criterion_increases[name]) == "z"
    assert "rises by so much without each term" in str(found)
    noisy = discover(record(lambda z, v: -0.1 * v - z - 0.5 * z**3, 1.5, 0.1), "sindy", options=UNPOLISHED)
    assert noisy.criterion_increases["z"] < found.criterion_increases["z"]


@pytest.mark.parametrize("terms", [["1/z"], pytest.param(["1/z", "z**-2", "z**-4"], marks=pytest.mark.long)])
def test_a_pole_within_the_motion_is_refused(terms: list[str]) -> None:
    """It would make the weighing of subsets slow, and stop it at worst."""
    swing = np.exp(-0.05 * TIME) * np.cos(TIME)
    swing[777] = 1e-9
    with pytest.raises(InputError, match="has a pole"):
        discover(PistonRecord(TIME, swing), "sindy", terms=terms, options=UNPOLISHED)
