"""Named libraries of terms, checks of terms along a motion, and the choice of a library for a record."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from granular.shared.errors import InputError, quote
from reduced_models.discovery.subset_selection import (
    EquationScorer,
    ScoredTerms,
    all_index_subsets,
    normalised_columns_and_lengths,
    rescore_subsets,
    score_subsets_and_make_scorer,
    scorers_in_common_unit,
)
from reduced_models.discovery.terms import (
    AnyTerm,
    Term,
    TermArguments,
    parse_term_expressions,
    physical_library_terms,
    sort_terms,
    structure_text,
    terms_with_coefficients,
)
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm
from reduced_models.laws.law import HeightLine

PHYSICAL = "physical"
"""Name of the default library: see `reduced_models.discovery.terms.physical_library_terms`."""

MEMORY = "memory"
"""Name of the library with hidden states: see `reduced_models.discovery.structure_proposals`."""

_PLAIN = ("1", "z", "z'", "abs(z')*z'", "sign(z')")

LIBRARIES = MappingProxyType(
    {
        PHYSICAL: ((), "powers of z times 1, z', |z'| z' and sign(z')"),
        "polynomial": (
            ("1", "z", "z**2", "z**3", "z**4", "z**5", "z'", "z*z'", "z**2*z'", "z'**2", "z*z'**2", "z'**3"),
            "springs and dampings that are polynomials of z and z'",
        ),
        "trigonometric": (
            (*_PLAIN, "sin(z)", "cos(z)", "sin(2*z)", "cos(2*z)", "sin(z)*z'", "cos(z)*z'"),
            "pendulums: z is an angle in radians",
        ),
        "rational": (
            (*_PLAIN, "1/z", "z**-2", "z**-2.5", "z**-3", "z**-4", "z'/z", "z'/z**2"),
            "springs that stiffen as the height goes to zero: z is a height",
        ),
        "dry friction": (
            (*_PLAIN, "z**3", "z'**3", "z*sign(z')", "abs(z)*sign(z')"),
            "friction with a constant force or a force that grows with the displacement",
        ),
        "contact": (
            (
                "1",
                "z",
                "z'",
                "z**3",
                "max(0, z)",
                "max(0, z)**1.5",
                "max(0, -z)**1.5",
                "max(0, z)*z'",
                "max(0, -z)*z'",
            ),
            "springs and stops that act only on one side of z = 0",
        ),
        "driven": (
            ("1", "z", "z**3", "z'", "abs(z')*z'", "u", "z*u", "z'*u", "u**2"),
            "a force or a motion of the support, which may also change the stiffness",
        ),
    }
)
"""Terms of each library and its purpose."""

_WITH_INPUT = MappingProxyType(
    {
        "polynomial": ("u", "u*z"),
        "trigonometric": ("u", "u*sin(z)", "u*cos(z)"),
        "rational": ("u", "u/z"),
        "dry friction": ("u",),
        "contact": ("u", "u*max(0, z)"),
    }
)
"""Further terms of libraries if there is an input u: a force u, or terms in which u changes a spring."""

_OPERON = {"/": "div", "max": "fmax", "min": "fmin"}
FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "abs", "max", "min", "/")
"""Functions of symbolic regressions in addition to sums, differences and products."""


def library_terms(
    names: str | Sequence[str], texts: Sequence[str], degree: int, column: str | None
) -> tuple[AnyTerm, ...]:
    """Return the distinct terms of the named libraries and of a user's texts."""
    terms: dict[AnyTerm, None] = {}
    for name in (names,) if isinstance(names, str) else names:
        if name not in LIBRARIES:
            if name == MEMORY:
                raise InputError(
                    f"library = {MEMORY!r} cannot be combined with other libraries; give it alone"
                )
            raise InputError(
                f"library = {quote(name)}; give one or more of {', '.join(LIBRARIES)}, or auto, "
                f"or {MEMORY}; custom terms are given by terms="
            )
        if name == PHYSICAL:
            terms |= dict.fromkeys(physical_library_terms(degree, column is not None))
        elif name == "driven" and column is None:
            raise InputError("library = 'driven' needs an input; give its column by input=")
        else:
            driven = () if column is None else _WITH_INPUT.get(name, ())
            terms |= dict.fromkeys(parse_custom_terms((*LIBRARIES[name][0], *driven), column))
    terms |= dict.fromkeys(parse_custom_terms(texts, column))
    if not terms:
        raise InputError("discover has no terms to choose from; give library= or terms=")
    return tuple(sort_terms(terms))


def parse_custom_terms(texts: Sequence[str], column: str | None) -> list[AnyTerm]:
    """Parse a user's texts as terms."""
    all_terms: list[AnyTerm] = []
    for text, expression in zip(texts, parse_term_expressions(texts, column), strict=True):
        terms = terms_with_coefficients(expression)
        if terms is None:
            raise InputError(
                f"the term {quote(text)} is not a real function of z, z', t and the input; give another term"
            )
        all_terms += terms
    return all_terms


def translate_function_names(names: Sequence[str], method: str) -> tuple[str, ...]:
    """Translate names of functions to the names in a method's program."""
    if names and method in ("sindy", "pysindy"):
        raise InputError(
            f"the argument functions is only for symbolic regression; for method {method!r} give complete "
            "terms by terms="
        )
    for name in names:
        if name not in FUNCTIONS:
            raise InputError(
                f"the function {quote(name)} is unknown; give one or more of {', '.join(FUNCTIONS)}"
            )
    known = {} if method == "pysr" else _OPERON
    return tuple(known.get(name, name) for name in names)


_POLE_GROWTH = 1e3  # a term that grows by more between samples has a pole there
_PEAKS = 100  # number of largest peaks examined
# Each round zooms in eightfold, down to 1.5e-11 of the time between samples.
_ZOOMS = 12
_GRID = np.linspace(-1.0, 1.0, 33)  # the next zoom covers two of its steps on either side


def term_fault_text(motion: SmoothedMotion, term: AnyTerm) -> str:
    """Describe the fault of a term along a motion; empty for a valid term."""
    for state in (motion.recorded_state, motion.smooth_state):
        if not np.isfinite(term.values(state)).all():
            return "is not finite"
        if term_has_pole(term, state):
            return "has a pole"
    if not all(np.isfinite(slope).all() for slope in _derivatives_that_carry_noise(motion, term)):
        return "has no finite slope"
    return ""


def term_has_pole(term: AnyTerm, state: TermArguments) -> bool:
    """Return whether a term grows without bound between finite samples."""
    # 1/z of a motion through zero is finite at every sample; its maximum only shows how close to zero a
    # sample happens to be.
    last = len(state.z) - 1
    sizes = np.abs(term.values(state))
    peaks = np.flatnonzero((sizes >= np.append(sizes[1:], 0.0)) & (sizes >= np.insert(sizes[:-1], 0, 0.0)))
    peaks = peaks[np.argsort(sizes[peaks])[-_PEAKS:]]
    # A term that is zero at a peak, such as a contact term away from contact, has not grown there.
    usual = np.median(sizes[sizes > 0.0]) if sizes.any() else 1.0
    before = np.maximum(sizes[peaks], usual)
    centres, half = peaks.astype(float), 1.0
    first, end = np.clip((centres[:, None] - 1.0, centres[:, None] + 1.0), 0.0, float(last))
    samples = np.arange(last + 1.0)
    maxima = before
    for _ in range(_ZOOMS):
        near = np.clip(centres[:, None] + half * _GRID, first, end)
        along = [None if value is None else np.interp(near, samples, value) for value in state]
        values = np.abs(term.values(TermArguments(*along)))  # type: ignore[arg-type]  # z, v
        if not np.isfinite(values).all():
            return True
        best = values.argmax(axis=1)
        rows = np.arange(len(peaks))
        centres, maxima = near[rows, best], np.maximum(maxima, values[rows, best])
        half /= 8.0
    return bool((maxima > _POLE_GROWTH * before).any())


def _derivatives_that_carry_noise(motion: SmoothedMotion, term: AnyTerm) -> list[np.ndarray]:
    """Return the term's derivatives through which the record's noise enters its integrals."""
    if term.is_total_derivative:
        return [term.height_factor(motion.z)]
    if term.is_speed_independent:
        return [term.derivative_by_height(motion.recorded_state)]
    if not term.varies_with_speed:
        return []
    state = motion.smooth_state
    return [term.derivative_by_speed(state), term.derivative_by_height(state)]


AUTO = "auto"
_CLEAR = 10.0
"""Difference of information criteria above which another library is proposed (decisive evidence: Kass &
Raftery 1995, doi:10.1080/01621459.1995.10476572)."""
_DEGREES = (3, 5)
_BETTER = 0.5
"""A higher degree is accepted if it reduces the error to at most this fraction. Further drives are accepted
if they reduce the error in excess of the noise to less than this fraction."""
_UNEXPLAINED = 1.2  # residual of all libraries, in noise levels, above which a drive is tried
_HOPELESS = 2.0  # residual, in noise levels, above which every library is tried
_MAXIMUM_DRIVES = 3
_LARGEST_REMAINING_EXCESS = 0.75
"""The search for drives stops if a further drive leaves more than this fraction of the mean square error in
excess of the noise. The first of three equally strong drives leaves two thirds."""
_OF_THE_HEIGHT = ("trigonometric", "rational", "contact")
"""Libraries in which z = 0 has a physical meaning, so that z must be the height itself."""
_WHY = {
    "polynomial": "a spring or drag of a higher power",
    "trigonometric": "a pendulum, whose height is an angle",
    "rational": "a force that grows as the height goes to zero",
    "dry friction": "friction or drag of another form",
    "contact": "a contact on one side of z = 0",
    "driven": "an input that changes the spring",
}


Drives = Sequence[Sequence[AnyTerm]]
"""Drives of unknown frequency, each given by its terms."""
FitDrives = Callable[[Drives, WeakForm, Sequence[AnyTerm]], Drives]
"""Function that fits the given drives and a further one, together with the terms of a library."""


class LibraryProposal(NamedTuple):
    """A library proposed for some records."""

    name: str
    terms: tuple[AnyTerm, ...]
    line: HeightLine  # from the terms' z to the height
    weak: WeakForm
    note: str = ""
    drives: Drives = ()  # terms sin(w*t), cos(w*t) of each drive, not among ``terms``


def propose_library(
    weak_form_of: Callable[[HeightLine], WeakForm],
    usual_line: HeightLine,
    column: str | None,
    degree: int,
    *,
    line_is_given: bool,
    coordinate_unit: str,
    fit_drives: FitDrives,
) -> LibraryProposal:
    """Return the library whose best sum of terms has the lowest information criterion."""
    # Libraries in which z = 0 has a meaning are tried for angles, motions about z = 0 or a given line, and if
    # the residuals of the others far exceed the noise; negative powers only for z > 0.
    plain = usual_line == HeightLine() or line_is_given
    weak = weak_form_of(usual_line)

    def scored_sums_of_library(name: str) -> list[_ScoredSumsOfLibrary]:
        """Score the sums of a library; return an empty list if the library does not suit these motions."""
        if name == PHYSICAL:
            terms: tuple[AnyTerm, ...] = _choose_degree_of_physical_terms(weak, column, degree)
            return [_ScoredSumsOfLibrary.score_all_sums(LibraryProposal(name, terms, usual_line, weak))]
        line_here, weak_form_here = usual_line, weak
        if name in _OF_THE_HEIGHT and not plain:
            line_here = HeightLine()
            weak_form_here = weak_form_of(line_here)
        if name == "rational" and not all((motion.z > 0.0).all() for motion in weak_form_here.motions):
            return []
        terms = library_terms(name, (), 3, column)
        if any(term_fault_text(motion, term) for motion in weak_form_here.motions for term in terms):
            return []
        return [_ScoredSumsOfLibrary.score_all_sums(LibraryProposal(name, terms, line_here, weak_form_here))]

    names = [name for name in LIBRARIES if column is not None or name != "driven"]
    # A motion away from z = 0 has no contact there.
    late = () if plain or coordinate_unit == "rad" else ("trigonometric",)
    early = [name for name in names if name not in late and (plain or name != "contact")]
    libraries = [item for name in early for item in scored_sums_of_library(name)]
    if min(item.scorer.excess for item in libraries) > _HOPELESS**2:
        libraries += [item for name in late for item in scored_sums_of_library(name)]
    chosen = _choose_proposal(_add_drives(libraries, fit_drives))
    undriven = next(item.proposal for item in libraries if item.proposal.name == chosen.name)
    return chosen._replace(terms=undriven.terms)


def _add_drives(undriven: list[_ScoredSumsOfLibrary], fit_drives: FitDrives) -> list[_ScoredSumsOfLibrary]:
    """Return the libraries with the same drives added to all, if these halve the error above the noise."""
    libraries = accepted = undriven
    drives: Drives = ()
    while len(drives) < _MAXIMUM_DRIVES:
        excess = min(item.scorer.excess for item in libraries)
        if excess <= _UNEXPLAINED**2:
            break
        # A wrong library biases the frequencies, so the drives with the smallest held-out error are taken.
        proposals = [item.proposal for item in undriven]
        trials = [fit_drives(drives, item.weak, item.terms) for item in proposals]
        errors = [
            held_out_error_of_terms(proposal.weak, (*proposal.terms, *itertools.chain(*trial)))
            for proposal, trial in zip(proposals, trials, strict=True)
        ]
        drives = trials[int(np.argmin(errors))]
        libraries = [
            _ScoredSumsOfLibrary.score_all_sums(
                item._replace(terms=(*item.terms, *itertools.chain(*drives)), drives=drives)
            )
            for item in proposals
        ]
        remaining = min(item.scorer.excess for item in libraries) - 1.0
        if remaining < _BETTER**2 * (min(item.scorer.excess for item in accepted) - 1.0):
            accepted = libraries
        elif remaining > _LARGEST_REMAINING_EXCESS * (excess - 1.0):
            break
    return accepted


class _ScoredSumsOfLibrary(NamedTuple):
    """A library with its scored sums of terms, the best first."""

    proposal: LibraryProposal
    ranked: list[ScoredTerms]
    scorer: EquationScorer

    @classmethod
    def score_all_sums(cls, proposal: LibraryProposal) -> _ScoredSumsOfLibrary:
        """Score all sums of a library's terms."""
        terms = proposal.terms
        return cls(
            proposal,
            *score_subsets_and_make_scorer(proposal.weak, terms, terms, all_index_subsets(len(terms))),
        )


def added_terms_and_cause_text(name: str, chosen: Sequence[AnyTerm], usual: Sequence[AnyTerm]) -> str:
    """Name the chosen terms that the physical library lacks, and their physical cause if it is clear."""
    words = ", ".join(term.text for term in chosen if term not in usual)
    # sin(z) next to z is not a pendulum but a correction for some nonlinear spring or friction.
    if name == "trigonometric" and Term(1) in chosen:
        return words
    return f"{words}, {_WHY[name]}"


def _choose_proposal(libraries: Sequence[_ScoredSumsOfLibrary]) -> LibraryProposal:
    """Return the proposal whose best sum has the lowest criterion, with a note on the reason."""
    proposals = [item.proposal for item in libraries]
    scorers = scorers_in_common_unit([item.scorer for item in libraries])
    sums = [
        rescore_subsets(item.ranked[:1], scorer)[0] for item, scorer in zip(libraries, scorers, strict=True)
    ]
    terms = [tuple(sort_terms(item.terms)) for item in sums]
    criteria = [item.criterion for item in sums]
    best = int(np.argmin(criteria))
    gain = criteria[0] - criteria[best]
    if gain < _CLEAR or set(terms[best]) <= set(proposals[0].terms):
        best = 0
    name, notes = proposals[best].name, list[str]()
    if proposals[best].drives:
        several = ["a drive", "two drives", "three drives"][len(proposals[best].drives) - 1]
        notes.append(
            f"the residuals of all libraries exceed the noise, but are much smaller with {several} sin(w*t), "
            f"cos(w*t): the record suggests {several} that no column of the record contains"
        )
    if best:
        below = f"{gain:.0f}" if gain < 1e4 else "far"
        notes.append(
            f"the terms come from the library {name!r}: the record suggests "
            f"{added_terms_and_cause_text(name, terms[best], proposals[0].terms)} "
            f"(information criterion {below} below {PHYSICAL!r}); another library can be chosen by library="
        )
        costs = [scorers[k].information_criterion(0.0, len(terms[k])) for k in (0, best)]
        if gain - (costs[0] - costs[1]) < _CLEAR:
            notes.append(
                f"the data cannot exclude {structure_text(terms[0])}, which fits as well with "
                f"{len(terms[0])} coefficients instead of {len(terms[best])}"
            )
    rivals = {
        structure_text(term): proposal.name
        for proposal, term, value in zip(proposals, terms, criteria, strict=True)
        if value < criteria[best] + _CLEAR and set(term) != set(terms[best]) and len(term) <= len(terms[best])
    }
    if rivals:
        others = ", ".join(f"{text} ({library})" for text, library in rivals.items())
        notes.append(
            f"the data cannot distinguish {structure_text(terms[best])} of the library {name!r} from {others}"
        )
    return proposals[best]._replace(note="; ".join(notes))


def _choose_degree_of_physical_terms(
    weak: WeakForm, column: str | None, minimum_degree: int
) -> tuple[AnyTerm, ...]:
    """Return physical terms; their degree is raised as long as this halves the held-out error."""
    chosen: tuple[AnyTerm, ...] = ()
    smallest_error = math.inf
    for degree in (minimum_degree, *(degree for degree in _DEGREES if degree > minimum_degree)):
        terms = library_terms(PHYSICAL, (), degree, column)
        error = held_out_error_of_terms(weak, terms)
        if chosen and error > _BETTER * smallest_error:
            break
        chosen, smallest_error = terms, error
    return chosen


def held_out_error_of_terms(weak: WeakForm, terms: Sequence[AnyTerm]) -> float:
    """Fit two thirds of the whitened integrals; return the rms residual of the others (every third one)."""
    whitening = weak.whitening_matrix((), np.zeros(0))
    matrix, target = whitening @ weak.term_integral_matrix(terms), whitening @ weak.target
    held = np.arange(len(target)) % 3 == 2
    if int((~held).sum()) <= len(terms):
        return math.inf
    columns, _ = normalised_columns_and_lengths(matrix)
    values = np.linalg.lstsq(columns[~held], target[~held], rcond=1e-10)[0]
    return float(np.sqrt(((target[held] - columns[held] @ values) ** 2).mean()))
