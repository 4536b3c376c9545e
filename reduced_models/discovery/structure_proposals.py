"""Candidate structures: sparse sums of terms, also with a hidden state, and symbolic expressions.

For given scales (a yield strain or a relaxation time), a hidden state can be computed from the preceding
heights, and it enters the terms like an input. Sums with the state are scored like any other sum. A search on
a refined grid finds the scales for which the sum of all terms has the smallest residual. The information
criterion counts each scale like a coefficient.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.array_types import Float
from granular.shared.errors import InputError, import_extra
from reduced_models.discovery.parametric_terms import ParametricTerms
from reduced_models.discovery.result import CandidateEquation, pareto_front
from reduced_models.discovery.subset_selection import (
    MAXIMUM_TERMS,
    EquationScorer,
    ScoredTerms,
    all_index_subsets,
    backward_elimination_steps,
    group_subsets_by_size,
    normalised_columns_and_lengths,
    rescore_subsets,
    score_subsets_and_make_scorer,
    scorers_in_common_unit,
)
from reduced_models.discovery.symbolic_search import (
    search_expressions_with_operon,
    search_expressions_with_pysr,
)
from reduced_models.discovery.term_libraries import MEMORY, parse_custom_terms
from reduced_models.discovery.terms import (
    DAMPER_STATES,
    HIDDEN_STATES,
    AnyTerm,
    CustomTerm,
    HiddenState,
    ScaledHiddenState,
    TermArguments,
    expression_node_count,
    linear_combination,
    sort_terms,
    state_symbols,
    terms_with_coefficients,
)
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm, white_noise_weak_form
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy


_THRESHOLDS = np.geomspace(1e-3, 0.5, 24)  # thresholds of a term's contribution, relative to the size of z''


def find_term_indices_with_pysindy(
    motions: Sequence[SmoothedMotion], terms: Sequence[AnyTerm]
) -> list[list[int]]:
    """Return, for each threshold of PySINDy, the indices of the terms that remain."""
    # As in PySINDy's guide: states (z, z') with their derivatives, inputs, the terms as a custom library, and
    # sequentially thresholded least squares (Brunton, Proctor & Kutz 2016, doi:10.1073/pnas.1517384113). The
    # threshold is scanned.
    pysindy = import_extra("pysindy", "method 'pysindy'", "discover")
    inner = [motion.without_ends for motion in motions]
    data = {
        "x": [np.stack([motion.smooth, motion.velocity], axis=1) for motion in inner],
        "t": [motion.time for motion in inner],
        "x_dot": [np.stack([motion.velocity, motion.acceleration], axis=1) for motion in inner],
        "u": [
            np.stack(
                [np.zeros_like(motion.time) if motion.drive is None else motion.drive, motion.time], axis=1
            )
            for motion in inner
        ],
    }
    library = pysindy.CustomLibrary(
        [_pysindy_library_function(term) for term in terms], interaction_only=True
    )
    size = float(np.linalg.norm(np.concatenate([motion.acceleration for motion in inner])))
    supports = []
    for threshold in size * _THRESHOLDS:
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1e-8, normalize_columns=True)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
        with warnings.catch_warnings(action="ignore"):  # a high threshold may remove all terms
            model.fit(**data)
        supports.append(np.flatnonzero(model.coefficients()[1]).tolist())
    return supports


def _pysindy_library_function(term: AnyTerm) -> Callable[..., np.ndarray]:
    # PySINDy inspects the number of arguments.
    return lambda z, v, u, t: term.values(TermArguments(*map(np.asarray, (z, v, u, t))))


_MAXIMUM_POINTS = 500  # number of samples in a symbolic regression
_MAXIMUM_UNION = 120


class SymbolicSearch(NamedTuple):
    """Settings of a symbolic regression by pyoperon or PySR."""

    method: str
    functions: tuple[str, ...] = ()
    effort: float = 1.0  # length of the search relative to the default
    seed: int = 0

    def find_expressions(
        self, inputs: Mapping[str, np.ndarray], target: Float[np.ndarray, "n"], noise: float
    ) -> list[sympy.Expr]:
        """Find expressions of the inputs that fit a target with noise, by symbolic regression."""
        find = search_expressions_with_pysr if self.method == "pysr" else search_expressions_with_operon
        return find(inputs, target, noise, self.functions, self.effort, self.seed)


@dataclasses.dataclass(frozen=True, eq=False)
class WeakFormStudy:
    """Weak-form integrals of some motions, and the candidate terms of their equations."""

    weak: WeakForm
    terms: tuple[AnyTerm, ...]
    left_side: str = "z''"  # or "force", or "height" for a formula of the time
    hidden_state: ScaledHiddenState | None = None  # takes the place of the input in the terms
    open_terms: ParametricTerms = dataclasses.field(default_factory=ParametricTerms)

    def candidate_with_full_criterion(self, candidate: CandidateEquation) -> CandidateEquation:
        """Count a candidate's nonlinear parameters and hidden-state scales in its criterion."""
        scales = 0 if self.hidden_state is None else len(self.hidden_state.scales)
        count = scales + len(self.open_terms.nonlinear_parameter_names(candidate))
        return dataclasses.replace(
            candidate,
            hidden_state=self.hidden_state,
            left_side=self.left_side,
            complexity=candidate.complexity + scales,
            criterion=candidate.criterion + count * math.log(self.weak.sample_count),
        )


class ProposedStructures(NamedTuple):
    """Candidate equations of the best study with their scorer, and the sums of every study."""

    candidates: list[CandidateEquation]
    scorer: EquationScorer
    study: WeakFormStudy  # study of the candidates: the one with the best sum
    groups: Sequence[Sequence[CandidateEquation]] = ()

    @property
    def candidates_of_other_studies(self) -> list[CandidateEquation]:
        """Candidates of the other studies that are on the Pareto front of all studies."""
        front = pareto_front([item for group in self.groups for item in group])
        return [item for item in front if item.hidden_state is not self.study.hidden_state]


def propose_structures(
    studies: Sequence[WeakFormStudy], method: str, search: SymbolicSearch | None
) -> ProposedStructures:
    """Propose sums of terms and expressions of symbolic regression, all scored by one criterion."""
    # The best sum of terms selects the study, and symbolic regression then searches in that study.
    groups, scorers = list[list[CandidateEquation]](), list[EquationScorer]()
    if search is None or len(studies) > 1:
        scored = [
            score_subsets_and_make_scorer(
                study.weak, study.terms, study.terms, _sparse_subsets(study, method)
            )
            for study in studies
        ]
        scorers = scorers_in_common_unit([scorer for _, scorer in scored])
        groups = [
            _candidates_of_sums(rescore_subsets(ranked, scorer), study)
            for (ranked, _), study, scorer in zip(scored, studies, scorers, strict=True)
        ]
    best = min(range(len(groups)), key=lambda k: groups[k][0].criterion, default=0)
    study = studies[best]
    candidates = list(groups[best]) if groups and method != "operon" else []
    if search is not None:
        subsets = [] if groups or method == "operon" else _sparse_subsets(study, method)
        excess = scorers[best].excess if groups else 1.0 if study.left_side == "height" else None
        expressions, scorer = propose_symbolic_candidates_and_scorer(study, search, subsets, excess)
        candidates += map(study.candidate_with_full_criterion, expressions)
        scorers = scorers or [scorer]
    return ProposedStructures(candidates, scorers[best], study, groups)


def _sparse_subsets(study: WeakFormStudy, method: str) -> list[np.ndarray]:
    """Return the subsets of terms that a sparse regression proposes."""
    if study.left_side == "height":
        return []
    if method != "pysindy":
        return all_index_subsets(len(study.terms))
    supports = find_term_indices_with_pysindy(study.weak.motions, study.terms)
    return _add_backward_eliminations_of_supports(study.weak, study.terms, supports) or all_index_subsets(1)


def _candidates_of_sums(ranked: Sequence[ScoredTerms], study: WeakFormStudy) -> list[CandidateEquation]:
    """Return candidates, the best first; a study with a hidden state keeps only sums that contain it."""
    candidates = [
        study.candidate_with_full_criterion(candidate_from_terms(item))
        for item in ranked
        if study.hidden_state is None or any(term.has_input for term in item.terms)
    ]
    return sorted(candidates, key=lambda candidate: candidate.criterion)


def _add_backward_eliminations_of_supports(
    weak: WeakForm, terms: Sequence[AnyTerm], supports: Sequence[Sequence[int]]
) -> list[np.ndarray]:
    """Return given sets of terms, and all smaller sets from their backward elimination, by size."""
    whitening = weak.whitening_matrix((), np.zeros(0))
    matrix, target = whitening @ weak.term_integral_matrix(terms), whitening @ weak.target
    paths = (
        path
        for support in supports
        if support
        for path in backward_elimination_steps(matrix, target, support)
    )
    return group_subsets_by_size(paths)


def propose_symbolic_candidates_and_scorer(
    study: WeakFormStudy,
    search: SymbolicSearch,
    subsets: Sequence[np.ndarray] = (),
    excess: float | None = None,
) -> tuple[list[CandidateEquation], EquationScorer]:
    """Return candidates (equations of a symbolic regression, complete and with fewer terms) and a scorer."""
    weak, terms = study.weak, study.terms
    expressions = _search_expressions_of_motion(study, search)
    sums = [(expression, terms_with_coefficients(expression)) for expression in expressions]
    union = sort_terms({term for _, parts in sums if parts is not None for term in parts})
    if len(subsets) or not union or len(union) > _MAXIMUM_UNION:
        more = [term for term in union if term not in terms]
        union = [*terms, *more][:_MAXIMUM_UNION]
    index = {term: k for k, term in enumerate(union)}
    supports = [[index[term] for term in parts if term in index] for _, parts in sums if parts is not None]
    groups = [*subsets, *_add_backward_eliminations_of_supports(weak, union, supports)] or all_index_subsets(
        1
    )
    ranked, scorer = score_subsets_and_make_scorer(weak, terms, union, groups)
    if excess is not None:
        scorer = dataclasses.replace(scorer, excess=excess)
        ranked = rescore_subsets(ranked, scorer)
    unique = {frozenset(item.terms): item for item in reversed(ranked)}  # searches may propose the same sum
    best_first = sorted(unique.values(), key=lambda item: item.criterion)
    candidates = [candidate_from_terms(item) for item in best_first]
    candidates += [
        pruned
        for item, parts in sums
        if parts is None
        for pruned in _pruned_candidates_of_expression(item, scorer)
    ]
    return candidates, scorer


def _pruned_candidates_of_expression(
    expression: sympy.Expr, scorer: EquationScorer
) -> list[CandidateEquation]:
    """Return candidates from an expression that is not a sum of terms: complete, and with fewer addends."""
    import sympy

    addends = sympy.Add.make_args(sympy.expand(expression))
    candidates = [_candidate_from_scored_expression(expression, scorer)]
    if not 1 < len(addends) <= MAXIMUM_TERMS:
        return candidates
    columns = scorer.whitening @ np.stack(
        [scorer.weak.expression_integrals(item) for item in addends], axis=1
    )
    if not np.isfinite(columns).all():
        return candidates
    target = scorer.whitening @ scorer.weak.target
    for chosen in backward_elimination_steps(columns, target, range(len(addends))):
        factors = np.linalg.lstsq(columns[:, chosen], target, rcond=1e-12)[0]
        parts = (sympy.Float(factor) * addends[k] for k, factor in zip(chosen, factors, strict=True))
        candidates.append(_candidate_from_scored_expression(sympy.Add(*parts), scorer))
    return candidates


def _search_expressions_of_motion(study: WeakFormStudy, search: SymbolicSearch) -> list[sympy.Expr]:
    import sympy

    _, v, _ = state_symbols()
    motions = study.weak.motions
    custom_terms = [term for term in study.terms if isinstance(term, CustomTerm)]
    parts = [
        _regression_samples_of_motion(motion, study.left_side, len(motions), custom_terms)
        for motion in motions
    ]
    samples = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    target = samples.pop("target")
    noise = math.sqrt(sum(motion.acceleration_noise**2 for motion in motions) / len(motions))
    replaced = {
        sympy.Symbol("speed", real=True): sympy.Abs(v),
        sympy.Symbol("direction", real=True): sympy.sign(v),
    }
    replaced |= {sympy.Symbol(f"own{k}", real=True): item.expression for k, item in enumerate(custom_terms)}
    return [expression.xreplace(replaced) for expression in search.find_expressions(samples, target, noise)]


def _regression_samples_of_motion(
    motion: SmoothedMotion, left_side: str, motion_count: int, custom_terms: Sequence[CustomTerm]
) -> dict[str, np.ndarray]:
    """Return one motion's samples for a symbolic regression, without the ends (inaccurate derivatives)."""
    motion = motion.without_ends
    every = max(1, math.ceil(len(motion.time) * motion_count / _MAXIMUM_POINTS))
    samples = {"target": motion.acceleration}
    if left_side == "height":
        samples[TIME] = motion.time
    else:
        samples |= {
            "z": motion.smooth,
            "v": motion.velocity,
            "speed": np.abs(motion.velocity),
            "direction": np.sign(motion.velocity),
        }
        if motion.drive is not None:
            samples["u"] = motion.drive
        samples |= {f"own{k}": item.values(motion.smooth_state) for k, item in enumerate(custom_terms)}
    return {name: values[::every] for name, values in samples.items()}


def candidate_from_terms(scored_terms: ScoredTerms) -> CandidateEquation:
    """Make a candidate equation from a scored subset of terms."""
    expression = linear_combination(scored_terms.terms, list(scored_terms.coefficients))
    return CandidateEquation(
        expression, expression_node_count(expression), scored_terms.misfit, scored_terms.criterion
    )


def _candidate_from_scored_expression(expression: sympy.Expr, scorer: EquationScorer) -> CandidateEquation:
    """Make a candidate that is not a sum of terms, scored by its residuals with its present numbers."""
    import sympy

    weak = scorer.weak
    left = scorer.whitening @ (weak.target - weak.expression_integrals(expression))
    count = len(expression.atoms(sympy.Float))
    squares = float(left @ left)
    if not math.isfinite(squares):
        squares = math.inf
    return CandidateEquation(
        expression,
        expression_node_count(expression),
        scorer.misfit_from_squares(squares, count),
        scorer.information_criterion(squares, count),
    )


HIDDEN = "w"
"""Name of the hidden state in user-defined terms."""
PLAIN_TERMS = ("1", "z**-2", "z**-2.5", "z**-3", "z'", "z'/z", "abs(z')*z'", "sign(z')*z**-2.5")
"""Terms of a bed: weight, pressure of the squeezed bed, drag, and friction that grows with the pressure."""
DAMPER_TERMS = ("1", "z", "z**3", "z'", "abs(z')*z'", "sign(z')")
"""Terms of a damper on a stroke about zero: springs, drag and dry friction."""
HIDDEN_TERMS = ("w", "w*z**-2", "w*z**-2.5", "w*z**-3")
_CLEAR = 10.0
"""Difference of information criteria that is decisive (Kass & Raftery 1995)."""
_FAR = 10.0
"""Ratio of the residual with all terms to the noise, above which residuals are not weighted by the noise."""
_FINER = 9
"""Number of values of each scale on the finer grids."""
_SCALE_ROUNDS = 2


def hidden_state_studies(weak: WeakForm, texts: Sequence[str], left_side: str) -> list[WeakFormStudy]:
    """Return a study without hidden state, and one for each hidden state with its best scales."""
    states, plain_texts, hidden_texts = memory_library(weak, left_side)
    plain = parse_custom_terms(plain_texts, HIDDEN)
    known = tuple(dict.fromkeys((*plain, *parse_custom_terms((*hidden_texts, *texts), HIDDEN))))
    search = _HiddenStateScaleSearch(weak, known, left_side)
    scaled = [search.study_and_misfit(state) for state in states]
    if left_side != "force" and min(misfit for _, misfit in scaled) > _FAR:
        search = _HiddenStateScaleSearch(white_noise_weak_form(weak), known, left_side)
        scaled = [search.study_and_misfit(state) for state in states]
    stateless = WeakFormStudy(search.weak, tuple(item for item in known if not item.has_input), left_side)
    return [stateless, *(study for study, _ in scaled)]


def memory_library(
    weak: WeakForm, left_side: str
) -> tuple[Sequence[HiddenState], Sequence[str], Sequence[str]]:
    """Return hidden states, terms without hidden states, and terms with them, for a bed or a damper."""
    # z is the height [m] here, because the states are strains.
    if all(motion.z.min() > 0.0 for motion in weak.motions):
        return HIDDEN_STATES, PLAIN_TERMS, HIDDEN_TERMS
    if left_side != "force":
        raise InputError(
            f"library = {MEMORY!r} uses strains of the bed, but some heights are not above zero; give "
            "heights above the floor of the bed"
        )
    return DAMPER_STATES, DAMPER_TERMS, (HIDDEN,)


class _HiddenStateScaleSearch:
    """Search for the scales of hidden states; terms without a state are integrated only once."""

    def __init__(self, weak: WeakForm, known: tuple[AnyTerm, ...], left_side: str) -> None:
        self.weak, self.known, self.left_side = weak, known, left_side
        self.whitening = weak.whitening_matrix((), np.zeros(0))
        self.target = self.whitening @ weak.target
        self.fixed_columns = self.whitening @ weak.term_integral_matrix(
            [item for item in known if not item.has_input]
        )
        self.state_terms = [item for item in known if item.has_input]

    def best_scales_and_misfit(self, state: HiddenState, scales: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the row of ``scales`` (k, s) for which all terms fit best together, and their misfit."""
        squares = []
        for item in _weak_forms_with_hidden_state(self.weak, state, scales):
            state_columns = self.whitening @ item.term_integral_matrix(self.state_terms)
            squares.append(self._square_sum(np.hstack([self.fixed_columns, state_columns])))
        best = int(np.argmin(squares))
        return scales[best], math.sqrt(squares[best] / max(1, len(self.target) - len(self.known)))

    @property
    def misfit_without_state(self) -> float:
        """Misfit of all terms without the state."""
        count = max(1, len(self.target) - self.fixed_columns.shape[1])
        return math.sqrt(self._square_sum(self.fixed_columns) / count)

    def _square_sum(self, columns: np.ndarray) -> float:
        columns, _ = normalised_columns_and_lengths(columns)
        left = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=1e-10)[0]
        return float(left @ left)

    def trial_scales(self, state: HiddenState) -> np.ndarray:
        """Return the coarse grid (k, s) of a state's scales; relaxation times are in s."""
        return state.trial_scales * (self.weak.motions[0].period if state.in_periods else 1.0)

    def study_and_misfit(self, state: HiddenState) -> tuple[WeakFormStudy, float]:
        """Return the study of a hidden state whose scales are refined on a grid, and the misfit."""
        scales = self.trial_scales(state)
        lows, highs = scales.min(axis=0), scales.max(axis=0)
        best, misfit = self.best_scales_and_misfit(state, scales)
        values = [np.unique(column) for column in scales.T]
        width = np.array([float((item[1:] / item[:-1]).max()) for item in values])
        for _ in range(_SCALE_ROUNDS):
            grid = best * width ** np.linspace(-1.0, 1.0, _FINER)[:, None]
            for k in range(len(best)):
                scales = np.tile(best, (_FINER, 1))
                scales[:, k] = np.clip(grid[:, k], lows[k], highs[k])
                best, misfit = self.best_scales_and_misfit(state, scales)
            width = width ** (2.0 / (_FINER - 1))
        weak = _weak_forms_with_hidden_state(self.weak, state, best[None])[0]
        scaled = ScaledHiddenState(state, tuple(map(float, best)))
        return WeakFormStudy(weak, self.known, self.left_side, scaled), misfit


def _weak_forms_with_hidden_state(weak: WeakForm, state: HiddenState, scales: np.ndarray) -> list[WeakForm]:
    """Return, for each row of ``scales`` (k, s), a weak form whose input is the hidden state."""
    values = [state.values_along_motion(motion.time, motion.smooth, scales) for motion in weak.motions]
    return [
        WeakForm(
            tuple(
                dataclasses.replace(part, motion=part.motion._replace(drive=value[k]))
                for part, value in zip(weak.parts, values, strict=True)
            )
        )
        for k in range(len(scales))
    ]


_MISFIT = 2.0  # misfit of an equation over the noise, up to which no memory is looked for
_ADVISED = 0.5  # maximum ratio of misfits, with to without a hidden state, at which the state is advised


def memory_advice(weak: WeakForm, error: float) -> str:
    """Recommend the library with memory if it halves the misfit of a force; empty otherwise."""
    if error < _MISFIT:
        return ""
    states, plain, hidden = memory_library(weak, "force")
    known = (*parse_custom_terms(plain, HIDDEN), *parse_custom_terms(hidden, HIDDEN))
    search = _HiddenStateScaleSearch(weak, known, "force")
    misfits = [search.best_scales_and_misfit(state, search.trial_scales(state))[1] for state in states]
    if min(misfits) > _ADVISED * min(error, search.misfit_without_state):
        return ""
    return (
        "the force may depend on the preceding motion: with a hidden state the misfit is "
        f"{min(misfits) / error:.2g} times as large; search with library={MEMORY!r} (--library {MEMORY})"
    )


def hidden_state_notes(groups: Sequence[Sequence[CandidateEquation]]) -> tuple[str, ...]:
    """State how much a hidden state improves the best sum of terms, and which states are equally good."""
    lead = min((group[0] for group in groups), key=lambda item: item.criterion)
    if lead.hidden_state is None:
        return ("no hidden state improves the fit enough to justify its parameters: the law has no memory",)
    gain = groups[0][0].criterion - lead.criterion
    notes = [
        f"the force has memory: with the hidden state '{lead.hidden_state.kind.name}' the information "
        f"criterion is {gain:.4g} lower than for the best sum without it"
    ]
    rivals = [
        group[0].hidden_state.kind.name
        for group in groups
        if group[0] is not lead
        and group[0].hidden_state is not None
        and group[0].criterion < lead.criterion + _CLEAR
    ]
    if rivals:
        notes.append(f"the data cannot distinguish this state from {', '.join(rivals)}")
    return tuple(notes)
