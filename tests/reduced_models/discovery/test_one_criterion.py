"""The equation that is chosen, and what is said of its terms and rivals, by one criterion."""

from __future__ import annotations

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models.discovery.candidate_choice import (
    StructureEvidence,
    polish_and_choose_candidate,
    weigh_structure_evidence,
)
from reduced_models.discovery.polishing import polish_candidate
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.structure_proposals import ProposedStructures, Study, candidate_from_terms
from reduced_models.discovery.subset_selection import EquationScorer, score_subsets, score_terms
from reduced_models.discovery.terms import Term, physical_library_terms
from reduced_models.discovery.weak_form import estimate_motion, weak_form
from reduced_models.laws.law import HeightLine

TIME = np.linspace(0.0, 40.0, 1000)
SPRING, DRAG, SQUARE, CUBE = Term(1), Term(0, 1, True), Term(2), Term(3)


@pytest.fixture(scope="module")
def record() -> PistonRecord:
    """Linear decay under 5 % of noise."""
    height = np.exp(-0.05 * TIME) * np.cos(1.05 * TIME)
    return PistonRecord(TIME, height + np.random.default_rng(0).normal(0.0, 0.02, len(TIME)))


@pytest.fixture(scope="module")
def scorer(record: PistonRecord) -> EquationScorer:
    """Scorer of the record's integrals."""
    weak = weak_form(estimate_motion(record, HeightLine()))
    library = physical_library_terms(3)
    return score_subsets(weak, library, library, [np.array([[0]])])[1]


def polished(record: PistonRecord, candidate: CandidateEquation) -> CandidateEquation:
    return polish_candidate(candidate, [record], HeightLine())


def test_no_term_is_chosen_that_the_printed_criterion_does_not_call_for(
    record: PistonRecord, scorer: EquationScorer
) -> None:
    """A sum with a term too many is fitted without it as well, and its rise is that of the solution."""
    rich = candidate_from_terms(score_terms(scorer, [DRAG, SPRING, CUBE]))
    proposed = ProposedStructures([rich], scorer, Study(scorer.weak, physical_library_terms(3)))
    front, chosen = polish_and_choose_candidate(proposed, lambda one: polished(record, one), 1)
    assert set(front[chosen].terms or ()) == {DRAG, SPRING}
    evidence = weigh_structure_evidence(front[chosen], [rich], scorer, 0, front)
    assert evidence is not None
    assert min(evidence.criterion_increases.values()) > 10.0
    model = front[chosen].model
    assert model is not None
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


def test_a_rival_that_its_solution_refutes_is_no_tie(record: PistonRecord, scorer: EquationScorer) -> None:
    """Without drag the decay is missed, whatever the halves of the integrals say."""
    sums = [candidate_from_terms(score_terms(scorer, terms)) for terms in ([DRAG, SPRING], [SPRING])]
    fitted = [polished(record, candidate) for candidate in sums]
    evidence = weigh_structure_evidence(fitted[0], sums, scorer, 0, fitted)
    assert evidence is not None
    assert evidence.rivals == ()
    assert all(rise > 100.0 for _, _, rise in evidence.refuted)
