"""Quality of a model's fit, and the directions that the data leave open."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Annotated

from reduced_models.models.plain_data import Interval, Probability, Size, SizeOrInfinity, TextForm

SURE = 1e-4
"""Probability below which residuals are not taken for white noise."""
_ANYTHING = 7.0  # of a logarithm: a factor of a thousand


@dataclasses.dataclass(frozen=True)
class ParameterDirection:
    """A direction in which the parameters can move without the data noticing."""

    powers: Mapping[str, float]  # joint change of the parameters: each as t to this power
    spread: Size  # standard deviation of log t that the data leave

    @property
    def is_undetermined(self) -> bool:
        """True if the data determine nothing along it."""
        return self.spread >= _ANYTHING

    def __str__(self) -> str:
        *most, last = self.powers
        names = f"{', '.join(most)} and {last}" if most else last
        together = "can be rescaled together" if most else "can be rescaled"
        if self.is_undetermined:
            words = f"not identifiable from this record: {names} {together}"
            return f"{words} without changing the fit"
        factor = f"{math.exp(self.spread):.2g}"
        return f"hardly identifiable from this record: {names} {together} by a factor of {factor}"


@dataclasses.dataclass(frozen=True)
class Quality:
    """Quality of a model's fit to the data.

    Attributes
    ----------
    residual : float
        Root mean square of height minus model over the record [m].
    relative : float
        The same over the rms swing of the record.
    test_error : float or None
        Rms error of the simulation over the test swings by a model that has not seen them, over the
        rms swing of the whole record; infinite where that model diverges. To be compared with
        ``test_error_at_rest``.
    test_swings : sequence of (float, float)
        Start and end of these swings, since the record's start [s]; one is the motion's end, where
        there are too few swings to spread them.
    starts, converged : int
        Random starts, and how many of them led to the best fit.
    samples : int
    solver_error : float
        Greatest difference of the solution that was fitted and an adaptive one at a tolerance of
        1e-10, over the amplitude.
    test_error_at_rest : float or None
        The same error of a piston that stays at the level of rest of the other samples: what a
        prediction has to beat.
    test_standard_error : float or None
        Standard error of ``test_error``, from how it differs between the swings; None for one.
    shifts : mapping of str to float
        How far period and damping ratio of the small swing at rest move, over themselves, where the
        test swings are left out of the fit: how much it matters what a law misses.
    noise : float
        Standard deviation of white noise in the record, from its third differences [m].
    correlation : float
        Integrated autocorrelation time of the residuals, in samples.
    collocation : str
        Result of a fit to accelerations in the record, which solves nothing: ``"same"`` fit,
        ``"worse"``, ``"better"`` (which is then this fit), or ``"none"`` where there is no such.
    whiteness, signs : float
        Probabilities that white noise is correlated as much as the residuals, and that its sign
        changes as seldom, or as often (tests of Dalla, Giraitis & Phillips, and of Wald & Wolfowitz).
    lag : float
        Time by which the solution comes late [s].
    slow, swinging : float
        Fraction of the residuals' power that is slower than the swing, and that is about as fast.
    drift : float
        Their slow power, over what white noise of the same power has there.
    """

    residual: Size
    relative: Size
    test_error: SizeOrInfinity | None
    test_swings: Sequence[Interval]
    starts: int
    converged: int
    samples: int
    solver_error: Size
    test_error_at_rest: Size | None = None
    test_standard_error: Size | None = None
    shifts: Mapping[str, Size] = dataclasses.field(default_factory=dict)
    noise: Size = 0.0
    correlation: Size = 1.0
    collocation: Annotated[str, TextForm(choices=("none", "same", "worse", "better"))] = "none"
    whiteness: Probability = 1.0
    signs: Probability = 1.0
    lag: float = 0.0
    slow: Size = 0.0
    swinging: Size = 0.0
    drift: Size = 1.0
    rounded: bool = False  # no residual exceeds the steps of a sensor that rounds
    zero_drift: Size = 0.0  # range of a fitted drift of the record's zero [m]

    @property
    def has_structured_residuals(self) -> bool:
        """True if the residuals are surely not white noise, so that the law is not right."""
        return not self.rounded and min(self.whiteness, self.signs) < SURE

    @property
    def test_swings_text(self) -> str:
        """Test samples that a law is judged on, in words."""
        if len(self.test_swings) > 1:
            return f"{len(self.test_swings)} swings"
        return "the end of the motion (too few swings to spread)"

    @property
    def figure_shifts_text(self) -> str:
        """Shifts of the figures without the test swings, in words; empty where none is known."""
        if not self.shifts:
            return ""
        moves = (f"{name.replace('_', ' ')} by {100.0 * by:.1g} %" for name, by in self.shifts.items())
        return f"; without {self.test_swings_text} the fit moves its {' and its '.join(moves)}"
