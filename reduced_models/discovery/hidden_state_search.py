"""Structures with memory: sums of terms that hold a hidden state, whose values the record tells.

A hidden state is known along the record once its inner scales are: it follows from the heights
before. So it enters the terms as an input would, and all that judges sums of terms judges these as
well. The scales are those at which all terms together leave least, on a grid that is refined; each
is paid for as a term's number is.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from granular.shared.errors import InputError
from reduced_models.discovery.hidden_states import (
    DAMPER_STATES,
    HIDDEN_STATES,
    HiddenState,
    ScaledHiddenState,
)
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.structure_proposals import Study
from reduced_models.discovery.subset_selection import normalise_columns
from reduced_models.discovery.term_libraries import MEMORY, parse_custom_terms
from reduced_models.discovery.terms import AnyTerm
from reduced_models.discovery.weak_form import WeakForm, white_noise_weak_form

HIDDEN = "w"
"""Name of the hidden state's fraction of the force in own terms."""
PLAIN_TERMS = ("1", "z**-2", "z**-2.5", "z**-3", "z'", "z'/z", "abs(z')*z'", "sign(z')*z**-2.5")
"""Weight, the pressure of a bed that is squeezed, drag, and friction that grows with the pressure.
"""
DAMPER_TERMS = ("1", "z", "z**3", "z'", "abs(z')*z'", "sign(z')")
"""Springs, drag and dry friction of a damper on a stroke about zero."""
HIDDEN_TERMS = ("w", "w*z**-2", "w*z**-2.5", "w*z**-3")
_CLEAR = 10.0
"""Difference of criteria that is decisive (Kass & Raftery 1995)."""
_FAR = 10.0
"""Noise levels left by all terms together, from which on they are not weighed by that noise."""
_FINER = 9
"""Values of each scale on the finer grids."""
_ROUNDS = 2


def hidden_state_studies(weak: WeakForm, texts: Sequence[str], left_side: str) -> list[Study]:
    """Studies without a hidden state, and with each of them at the scales where all terms leave least."""
    # z is the height [m] here, since strains are meant.
    states: Sequence[HiddenState] = HIDDEN_STATES
    plain_texts: Sequence[str] = PLAIN_TERMS
    hidden_texts: Sequence[str] = HIDDEN_TERMS
    if any(motion.z.min() <= 0.0 for motion in weak.motions):
        if left_side != "force":
            raise InputError(
                f"library = {MEMORY!r} is about strains of a bed, but a height is not above zero; give "
                "heights above the floor"
            )
        states, plain_texts, hidden_texts = DAMPER_STATES, DAMPER_TERMS, (HIDDEN,)
    plain = parse_custom_terms(plain_texts, HIDDEN)
    known = tuple(dict.fromkeys((*plain, *parse_custom_terms((*hidden_texts, *texts), HIDDEN))))
    search = _ScaleSearch(weak, known, left_side)
    scaled = [search.study(state) for state in states]
    if left_side != "force" and min(misfit for _, misfit in scaled) > _FAR:
        search = _ScaleSearch(white_noise_weak_form(weak), known, left_side)
        scaled = [search.study(state) for state in states]
    stateless = Study(search.weak, tuple(item for item in known if not item.has_input), left_side)
    return [stateless, *(study for study, _ in scaled)]


class _ScaleSearch:
    """White columns of a weak form, of which those without a hidden state stay as they are."""

    def __init__(self, weak: WeakForm, known: tuple[AnyTerm, ...], left_side: str) -> None:
        self.weak, self.known, self.left_side = weak, known, left_side
        self.whitening = weak.whitening_matrix((), np.zeros(0))
        self.target = self.whitening @ weak.target
        self.fixed_columns = self.whitening @ weak.term_integral_matrix(
            [item for item in known if not item.has_input]
        )
        self.state_terms = [item for item in known if item.has_input]

    def best_scales(self, state: HiddenState, scales: np.ndarray) -> tuple[np.ndarray, float]:
        """Return those of the scales (k, s) that leave least, with all terms, and their misfit."""
        squares = []
        for item in _weak_form_with_state(self.weak, state, scales):
            columns = np.hstack(
                [self.fixed_columns, self.whitening @ item.term_integral_matrix(self.state_terms)]
            )
            columns, _ = normalise_columns(columns)
            left = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=1e-10)[0]
            squares.append(float(left @ left))
        best = int(np.argmin(squares))
        return scales[best], math.sqrt(squares[best] / max(1, len(self.target) - len(self.known)))

    def study(self, state: HiddenState) -> tuple[Study, float]:
        """Return the terms with a hidden state whose scales are refined on a grid, and their misfit."""
        scales = state.trial_scales * (self.weak.motions[0].period if state.in_periods else 1.0)
        lows, highs = scales.min(axis=0), scales.max(axis=0)
        best, misfit = self.best_scales(state, scales)
        values = [np.unique(column) for column in scales.T]
        width = np.array([float((item[1:] / item[:-1]).max()) for item in values])
        for _ in range(_ROUNDS):
            grid = best * width ** np.linspace(-1.0, 1.0, _FINER)[:, None]
            for k in range(len(best)):  # one scale after the other
                scales = np.tile(best, (_FINER, 1))
                scales[:, k] = np.clip(grid[:, k], lows[k], highs[k])
                best, misfit = self.best_scales(state, scales)
            width = width ** (2.0 / (_FINER - 1))
        weak = _weak_form_with_state(self.weak, state, best[None])[0]
        scaled = ScaledHiddenState(state, tuple(map(float, best)))
        return Study(weak, self.known, self.left_side, scaled), misfit


def _weak_form_with_state(weak: WeakForm, state: HiddenState, scales: np.ndarray) -> list[WeakForm]:
    """Weak form with the hidden state as its input, for each of the scales (k, s)."""
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


def memory_notes(groups: Sequence[Sequence[CandidateEquation]]) -> tuple[str, ...]:
    """Gain by the hidden state, and others that do as well, by the best sums without one and with each."""
    lead = min((group[0] for group in groups), key=lambda item: item.criterion)
    if lead.hidden_state is None:
        return ("no hidden state that was tried is worth its numbers: the law has no memory",)
    gain = groups[0][0].criterion - lead.criterion
    notes = [
        f"the force has memory: with a {lead.hidden_state.kind.name} the information criterion is "
        f"{gain:.4g} below that of the best sum without"
    ]
    alike = [
        group[0].hidden_state.kind.name
        for group in groups
        if group[0] is not lead
        and group[0].hidden_state is not None
        and group[0].criterion < lead.criterion + _CLEAR
    ]
    if alike:
        notes.append(f"the data cannot tell it from {', '.join(alike)}")
    return tuple(notes)
