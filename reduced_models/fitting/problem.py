"""The problem that a fit solves: data of the records, and options with defaults and limits.

One search vector describes all records: first the shared parameters, then the parameters and initial
state of each record.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral, Real
from typing import Literal, get_args

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote, unknown_word_message
from reduced_models.fitting.fit_data import FitData, Selection
from reduced_models.fitting.levenberg_marquardt import (
    Normal,
    NormalPrior,
    SearchBounds,
    levenberg_marquardt_vectors_and_costs,
)
from reduced_models.fitting.parameter import Pairs, SearchUnknowns, parse_si_number
from reduced_models.fitting.residuals import LOSSES
from reduced_models.laws.law import Law
from reduced_models.records.inputs import INTERPOLATIONS, Interpolation
from reduced_models.records.sensor import Sensor, SensorQuantity

Intervals = Literal["linear", "profile"]

_REFIT_PATIENCE = 2  # trials without a gain after which a search that starts near its minimum ends
_REFIT_DAMPING = 1e-6  # initial damping of a search that starts near its minimum


@dataclasses.dataclass(frozen=True, eq=False)
class FitProblem:
    """Data to fit together, and the options of the fit; see `reduced_models.fitting.fit.fit`."""

    data: tuple[FitData, ...]
    bounds: Pairs = dataclasses.field(default_factory=dict)  # bounds of the parameters of all records
    start: Mapping[str, float] = dataclasses.field(default_factory=dict)  # given start values of parameters
    known_noise: bool = False
    starts: int = 1
    confidence: float = 0.95
    intervals: Intervals = "linear"
    seed: int = 0
    notes: tuple[str, ...] = ()  # notes on the data
    # Quantities that the signal does not determine: "level", the equilibrium height; "size", the amplitude.
    unidentified: tuple[str, ...] = ()

    @property
    def unknowns(self) -> SearchUnknowns:
        """Law and scales that all records share."""
        return self.data[0].unknowns

    @property
    def law(self) -> Law:
        """Law that is fitted."""
        return self.unknowns.law

    @property
    def largest_amplitude_data(self) -> FitData:
        """Data of the record with the largest amplitude."""
        return max(self.data, key=lambda data: data.guess.amplitude)

    @property
    def training_sample_counts(self) -> tuple[int, ...]:
        """Number of samples in each training segment."""
        return tuple(data.training for data in self.data)

    def with_data(self, data: Iterable[FitData]) -> FitProblem:
        """Return this problem with other data."""
        return dataclasses.replace(self, data=tuple(data))

    def with_scales(self, unknowns: SearchUnknowns) -> FitProblem:
        """Return the problem in the given scales; observed columns keep the scale of their signal."""
        return self.with_data(
            dataclasses.replace(
                data,
                unknowns=dataclasses.replace(
                    unknowns, observation=data.unknowns.observation, signal=data.unknowns.signal
                )
                if data.unknowns.observation
                else unknowns,
            )
            for data in self.data
        )

    @functools.cached_property
    def search_bounds(self) -> SearchBounds:
        """Lower and upper bounds (q,) of the search vector; the two are equal for fixed entries."""
        edges = [data.search_bounds for data in self.data]
        return SearchBounds(*(self.joint_vector(side) for side in zip(*edges, strict=True)))

    @property
    def held_entry_mask(self) -> np.ndarray:
        """Mask (q,) that is true for the fixed entries of the search vector."""
        return np.asarray(self.search_bounds.low == self.search_bounds.high)

    def joint_vector(self, vectors: Sequence[np.ndarray]) -> Float[np.ndarray, "... q"]:
        """Join the records' search vectors; shared entries are taken from the first record."""
        result = np.empty((*vectors[0].shape[:-1], self._search_vector_length))
        for vector, data in zip(reversed(vectors), reversed(self.data), strict=True):
            result[..., data.joint_vector_indices] = vector
        return result

    @property
    def _search_vector_length(self) -> int:
        return 1 + max(int(data.joint_vector_indices.max()) for data in self.data)

    def prior(self, samples: float) -> NormalPrior:
        """Return the prior for a search whose cost is a sum over a number of samples."""
        return NormalPrior(self.joint_vector([self.unknowns.prior_precisions] * len(self.data)), samples)

    def residuals(self, theta: Float[np.ndarray, "q"]) -> list[np.ndarray]:
        """Residuals (n,) of each record, in units of its amplitude."""
        return [data.residuals(theta[data.joint_vector_indices]) for data in self.data]

    def make_sum_of_normal_equations(self, normals: Sequence[Normal]) -> Normal:
        """Return the sum of the records' normal equations for the joint search vector."""
        size = self._search_vector_length

        def normal_equations(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            count = len(theta)
            cost, gradient = np.zeros(count), np.zeros((count, size))
            matrix = np.zeros((count, size, size))
            for data, record_normal in zip(self.data, normals, strict=True):
                here = data.joint_vector_indices
                cost_of_record, gradient_of_record, matrix_of_record = map(
                    np.asarray, record_normal(theta[:, here])
                )
                cost += cost_of_record
                gradient[:, here] += gradient_of_record
                matrix[:, here[:, None], here] += matrix_of_record
            return cost, gradient, matrix

        return normal_equations

    def make_normal_equations(self, selections: Sequence[Selection] | None = None) -> Normal:
        """Return the normal equations of selected samples of each record, or of all samples."""
        chosen = selections or [None] * len(self.data)
        normals = [data.make_normal_equations(here) for data, here in zip(self.data, chosen, strict=True)]
        return self.make_sum_of_normal_equations(normals)

    def normal_matrix(self, theta: Float[np.ndarray, "q"]) -> Float[np.ndarray, "q q"]:
        """Matrix J'J of all samples of all records."""
        return np.asarray(self.make_normal_equations()(theta[None])[2][0])

    def refit(
        self, theta: Float[np.ndarray, "q"], selections: Sequence[int | np.ndarray], tolerance: float = 1e-11
    ) -> Float[np.ndarray, "q"]:
        """Fit selected samples of each record, from a search vector (q,) near the minimum."""
        theta, _ = levenberg_marquardt_vectors_and_costs(
            self.make_normal_equations(selections),
            theta[None],
            self.prior(float(sum(np.sum(here) for here in selections))),
            tolerance,
            self.search_bounds,
            damping=_REFIT_DAMPING,
            patience=_REFIT_PATIENCE,
        )
        return np.asarray(theta[0])


STARTS = 16
TEST_FRACTION = 0.3
MAXIMUM_STARTS = 10_000
"""Maximum number of starts; a tenth of it already takes minutes for a short record."""

Initial = Literal["free", "rest"] | Mapping[str, float | str] | PistonRecord | Sequence[PistonRecord]


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """Less common options of `fit`: how a law and its records are interpreted.

    Parameters
    ----------
    drift : bool, optional
        Whether the zero of the records may drift, as a random walk. If true, intervals allow for the
        drift. By default a drift is fitted if the residuals are white noise plus a random walk, and
        a note reports the drift.
    input_interpolation : str, optional
        Interpolation of inputs between samples: ``"spline"``, ``"linear"``, ``"previous"`` (the
        last value is held) or ``"band-limited"``; by default the one with the smallest held-out
        error.
    measured : str or Sensor, optional
        Quantity that is compared with the law: ``"height"``, ``"velocity"``, ``"acceleration"`` or
        ``"base_force"``, or a `Sensor` with gain, offset and filter; by default the quantity that the
        record contains. If this quantity does not determine the equilibrium height, heights are
        measured from equilibrium. With ``"force"``, the heights of a record are a prescribed stroke,
        and a law of the force is fitted, see `fit`.
    initial : "rest", "free", mapping of str to float, or PistonRecord, optional
        Initial state. ``"rest"``: the velocity is zero. ``"free"``: everything is fitted, including
        hidden states. A mapping gives a number or ``"free"`` for ``height`` [m], ``velocity`` [m/s]
        and hidden states by name. A record gives the motion before the fitted record, up to the
        start of the fitted record; hidden states are integrated along this earlier motion. For several
        fitted records give a list of earlier motions. By default height and velocity are fitted and
        hidden states are zero.

    Raises
    ------
    InputError
        If the interpolation, the measured quantity or the word for the initial state is not one of
        these.

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
            _check_choice("input_interpolation", self.input_interpolation, INTERPOLATIONS)
        if isinstance(self.measured, str):
            _check_choice("measured", self.measured, get_args(SensorQuantity))
        if isinstance(self.initial, str) and self.initial not in ("rest", "free"):
            raise InputError(
                f"initial = {quote(self.initial)}; give 'rest', 'free', numbers by name, "
                "or the record of the preceding motion"
            )


def check_fit_options(
    starts: int = STARTS,
    test_fraction: float = TEST_FRACTION,
    confidence: float = 0.95,
    intervals: str = "linear",
    loss: str = "linear",
    seed: int = 0,
) -> None:
    """Check that the options of `fit` are within their ranges."""
    if not isinstance(starts, int) or isinstance(starts, bool) or not 1 <= starts <= MAXIMUM_STARTS:
        raise InputError(f"starts = {quote(starts)}; give an integer from 1 to {MAXIMUM_STARTS}")
    if not isinstance(test_fraction, Real) or not 0.0 <= float(test_fraction) <= 0.9:
        raise InputError(f"test_fraction = {quote(test_fraction)}; give a fraction from 0 to 0.9")
    if not isinstance(confidence, Real) or not 0.0 < float(confidence) < 1.0:
        raise InputError(f"confidence = {quote(confidence)}; give a fraction between 0 and 1")
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError(f"seed = {quote(seed)}; give an integer from 0 on")
    _check_choice("intervals", intervals, get_args(Intervals))
    _check_choice("loss", loss, LOSSES)


def _check_choice(name: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise InputError(f"{name} = {quote(value)}; give {', '.join(map(repr, known[:-1]))} or {known[-1]!r}")


def prescribed_initial_state(law: Law, initial: object) -> dict[str, float]:
    """Return the given initial height [m], velocity [m/s] and hidden states by name; others are free."""
    # Other coordinates have free initial states; so have hidden states along a stroke, since it may have
    # begun in any state.
    free = law.hidden if law.prescribed else law.other_coordinates
    at_zero = {name: 0.0 for name in law.hidden if name not in free}
    if initial is None:
        return at_zero
    if initial == "free":
        return {}
    if initial == "rest":
        speeds = (name for name in law.other_coordinates if name.endswith("_first"))
        return {"velocity": 0.0, **at_zero, **dict.fromkeys(speeds, 0.0)}
    names = ("height", "velocity", *law.hidden)
    if not isinstance(initial, Mapping):
        raise InputError(
            f"initial = {quote(initial)}; give 'rest', 'free', numbers by name (for "
            f"{', '.join(names)}), or the record of the preceding motion"
        )
    result = dict(at_zero)
    for name, value in initial.items():
        if name not in names:
            raise InputError(unknown_word_message(str(name), names, "state at the start"))
        if value == "free":
            result.pop(name, None)
        else:
            result[name] = parse_si_number(f"initial {name}", value, "")
    return result
