"""Discovery with memory: sums of terms that hold a hidden state, whose values the record tells.

A hidden state is known along the record once its inner scales are: it follows from the heights
before. So it enters the terms as an input would, and all that judges sums of terms judges these as
well. The scales are those at which all terms together leave least, on a grid that is refined; each
is paid for as a term's number is.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError
from reduced_models.discovery.choice import notes_on, polished_front
from reduced_models.discovery.force_form import force_form, without_noise
from reduced_models.discovery.hidden_states import HIDDEN_STATES, HiddenState, Memory
from reduced_models.discovery.libraries import MEMORY, own_terms
from reduced_models.discovery.motion import motion_of
from reduced_models.discovery.polishing import STARTS, law_of, parametrised, smoothed
from reduced_models.discovery.result import CandidateEquation, Discovery, pareto_front
from reduced_models.discovery.selection import Judge, Scored, all_subsets, scored
from reduced_models.discovery.structures import Search, candidate_of, symbolic_candidates
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm, weak_form
from reduced_models.fitting.fitting import fit
from reduced_models.laws.height_map import HeightMap
from reduced_models.records.derivatives import DerivativeMethod

HIDDEN = "w"
"""What own terms call what of the hidden states is in the force."""
PLAIN_TERMS = ("1", "z**-2", "z**-2.5", "z**-3", "z'", "z'/z", "abs(z')*z'", "sign(z')*z**-2.5")
"""Weight, the pressure of a bed that is squeezed, drag, and friction that grows with the pressure.
"""
HIDDEN_TERMS = ("w", "w*z**-2", "w*z**-2.5", "w*z**-3")
_CLEAR = 10.0
"""Difference of criteria that is decisive (Kass & Raftery 1995)."""
_FAR = 10.0
"""Noise levels left by the best sums, from which on they are not weighed by that noise."""
_FINER = 9
"""Values of each scale on the finer grids."""
_ROUNDS = 2
_RESOLUTION = 2
"""Of laws with a hidden state, in the steps of smooth ones."""
_KEPT = 20
"""Sums of each hidden state that are candidates."""


class _Judged(NamedTuple):
    """The best sums with one hidden state, or with none."""

    memory: Memory | None
    ranked: list[Scored]
    judge: Judge


def memory_discovery(
    records: Sequence[PistonRecord],
    search: Search | None,
    *,
    terms: Sequence[str] = (),
    derivative: DerivativeMethod = "savitzky-golay",
    force: bool = False,
    polish: int = 3,
    sparse: bool = True,
) -> Discovery:
    """Equations with hidden states, as `discover` gives them; z is the height [m].

    Parameters
    ----------
    records : sequence of PistonRecord
        Of beds without strain at their starts.
    search : Search, optional
        Of a symbolic regression of F(z, z', w), with the hidden state that sums need.
    terms : sequence of str
        Own terms beside those of the library, in z, z' and w.
    derivative : str
        Estimator of z'.
    force : bool
        Explain the measured force [N] and not z''; such equations are not polished.
    polish : int
        How many of the best are fitted through their differential equations.
    sparse : bool
        Whether sums of terms are candidates, beside what a search proposes.

    Raises
    ------
    InputError
        If a height is not above zero, a record of measured force has none, or a text is no term.
    """
    if any(one.height.min() <= 0.0 for one in records):
        raise InputError(
            f"library = {MEMORY!r} is about strains of a bed, but a height is not above zero; give "
            "heights above the floor"
        )
    motions = [motion_of(one, HeightMap(), derivative) for one in records]
    weak = force_form(records, motions) if force else weak_form(*motions)
    plain = tuple(own_terms(PLAIN_TERMS, HIDDEN))
    more = tuple(own_terms((*HIDDEN_TERMS, *terms), HIDDEN))
    known = (*plain, *(one for one in more if one not in plain))
    judged = _all(weak, known)
    excess = min(one.judge.excess for one in judged)
    if not force and excess > _FAR**2:
        judged = _all(without_noise(weak), known)
        excess = min(one.judge.excess for one in judged)
    # All in one unit of misfit: that of the hidden state with which least is left.
    groups = [_candidates(one, excess) for one in judged]
    best = min(range(len(judged)), key=lambda k: groups[k][0].criterion)
    candidates = [one for group in groups for one in group] if sparse else []
    if search is not None:
        candidates += _searched(judged[best], known, search, excess)
    chosen_state = judged[best]
    own = [one for one in candidates if _kind(one) == _kind(groups[best][0])]
    front, chosen = polished_front(
        own,
        lambda one: _polished(_remembered(one, chosen_state), records),
        0 if force else polish,
        dataclasses.replace(chosen_state.judge, excess=excess),
    )
    front, chosen = _with_others(front, chosen, candidates, force)
    notes = (*_notes(groups, best), *notes_on(front[chosen], judged[best].judge))
    searches = ("sindy" if sparse else "", "" if search is None else search.method)
    method = " and ".join(name for name in searches if name)
    left = "force" if force else "z''"
    return Discovery(
        f"{method}, with memory, {left}", tuple(front), chosen, HeightMap(), notes=notes
    )


def _all(weak: WeakForm, known: Sequence[AnyTerm]) -> list[_Judged]:
    """The best sums without a hidden state, and with each of them."""
    still = tuple(one for one in known if not one.driven)
    white = _White(weak, known)
    return [
        _Judged(None, *scored(weak, still, still, all_subsets(len(still)))),
        *(_with(state, white, known) for state in HIDDEN_STATES),
    ]


class _White:
    """White columns of a weak form, of which those without a hidden state stay as they are."""

    def __init__(self, weak: WeakForm, known: Sequence[AnyTerm]) -> None:
        self.weak = weak
        self.whitening = weak.whitening((), np.zeros(0))
        self.target = self.whitening @ weak.target
        self.still = self.whitening @ weak.matrix([one for one in known if not one.driven])
        self.driven = [one for one in known if one.driven]

    def least(self, state: HiddenState, scales: np.ndarray) -> int:
        """Which of the scales (k, s) leaves the least squares, with all terms."""
        squares = []
        for one in _strained(self.weak, state, scales):
            columns = np.hstack([self.still, self.whitening @ one.matrix(self.driven)])
            columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
            left = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=1e-10)[0]
            squares.append(float(left @ left))
        return int(np.argmin(squares))


def _with(state: HiddenState, white: _White, known: Sequence[AnyTerm]) -> _Judged:
    """The best sums with a hidden state, at the scales where all terms together leave least."""
    weak = white.weak
    scales = state.tried(weak.motions[0].period)
    lows, highs = scales.min(axis=0), scales.max(axis=0)
    best = scales[white.least(state, scales)]
    width = _ratio(scales)
    for _ in range(_ROUNDS):
        grid = best * width ** np.linspace(-1.0, 1.0, _FINER)[:, None]
        for place in range(len(best)):  # one scale after the other
            scales = np.tile(best, (_FINER, 1))
            scales[:, place] = np.clip(grid[:, place], lows[place], highs[place])
            best = scales[white.least(state, scales)]
        width = width ** (2.0 / (_FINER - 1))
    strained = _strained(weak, state, best[None])[0]
    ranked, judge = scored(strained, known, known, all_subsets(len(known)))
    return _Judged(Memory(state, tuple(map(float, best))), ranked, judge)


def _ratio(scales: np.ndarray) -> np.ndarray:
    """Of neighbours on the first grid, scale by scale."""
    different = [np.unique(scales[:, place]) for place in range(scales.shape[1])]
    return np.array([float((one[1:] / one[:-1]).max()) for one in different])


def _strained(weak: WeakForm, state: HiddenState, scales: np.ndarray) -> list[WeakForm]:
    """The weak form with the hidden state as its input, for each of the scales (k, s)."""
    values = [state.values(one.time, one.smooth, scales) for one in weak.motions]
    return [
        WeakForm(
            tuple(
                dataclasses.replace(part, motion=part.motion._replace(drive=value[k]))
                for part, value in zip(weak.parts, values, strict=True)
            )
        )
        for k in range(len(scales))
    ]


def _candidates(judged: _Judged, excess: float) -> list[CandidateEquation]:
    """The best sums first, with the criterion that counts inner scales as numbers."""
    found = []
    judge = dataclasses.replace(judged.judge, excess=excess)
    for one in judged.ranked:
        count = len(one.terms)
        # A sum that does not hold the hidden state is one without memory.
        if judged.memory is not None and not any(term.driven for term in one.terms):
            continue
        squares = one.misfit**2 * max(1, judge.rows - count)
        found.append(
            _remembered(
                dataclasses.replace(candidate_of(one), criterion=judge.criterion(squares, count)),
                judged,
            )
        )
    return sorted(found, key=lambda one: one.criterion)[:_KEPT]


def _remembered(candidate: CandidateEquation, judged: _Judged) -> CandidateEquation:
    """A candidate with its hidden state, whose scales cost what other numbers do."""
    if judged.memory is None or candidate.memory is not None:
        return candidate
    count = len(judged.memory.scales)
    return dataclasses.replace(
        candidate,
        memory=judged.memory,
        complexity=candidate.complexity + count,
        criterion=candidate.criterion + count * math.log(judged.judge.weak.samples),
    )


def _searched(
    judged: _Judged, known: Sequence[AnyTerm], search: Search, excess: float
) -> list[CandidateEquation]:
    """What a symbolic regression proposes, with the hidden state as a variable."""
    weak = judged.judge.weak
    if judged.memory is None:
        return []
    terms = [one for one in known if one.driven or one.still]
    found, _ = symbolic_candidates(weak, terms, search)
    judge = dataclasses.replace(judged.judge, excess=excess)
    rows = judge.rows
    candidates = []
    for one in found:
        count = len(parametrised(one.expression)[1])
        squares = one.error**2 * max(1, rows - count)
        again = dataclasses.replace(one, criterion=judge.criterion(squares, count))
        candidates.append(_remembered(again, judged))
    return candidates


def _with_others(
    front: Sequence[CandidateEquation], chosen: int, candidates: list[CandidateEquation],
    force: bool,
) -> tuple[list[CandidateEquation], int]:  # fmt: skip
    """The front beside the best sums with other hidden states, and the place of the choice."""
    rest = [one for one in pareto_front(candidates) if _kind(one) != _kind(front[chosen])]
    shown = sorted([*front, *rest], key=lambda one: (one.complexity, -one.error))
    place = next(k for k, one in enumerate(shown) if one is front[chosen])
    if force:
        shown = [dataclasses.replace(one, left="force") for one in shown]
    return shown, place


def _kind(candidate: CandidateEquation) -> str:
    return "" if candidate.memory is None else candidate.memory.state.name


def _polished(candidate: CandidateEquation, records: Sequence[PistonRecord]) -> CandidateEquation:
    """A candidate with all numbers, those of the hidden state too, fitted to the motion."""
    import sympy

    template, values = parametrised(candidate.expression)
    memory = candidate.memory
    if memory is not None:
        values |= dict(zip(memory.state.scales, memory.scales, strict=True))
    law = law_of(smoothed(template, records, HeightMap()), values)
    if memory is not None:
        law = dataclasses.replace(
            law,
            name=f"discovered, with a {memory.state.name}",
            equation=memory.state.within(law.equation),
            positive=memory.state.scales,
            resolution=max(_RESOLUTION, law.resolution),
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # notes stand in the model
            models = fit(list(records), law, map=HeightMap(), starts=STARTS, holdout=0.0)
    except GranularError as error:
        return dataclasses.replace(candidate, note=str(error))
    numbers = models[0].parameters
    expression = template.xreplace(
        {one: sympy.Float(numbers[one.name]) for one in template.free_symbols if one.name in values}
    )
    if memory is not None:
        memory = memory._replace(scales=tuple(numbers[name] for name in memory.state.scales))
    return dataclasses.replace(candidate, expression=expression, models=models, memory=memory)


def _notes(groups: Sequence[Sequence[CandidateEquation]], best: int) -> tuple[str, ...]:
    """What the hidden state buys, and which others do as well."""
    lead = groups[best][0]
    if lead.memory is None:
        return ("no hidden state that was tried is worth its numbers: the law has no memory",)
    gain = groups[0][0].criterion - lead.criterion
    notes = [
        f"the force has memory: with a {lead.memory.state.name} the information criterion is "
        f"{gain:.4g} below that of the best sum without"
    ]
    alike = [
        group[0].memory.state.name
        for group in groups
        if group[0] is not lead
        and group[0].memory is not None
        and group[0].criterion < lead.criterion + _CLEAR
    ]
    if alike:
        notes.append(f"the data cannot tell it from {', '.join(alike)}")
    return tuple(notes)
