"""Options of a fit, checked before anything is computed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Literal, get_args

from granular.records.record import PistonRecord
from granular.shared.errors import InputError
from granular.shared.message_text import quote, unknown_word_message
from reduced_models.fitting.parameter import si_number
from reduced_models.fitting.problem import Intervals
from reduced_models.fitting.residuals import LOSSES
from reduced_models.laws.law import Law
from reduced_models.records.inputs import INTERPOLATIONS, Interpolation
from reduced_models.records.sensor import Sensor, SensorQuantity

STARTS = 16
TEST_FRACTION = 0.3
MOST_STARTS = 10_000
"""Ten times a thousand, with which a short record takes minutes."""

Initial = Literal["free", "rest"] | Mapping[str, float | str] | PistonRecord | Sequence[PistonRecord]


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """Rare options of `fit`: how a law and its records are read.

    Parameters
    ----------
    drift : bool, optional
        Whether the records' zero may drift, as a random walk; intervals then allow for it. If not
        given, it may where the residuals are such a walk next to white noise, and a note says so.
    input_interpolation : str, optional
        What an input does between samples: ``"spline"``, ``"linear"``, ``"previous"`` (it keeps its
        last value) or ``"band-limited"``; otherwise that with the least held-out error.
    measured : str or Sensor, optional
        What is compared: ``"height"``, ``"velocity"``, ``"acceleration"`` or ``"base_force"``, or a
        `Sensor` with gain, offset and filter; that of which the record holds the measurement if not
        given. Where it does not tell the level of rest, heights count from there. ``"force"`` of a
        record with heights: these are prescribed, and laws of the force are fitted, see
        `fit`.
    initial : "rest", "free", mapping of str to float, or PistonRecord, optional
        The start of the motion: at velocity zero, or free with the hidden states too, or numbers
        (or ``"free"``) for ``height`` [m], ``velocity`` [m/s] and hidden states by name. Or the
        record of the motion before, that ends where this one begins (for several records a list of
        such): hidden states are carried along it. Otherwise height and velocity are free, and
        hidden states are zero.

    Raises
    ------
    InputError
        If the interpolation, what is measured or a word for the start is none of these.

    Examples
    --------
    >>> from reduced_models import FitOptions
    >>> FitOptions(initial="rest").drift is None
    True
    """

    drift: bool | None = None
    input_interpolation: Interpolation | None = None
    measured: SensorQuantity | Sensor | None = None
    initial: Initial | None = None

    def __post_init__(self) -> None:
        if self.input_interpolation is not None:
            _check_word("input_interpolation", self.input_interpolation, INTERPOLATIONS)
        if isinstance(self.measured, str):
            _check_word("measured", self.measured, get_args(SensorQuantity))
        if isinstance(self.initial, str) and self.initial not in ("rest", "free"):
            raise InputError(
                f"initial = {quote(self.initial)}; give 'rest', 'free' or numbers by name, "
                "or the motion before"
            )


def check_fit_options(
    starts: int = STARTS,
    test_fraction: float = TEST_FRACTION,
    confidence: float = 0.95,
    intervals: str = "linear",
    loss: str = "linear",
    seed: int = 0,
) -> None:
    """Check that the options of `fit` are in their ranges."""
    if not isinstance(starts, int) or isinstance(starts, bool) or not 1 <= starts <= MOST_STARTS:
        raise InputError(f"starts = {quote(starts)}; give an integer from 1 to {MOST_STARTS}")
    if not isinstance(test_fraction, Real) or not 0.0 <= float(test_fraction) <= 0.9:
        raise InputError(f"test_fraction = {quote(test_fraction)}; give a fraction from 0 to 0.9")
    if not isinstance(confidence, Real) or not 0.0 < float(confidence) < 1.0:
        raise InputError(f"confidence = {quote(confidence)}; give a fraction between 0 and 1")
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError(f"seed = {quote(seed)}; give an integer from 0 on")
    _check_word("intervals", intervals, get_args(Intervals))
    _check_word("loss", loss, LOSSES)


def _check_word(name: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise InputError(f"{name} = {quote(value)}; give {', '.join(map(repr, known[:-1]))} or {known[-1]!r}")


def prescribed_initial_state(law: Law, initial: object) -> dict[str, float]:
    """Given height, velocity and hidden states at the start by name; the rest is free [m, m/s]."""
    # Other coordinates have starts of their own; so have hidden states along a stroke, which may have begun
    # anywhere.
    free = law.hidden if law.prescribed else law.other_coordinates
    still = {name: 0.0 for name in law.hidden if name not in free}
    if initial is None:
        return still
    if initial == "free":
        return {}
    if initial == "rest":
        speeds = (name for name in law.other_coordinates if name.endswith("_first"))
        return {"velocity": 0.0, **still, **dict.fromkeys(speeds, 0.0)}
    names = ("height", "velocity", *law.hidden)
    if not isinstance(initial, Mapping):
        raise InputError(
            f"initial = {quote(initial)}; give 'rest', 'free' or numbers by name, for "
            f"{', '.join(names)}, or the motion before"
        )
    result = dict(still)
    for name, value in initial.items():
        if name not in names:
            raise InputError(unknown_word_message(str(name), names, "state at the start"))
        if value == "free":
            result.pop(name, None)
        else:
            result[name] = si_number(f"initial {name}", value, "")
    return result
