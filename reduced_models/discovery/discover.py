"""`discover`: the equation of a record, by sparse or by symbolic regression."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from numbers import Real
from typing import Literal, get_args

from granular.records.record import PistonRecord
from granular.shared.errors import InputError, quote, sanitize
from granular.shared.progress_bars import stage_reporter
from reduced_models.discovery.candidate_choice import (
    fit_candidate_numbers,
    fit_candidates_and_choose_index,
    notes_on_candidate,
    weigh_structure_evidence,
)
from reduced_models.discovery.parametric_terms import (
    OpenTerms,
    ParametricTerms,
    split_constant_and_open_terms,
)
from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.discovery.structure_proposals import (
    SymbolicSearch,
    WeakFormStudy,
    hidden_state_notes,
    hidden_state_studies,
    memory_advice,
    propose_structures,
)
from reduced_models.discovery.symbolic_search import is_operon_installed, require_pysr
from reduced_models.discovery.term_libraries import (
    AUTO,
    MEMORY,
    PHYSICAL,
    LibraryProposal,
    library_terms,
    parse_custom_terms,
    propose_library,
    term_fault_text,
    translate_function_names,
)
from reduced_models.discovery.terms import AnyTerm, Term
from reduced_models.discovery.weak_form import (
    WeakForm,
    estimate_smoothed_motion,
    make_weak_form,
    normalising_height_line,
    weak_form_of_measured_signal,
)
from reduced_models.fitting.fit_data import RecordLike, list_of_records, refuse_prescribed_strokes
from reduced_models.laws.equation import parse_equation
from reduced_models.laws.law import HeightLine
from reduced_models.records.inputs import input_column_names

Method = Literal["auto", "sindy", "pysindy", "operon", "pysr"]
Target = Literal["acceleration", "force", "height"]
LEAST_EFFECT = 1e-3
"""Minimum change of the motion that a term must cause, relative to the rms displacement."""
SPARSE = ("sindy", "pysindy")
"""Methods that only choose among the terms of a library."""
_MAXIMUM_SEED = 2**32 - 1  # accepted by the programs for symbolic regression


@dataclasses.dataclass(frozen=True)
class DiscoveryOptions:
    """Less common options of `discover`.

    Parameters
    ----------
    height : str
        Height [m] as a linear function of z, such as ``"0.06 + 1e-3*z"``, or ``"z"``. With ``"auto"``,
        z is the height itself if the equilibrium is within one amplitude of height zero. Otherwise z is
        the displacement from equilibrium in units of the amplitude; equilibrium and amplitude are
        taken from the record with the largest amplitude. With user-defined terms or a library that gives
        z = 0 a meaning, z is the height itself.
    polish : int
        Maximum number of candidates, 0 or more, whose solutions are fitted to the records, the best
        candidates first. Candidates whose criterion is far above the lowest one are skipped. With 0
        no candidate has a model.
    functions : sequence of str
        Functions that symbolic regressions may use in addition to sums, differences and products:
        ``"sin"``, ``"exp"``, ``"max"``, ``"/"`` and others.
    effort : float
        Number of trials of a symbolic regression relative to the default number, above 0.
    progress : bool
        True to print the current step on standard error.

    Raises
    ------
    InputError
        If an option is out of its range.

    Examples
    --------
    >>> from reduced_models import DiscoveryOptions
    >>> DiscoveryOptions(polish=0).height
    'auto'
    """

    height: str = "auto"
    polish: int = 3
    functions: str | Sequence[str] = ()
    effort: float = 1.0
    progress: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "functions", texts_as_tuple("functions", self.functions))
        if not isinstance(self.polish, int) or self.polish < 0:
            raise InputError(f"polish = {quote(self.polish)}; give an integer >= 0")
        if not isinstance(self.effort, int | float) or not 0.0 < self.effort < math.inf:
            raise InputError(f"effort = {quote(self.effort)}; give a number above 0")
        _ = self.height_line

    @property
    def height_line(self) -> HeightLine | None:
        """Linear relation from z to the height; None if the records determine it."""
        if self.height == "auto":
            return None
        wrong = (
            f"height = {quote(self.height)}; give 'auto' or a linear function of z, such as '0.06 + 1e-3*z'"
        )
        if not isinstance(self.height, str) or not self.height.strip() or ";" in self.height:
            raise InputError(wrong)
        try:
            parsed = parse_equation(f"z'' = 0; height = {self.height}")
        except InputError:
            raise InputError(wrong) from None
        line = (0, 1) if parsed.line is None else parsed.line
        if parsed.parameters or (parsed.line is None and parsed.observations["height"] != parsed.symbol_z):
            raise InputError(wrong)
        return HeightLine(*map(float, line))


def check_discovery_arguments(
    method: str,
    libraries: Sequence[str],
    target: str,
    degree: int,
    terms: Sequence[str],
    column: str | None,
    seed: object,
    line: HeightLine | None,
    least_effect: object = LEAST_EFFECT,
) -> None:
    """Check that the arguments of `discover` are in range and compatible."""
    for name, value, valid in (("method", method, get_args(Method)), ("target", target, get_args(Target))):
        if value not in valid:
            raise InputError(f"{name} = {quote(value)}; give one of {', '.join(valid)}")
    if not isinstance(degree, int) or not 1 <= degree <= 5:
        raise InputError(f"degree = {quote(degree)}; give an integer from 1 to 5")
    if not isinstance(seed, int) or not 0 <= seed <= _MAXIMUM_SEED:
        raise InputError(f"seed = {quote(seed)}; give an integer from 0 to {_MAXIMUM_SEED}")
    if not isinstance(least_effect, Real) or not 0.0 <= float(least_effect) < 1.0:
        raise InputError(f"least_effect = {quote(least_effect)}; give a number from 0 to below 1")
    if target == "height":
        if method in ("auto", *SPARSE):
            raise InputError("target = 'height' needs symbolic regression; give method = 'operon' or 'pysr'")
        if terms or column is not None or line is not None or libraries != (AUTO,):
            raise InputError(
                "target = 'height' searches for the height as a function of time alone; remove the arguments "
                "library, terms, input and height"
            )
    if libraries == (MEMORY,) and (column is not None or line not in (None, HeightLine())):
        raise InputError(
            f"library = {MEMORY!r} can be used only for an undriven bed and with z equal to the height; "
            "remove the arguments input and height"
        )


def texts_as_tuple(name: str, texts: object) -> tuple[str, ...]:
    """Return a string, or a sequence of strings, as a tuple."""
    result = (texts,) if isinstance(texts, str) else texts
    if not isinstance(result, Sequence) or not all(isinstance(text, str) for text in result):
        raise InputError(f"{name} = {quote(texts)}; give a string or a list of strings")
    return tuple(result)


_NO_OPERON = (
    "pyoperon is not installed, so only sparse regression proposes structures; for symbolic regression: "
    "pip install 'granular-damper[discover]'"
)
_INTEGRATED = (
    "terms were proposed from the integrated {0}, whose noise is not white, so the errors relative to the "
    "noise can only rank candidates; the model was fitted to the measured {0}"
)
_UNUSED = "columns not used as an input: {0}; to use one as the drive, pass input=NAME (--input NAME)"
_LINE = 70  # characters of a formula in a line of progress
_LEFT_SIDES = {"acceleration": "z''", "force": "force", "height": "height"}
_FORMULA = ("sin", "cos", "exp")  # functions allowed in formulas of the time
_DRIVES = tuple((f"sin({name}*t)", f"cos({name}*t)") for name in ("w", "w2", "w3"))
_DEFAULTS = DiscoveryOptions()


def discover(
    records: RecordLike | Sequence[RecordLike],
    method: Method = "auto",
    *,
    library: str | Sequence[str] = AUTO,
    target: Target = "acceleration",
    degree: int = 3,
    terms: str | Sequence[str] = (),
    input: str | None = None,  # noqa: A002
    seed: int = 0,
    least_effect: float = LEAST_EFFECT,
    options: DiscoveryOptions = _DEFAULTS,
) -> Discovery:
    """Discover the equation of motion z'' = f(z, z', input, t) of one record or of several together.

    Every method proposes structures, and all are scored by the same whitened residuals of the weak form. The
    Pareto front consists of structures with a smaller error than every simpler one. The best of these
    structures are fitted to the records by solving their differential equations. Equations whose information
    criterion is at most 6 above the lowest count as equally good; of these, the equation with the fewest
    parameters is chosen (Bayesian information criterion, Schwarz 1978, doi:10.1214/aos/1176344136; extended
    by the number of structures searched, Chen & Chen 2008, doi:10.1093/biomet/asn034).

    Parameters
    ----------
    records : PistonRecord, table (pandas, xarray, mapping), path, (time, height), or a list of these
        Times [s] and heights [m], 20 or more samples each. Several records share one equation with
        the same parameters; each has its own initial state.
    method : str
        ``"auto"``: candidates of ``"sindy"`` and, if pyoperon is installed, of ``"operon"``.
        ``"sindy"``: a sparse sum of library terms (Brunton, Proctor & Kutz 2016,
        doi:10.1073/pnas.1517384113). All subsets are tried, on integrals that need derivatives of the
        record only for drag and friction (Messenger & Bortz 2021, doi:10.1137/20M1343166).
        ``"pysindy"``: sums found by PySINDy's thresholded least squares on smoothed derivatives,
        and the same sums pruned term by term. ``"operon"``: symbolic regression in z, z', |z'| and
        sign(z') with pyoperon. ``"pysr"``: sparse sums, and symbolic regression with PySR, which
        needs Julia.
    library : str, or a sequence of them
        Terms to choose from: ``"auto"``, ``"memory"``, or one or more of
        `reduced_models.discovery.term_libraries.LIBRARIES`: ``"physical"``, ``"polynomial"``,
        ``"trigonometric"``, ``"rational"``, ``"dry friction"``, ``"contact"``, ``"driven"``.
        ``"auto"`` takes the library that fits the record best, with a note if this is not the
        physical one. If the residuals of all libraries exceed the noise, ``"auto"`` also tries up to
        three drives sin(w*t), cos(w*t) and finds each w. In symbolic regression, terms that are not
        products of powers become variables. ``"memory"`` contains terms with a hidden state w and
        terms without it. For a bed, the terms are powers of the height, and w is a strain that yields
        or relaxes (`reduced_models.discovery.structure_proposals`). For forces along a stroke about
        zero, w is a displacement that yields, as in the Bouc-Wen and Dahl models.
    target : "acceleration", "force" or "height"
        Left side of the equation: z'' for ``"acceleration"``; for ``"force"``, the force measured
        along a prescribed stroke; for ``"height"`` (symbolic regression only), the height itself as
        a function of the time t.
    degree : int
        Highest power of z in the physical library, from 1 to 5. With ``library="auto"`` the degree
        starts at this value and increases while the held-out error decreases.
    terms : sequence of str
        User-defined terms in addition to the library, in z, z', the input's column and the time t
        since the start: ``"sin(z)"``, ``"max(0, z)"``, ``"z'**3"``, ``"z**-2.5"``. Each gets a
        coefficient. Numbers inside a term stay fixed; names denote parameters to be found:
        ``"max(0, z - d)"``, ``"sin(w*t)"``. A sum is split, and each of its terms gets a separate
        coefficient in place of its numerical factor.
    input : str, optional
        Column of the records that drives the motion: ``"force"`` or the name of an extra column.
    seed : int
        Seed of random searches, from 0 to 2^32 - 1.
    least_effect : float
        Minimum change of the motion, relative to its rms displacement, that a term must cause to be chosen,
        in addition to the statistical criterion; from 0 to below 1. This excludes terms that only describe
        small errors of an integrator or an interpolation. Used only with ``target="acceleration"``, and not
        with ``library="memory"``.
    options : DiscoveryOptions
        Less common options: height, polish, functions, effort, progress.

    Returns
    -------
    Discovery
        Equations on the Pareto front and close competitors, the simplest first; models (in s and m)
        of the fitted equations; and the index of the chosen equation.

    Raises
    ------
    RecordError
        If a table is not a record, or a record is too short, does not move, holds no heights, or lacks
        the input's column or the force that ``target`` needs.
    InputError
        If no record is given, an argument is out of range, arguments are incompatible, a term or
        function cannot be read, a term is not finite over the motion, or a program that the method
        needs is not installed.
    """
    given, texts = list_of_records(records), texts_as_tuple("terms", terms)
    libraries = texts_as_tuple("library", library)
    check_discovery_arguments(
        method, libraries, target, degree, texts, input, seed, options.height_line, least_effect
    )
    _check_records_for_target(given, target)
    functions = translate_function_names(options.functions, method)
    used = _method_or_installed_replacement(method, options.functions)
    search = None
    if used not in SPARSE:
        if target == "height":
            functions = tuple(dict.fromkeys((*_FORMULA, *functions)))
        search = SymbolicSearch("pysr" if used == "pysr" else "operon", functions, options.effort, seed)
    with stage_reporter("discover", wanted=options.progress) as now:
        now("libraries")
        studies, line, note = _studies_with_line_and_note(
            given, libraries, target, degree, texts, input, options.height_line, least_effect
        )
        now("sparse sums of terms" if search is None else "symbolic regression")
        proposed = propose_structures(studies, used, search)
        open_terms = proposed.study.open_terms

        def fit_numbers_of_candidate(candidate: CandidateEquation) -> CandidateEquation:
            now(f"fit of {candidate.left_side} = {candidate.expression.evalf(3)}"[:_LINE])
            return fit_candidate_numbers(candidate, given, line, input, seed, open_terms)

        front, chosen = fit_candidates_and_choose_index(
            proposed,
            fit_numbers_of_candidate,
            options.polish,
            seed,
            integrated=given[0].measured in ("velocity", "acceleration"),
        )
        now("done")
    rivals = open_terms.candidates_with_chosen_values(proposed.candidates, front[chosen])
    sure = weigh_structure_evidence(front[chosen], rivals, proposed.scorer, seed, front)
    advises_memory = target == "force" and libraries != (MEMORY,) and input is None
    notes = (
        note,
        *(hidden_state_notes(proposed.groups) if len(studies) > 1 else ()),
        *_discovery_notes(given, input, target, notes_on_candidate(front[chosen], proposed.scorer)),
        *(words for model in front[chosen].models for words in model.notes),
        memory_advice(proposed.study.weak, front[chosen].error) if advises_memory else "",
        "" if sure is None else sure.rival_structures_text,
        "" if used == method else _NO_OPERON,
    )
    return Discovery(
        _method_description(used, libraries, target),
        tuple(front),
        chosen,
        line,
        tuple(words for words in dict.fromkeys(notes) if words),
        {} if sure is None else sure.criterion_increases,
    )


def _studies_with_line_and_note(
    records: Sequence[PistonRecord],
    libraries: Sequence[str],
    target: Target,
    degree: int,
    texts: Sequence[str],
    column: str | None,
    wanted: HeightLine | None,
    least_effect: float,
) -> tuple[list[WeakFormStudy], HeightLine, str]:
    """Return studies with all terms, the linear relation of z to the height, and a note on the library."""
    left_side = _LEFT_SIDES[target]

    def weak_form_in_coordinate(line: HeightLine) -> WeakForm:
        if target == "acceleration" and libraries != (MEMORY,):
            motions = [estimate_smoothed_motion(record, line, column, least_effect) for record in records]
            return make_weak_form(*motions, least_effect=least_effect)
        motions = [estimate_smoothed_motion(record, line, column) for record in records]
        if target == "acceleration":
            return make_weak_form(*motions)
        return weak_form_of_measured_signal(target, records, motions)

    if target == "height":
        return [WeakFormStudy(weak_form_in_coordinate(HeightLine()), (Term(0),), left_side)], HeightLine(), ""
    if libraries == (MEMORY,):
        studies = hidden_state_studies(weak_form_in_coordinate(HeightLine()), texts, left_side)
        return studies, HeightLine(), ""
    plain, opened = split_constant_and_open_terms(texts, column, input_column_names(records[0]))
    # In user-defined terms and libraries other than the physical one, z is the height.
    automatic, usual = libraries == (AUTO,), not texts and libraries in ((AUTO,), (PHYSICAL,))
    line = wanted or (normalising_height_line(records) if usual else HeightLine())
    drives = [split_constant_and_open_terms(drive, None, ())[1] for drive in _DRIVES]
    drives = [OpenTerms() if {*drive.names} & {*opened.names} else drive for drive in drives]
    filled = ParametricTerms()
    if automatic and target == "acceleration":
        own = tuple(parse_custom_terms(plain, column))
        proposal = propose_library(
            weak_form_in_coordinate,
            line,
            column,
            degree,
            line_is_given=bool(texts) or wanted is not None,
            coordinate_unit=records[0].coordinate_unit,
            fit_drives=lambda first, weak, known: filled.fit_drives(
                drives[: len(first) + 1], weak, known, first
            ),
        )
        proposal = proposal._replace(terms=tuple(dict.fromkeys((*proposal.terms, *own))))
    else:
        known = library_terms((PHYSICAL,) if automatic else libraries, plain, degree, column)
        proposal = LibraryProposal("", known, line, weak_form_in_coordinate(line))
    _check_terms_finite(proposal.weak, proposal.terms)
    drive_terms = filled.fit_drives(
        drives[: len(proposal.drives)], proposal.weak, proposal.terms, proposal.drives
    )
    known = (*proposal.terms, *itertools.chain(*drive_terms))
    known = (*known, *filled.fit_open_terms(opened, proposal.weak, known))
    return [WeakFormStudy(proposal.weak, known, left_side, open_terms=filled)], proposal.line, proposal.note


def _discovery_notes(
    records: Sequence[PistonRecord], column: str | None, target: str, candidate_notes: Sequence[str]
) -> tuple[str, ...]:
    """Collect notes on the candidate, on unused columns, and on the noise of an integrated signal."""
    first = records[0]
    if first.measured in ("velocity", "acceleration"):  # notes on noise do not hold for these
        candidate_notes = [_INTEGRATED.format(first.measured)]
    others = [name for name in input_column_names(first) if name != first.measured]
    simulated = first.source is not None and bool(first.source.scene)
    if not others or column is not None or target != "acceleration" or simulated:
        return tuple(candidate_notes)
    return (*candidate_notes, _UNUSED.format(", ".join(map(sanitize, others))))


def _method_or_installed_replacement(method: Method, functions: str | Sequence[str]) -> Method:
    """Return the method, or "sindy" in place of "auto" if pyoperon is not installed."""
    if method == "pysr":
        require_pysr()
    if method != "auto" or is_operon_installed():
        return method
    if functions:
        raise InputError(f"functions need symbolic regression, but {_NO_OPERON}")
    return "sindy"


def _check_records_for_target(records: Sequence[PistonRecord], target: str) -> None:
    if target != "force":
        refuse_prescribed_strokes(records, "discover")
    if not records:
        raise InputError("the argument records is empty; give one or more records")
    if target == "height" and len(records) > 1:
        raise InputError(
            f"target = 'height' takes one record, but {len(records)} are given; give a single record"
        )


def _check_terms_finite(weak: WeakForm, terms: Sequence[AnyTerm]) -> None:
    for motion in weak.motions:
        for term in terms:
            wrong = term_fault_text(motion, term)
            if wrong:
                low, high = motion.z.min(), motion.z.max()
                raise InputError(
                    f"the term {quote(term.text)} {wrong} for z from {low:.3g} to "
                    f"{high:.3g}; remove the term, or choose another z by DiscoveryOptions(height=...)"
                )


def _method_description(method: str, libraries: Sequence[str], target: str) -> str:
    """Describe the method in words."""
    words = ["sindy and operon" if method == "auto" else method]
    words += ["with memory"] if libraries == (MEMORY,) else []
    return ", ".join([*words, *([] if target == "acceleration" else [f"of the {target}"])])
