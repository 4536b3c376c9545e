"""`discover`: the equation of a record, by sparse or by symbolic regression."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from reduced_models.discovery.choice import notes_on, polished_front
from reduced_models.discovery.evidence import evidence
from reduced_models.discovery.libraries import PHYSICAL, functions_named, own_terms, terms_named
from reduced_models.discovery.motion import map_of, motion_of
from reduced_models.discovery.polishing import polished
from reduced_models.discovery.proposal import AUTO, proposed
from reduced_models.discovery.result import Discovery
from reduced_models.discovery.selection import scored
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
    target: Literal["acceleration", "height"] = "acceleration",
    map: HeightMap | Literal["auto"] = "auto",  # noqa: A002
    polish: int = 3,
    effort: float = 1.0,
    seed: int = 0,
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
    target : "acceleration" or "height"
        z'' or, for symbolic regression of one record, z(t) itself. The latter is not polished.
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
    automatic = library in (AUTO, (AUTO,), [AUTO])
    known = tuple(own_terms(terms, input)) if automatic else terms_named(
        library, terms, degree, input
    )  # fmt: skip
    allowed = functions_named(functions, method)
    records = [record] if isinstance(record, PistonRecord) else list(record)
    if not records:
        raise InputError("there is no record to discover a law in; give at least one")
    if target == "height" and len(records) > 1:
        raise InputError(f"target = 'height' is of one record, not of {len(records)}; give one")
    lacking = method == "auto" and not has_operon()
    if lacking and functions:
        raise InputError(f"functions need symbolic regression, but {_NO_OPERON}")
    if method == "pysr":
        from reduced_models.discovery.julia import require_julia

        require_julia()
    own = bool(terms) or not (automatic or library in (PHYSICAL, (PHYSICAL,), [PHYSICAL]))
    height_map = HeightMap() if own and map == "auto" else map_of(records, map)
    if target == "height":
        from reduced_models.discovery.height import height_equations

        return height_equations(records[0], method, height_map, effort, seed)
    proposal_note = ""
    if automatic:
        proposal = proposed(records, derivative, input, height_map if own else map, degree)
        height_map, weak, proposal_note = proposal.map, proposal.weak, proposal.note
        known = (*proposal.terms, *(one for one in known if one not in proposal.terms))
    else:
        weak = weak_form(*(motion_of(each, height_map, derivative, input) for each in records))
    _check_finite(weak, known)
    inclusion: dict[str, float] = {}
    supports: list[np.ndarray] = []
    if method in ("auto", "sindy"):
        supports, inclusion = sindy_supports(weak, known, form, ensemble, seed)
    if method == "sindy" or lacking:
        method = "sindy"
        ranked, judge = scored(weak, known, known, supports)
        candidates = [candidate_of(one) for one in ranked]
    else:
        symbolic = "pysr" if method == "pysr" else "operon"
        search = Search(symbolic, allowed, effort, seed)
        candidates, judge = symbolic_candidates(weak, known, search, supports)
    name = f"discovered by {_words(method, form, ensemble)}"
    front, chosen = polished_front(
        candidates,
        lambda one: polished(one, records, height_map, input, seed, name),
        polish,
        judge,
    )
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


def _check(
    method: str, form: str, target: str, degree: int, polish: int, ensemble: bool, effort: float
) -> None:
    for name, value, valid in (
        ("method", method, METHODS),
        ("form", form, ("weak", "strong")),
        ("target", target, ("acceleration", "height")),
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
