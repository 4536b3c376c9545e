"""`discover`: the equation of a record, by sparse or by symbolic regression."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from granular.shared.progress import stages
from reduced_models.discovery.choice import notes_on, polished_front
from reduced_models.discovery.evidence import evidence
from reduced_models.discovery.libraries import (
    MEMORY,
    PHYSICAL,
    functions_named,
    own_terms,
    terms_named,
)
from reduced_models.discovery.motion import map_of, motion_of
from reduced_models.discovery.polishing import polished
from reduced_models.discovery.proposal import AUTO, proposed
from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.discovery.selection import Judge, scored
from reduced_models.discovery.soundness import fault
from reduced_models.discovery.structures import (
    Search,
    candidate_of,
    sindy_supports,
    symbolic_candidates,
)
from reduced_models.discovery.symbolic import has_operon
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm, weak_form
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import DerivativeMethod

Method = Literal["auto", "sindy", "operon", "pysr"]
_NO_OPERON = (
    "pyoperon is not installed, so sparse regression alone proposes structures: "
    "pip install 'granular-damper[discover]'"
)
_GREATEST_SEED = 2**32 - 1
_LINE = 70  # signs of a formula that a line of progress shows
METHODS: tuple[Method, ...] = ("auto", "sindy", "operon", "pysr")


def discover(
    record: PistonRecord | Sequence[PistonRecord],
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
    """Discover the equation of motion z'' = f(z, z', input) of a record, or of several at once.

    Every method proposes structures. All are weighed by the same white residuals of the weak form;
    those that no simpler one beats make the Pareto front; the best of them are fitted through their
    differential equation, and the simplest is chosen to which the information criterion does not
    strongly prefer another.

    Parameters
    ----------
    record : PistonRecord, or a sequence of them
        Several obey the same equation, with the same numbers, each from its own initial state.
    method : str
        ``"auto"``: what ``"sindy"`` and, where pyoperon is installed, ``"operon"`` propose, side by
        side. ``"sindy"``: a sparse sum of the terms of a physical library, powers of z times 1, z',
        |z'| z' and sign(z'). ``"operon"``: symbolic regression in z, z', |z'| and sign(z') by
        pyoperon. ``"pysr"``: the same by PySR, which needs Julia.
    form : "weak" or "strong"
        For ``"sindy"``: all subsets of the library, on integrals that need no derivative of the
        record (but for drag and friction); or thresholded least squares on an estimate of z''.
    ensemble : bool
        For ``"sindy"``: thresholded least squares on resampled rows; the result says how often each
        term was needed.
    derivative : str
        Estimator of z' and z'', see `derivatives`.
    degree : int
        Of the powers of z in the physical library, from 1 to 5. With ``library="auto"`` it is the
        least one: it grows while the held-out error falls.
    library : str, or a sequence of them
        Which terms there are to choose from. ``"auto"``: those of the library that the record
        speaks for, with a note why where it is not the physical one. Or one or more of
        `reduced_models.discovery.libraries.LIBRARIES`: ``"physical"``, ``"polynomial"``,
        ``"trigonometric"``, ``"rational"``, ``"dry friction"``, ``"contact"``, ``"driven"``.
        Symbolic regressions are given what of it is no product of powers as variables.
        ``"memory"``: for beds, powers of the height with and without a hidden state w, a strain
        that yields or relaxes (`reduced_models.discovery.memory`).
    terms : sequence of str
        Own terms beside the library's, in z, z' and the input's column: ``"sin(z)"``,
        ``"max(0, z)"``, ``"z'**3"``, ``"z**-2.5"``. Each gets a coefficient, and
        numbers within it stay as they are. A sum is taken apart, and each of its terms gets a
        coefficient of its own, in place of the number that stands before it.
    functions : sequence of str
        What symbolic regressions may use beside sums, differences and products:
        ``"sin"``, ``"exp"``, ``"max"``, ``"/"`` and others.
    input : str, optional
        Column of the records that drives the motion ("force", or an extra one).
    target : "acceleration", "height" or "force"
        z''; or, for symbolic regression of one record, z(t) itself; or, with the library
        ``"memory"``, the measured force. The latter two are not polished.
    map : HeightMap or "auto"
        z = (height - shift)/scale. Automatically the height itself, or, where the level of rest is
        farther from zero than the swing is wide, the swing about rest in amplitudes; of the record
        that swings the furthest. With own terms or another library, which mean something by z, it
        is the height itself.
    polish : int
        Greatest number of candidates, best first, that are fitted through their differential
        equation; those whose criterion is hopeless beside the best one's are not.
    effort : float
        Times the usual length of a symbolic regression.
    seed : int
        Of random searches.
    progress : bool
        Whether a line on standard error shows what is being done.

    Returns
    -------
    Discovery

    Raises
    ------
    RecordError
        If the record is too short or does not move, or has no such column.
    InputError
        If an option is out of its range, or a program that the method needs is not installed.
    """
    _check(method, form, target, degree, polish, ensemble, effort)
    _check_kinds(library, map, seed)
    terms, functions = _texts(terms), _texts(functions)
    records = [record] if isinstance(record, PistonRecord) else list(record)
    if not records:
        raise InputError("there is no record to discover a law in; give at least one")
    remembers = library in (MEMORY, (MEMORY,), [MEMORY])
    automatic = library in (AUTO, (AUTO,), [AUTO])
    plain = automatic or remembers
    known = (
        tuple(own_terms(() if remembers else terms, input)) if plain
        else terms_named(library, terms, degree, input)
    )  # fmt: skip
    allowed = functions_named(functions, method)
    if target == "height" and len(records) > 1:
        raise InputError(f"target = 'height' is of one record, not of {len(records)}; give one")
    if target == "force" and not remembers:
        raise InputError(f"target = 'force' is for the library {MEMORY!r}; give library={MEMORY!r}")
    lacking = method == "auto" and not has_operon()
    if lacking and functions:
        raise InputError(f"functions need symbolic regression, but {_NO_OPERON}")
    if method == "pysr":
        from reduced_models.discovery.julia import require_julia

        require_julia()
    if remembers:
        with stages("discover", wanted=progress) as now:
            now("hidden states")
            return _with_memory(
                records, method, allowed, terms, derivative, input, target, map, form, ensemble,
                polish, effort, seed,
            )  # fmt: skip
    own = bool(terms) or not (automatic or library in (PHYSICAL, (PHYSICAL,), [PHYSICAL]))
    height_map = HeightMap() if own and map == "auto" else map_of(records, map)
    if target == "height":
        from reduced_models.discovery.height import height_equations

        with stages("discover", wanted=progress) as now:
            now("symbolic regression of z(t)")
            return height_equations(records[0], method, height_map, effort, seed)
    if lacking:
        method = "sindy"
    proposal_note, name = "", f"discovered by {_words(method, form, ensemble)}"
    with stages("discover", wanted=progress) as now:
        if automatic:
            now("libraries")
            proposal = proposed(records, derivative, input, height_map if own else map, degree)
            height_map, weak, proposal_note = proposal.map, proposal.weak, proposal.note
            known = (*proposal.terms, *(one for one in known if one not in proposal.terms))
        else:
            weak = weak_form(*(motion_of(each, height_map, derivative, input) for each in records))
        _check_finite(weak, known)
        candidates, judge, inclusion = _structures(
            weak, known, method, (form, ensemble, seed),
            Search("pysr" if method == "pysr" else "operon", allowed, effort, seed), now,
        )  # fmt: skip

        def fitted(one: CandidateEquation) -> CandidateEquation:
            now(f"fit of z'' = {one.expression.evalf(3)}"[:_LINE])
            return polished(one, records, height_map, input, seed, name)

        front, chosen = polished_front(candidates, fitted, polish, judge)
        now("done")
    sure = evidence(front[chosen], candidates, judge, seed)
    notes = (
        proposal_note,
        *notes_on(front[chosen], judge),
        "" if sure is None else sure.note,
        _NO_OPERON if lacking else "",
    )
    return Discovery(
        _words(method, form, ensemble),
        tuple(front),
        chosen,
        height_map,
        inclusion,
        tuple(note for note in notes if note),
        {} if sure is None else sure.prices,
    )


def _structures(
    weak: WeakForm, known: tuple[AnyTerm, ...], method: str, sparse: tuple[str, bool, int],
    search: Search, now: Callable[[str], None],
) -> tuple[list[CandidateEquation], Judge, dict[str, float]]:  # fmt: skip
    """Candidates of a method, who judges them, and how often ensembles held each term."""
    supports, inclusion = list[np.ndarray](), dict[str, float]()
    if method in ("auto", "sindy"):
        now("sparse sums of terms")
        supports, inclusion = sindy_supports(weak, known, *sparse)
    if method == "sindy":
        ranked, judge = scored(weak, known, known, supports)
        return [candidate_of(one) for one in ranked], judge, inclusion
    now("symbolic regression")
    return *symbolic_candidates(weak, known, search, supports), inclusion


def _with_memory(
    records: Sequence[PistonRecord], method: str, functions: tuple[str, ...],
    terms: Sequence[str], derivative: DerivativeMethod, column: str | None, target: str,
    height_map: HeightMap | str, form: str, ensemble: bool, polish: int, effort: float, seed: int,
) -> Discovery:  # fmt: skip
    from reduced_models.discovery.memory import memory_discovery

    if target == "height" or form != "weak" or ensemble or column is not None:
        raise InputError(
            f"library = {MEMORY!r} is of z'' or the force of a bed that is not driven, by its weak "
            "form; leave out form, ensemble, input and target = 'height'"
        )
    if height_map not in ("auto", HeightMap()):
        raise InputError(f"library = {MEMORY!r} is of the height itself; leave out map")
    symbolic = "pysr" if method == "pysr" else "operon"
    search = None if method == "sindy" else Search(symbolic, functions, effort, seed)
    if method == "auto" and not has_operon():
        search = None
    return memory_discovery(
        records, search, terms=terms, derivative=derivative, force=target == "force",
        polish=polish, sparse=method in ("auto", "sindy"),
    )  # fmt: skip


def _check(
    method: str, form: str, target: str, degree: int, polish: int, ensemble: bool, effort: float
) -> None:
    for name, value, valid in (
        ("method", method, METHODS),
        ("form", form, ("weak", "strong")),
        ("target", target, ("acceleration", "height", "force")),
    ):
        if value not in valid:
            raise InputError(f"{name} = {quoted(value)}; give one of {', '.join(valid)}")
    if not isinstance(degree, int) or not 1 <= degree <= 5:
        raise InputError(f"degree = {quoted(degree)}; give a whole number from 1 to 5")
    if not isinstance(polish, int) or polish < 0:
        raise InputError(f"polish = {quoted(polish)}; give a whole number from 0 on")
    if not isinstance(effort, int | float) or not 0.0 < effort < math.inf:
        raise InputError(f"effort = {quoted(effort)}; give a number above 0")
    if method in ("auto", "sindy") and target == "height":
        raise InputError(
            "target = 'height' needs a symbolic method: give method 'operon' or 'pysr'"
        )
    if method not in ("auto", "sindy") and (ensemble or form != "weak"):
        raise InputError(
            f"form and ensemble belong to method 'sindy'; leave them out of {quoted(method)}"
        )


def _check_kinds(library: object, height_map: object, seed: object) -> None:
    names = [library] if isinstance(library, str) else library
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise InputError(f"library = {quoted(library)}; give a name, or several in a list")
    if not isinstance(seed, int) or not 0 <= seed <= _GREATEST_SEED:
        raise InputError(f"seed = {quoted(seed)}; give a whole number from 0 to {_GREATEST_SEED}")
    if isinstance(height_map, HeightMap):
        if not (math.isfinite(height_map.shift) and 0.0 < abs(height_map.scale) < math.inf):
            raise InputError(
                f"map has the shift {height_map.shift:g} and the scale {height_map.scale:g} m; "
                "give finite ones, and a scale that is not zero"
            )
    elif height_map != "auto":
        raise InputError(f"map = {quoted(height_map)}; give 'auto' or HeightMap(shift, scale)")


def _texts(texts: str | Sequence[str]) -> Sequence[str]:
    """Texts, or a single one, in a sequence."""
    return (texts,) if isinstance(texts, str) else texts


def _check_finite(weak: WeakForm, terms: Sequence[AnyTerm]) -> None:
    for motion in weak.motions:
        for term in terms:
            wrong = fault(motion, term)
            if wrong:
                low, high = motion.z.min(), motion.z.max()
                raise InputError(
                    f"the term {quoted(term.text)} {wrong} for z from {low:.3g} to "
                    f"{high:.3g}; leave it out, or give map=HeightMap(shift, scale)"
                )


def _words(method: str, form: str, ensemble: bool) -> str:
    if method == "auto":
        return "sindy and operon"
    if method != "sindy":
        return method
    return f"sindy, {form} form" + (", ensemble" if ensemble else "")
