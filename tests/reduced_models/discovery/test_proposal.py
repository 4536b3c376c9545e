"""The library chosen for a record, the gain by each term, the choice of the equation, and the print-out."""

import functools
from collections.abc import Callable

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.candidate_choice import (
    StructureEvidence,
    fit_candidate_numbers,
    fit_candidates_and_choose_index,
    weigh_structure_evidence,
)
from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.discovery.structure_proposals import (
    ProposedStructures,
    WeakFormStudy,
    candidate_from_terms,
)
from reduced_models.discovery.subset_selection import (
    EquationScorer,
    score_subsets_and_make_scorer,
    score_terms,
)
from reduced_models.discovery.term_libraries import (
    added_terms_and_cause_text,
    library_terms,
    parse_custom_terms,
    term_fault_text,
)
from reduced_models.discovery.terms import Term, physical_library_terms
from reduced_models.discovery.weak_form import estimate_smoothed_motion, make_weak_form
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import moved, noisy

TIME = np.linspace(0.0, 40.0, 1000)
UNPOLISHED = DiscoveryOptions(polish=0)


def record(law: Callable[..., float], start: float, fraction: float) -> PistonRecord:
    """Return the motion of z'' = law(t, z, z') released at a height, with noise of a fraction of its rms."""
    z = moved(law, TIME, start, rtol=1e-9, atol=1e-11, max_step=0.05)
    return noisy(TIME, z, fraction * z.std())


def stiffening(_: float, z: float, v: float) -> float:
    return -0.1 * v - z - 0.5 * z**3


@functools.cache
def spring_and_discovery() -> tuple[PistonRecord, Discovery]:
    """Return the record of a stiffening spring with 1 % noise, and its discovery."""
    spring = record(stiffening, 1.5, 0.01)
    return spring, discover(spring, "sindy", options=UNPOLISHED)


def test_sin_z_without_a_linear_spring_is_described_as_a_pendulum() -> None:
    """Friction that decreases with speed can add sin(z) to a linear spring.

    Such a sum is not described as a pendulum.
    """
    usual = physical_library_terms(3)
    (sine,) = parse_custom_terms(["sin(z)"], None)
    spring, friction = Term(1), Term(0, 0, True)
    assert (
        added_terms_and_cause_text("trigonometric", (sine, friction), usual)
        == "sin(z), a pendulum, whose height is an angle"
    )
    assert added_terms_and_cause_text("trigonometric", (sine, friction, spring), usual) == "sin(z)"


def test_discovery_chooses_the_trigonometric_library_for_a_pendulum() -> None:
    swing = record(lambda t, z, v: -0.15 * v - 2.0 * np.sin(z), 2.5, 0.01)
    found = discover(swing, "sindy", options=UNPOLISHED)
    assert any("library 'trigonometric'" in note for note in found.notes)
    assert {term.text for term in found.best.terms or ()} == {"sin(z)", "z'"}


def test_discovery_keeps_the_physical_library_for_a_linear_oscillation() -> None:
    """The equilibrium may be far from zero. In this library, z is the displacement from equilibrium."""
    plain, found = spring_and_discovery()
    assert {term.text for term in found.best.terms or ()} == {"z", "z'", "z**3"}
    assert not any("library" in note for note in found.notes)
    lifted = PistonRecord(TIME, 5.0 + 0.1 * plain.height)
    found = discover(lifted, "sindy", options=UNPOLISHED)
    assert found.line != HeightLine()
    assert {"z", "z'", "z**3"} <= {term.text for term in found.best.terms or ()}


def test_in_custom_terms_z_is_the_height_for_every_proposed_library() -> None:
    time = TIME[:400]
    lifted = PistonRecord(time, 5.0 + 0.1 * np.cos(time))
    found = discover(lifted, "sindy", terms=["sin(3*z)"], options=UNPOLISHED)
    assert found.line == HeightLine()


def test_removing_the_most_important_term_raises_the_information_criterion_most() -> None:
    found = spring_and_discovery()[1]
    assert set(found.criterion_increases) == {"z", "z'", "z**3"}
    assert min(found.criterion_increases.values()) > 10.0
    assert max(found.criterion_increases, key=lambda name: found.criterion_increases[name]) == "z"
    assert "information criterion without each term" in str(found)
    blurred = discover(record(stiffening, 1.5, 0.1), "sindy", options=UNPOLISHED)
    assert blurred.criterion_increases["z"] < found.criterion_increases["z"]


SPRING, DRAG, CUBE = Term(1), Term(0, 1, True), Term(3)


@pytest.fixture(scope="module")
def linear_decay() -> PistonRecord:
    """Return the decay of a linear oscillator with 5 % noise."""
    height = np.exp(-0.05 * TIME) * np.cos(1.05 * TIME)
    return PistonRecord(TIME, height + np.random.default_rng(0).normal(0.0, 0.02, len(TIME)))


@pytest.fixture(scope="module")
def scorer(linear_decay: PistonRecord) -> EquationScorer:
    """Return the object that scores equations by the record's integrals."""
    weak = make_weak_form(estimate_smoothed_motion(linear_decay, HeightLine()))
    library = physical_library_terms(3)
    return score_subsets_and_make_scorer(weak, library, library, [np.array([[0]])])[1]


def polished(linear_decay: PistonRecord, candidate: CandidateEquation) -> CandidateEquation:
    return fit_candidate_numbers(candidate, [linear_decay], HeightLine())


def test_terms_not_required_by_the_information_criterion_are_removed(
    linear_decay: PistonRecord, scorer: EquationScorer
) -> None:
    """An equation with a superfluous term is also fitted without this term.

    The increase of the criterion without a term follows from the fit.
    """
    rich = candidate_from_terms(score_terms(scorer, [DRAG, SPRING, CUBE]))
    proposed = ProposedStructures([rich], scorer, WeakFormStudy(scorer.weak, physical_library_terms(3)))
    front, chosen = fit_candidates_and_choose_index(proposed, lambda one: polished(linear_decay, one), 1)
    assert set(front[chosen].terms or ()) == {DRAG, SPRING}
    evidence = weigh_structure_evidence(front[chosen], [rich], scorer, 0, front)
    assert min(evidence.criterion_increases.values()) > 10.0
    model = front[chosen].model
    # Likelihood of the solution: squared ratio of coefficient and standard error, minus the penalty.
    low, high = model.intervals["c0"]
    wald = (model.parameters["c0"] / ((high - low) / 3.92)) ** 2
    assert next(iter(evidence.criterion_increases.values())) == pytest.approx(wald, rel=0.1)


def test_discovery_notes_why_an_equation_chosen_by_most_random_halves_of_a_record_is_rejected() -> None:
    evidence = StructureEvidence({"z": 50.0}, 0.0, (), (("a*z + b*z**3", 0.9, 31.0),))
    assert evidence.rival_structures_text == (
        "90 % of random halves of the record's integrals choose a*z + b*z**3, but its solution fits the "
        "record worse (information criterion 31 higher)"
    )
    assert (
        StructureEvidence({"z": 50.0}, 0.95, (), (("a*z + b*z**3", 0.05, 31.0),)).rival_structures_text == ""
    )


def test_an_equation_whose_solution_misses_the_record_does_not_count_as_an_alternative(
    linear_decay: PistonRecord, scorer: EquationScorer
) -> None:
    """Without drag the solution misses the decay, even if this equation fits the integrals better."""
    sums = [candidate_from_terms(score_terms(scorer, terms)) for terms in ([DRAG, SPRING], [SPRING])]
    fitted = [polished(linear_decay, candidate) for candidate in sums]
    evidence = weigh_structure_evidence(fitted[0], sums, scorer, 0, fitted)
    assert evidence.rivals == ()
    assert all(rise > 100.0 for _, _, rise in evidence.refuted)


def test_a_long_pareto_front_is_printed_on_one_screen() -> None:
    """The chosen equation is printed separately and does not count among the omitted ones."""
    z = sympy.Symbol("z", real=True)
    front = [
        CandidateEquation(sum(1.5 * z**power for power in range(1, terms + 1)), terms, 1.0, 0.0)
        for terms in range(1, 30)
    ]
    lines = str(Discovery("sindy", tuple(front), 20, HeightLine())).splitlines()
    (chosen,) = (line for line in lines if line.startswith(" * "))
    assert chosen.endswith(front[20].text)
    assert len(lines) <= 20
    assert max(len(line) for line in lines if line != chosen) <= 100
    assert any(line.startswith("   and 20 more") for line in lines)


DECAY = PistonRecord(TIME, np.exp(-0.02 * TIME) * np.cos(TIME))


@pytest.mark.parametrize("library", ["contact", "trigonometric", "dry friction", "polynomial"])
def test_terms_that_are_zero_for_part_of_the_motion_have_no_pole(library: str) -> None:
    """Contact terms vanish on one side of z = 0."""
    motion = estimate_smoothed_motion(DECAY, HeightLine())
    assert not [
        term_fault_text(motion, term)
        for term in library_terms(library, (), 3, None)
        if term_fault_text(motion, term)
    ]


def test_a_negative_power_has_a_pole() -> None:
    motion = estimate_smoothed_motion(DECAY, HeightLine())
    faults = {one.text: term_fault_text(motion, one) for one in library_terms((), ["1/z", "z'/z"], 3, None)}
    assert set(faults.values()) == {"has a pole"}
