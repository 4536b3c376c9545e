"""Harmonic response of a bed to a steady drive, and hysteresis of its compression cycles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.observables.forces import piston_force
from granular.observables.frame import checked_series, labelled_columns
from granular.schema.cell import piston_wall_key
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError, unknown_word_message

if TYPE_CHECKING:
    import xarray

    from granular.protocol import Oscillate, Push
    from granular.run.trajectory import Trajectory


# The errors come from the scatter between periods: two periods leave one degree of freedom.
MINIMUM_PERIODS = 3
"""Minimum number of complete periods after the transient."""


class HarmonicResponse(NamedTuple):
    """Response mean + sum_k ratio_k U cos(k p + phase_k) to a drive U cos(p), for k = 1 ... K."""

    frequency: float  # [Hz]
    harmonics: Int[np.ndarray, "K"]
    ratio: Float[np.ndarray, "K"]  # amplitude/U, in units of the response divided by units of the drive
    phase: Float[np.ndarray, "K"]  # from -pi to pi; negative if the response lags [rad]
    ratio_error: Float[np.ndarray, "K"]  # standard error, in the unit of ``ratio``
    phase_error: Float[np.ndarray, "K"]  # standard error [rad]; infinite if the ratio is 0
    drive_amplitude: float  # U, in the unit of the drive
    periods: int  # number of whole periods used


def harmonic_response(
    time: np.ndarray,
    drive: np.ndarray,
    response: np.ndarray,
    frequency: float,
    harmonics: int = 3,
    discard: float | None = None,
) -> HarmonicResponse:
    """Amplitude ratio and phase of a response to a sinusoidal drive.

    Mean, linear drift and harmonics are fitted together by least squares, as in the sine fits of IEEE Std
    1057. The fit uses all complete periods after the transient, counted back from the end of the record.
    Standard errors are computed from the scatter between periods, which are assumed independent. A remaining
    transient increases these errors.

    Parameters
    ----------
    time : float (n,)
        Times [s], finite and not decreasing, evenly spaced or nearly so.
    drive, response : float (n,)
        Drive and response at these times, finite, in any units.
    frequency : float
        Frequency of the drive [Hz], above 0.
    harmonics : int
        Number K of the highest fitted harmonic, 1 or more.
    discard : float, optional
        Length of the initial transient to be discarded [s], 0 or more; half of the record if not given.

    Returns
    -------
    HarmonicResponse
        Amplitude ratio (K,) and phase (K,) [rad] of each harmonic, with standard errors. Ratios are in units
        of the response divided by units of the drive. The error of a phase is infinite if the ratio is 0.

    Raises
    ------
    InputError
        If the shapes differ or are not (n,), there are no samples, or a value, ``frequency``, ``harmonics``
        or ``discard`` is outside its limits. Also if fewer than `MINIMUM_PERIODS` complete periods remain, a
        period has fewer than 2 K + 3 samples, or the drive has no amplitude at the frequency.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import harmonic_response
    >>> time = np.linspace(0.0, 10.0, 5000)
    >>> drive = np.sin(2 * np.pi * 3.0 * time)
    >>> found = harmonic_response(time, drive, 0.5 * np.roll(drive, 10), 3.0)
    >>> round(float(np.ravel(found.ratio)[0]), 2)
    0.5
    """
    time, drive, response = checked_series("time, drive and response", time, drive, response)
    if not all(np.isfinite(series).all() for series in (time, drive, response)):
        raise InputError("a value of time, drive or response is not finite; remove such samples")
    if (np.diff(time) < 0.0).any():
        raise InputError("time decreases; sort the samples by time")
    if discard is not None and not 0.0 <= discard < np.inf:
        raise InputError(f"discard = {discard:g} s; 0 s or more is needed")
    if harmonics < 1 or not 0.0 < frequency < np.inf:
        raise InputError(
            f"harmonics = {harmonics}, frequency = {frequency:g} Hz; harmonics must be 1 or more, and "
            "the frequency above 0 Hz"
        )
    periods = _count_whole_periods(time, frequency, discard)
    chosen = time > time[-1] - (periods - 1e-9) / frequency
    time, drive, response = time[chosen], drive[chosen], response[chosen]
    # Two unknowns per harmonic, a mean and a drift, and one extra sample.
    minimum = 2 * harmonics + 3
    if len(time) < periods * minimum:
        raise InputError(
            f"{len(time) / periods:.3g} samples per period; {harmonics} harmonics need {minimum} or more; "
            "record more often, or reduce harmonics"
        )
    # If time is measured from the middle of the window, the drift is independent of the other terms.
    middle = time[-1] - 0.5 * periods / frequency
    centred_time = time - middle
    drive_harmonics, drive_drift = _harmonic_amplitudes_and_drift(centred_time, drive, frequency, harmonics)
    response_harmonics, response_drift = _harmonic_amplitudes_and_drift(
        centred_time, response, frequency, harmonics
    )
    transfer = _relative_response_harmonics(drive_harmonics, response_harmonics)
    # Without drift: within one period a drift and a sine are too similar to be fitted together.
    period_transfers = _relative_response_harmonics_by_period(
        centred_time,
        drive - drive_drift * centred_time,
        response - response_drift * centred_time,
        frequency,
        harmonics,
        periods,
    )
    along, across = _errors_of_ratio_and_phase(transfer, period_transfers)
    ratio = np.abs(transfer)
    with np.errstate(divide="ignore", invalid="ignore"):
        phase_error = np.where(ratio > 0.0, across / ratio, np.inf)
    return HarmonicResponse(
        frequency=float(frequency),
        harmonics=np.arange(1, harmonics + 1),
        ratio=ratio,
        phase=np.angle(transfer),
        ratio_error=along,
        phase_error=phase_error,
        drive_amplitude=float(np.abs(drive_harmonics[0])),
        periods=periods,
    )


def stage_response(
    run: Trajectory, stage: str | None = None, harmonics: int = 3, discard: float | None = None
) -> xarray.Dataset:
    """Harmonic response in a stage with a sinusoidal force on the piston or a sinusoidal piston motion.

    In a ``push`` stage the drive is the external force and the response is the piston's height (ratio in
    m/N). In an ``oscillate`` stage the drive is the height and the response is the force of the grains on the
    piston (ratio in N/m). `harmonic_response` fits the sines as in IEEE Std 1057.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    stage : str, optional
        Name of the stage; may be omitted if the run has only one driven stage.
    harmonics : int
        Number of the highest fitted harmonic, 1 or more.
    discard : float, optional
        Length of the initial transient to be discarded [s], 0 or more; half of the stage if not given.

    Returns
    -------
    xarray.Dataset
        ``ratio`` and ``ratio_error`` [m/N or N/m], ``phase`` and ``phase_error`` [rad] on ``harmonic``. The
        attributes are ``stage``, ``frequency`` [Hz], ``drive_amplitude`` [N or m] and ``periods``.

    Raises
    ------
    InputError
        If the run has no driven stage of that name or has not reached it, or if no name is given and the run
        does not have exactly one driven stage. Also if the piston force of an ``oscillate`` stage is not
        recorded, or `harmonic_response` raises this error.
    """
    import xarray

    driven = _find_driven_stage(run, stage)
    time, drive, response, unit = _times_drive_response_and_ratio_unit(run, driven)
    result = harmonic_response(time, drive, response, driven.frequency, harmonics, discard)
    columns = {
        "ratio": (result.ratio, unit, "ratio of the response's amplitude to the drive's amplitude"),
        "phase": (result.phase, "rad", "phase of the response relative to the drive"),
        "ratio_error": (result.ratio_error, unit, "standard error of the ratio"),
        "phase_error": (result.phase_error, "rad", "standard error of the phase"),
    }
    return xarray.Dataset(
        labelled_columns("harmonic", columns),
        coords={"harmonic": result.harmonics},
        attrs={
            "stage": driven.name,
            "frequency": result.frequency,
            "drive_amplitude": result.drive_amplitude,
            "periods": result.periods,
        },
    )


def _count_whole_periods(time: np.ndarray, frequency: float, discard: float | None) -> int:
    duration = float(time[-1] - time[0]) if len(time) else 0.0
    remaining = duration - (0.5 * duration if discard is None else discard)
    # A period ends one sample interval after its last sample.
    remaining += duration / max(len(time) - 1, 1)
    periods = int(remaining * frequency + 1e-6)
    if periods < MINIMUM_PERIODS:
        raise InputError(
            f"{max(periods, 0)} complete periods remain after the transient, and {MINIMUM_PERIODS} or more "
            "are needed; use a longer record or a smaller discard"
        )
    return periods


def _harmonic_amplitudes_and_drift(
    time: np.ndarray, values: np.ndarray, frequency: float, number: int, drifting: bool = True
) -> tuple[np.ndarray, float]:
    """Fit amplitudes X_k (K,) and drift (per second) in mean + drift t + sum_k Re(X_k exp(i k w t))."""
    phases = 2.0 * np.pi * frequency * np.multiply.outer(time, np.arange(1, number + 1))
    slope = [frequency * time[:, None]] if drifting else []
    basis = np.concatenate([np.cos(phases), np.sin(phases), np.ones((len(time), 1)), *slope], axis=1)
    result = np.linalg.lstsq(basis, values, rcond=None)[0]
    drift = float(result[-1]) * frequency if drifting else 0.0
    return result[:number] - 1j * result[number : 2 * number], drift


def _relative_response_harmonics(drive_harmonics: np.ndarray, response_harmonics: np.ndarray) -> np.ndarray:
    """Complex harmonics (K,) of the response, relative to the drive in amplitude and phase."""
    amplitude = abs(drive_harmonics[0])
    if amplitude == 0.0:
        raise InputError("the drive has an amplitude of 0 at this frequency; use the frequency of the drive")
    orders = np.arange(1, len(response_harmonics) + 1)
    return np.asarray(response_harmonics * np.exp(-1j * orders * np.angle(drive_harmonics[0])) / amplitude)


def _relative_response_harmonics_by_period(
    time: np.ndarray, drive: np.ndarray, response: np.ndarray, frequency: float, harmonics: int, periods: int
) -> np.ndarray:
    """Apply `_relative_response_harmonics` to each period of signals without drift: complex (p, K)."""
    position = (time - time[-1]) * frequency + periods
    period_of_sample = np.clip(np.ceil(position - 1e-9).astype(int) - 1, 0, periods - 1)
    rows = []
    for period_number in range(periods):
        in_period = period_of_sample == period_number
        drive_and_response = (
            _harmonic_amplitudes_and_drift(
                time[in_period], values[in_period], frequency, harmonics, drifting=False
            )[0]
            for values in (drive, response)
        )
        rows.append(_relative_response_harmonics(*drive_and_response))
    return np.array(rows)


def _errors_of_ratio_and_phase(
    transfer: np.ndarray, period_transfers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute standard errors (K,) of ratio and phase from the scatter along and across the mean phasor."""
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = np.where(transfer == 0.0, 1.0, transfer / np.abs(transfer))
    aligned = period_transfers * direction.conj()
    root_count = np.sqrt(len(period_transfers))
    # Scatter along the mean is scatter of the amplitude; scatter across it is scatter of the phase.
    return aligned.real.std(axis=0, ddof=1) / root_count, aligned.imag.std(axis=0, ddof=1) / root_count


def _find_driven_stage(run: Trajectory, name: str | None) -> Oscillate | Push:
    from granular.protocol import Oscillate, Push

    driven = {
        stage.name: stage
        for stage in run.scene.protocol
        if isinstance(stage, Oscillate) or (isinstance(stage, Push) and stage.amplitude > 0.0)
    }
    if name is None:
        if len(driven) == 1:
            return next(iter(driven.values()))
        advice = "name one" if driven else "add a stage of kind 'oscillate' or 'push'"
        raise InputError(f"the scene has {len(driven)} stages with a sinusoidal drive; {advice}")
    if name not in driven:
        raise InputError(unknown_word_message(name, tuple(driven), "driven stage"))
    return driven[name]


def _times_drive_response_and_ratio_unit(
    run: Trajectory, driven: Oscillate | Push
) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Return times [s], drive and response recorded in a stage, and the unit of response per drive."""
    from granular.protocol import Push

    record = run.piston(driven.name)
    if isinstance(driven, Push):
        stage_time = record.time - run.stage(driven.name).start
        force = driven.mean + driven.amplitude * np.sin(2.0 * np.pi * driven.frequency * stage_time)
        return record.time, force, record.height, "m/N"
    if record.force is None:
        wall = piston_wall_key(run.scene.cell.lines)
        raise InputError(f"the run records no piston force; add {wall} to the scene")
    return record.time, record.height, record.force, "N/m"


MINIMUM_STROKE = 0.01
"""Minimum stroke of a cycle, as a fraction of the full range of piston heights."""


class CompressionCycle(NamedTuple):
    """Samples of a cycle: the height decreases from a maximum to a minimum and rises to the next maximum."""

    start: int
    lowest: int
    stop: int


def hysteresis_energy(height: np.ndarray, force: np.ndarray) -> float:
    """Work of the piston on the bed in one cycle: the area of the loop of force against height.

    The loop is shown in [D, Fig. 3.4].

    Parameters
    ----------
    height : float (n,)
        Height of the piston [m] over a cycle that begins at the maximum height, in three or more samples.
    force : float (n,)
        Force of the grains on the piston, upwards [N].

    Returns
    -------
    float
        -(integral of F dh) [J], positive if the bed takes up energy, computed with the trapezoidal rule; NaN
        if a height or force is NaN. To close the loop, only heights up to the lower of the first and the
        last height are included; a cycle should therefore begin and end near its maximum.

    Raises
    ------
    InputError
        If there are fewer than three samples, or the shapes differ or are not (n,).

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import hysteresis_energy
    >>> height = np.array([2.0, 1.0, 1.0, 2.0, 2.0])  # down at a force of 3, up at 1
    >>> force = np.array([3.0, 3.0, 1.0, 1.0, 3.0])
    >>> float(hysteresis_energy(height, force))
    2.0
    """
    height, force = checked_series("height and force", height, force)
    if len(height) < 3:
        raise InputError(f"the cycle has {len(height)} samples; 3 or more are needed")
    # The loop is closed only up to the lower of its two end points.
    top = min(height[0], height[-1])
    return -_work_below_height(height, force, top)


def find_compression_cycles(height: Float[np.ndarray, "n"]) -> list[CompressionCycle]:
    """Find the cycles of a motion, each from a maximum of the height [m] to the next maximum."""
    height = np.asarray(height, dtype=np.float64)
    turns = _sample_indices_at_turning_points(height, MINIMUM_STROKE * np.ptp(height) if len(height) else 0.0)
    return [
        CompressionCycle(_last_resting_sample_index_at_turning_point(height, a, b), b, c)
        for a, b, c in zip(turns, turns[1:], turns[2:], strict=False)
        if height[b] < height[a]
    ]


def hysteresis_cycles(run: Trajectory) -> xarray.Dataset:
    """Hysteresis of every cycle of compression and expansion of a run [D, Fig. 3.4].

    Energies are computed by `hysteresis_energy`. Reversals by less than the fraction `MINIMUM_STROKE` of the
    full range of piston heights do not count as cycles.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.

    Returns
    -------
    xarray.Dataset
        On ``cycle``: ``energy`` [J], ``start`` and ``stop`` [s], and the height limits of the closed loop,
        ``lowest`` and ``highest`` [m]; empty without cycles.

    Raises
    ------
    InputError
        If the scene has no piston, or no force acts on it (``effects.walls.top``).
    """
    import xarray

    force = piston_force(run).values
    height = run.dataset["piston_height"].values
    time = run.dataset["time"].values
    cycles = find_compression_cycles(height)
    parts = [slice(cycle.start, cycle.stop + 1) for cycle in cycles]
    columns = {
        "energy": ([hysteresis_energy(height[k], force[k]) for k in parts], "J", "energy lost"),
        "start": ([time[cycle.start] for cycle in cycles], "s", "start of the compression"),
        "stop": ([time[cycle.stop] for cycle in cycles], "s", "end of the expansion"),
        "lowest": ([height[cycle.lowest] for cycle in cycles], "m", "minimum height"),
        "highest": (
            [min(height[cycle.start], height[cycle.stop]) for cycle in cycles],
            "m",
            "upper height limit of the closed loop",
        ),
    }
    return xarray.Dataset(labelled_columns("cycle", columns), coords={"cycle": np.arange(len(cycles))})


def _work_below_height(height: np.ndarray, force: np.ndarray, top: float) -> float:
    """Integral of F dh over the parts of the path at heights up to ``top``."""
    start, step = height[:-1], np.diff(height)
    with np.errstate(divide="ignore", invalid="ignore"):
        fraction = (top - start) / step
    # Each segment of the path is included from fraction a to fraction b of its length.
    crossing = np.clip(np.where(step == 0.0, 0.0, fraction), 0.0, 1.0)
    a = np.where(step < 0.0, crossing, 0.0)
    b = np.where(step > 0.0, crossing, 1.0)
    middle = 0.5 * (a + b)
    mean_force = force[:-1] + middle * np.diff(force)
    return float(np.sum(mean_force * (b - a) * step))


def _sample_indices_at_turning_points(height: np.ndarray, minimum_reversal: float) -> list[int]:
    """List sample indices: start, turning points of reversals above ``minimum_reversal``, and end."""
    turns: list[int] = []
    low = high = 0
    rising: bool | None = None
    for k, value in enumerate(height):
        high = k if value > height[high] else high
        low = k if value < height[low] else low
        if rising is not True and value - height[low] > minimum_reversal:
            turns.append(low)
            rising, high = True, k
        elif rising is not False and height[high] - value > minimum_reversal:
            turns.append(high)
            rising, low = False, k
    if rising is not None:
        turns.append(high if rising else low)
    return turns


def _last_resting_sample_index_at_turning_point(height: np.ndarray, turn: int, next_turn: int) -> int:
    """Last sample at which the piston rests at a turning point."""
    at_rest = np.flatnonzero(height[turn:next_turn] == height[turn])
    return turn + int(at_rest[-1])
