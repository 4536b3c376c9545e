"""`discover`: the equation of a record, by sparse or by symbolic regression."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from granular.run.piston_record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.message_text import quote, sanitize
from granular.shared.progress_bars import stage_reporter
from reduced_models.discovery.candidate_choice import (
    notes_on_candidate,
    polish_and_choose_candidate,
    weigh_structure_evidence,
)
from reduced_models.discovery.hidden_state_search import add_hidden_state, propose_hidden_state_structures
from reduced_models.discovery.operon_search import is_operon_installed
from reduced_models.discovery.parametric_terms import ParametricTerms, split_parametric_terms
from reduced_models.discovery.polishing import polish_candidate, polish_force_candidate
from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.discovery.structure_proposals import SymbolicSearch, propose_structures
from reduced_models.discovery.term_libraries import (
    AUTO,
    MEMORY,
    PHYSICAL,
    LibraryProposal,
    find_term_fault,
    functions_known_to_program,
    library_terms,
    parse_custom_terms,
    propose_library,
)
from reduced_models.discovery.terms import AnyTerm, physical_library_terms
from reduced_models.discovery.weak_form import (
    SmoothedMotion,
    WeakForm,
    choose_height_map,
    estimate_motion,
    force_weak_form,
    weak_form,
)
from reduced_models.fitting.problem import RecordLike, list_of_records, refuse_prescribed_strokes
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import DerivativeMethod
from reduced_models.records.inputs import column_names

Method = Literal["auto", "sindy", "operon", "pysr"]
_NO_OPERON = (
    "pyoperon is not installed, so sparse regression alone proposes structures: "
    "pip install 'granular-damper[discover]'"
)
_INTEGRATED = (
    "terms were proposed from the integrated {0}, whose noise is not white: errors over the noise compare "
    "candidates only; the model was fitted to the {0} itself"
)
_UNUSED = "columns that were not used as an input: {0}; input=NAME (--input NAME) takes one as the drive"
_GREATEST_SEED = 2**32 - 1  # that np.random.seed takes, which PySINDy draws by
_LINE = 70  # characters of a formula that a line of progress shows
METHODS: tuple[Method, ...] = ("auto", "sindy", "operon", "pysr")


def discover(
    record: RecordLike | Sequence[RecordLike],
    method: Method = "auto",
    *,
    form: Literal["weak", "strong"] = "weak",
    ensemble: bool = False,
    derivative: DerivativeMethod = "savitzky-golay",
    degree: int = 3,
    library: str | Sequence[str] = AUTO,
    terms: Sequence[str] = (),
    functions: Sequence[str] = (),
    input: str | None = None,  # noqa: A002
    target: Literal["acceleration", "height", "force"] = "acceleration",
    map: HeightMap | Literal["auto"] = "auto",  # noqa: A002
    polish: int = 3,
    effort: float = 1.0,
    seed: int = 0,
    progress: bool = False,
) -> Discovery:
    """Discover the equation of motion z'' = f(z, z', input) of a record, or of several together.

    Every method proposes structures. All are weighed by the same white residuals of the weak form;
    those that no simpler one beats make the Pareto front; the best of them are fitted through their
    differential equation, and the simplest is chosen to which the information criterion does not
    strongly prefer another (Bayesian information criterion; Schwarz 1978,
    doi:10.1214/aos/1176344136; extended by the number of structures searched; Chen & Chen 2008,
    doi:10.1093/biomet/asn034).

    Parameters
    ----------
    record : PistonRecord, table (pandas, xarray, mapping), path, (time, height), or a list of these
        Times [s] and heights [m], at least 20 samples each. Several obey the same equation, with
        the same numbers, each from its own initial state.
    method : str
        ``"auto"``: what ``"sindy"`` and, where pyoperon is installed, ``"operon"`` propose, side by
        side. ``"sindy"``: a sparse sum of the terms of a physical library, powers of z times 1, z',
        |z'| z' and sign(z') (Brunton, Proctor & Kutz 2016, doi:10.1073/pnas.1517384113).
        ``"operon"``: symbolic regression in z, z', |z'| and sign(z') by pyoperon. ``"pysr"``:
        sparse sums, and symbolic regression by PySR, which needs Julia.
    form : "weak" or "strong"
        For ``"sindy"``: all subsets of the library, on integrals that need no derivative of the
        record (but for drag and friction; Messenger & Bortz 2021, doi:10.1137/20M1343166); or
        thresholded least squares on an estimate of z''.
    ensemble : bool
        For ``"sindy"``: thresholded least squares on resampled rows (Fasel, Kutz, Brunton & Brunton
        2022, doi:10.1098/rspa.2021.0904); the result says how often each term was needed.
    derivative : str
        Estimator of z' and z'', ``"savitzky-golay"``, ``"smoothing-spline"`` or
        ``"finite-differences"``; see `derivatives`.
    degree : int
        Of the powers of z in the physical library, from 1 to 5. With ``library="auto"`` it is the
        least one: it grows while the held-out error falls.
    library : str, or a sequence of them
        Which terms there are to choose from. ``"auto"``: those of the library that the record
        speaks for, with a note why where it is not the physical one. Or one or more of
        `reduced_models.discovery.term_libraries.LIBRARIES`: ``"physical"``, ``"polynomial"``,
        ``"trigonometric"``, ``"rational"``, ``"dry friction"``, ``"contact"``, ``"driven"``.
        Symbolic regressions are given what of it is no product of powers as variables.
        ``"memory"``: for beds, powers of the height with and without a hidden state w, a strain
        that yields or relaxes (`reduced_models.discovery.hidden_state_search`); for forces along a
        stroke about zero, a displacement that yields, as in the models of Bouc and Wen, and of Dahl.
    terms : sequence of str
        Own terms next to the library's, in z, z' and the input's column: ``"sin(z)"``,
        ``"max(0, z)"``, ``"z'**3"``, ``"z**-2.5"``. Each gets a coefficient; numbers within it stay
        as they are, and names stand for numbers to be found: ``"max(0, z - d)"``. A sum is taken
        apart, and each of its terms gets a coefficient of its own, in place of the number before it.
    functions : sequence of str
        What symbolic regressions may use next to sums, differences and products:
        ``"sin"``, ``"exp"``, ``"max"``, ``"/"`` and others. Not for ``"sindy"``.
    input : str, optional
        Column of the records that drives the motion ("force", or an extra one).
    target : "acceleration", "height" or "force"
        Z''; or, for symbolic regression of one record, z(t) itself, which is not polished; or the
        force that was measured along a prescribed stroke, of which the chosen equation is fitted.
    map : HeightMap or "auto"
        Z = (height - shift)/scale. Automatically the height itself, or, where the level of rest is
        farther from zero than the swing is wide, the swing about rest in amplitudes; of the record
        that swings the furthest. With own terms or another library, which mean something by z, it
        is the height itself.
    polish : int
        Greatest number of candidates, from 0 on, best first, that are fitted through their differential
        equation; those whose criterion is hopeless next to the best one's are not. With 0 no
        candidate has a model.
    effort : float
        Times the usual length of a symbolic regression, above 0.
    seed : int
        Seed of random searches, from 0 to 2^32 - 1.
    progress : bool
        True for a line on standard error that shows what is being done.

    Returns
    -------
    Discovery
        Equations of the Pareto front and close rivals, the simplest first, with models [s, m] of
        those that were polished, and which of them is chosen.

    Raises
    ------
    RecordError
        If a table is no record, or a record is too short or does not move, holds no heights, or has
        no such column or no force that ``target`` needs.
    InputError
        If there is no record, an option is out of its range, options do not go together, a term or
        function cannot be read, a term is not finite over the motion, or a program that the method
        needs is not installed.
    """
    records = list_of_records(record)
    terms, functions = _as_text_sequence(terms), _as_text_sequence(functions)
    _check_arguments(method, form, target, degree, polish, ensemble, effort)
    _check_argument_types(library, map, seed)
    _check_records_for_target(records, target)
    remembers = _is_single_library(library, MEMORY)
    if remembers:
        _check_hidden_state_options(target, form, ensemble, input, map)
    plain, open_terms = split_parametric_terms(() if remembers else terms, input, column_names(records[0]))
    known = _requested_terms(library, plain, degree, input)
    allowed = functions_known_to_program(functions, method)
    method, lacking = _resolve_installed_method(method, functions)
    search = None
    if method != "sindy":
        search = SymbolicSearch("pysr" if method == "pysr" else "operon", allowed, effort, seed)
    with stage_reporter("discover", wanted=progress) as now:
        if target == "height":
            from reduced_models.discovery.formula_of_time import discover_height_formulas

            now("symbolic regression of z(t)")
            assert search is not None
            height_map, (only,) = _resolve_height_map(records, library, terms, map), records
            return discover_height_formulas(only.time, only.height, search, height_map)

        if remembers:
            now("hidden states")
            height_map, library_note = HeightMap(), ""
            motions = [estimate_motion(record, height_map, derivative) for record in records]
            weak = force_weak_form(records, motions) if target == "force" else weak_form(*motions)
            proposed = propose_hidden_state_structures(weak, search, terms, method != "operon")
        else:
            now("libraries")
            _, known, height_map, weak, library_note = _choose_library(
                records, library, terms, known, derivative, input, map, degree, force=target == "force"
            )
            known = (*known, *_fit_parametric_terms(weak, known, open_terms))
            now("sparse sums of terms" if search is None else "symbolic regression")
            proposed = propose_structures(
                weak, known, search, sparse=method != "operon", form=form, ensemble=ensemble, seed=seed
            )
            left = "force" if target == "force" else "z''"
            candidates = open_terms.add_parameter_costs(proposed.candidates, weak.sample_count, left)
            proposed = proposed._replace(candidates=candidates)
        words = _method_description(method, form, ensemble, target if remembers else "")

        def polish_one(candidate_equation: CandidateEquation) -> CandidateEquation:
            now(f"fit of z'' = {candidate_equation.expression.evalf(3)}"[:_LINE])
            candidate = add_hidden_state(candidate_equation, proposed.hidden_state, proposed.scorer)
            return polish_candidate(candidate, records, height_map, input, seed, open_terms)

        count = 0 if target == "force" else polish
        front, chosen = polish_and_choose_candidate(
            proposed.candidates,
            polish_one,
            count,
            proposed.scorer,
            proposed.others,
            None if remembers else seed,
            integrated=records[0].measured in ("velocity", "acceleration"),
        )
        said = notes_on_candidate(front[chosen], proposed.scorer)
        if target == "force" and polish:
            front[chosen] = polish_force_candidate(front[chosen], records, height_map, input, seed)
        now("done")
    rivals = open_terms.with_chosen_values(proposed.candidates, front[chosen])
    sure = (
        None if remembers else weigh_structure_evidence(front[chosen], rivals, proposed.scorer, seed, front)
    )
    notes = (
        library_note,
        *proposed.notes,
        *_notes_on_records(records, input, target, said),
        *(note for model in front[chosen].models for note in model.notes),
        "" if sure is None else sure.rival_note,
        _NO_OPERON if lacking else "",
    )
    return Discovery(
        words,
        tuple(front),
        chosen,
        height_map,
        proposed.inclusion_fractions,
        tuple(note for note in dict.fromkeys(notes) if note),
        {} if sure is None else sure.criterion_increases,
    )


def _notes_on_records(
    records: Sequence[PistonRecord], column: str | None, target: str, said: Sequence[str]
) -> tuple[str, ...]:
    """Collect notes on a chosen equation, on integrated noise, and on columns that drive nothing."""
    first = records[0]
    if first.measured in ("velocity", "acceleration"):  # notes on noise say nothing of these
        said = [_INTEGRATED.format(first.measured)]
    others = [name for name in column_names(first) if name != first.measured]
    simulated = first.source is not None and bool(first.source.scene)
    if not others or column is not None or target != "acceleration" or simulated:
        return tuple(said)
    return (*said, _UNUSED.format(", ".join(map(sanitize, others))))


def _requested_terms(
    library: str | Sequence[str], terms: Sequence[str], degree: int, column: str | None
) -> tuple[AnyTerm, ...]:
    """Terms of a library that is named, and own ones; own ones alone where none is."""
    if _is_single_library(library, MEMORY):
        return ()
    if _is_single_library(library, AUTO):
        return tuple(parse_custom_terms(terms, column))
    return library_terms(library, terms, degree, column)


def _choose_library(
    records: Sequence[PistonRecord],
    library: str | Sequence[str],
    terms: Sequence[str],
    known: tuple[AnyTerm, ...],
    derivative: DerivativeMethod,
    column: str | None,
    wanted: HeightMap | Literal["auto"],
    degree: int,
    *,
    force: bool,
) -> LibraryProposal:
    """Terms to choose from, and the weak form of the records in the z that they mean."""
    height_map = _resolve_height_map(records, library, terms, wanted)

    def motions(height_map: HeightMap) -> list[SmoothedMotion]:
        return [estimate_motion(record, height_map, derivative, column) for record in records]

    if force:
        if _is_single_library(library, AUTO):
            known = (*physical_library_terms(degree, column is not None), *known)
        weak = force_weak_form(records, motions(height_map))
        proposal = LibraryProposal("", known, height_map, weak, "")
    elif _is_single_library(library, AUTO):
        proposal = propose_library(
            lambda height_map: weak_form(*motions(height_map)),
            height_map,
            column,
            degree,
            map_is_given=bool(terms) or wanted != "auto",
            angle=records[0].angle,
        )
        proposal = proposal._replace(terms=tuple(dict.fromkeys((*proposal.terms, *known))))
    else:
        proposal = LibraryProposal("", known, height_map, weak_form(*motions(height_map)), "")
    _check_terms_finite(proposal.weak, proposal.terms)
    return proposal


def _fit_parametric_terms(
    weak: WeakForm, known: Sequence[AnyTerm], open_terms: ParametricTerms
) -> list[AnyTerm]:
    """Open terms with the numbers that leave least next to the known ones."""
    terms = open_terms.terms_with_best_values(weak, known)
    _check_terms_finite(weak, terms)
    return terms


def _resolve_height_map(
    records: Sequence[PistonRecord],
    library: str | Sequence[str],
    terms: Sequence[str],
    wanted: HeightMap | Literal["auto"],
) -> HeightMap:
    """Map that is wanted; own terms and libraries other than the usual mean the height."""
    usual = _is_single_library(library, AUTO) or _is_single_library(library, PHYSICAL)
    if wanted == "auto" and (terms or not usual):
        return HeightMap()
    return choose_height_map(records, wanted)


def _resolve_installed_method(method: Method, functions: Sequence[str]) -> tuple[Method, bool]:
    """Return the method, or what stands in for it, and whether pyoperon is lacking for it."""
    if method == "pysr":
        from reduced_models.discovery.pysr_search import require_pysr

        require_pysr()
    if method != "auto" or is_operon_installed():
        return method, False
    if functions:
        raise InputError(f"functions need symbolic regression, but {_NO_OPERON}")
    return "sindy", True


def _is_single_library(library: str | Sequence[str], name: str) -> bool:
    """Return True where a library's name, or the only one of a list, is this one."""
    return [library] == [name] or list(library) == [name]


def _check_records_for_target(records: Sequence[PistonRecord], target: str) -> None:
    if target != "force":
        refuse_prescribed_strokes(records, "discover")
    if not records:
        raise InputError("there is no record to discover a law in; give at least one")
    if target == "height" and len(records) > 1:
        raise InputError(f"target = 'height' is of one record, not of {len(records)}; give one")


def _check_hidden_state_options(
    target: str, form: str, ensemble: bool, column: str | None, height_map: HeightMap | str
) -> None:
    if target == "height" or form != "weak" or ensemble or column is not None:
        raise InputError(
            f"library = {MEMORY!r} is of z'' or the force of a bed that is not driven, by its weak "
            "form; leave out form, ensemble, input and target = 'height'"
        )
    if height_map not in ("auto", HeightMap()):
        raise InputError(f"library = {MEMORY!r} is of the height itself; leave out map")


def _check_arguments(
    method: str, form: str, target: str, degree: int, polish: int, ensemble: bool, effort: float
) -> None:
    for name, value, valid in (
        ("method", method, METHODS),
        ("form", form, ("weak", "strong")),
        ("target", target, ("acceleration", "height", "force")),
    ):
        if value not in valid:
            raise InputError(f"{name} = {quote(value)}; give one of {', '.join(valid)}")
    if not isinstance(degree, int) or not 1 <= degree <= 5:
        raise InputError(f"degree = {quote(degree)}; give an integer from 1 to 5")
    if not isinstance(polish, int) or polish < 0:
        raise InputError(f"polish = {quote(polish)}; give an integer from 0 on")
    if not isinstance(effort, int | float) or not 0.0 < effort < math.inf:
        raise InputError(f"effort = {quote(effort)}; give a number above 0")
    if method in ("auto", "sindy") and target == "height":
        raise InputError("target = 'height' needs a symbolic method: give method 'operon' or 'pysr'")
    if method not in ("auto", "sindy") and (ensemble or form != "weak"):
        raise InputError(f"form and ensemble belong to method 'sindy'; leave them out of {quote(method)}")


def _check_argument_types(library: object, height_map: object, seed: object) -> None:
    names = [library] if isinstance(library, str) else library
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise InputError(f"library = {quote(library)}; give a name, or several in a list")
    if not isinstance(seed, int) or not 0 <= seed <= _GREATEST_SEED:
        raise InputError(f"seed = {quote(seed)}; give an integer from 0 to {_GREATEST_SEED}")
    if isinstance(height_map, HeightMap):
        if not (math.isfinite(height_map.shift) and 0.0 < abs(height_map.scale) < math.inf):
            raise InputError(
                f"map has the shift {height_map.shift:g} and the scale {height_map.scale:g} m; "
                "give finite ones, and a scale that is not zero"
            )
    elif height_map != "auto":
        raise InputError(f"map = {quote(height_map)}; give 'auto' or HeightMap(shift, scale)")


def _as_text_sequence(texts: str | Sequence[str]) -> Sequence[str]:
    """Texts, or a single one, in a sequence."""
    result = (texts,) if isinstance(texts, str) else texts
    if not isinstance(result, Sequence):
        raise InputError(f"terms or functions = {quote(texts)}; give a text, or several in a list")
    return result


def _check_terms_finite(weak: WeakForm, terms: Sequence[AnyTerm]) -> None:
    for motion in weak.motions:
        for term in terms:
            wrong = find_term_fault(motion, term)
            if wrong:
                low, high = motion.z.min(), motion.z.max()
                raise InputError(
                    f"the term {quote(term.text)} {wrong} for z from {low:.3g} to "
                    f"{high:.3g}; leave it out, or give map=HeightMap(shift, scale)"
                )


def _method_description(method: str, form: str, ensemble: bool, memory_of: str) -> str:
    """Return the method in words; ``memory_of`` is the target where hidden states are searched."""
    name = "sindy and operon" if method == "auto" else method
    if memory_of:
        return f"{name}, with memory, " + ("force" if memory_of == "force" else "z''")
    if method != "sindy":
        return name
    return f"{name}, {form} form" + (", ensemble" if ensemble else "")
