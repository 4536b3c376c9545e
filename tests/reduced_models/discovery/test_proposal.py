"""Libraries that a record speaks for, what a term buys, the choice by one criterion, and its print-out."""

import functools
from collections.abc import Callable

import numpy as np
import pytest
import sympy

from granular import PistonRecord
from reduced_models import DiscoveryOptions, discover
from reduced_models.discovery.candidate_choice import (
    StructureEvidence,
    polish_and_choose_candidate,
    polish_candidate,
    weigh_structure_evidence,
)
from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.discovery.structure_proposals import ProposedStructures, Study, candidate_from_terms
from reduced_models.discovery.subset_selection import EquationScorer, score_subsets, score_terms
from reduced_models.discovery.term_libraries import (
    cause_text,
    find_term_fault,
    library_terms,
    parse_custom_terms,
)
from reduced_models.discovery.terms import Term, physical_library_terms
from reduced_models.discovery.weak_form import estimate_motion, weak_form
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import moved, noisy

TIME = np.linspace(0.0, 40.0, 1000)
UNPOLISHED = DiscoveryOptions(polish=0)


def record(law: Callable[..., float], start: float, fraction: float) -> PistonRecord:
    """Of z'' = law(t, z, z'), released at a height, with that fraction of noise."""
    z = moved(law, TIME, start, rtol=1e-9, atol=1e-11, max_step=0.05)
    return noisy(TIME, z, fraction * z.std())


def stiffening(_: float, z: float, v: float) -> float:
    return -0.1 * v - z - 0.5 * z**3


@functools.cache
def spring_and_discovery() -> tuple[PistonRecord, Discovery]:
    """A spring that stiffens, with 1 % noise."""
    spring = record(stiffening, 1.5, 0.01)
    return spring, discover(spring, "sindy", options=UNPOLISHED)


def test_a_pendulum_has_no_linear_spring() -> None:
    """Friction that falls with the speed calls for sin(z) next to z, which is none."""
    usual = physical_library_terms(3)
    (sine,) = parse_custom_terms(["sin(z)"], None)
    spring, friction = Term(1), Term(0, 0, True)
    assert (
        cause_text("trigonometric", (sine, friction), usual) == "sin(z), a pendulum, whose height is an angle"
    )
    assert cause_text("trigonometric", (sine, friction, spring), usual) == "sin(z)"


def test_a_record_speaks_for_its_library() -> None:
    swing = record(lambda t, z, v: -0.15 * v - 2.0 * np.sin(z), 2.5, 0.01)
    found = discover(swing, "sindy", options=UNPOLISHED)
    assert any("library 'trigonometric'" in note for note in found.notes)
    assert {term.text for term in found.best.terms or ()} == {"sin(z)", "z'"}


def test_a_plain_swing_speaks_for_no_other_library() -> None:
    """Nor does one about a level far from zero, which is then seen from its rest."""
    plain, found = spring_and_discovery()
    assert {term.text for term in found.best.terms or ()} == {"z", "z'", "z**3"}
    assert not any("library" in note for note in found.notes)
    lifted = PistonRecord(TIME, 5.0 + 0.1 * plain.height)
    found = discover(lifted, "sindy", options=UNPOLISHED)
    assert found.line != HeightLine()
    assert {"z", "z'", "z**3"} <= {term.text for term in found.best.terms or ()}


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
    blurred = discover(record(stiffening, 1.5, 0.1), "sindy", options=UNPOLISHED)
    assert blurred.criterion_increases["z"] < found.criterion_increases["z"]


SPRING, DRAG, CUBE = Term(1), Term(0, 1, True), Term(3)


@pytest.fixture(scope="module")
def linear_decay() -> PistonRecord:
    """Linear decay under 5 % of noise."""
    height = np.exp(-0.05 * TIME) * np.cos(1.05 * TIME)
    return PistonRecord(TIME, height + np.random.default_rng(0).normal(0.0, 0.02, len(TIME)))


@pytest.fixture(scope="module")
def scorer(linear_decay: PistonRecord) -> EquationScorer:
    """Scorer of the record's integrals."""
    weak = weak_form(estimate_motion(linear_decay, HeightLine()))
    library = physical_library_terms(3)
    return score_subsets(weak, library, library, [np.array([[0]])])[1]


def polished(linear_decay: PistonRecord, candidate: CandidateEquation) -> CandidateEquation:
    return polish_candidate(candidate, [linear_decay], HeightLine())


def test_no_term_is_chosen_that_the_printed_criterion_does_not_call_for(
    linear_decay: PistonRecord, scorer: EquationScorer
) -> None:
    """A sum with a term too many is fitted without it as well, and its rise is that of the solution."""
    rich = candidate_from_terms(score_terms(scorer, [DRAG, SPRING, CUBE]))
    proposed = ProposedStructures([rich], scorer, Study(scorer.weak, physical_library_terms(3)))
    front, chosen = polish_and_choose_candidate(proposed, lambda one: polished(linear_decay, one), 1)
    assert set(front[chosen].terms or ()) == {DRAG, SPRING}
    evidence = weigh_structure_evidence(front[chosen], [rich], scorer, 0, front)
    assert min(evidence.criterion_increases.values()) > 10.0
    model = front[chosen].model
    # By the likelihood of the solution: the coefficient over its standard error, squared, less its price.
    low, high = model.intervals["c0"]
    wald = (model.parameters["c0"] / ((high - low) / 3.92)) ** 2
    assert next(iter(evidence.criterion_increases.values())) == pytest.approx(wald, rel=0.1)


def test_the_reason_why_a_rival_of_the_integrals_is_not_taken() -> None:
    evidence = StructureEvidence({"z": 50.0}, 0.0, (), (("a*z + b*z**3", 0.9, 31.0),))
    assert evidence.rival_note == (
        "integrals over random halves of the record choose a*z + b*z**3 in 90 %, but its solution misses the "
        "record by more (information criterion 31 higher)"
    )
    assert StructureEvidence({"z": 50.0}, 0.95, (), (("a*z + b*z**3", 0.05, 31.0),)).rival_note == ""


def test_a_rival_that_its_solution_refutes_is_no_tie(
    linear_decay: PistonRecord, scorer: EquationScorer
) -> None:
    """Without drag the decay is missed, whatever the halves of the integrals say."""
    sums = [candidate_from_terms(score_terms(scorer, terms)) for terms in ([DRAG, SPRING], [SPRING])]
    fitted = [polished(linear_decay, candidate) for candidate in sums]
    evidence = weigh_structure_evidence(fitted[0], sums, scorer, 0, fitted)
    assert evidence.rivals == ()
    assert all(rise > 100.0 for _, _, rise in evidence.refuted)


def test_a_long_front_is_printed_on_one_screen() -> None:
    """The chosen equation is never cut, nor counted among those left out."""
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


SWING = PistonRecord(TIME, np.exp(-0.02 * TIME) * np.cos(TIME))


@pytest.mark.parametrize("library", ["contact", "trigonometric", "dry friction", "polynomial"])
def test_terms_that_are_zero_for_a_while_have_no_pole(library: str) -> None:
    """As those of a contact have on the other side of z = 0."""
    motion = estimate_motion(SWING, HeightLine())
    assert not [
        find_term_fault(motion, term)
        for term in library_terms(library, (), 3, None)
        if find_term_fault(motion, term)
    ]


def test_a_power_below_zero_has_one() -> None:
    motion = estimate_motion(SWING, HeightLine())
    faults = {one.text: find_term_fault(motion, one) for one in library_terms((), ["1/z", "z'/z"], 3, None)}
    assert set(faults.values()) == {"has a pole"}
