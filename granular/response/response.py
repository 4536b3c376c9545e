"""Frequency response of a host (a structure that carries a damper) by stepped sines, and its file format."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.host_structure import Host
from granular.response.linear_system import (
    amplitudes_without_damper_and_with_tuned_mass,
    host_amplitudes_and_damper_equivalents,
)
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.blocks import Table, format_number
from granular.shared.errors import GranularError, InputError, quote, sanitize
from granular.shared.files import make_directory, read_text, write_text
from granular.studies.cases import CaseOutcome, keep_measure_name
from granular.studies.sweep import sweep

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes


FRACTION = 0.4
"""Final fraction of a sine's duration, in which the oscillation is assumed steady and is measured."""
MINIMUM_PERIODS = 4


def fit_complex_amplitude(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"], frequency: float
) -> complex:
    """Fit A in Im(A exp(i omega t)) + constant + slope t (IEEE Std 1057); time [s], frequency [Hz]."""
    omega = math.tau * frequency
    moment = time - time.mean()
    return _fit_complex_amplitude_over_phase(omega * time, moment, values)


def _fit_complex_amplitude_over_phase(phase: np.ndarray, moment: np.ndarray, values: np.ndarray) -> complex:
    columns = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase), moment], axis=1)
    (sine, cosine, _, _), *_ = np.linalg.lstsq(columns, values, rcond=None)
    return complex(sine, cosine)


def start_and_end_of_last_whole_periods(start: float, end: float, frequency: float) -> tuple[float, float]:
    """Return start and end [s] of the whole periods in the last `FRACTION` of a drive; frequency [Hz]."""
    count = max(math.floor(FRACTION * (end - start) * frequency), MINIMUM_PERIODS)
    return max(start, end - count / frequency), end


@keep_measure_name("granular.response.response:steady_figures#88116dfe")
def measure_steady_amplitudes_and_energies(run: Trajectory) -> Mapping[str, Any]:
    """Measure amplitudes [m], energies [J] and steadiness at the end of a run with sinusoidal drive."""
    host, data = run.scene.effects.host, run.dataset
    assert host is not None
    assert host.excitation is not None
    frequency, began = float(host.excitation.frequency or 0.0), host.excitation.start
    time = data.time.values
    first, last = start_and_end_of_last_whole_periods(began, float(time[-1]), frequency)
    inside = time >= first - 1e-9  # [s]; recorded times have rounding errors
    moment, drive = time[inside], time[inside] - began
    height = data.piston_height.values[inside] if "piston_height" in data else np.zeros(len(drive))
    body = data.host_displacement.values[inside] if host.bodies else height
    amplitude, stroke = (fit_complex_amplitude(drive, series, frequency) for series in (body, height))
    middle = len(drive) // 2
    halves = [
        abs(fit_complex_amplitude(drive[part], body[part], frequency))
        for part in (slice(None, middle), slice(middle, None))
    ]
    periods = (moment[-1] - moment[0]) * frequency
    figures = {
        "real": amplitude.real,
        "imaginary": amplitude.imag,
        "stroke_real": stroke.real,
        "stroke_imaginary": stroke.imag,
        "greatest": 0.5 * float(np.ptp(body)),
        "unsteady": abs(halves[1] - halves[0]) / max(0.5 * sum(halves), 1e-300),
    }
    for name in data.data_vars:
        if str(name).endswith("_loss") or name == "work":
            values = data[name].values[inside]
            figures[f"{name}_a_period"] = float(values[-1] - values[0]) / periods
    drag = run.scene.effects.drag
    if drag is not None:
        faces = run.scene.grains.face_area_ratios()[run.scene.grains.species_indices()]
        # For affine motion, v = V y/H, the mean drag of the grains is a third of its value at the piston.
        affine = drag.coefficient * float(faces.sum()) / 3.0
        figures["affine_loss_a_period"] = math.pi * math.tau * frequency * affine * abs(stroke) ** 2
    figures["last"] = last
    return figures


PERIODS = 6.0
"""Number of drive periods in the interval from which an amplitude in a sweep is determined."""
POINTS = 200


def swept_response(run: Trajectory, points: int = POINTS) -> xarray.Dataset:
    """Measure the amplitudes of the last body and of the piston during a frequency sweep.

    In an interval of 6 periods of the drive around each time t,
    a sin(phase) + b cos(phase) + c + d t is fitted to the displacement by least squares (as in the sine fit
    of IEEE Std 1057 in `fit_complex_amplitude`), where phase is the phase of the drive. Let f' be the rate of
    change of the frequency, and delta the decay rate of the machine. The result is the steady response if
    f' << delta^2/(2 pi): within the decay time 1/delta, the frequency then changes by much less than the
    half-width of the peak, delta/(2 pi). If the machine's stiffness depends on amplitude, the amplitude can
    jump, at different frequencies in upward and downward sweeps.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run of a host with bodies under a sweep.
    points : int
        Number p of frequencies of the result, 2 or more.

    Returns
    -------
    xarray.Dataset
        Variables on the increasing coordinate ``frequency`` (p,) [Hz]: ``displacement``, an amplitude [m];
        ``phase``, the lag behind the drive, from -pi to pi [rad]; and, if there is a piston, ``stroke``, the
        amplitude of the piston relative to the cell [m].

    Raises
    ------
    InputError
        If the host has no bodies or is not driven by a sweep, ``points`` is below 2, or the run covers less
        than 6 periods of the sweep.
    """
    import xarray

    host = run.scene.effects.host
    drive = None if host is None else host.excitation
    if host is None or drive is None or drive.kind != "sweep" or not host.bodies:
        raise InputError(
            f"the scene {quote(run.scene.name)} has no host under a sweep; add bodies to "
            "effects.host, and an excitation of kind 'sweep'"
        )
    low, high = float(drive.frequency or 0.0), float(drive.to or 0.0)
    length, data = float(drive.duration or 0.0), run.dataset
    time = data.time.values - drive.start
    recorded = {"displacement": data.host_displacement.values}
    if "piston_height" in data:
        recorded["stroke"] = data.piston_height.values
    frequencies, amplitudes = swept_amplitudes(time, list(recorded.values()), (low, high, length), points)
    result = {
        name: ("frequency", np.abs(amplitude), {"units": "m"})
        for name, amplitude in zip(recorded, amplitudes, strict=True)
    }
    result["phase"] = ("frequency", -np.angle(amplitudes[0]), {"units": "rad"})
    return xarray.Dataset(result, coords={"frequency": ("frequency", frequencies, {"units": "Hz"})})


def swept_amplitudes(
    time: Float[np.ndarray, "n"], values: list[np.ndarray], sweep: tuple[float, float, float], points: int
) -> tuple[Float[np.ndarray, "p"], list[np.ndarray]]:
    """Return frequencies and complex amplitudes in an exponential sweep; time [s], sweep [Hz, Hz, s]."""
    low, high, length = sweep
    if points < 2:
        raise InputError(f"points = {points}; 2 or more are needed")
    rate = math.log(high / low) / length
    phase = math.tau * low * np.expm1(rate * time) / rate
    middles = math.log1p(rate * 0.5 * PERIODS / low) / rate  # half the first interval
    last = min(length, float(time[-1]))
    moments = np.linspace(middles, last - 0.5 * PERIODS / (low * math.exp(rate * last)), points)
    if moments[-1] <= moments[0]:
        raise InputError(
            f"the run covers {last:g} s of the sweep, less than {PERIODS:g} periods; simulate a longer time"
        )
    frequencies = low * np.exp(rate * moments)
    amplitudes = [np.empty(points, dtype=np.complex128) for _ in values]
    for k, (moment, frequency) in enumerate(zip(moments, frequencies, strict=True)):
        near = np.abs(time - moment) <= 0.5 * PERIODS / frequency
        for amplitude, value in zip(amplitudes, values, strict=True):
            amplitude[k] = _fit_complex_amplitude_over_phase(phase[near], time[near] - moment, value[near])
    return frequencies, amplitudes


DURATION = 20.0
"""Default duration of a sine [s]."""
DENSE = 4001
"""Number of frequencies at which the exact curves of linear hosts are computed to find their peaks."""
AMPLITUDES = ("force", "acceleration", "displacement")


@dataclasses.dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response of a host to sinusoidal drives.

    Attributes
    ----------
    scene : Scene
        Scene of the damper and its host.
    dataset : xarray.Dataset
        Variables on the coordinates ``amplitude`` (of the force or the base) and ``frequency`` [Hz], in SI:

        - ``displacement``: amplitude of the last body, or of the load on the piston if the cell stands on the
          base
        - ``alone``: the same amplitude without a damper
        - ``ideal``: the same amplitude with Den Hartog's tuned mass, as heavy as the damper
        - ``stroke``: amplitude of the piston relative to the cell
        - ``effective_mass``, ``added_damping``, ``added_stiffness`` and ``loss_factor`` of the damper
        - ``transmissibility``, and energies dissipated per period
        - ``unsteady``: change of the amplitude during the measurement
    settings : dict
        Settings of the simulation: ``dt`` and ``duration`` [s]. If the response was measured by a sweep,
        ``sweep`` is the pair of its first and last frequency [Hz].
    """

    scene: Scene
    dataset: xarray.Dataset
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def quantity(self) -> str:
        """Name of the driven quantity, which is a key of `AMPLITUDES`."""
        return str(self.dataset.amplitude.attrs["long_name"])

    @property
    def peak(self) -> float:
        """Maximum displacement of the machine over all frequencies and amplitudes, float [m]."""
        return float(self.dataset.displacement.max())

    def peaks(self) -> list[dict[str, float]]:
        """List the peaks [m] and their frequencies [Hz] with the damper, without it and with a tuned mass."""
        result = []
        for value in self.dataset.amplitude.values:
            part = self.dataset.sel(amplitude=value)
            row = {"amplitude": float(value)}
            row["frequency"] = float(part.frequency[int(part.displacement.values.argmax())])
            row["peak"] = float(part.displacement.max())
            if "alone" in part:
                curves = self.linear_curves(float(value))
                row |= {key: float(curves[key].max()) for key in ("alone", "ideal")}
                row["reduction"] = row["alone"] / row["peak"]
                row["over_ideal"] = row["peak"] / row["ideal"]
            result.append(row)
        return result

    def linear_curves(self, amplitude: float) -> dict[str, np.ndarray]:
        """Exact amplitudes [m] of the host alone and with a tuned mass, at `DENSE` frequencies [Hz]."""
        host, known = self.scene.effects.host, self.dataset.frequency.values
        assert host is not None
        dense, quantity = np.geomspace(known.min(), known.max(), DENSE), self.quantity
        alone, ideal = amplitudes_without_damper_and_with_tuned_mass(
            self.scene, host, quantity, amplitude, dense
        )
        return {"frequency": dense, "alone": alone, "ideal": ideal}

    @property
    def table(self) -> Table:
        """Peaks with and without the damper as a table in SI, one row per drive amplitude."""
        rows = self.peaks()
        return Table(tuple(rows[0]), [[format_number(value) for value in row.values()] for row in rows])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement [mm] against frequency [Hz], with and without the damper."""
        from granular.shared.plotting import axes_or_new, line_style

        ax = axes_or_new(ax)
        data, unit = self.dataset, self.dataset.amplitude.attrs["units"]
        for k, value in enumerate(data.amplitude.values):
            part = data.sel(amplitude=value)
            label = f"with the damper, {value:g} {unit}"
            ax.plot(part.frequency, 1e3 * part.displacement, label=label, **line_style(k))
        if "alone" in data:
            curves = self.linear_curves(float(data.amplitude[-1]))
            for key, style, label in (("alone", "k--", "without"), ("ideal", "k:", "tuned mass")):
                ax.plot(
                    curves["frequency"],
                    1e3 * curves[key],
                    style,
                    lw=0.8,
                    label=f"{label}, {data.amplitude.values[-1]:g} {unit}",
                )
        ax.set(xlabel="frequency [Hz]", ylabel="displacement [mm]", yscale="log")
        ax.legend(frameon=False)
        return ax


def frequency_response(
    scene: Scene,
    frequencies: Sequence[float],
    *,
    amplitudes: Sequence[float] | None = None,
    duration: float = DURATION,
    dt: float | str = "auto",
    out: str | Path | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> FrequencyResponse:
    """Measure the frequency response of a scene's host, with one run for each sine.

    The sine begins at the excitation's ``start`` and lasts for ``duration``. During the last 40 % of this
    duration the oscillation is assumed steady; ``unsteady`` is the remaining change of the amplitude.

    Parameters
    ----------
    scene : Scene
        Scene with a host under a sine.
    frequencies : sequence of float, f long
        Frequencies of the sines [Hz], distinct and above 0.
    amplitudes : sequence of float, s long, optional
        Amplitudes of the force [N], or of the base's acceleration [m/s^2] or displacement [m], distinct and
        above 0; the scene's amplitude if not given.
    duration : float
        Duration of each sine [s], 10 periods of the lowest frequency or more.
    dt : float or str
        Time step [s]; "auto" resolves the stiffest mode that the bed can reach; "auto/2" or "auto*2" is half
        or twice that step.
    out : str or Path, optional
        Directory in which finished runs are stored; repeating the same call continues from there.
    workers : int, optional
        Number of processes, 1 or more; the number of processors if not given.
    progress : bool
        Show a progress bar.

    Returns
    -------
    FrequencyResponse
        Amplitudes [m], phases [rad] and more, float64 (s, f) each, as functions of drive amplitude and
        frequency [Hz].

    Raises
    ------
    InputError
        If the scene has no host under a sine, no frequency or amplitude is given, a frequency or amplitude
        is repeated or not above 0, the duration is too short, ``dt`` is not a time step, or ``out`` cannot
        be written.
    GranularError
        If a run failed; the other runs are kept in ``out``.

    Warns
    -----
    UserWarning
        If runs raised warnings: their number, and the first warning.
    """
    host = _require_host_under_sine(scene, frequencies, duration)
    assert host.excitation is not None
    (key,) = (name for name in AMPLITUDES if getattr(host.excitation, name) is not None)
    sizes = [getattr(host.excitation, key)] if amplitudes is None else list(amplitudes)
    if not all(size > 0.0 for size in sizes):
        raise InputError(f"amplitudes = {sizes}; each must be above 0")
    made = sweep(
        scene,
        measure=measure_steady_amplitudes_and_energies,
        cases=[
            {"effects.host.excitation.frequency": float(f), f"effects.host.excitation.{key}": size}
            for size in sizes
            for f in frequencies
        ],
        t_end=host.excitation.start + duration,
        dt=dt,
        out=out,
        workers=workers,
        progress=progress,
        title="response",
    )
    wrong = [outcome.error for outcome in made.outcomes if outcome.error is not None]
    if wrong:
        raise GranularError(f"{len(wrong)} of {len(made.cases)} runs failed, the first: {wrong[0]}")
    result = _steady_response_dataset(scene, host, key, sizes, frequencies, made.outcomes)
    return FrequencyResponse(scene, result, {"dt": dt, "duration": duration})


def _require_host_under_sine(scene: Scene, frequencies: Sequence[float], duration: float) -> Host:
    host = scene.effects.host
    if host is None or host.excitation is None or host.excitation.kind != "sine":
        raise InputError(
            f"the scene {quote(scene.name)} has no host under a sine; add an excitation of kind "
            "'sine' to effects.host, or use the packaged scene 'machine'"
        )
    if not len(frequencies) or not all(f > 0.0 for f in frequencies):
        raise InputError(f"frequencies = {list(frequencies)}; give one or more, each above 0 Hz")
    # The last `FRACTION` of the run then has `MINIMUM_PERIODS`, from which amplitudes are determined.
    if duration * min(frequencies) < 10.0:
        raise InputError(
            f"duration = {duration:g} s is less than 10 periods of {min(frequencies):g} Hz; use "
            f"{10.0 / min(frequencies):g} s or more"
        )
    return host


def _steady_response_dataset(
    scene: Scene,
    host: Host,
    key: str,
    sizes: Sequence[float],
    frequencies: Sequence[float],
    outcomes: Sequence[CaseOutcome],
) -> xarray.Dataset:
    shape = (len(sizes), len(frequencies))
    figures = [outcome.figures for outcome in outcomes]

    def field(name: str) -> np.ndarray:
        return np.array([figure[name] for figure in figures]).reshape(shape)

    amplitude = field("real") + 1j * field("imaginary")
    stroke = field("stroke_real") + 1j * field("stroke_imaginary")
    result: dict[str, tuple[str, str, np.ndarray]] = {
        "displacement": ("m", "amplitude of the last body", np.abs(amplitude)),
        "phase": ("rad", "phase of the last body behind the drive", -np.angle(amplitude)),
        "greatest": ("m", "half the range of the last body", field("greatest")),
        "stroke": ("m", "amplitude of the piston relative to the cell", np.abs(stroke)),
        "unsteady": ("1", "change of the amplitude during the measurement", field("unsteady")),
    }
    for name in figures[0]:
        if name.endswith("_a_period"):
            label = name.removesuffix("_a_period").replace("_", " ")
            result[name] = ("J", f"{label} in a period", field(name))
    omega = math.tau * np.array(frequencies)
    if host.bodies:
        result |= host_amplitudes_and_damper_equivalents(scene, host, key, sizes, frequencies, amplitude)
    if host.excitation is not None and host.excitation.is_base_motion:
        shake = np.array(sizes)[:, None] * (np.ones_like(omega) if key == "acceleration" else -(omega**2))
        total = amplitude - shake / omega**2
        ratio = np.abs(total) / np.abs(shake / omega**2)
        result["transmissibility"] = ("1", "amplitude relative to the amplitude of the base", ratio)
    return response_dataset(key, sizes, frequencies, result)


def response_dataset(
    quantity: str,
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    fields: Mapping[str, tuple[str, str, np.ndarray]],
) -> xarray.Dataset:
    """Combine fields (s, f) of a response in one dataset; amplitudes [N; m/s^2; m], frequencies [Hz]."""
    import xarray

    dims = ("amplitude", "frequency")
    units = {"force": "N", "acceleration": "m/s^2", "displacement": "m"}[quantity]
    return xarray.Dataset(
        {
            name: (dims, values, {"units": unit, "long_name": label})
            for name, (unit, label, values) in fields.items()
        },
        coords={
            "amplitude": ("amplitude", list(amplitudes), {"units": units, "long_name": quantity}),
            "frequency": ("frequency", list(frequencies), {"units": "Hz"}),
        },
    )


FILE = "response.json"
MAXIMUM_BYTES = 64 * 2**20


def save_response(response: FrequencyResponse, directory: str | Path) -> Path:
    """Write a response to ``response.json`` in a directory, and return the path of the file.

    Numbers are stored exactly, including NaN and infinity; an existing file is replaced.

    Parameters
    ----------
    response : FrequencyResponse
        Measured response.
    directory : str or Path
        Directory of the result; created if missing.

    Returns
    -------
    Path
        Path of the written file.

    Raises
    ------
    InputError
        If the directory cannot be created or the file cannot be written.
    """
    path = Path(directory) / FILE
    make_directory(path.parent)
    plain = {
        "scene": response.scene.to_plain(),
        "settings": dict(response.settings),
        "dataset": response.dataset.to_dict(),
    }
    write_text(path, json.dumps(plain) + "\n")
    return path


def load_response(directory: str | Path) -> FrequencyResponse:
    """Read a response written by `save_response` or the command ``response``.

    Parameters
    ----------
    directory : str or Path
        Directory with ``response.json``.

    Returns
    -------
    FrequencyResponse
        The response, in SI units, exactly as written.

    Raises
    ------
    InputError
        If the directory has no response, or its file is damaged, above 64 MiB, or belongs to a scene with a
        user-defined effect or stage that was not imported.
    """
    path = Path(directory) / FILE
    if not path.exists():
        raise InputError(
            f"{quote(str(directory))} has no {FILE}; create it with: granular-damper response SCENE -o DIR"
        )
    text = read_text(path, MAXIMUM_BYTES)
    try:
        return _response_from_plain(json.loads(text))
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError) as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__} "
        raise InputError(
            f"{sanitize(path)} cannot be read: {kind}{error}; create it again with granular-damper response"
        ) from None


def _response_from_plain(plain: Any) -> FrequencyResponse:
    import xarray

    data = xarray.Dataset.from_dict(plain["dataset"])
    response = FrequencyResponse(Scene.from_plain(plain["scene"]), data, dict(plain["settings"]))
    fields = [data["displacement"], data["amplitude"], data["frequency"]]
    sound = data["displacement"].dims == ("amplitude", "frequency") and all(
        np.issubdtype(field.dtype, np.number) and field.size for field in fields
    )
    if not sound or not {"units", "long_name"} <= set(data["amplitude"].attrs):
        raise InputError("it contains no amplitudes as a function of frequency")
    return response
