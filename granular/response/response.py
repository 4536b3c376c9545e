"""The frequency response of a host with its damper, by stepped sines; kept in a file."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.effects.host_structure import Host
from granular.response.linear_system import linear_host_comparison, without_damper
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
"""Last part of a sine's duration, in which the swing is taken for steady."""
LEAST_PERIODS = 4


def complex_amplitude(
    time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"], frequency: float
) -> complex:
    """Complex A of Im(A exp(i omega t)) + constant + slope t (IEEE Std 1057); time [s], frequency [Hz]."""
    omega = math.tau * frequency
    moment = time - time.mean()
    return _amplitude_over_phase(omega * time, moment, values)


def _amplitude_over_phase(phase: np.ndarray, moment: np.ndarray, values: np.ndarray) -> complex:
    columns = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase), moment], axis=1)
    (sine, cosine, _, _), *_ = np.linalg.lstsq(columns, values, rcond=None)
    return complex(sine, cosine)


def last_whole_periods(start: float, end: float, frequency: float) -> tuple[float, float]:
    """Range of the last whole periods within `FRACTION` of a drive [s]; start, end [s], frequency [Hz]."""
    count = max(math.floor(FRACTION * (end - start) * frequency), LEAST_PERIODS)
    return max(start, end - count / frequency), end


@keep_measure_name("granular.response.response:steady_figures#88116dfe")
def steady_figures(run: Trajectory) -> Mapping[str, Any]:
    """Amplitudes, energies and steadiness at the end of a run whose host is shaken by a sine [m, J, s]."""
    host, data = run.scene.effects.host, run.dataset
    assert host is not None
    assert host.excitation is not None
    frequency, began = float(host.excitation.frequency or 0.0), host.excitation.start
    time = data.time.values
    first, last = last_whole_periods(began, float(time[-1]), frequency)
    inside = time >= first - 1e-9  # [s]; recorded times carry rounding
    moment, drive = time[inside], time[inside] - began
    height = data.piston_height.values[inside] if "piston_height" in data else np.zeros(len(drive))
    body = data.host_displacement.values[inside] if host.bodies else height
    swing, stroke = (complex_amplitude(drive, series, frequency) for series in (body, height))
    middle = len(drive) // 2
    halves = [
        abs(complex_amplitude(drive[part], body[part], frequency))
        for part in (slice(None, middle), slice(middle, None))
    ]
    periods = (moment[-1] - moment[0]) * frequency
    figures = {
        "real": swing.real,
        "imaginary": swing.imag,
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
        # Affine motion, v = V y/H: the drag of the grains averages to a third of its value at the piston.
        affine = drag.coefficient * float(faces.sum()) / 3.0
        figures["affine_loss_a_period"] = math.pi * math.tau * frequency * affine * abs(stroke) ** 2
    figures["last"] = last
    return figures


PERIODS = 6.0
"""Periods of the drive in which one amplitude is resolved."""
POINTS = 200


def swept_response(run: Trajectory, points: int = POINTS) -> xarray.Dataset:
    """Amplitudes of the last body and of the piston while a sweep passes, in one run.

    About each moment, over 6 periods of the drive, the displacement is taken for
    a sin(phase) + b cos(phase) + c + d t with the phase of the sweep (least squares, as the sine fit of
    IEEE Std 1057 in `complex_amplitude`). A sweep shows the steady response where its frequency
    changes little while the machine forgets: with the change f' of the frequency and the decay rate
    delta, f' << delta^2/(2 pi). This is the toolkit's own estimate: within a decay, 1/delta, the
    frequency moves by much less than the peak's half-width, delta/(2 pi). A hardening or softening
    machine jumps elsewhere upwards than downwards.

    Parameters
    ----------
    run : Trajectory
        Run of a host with bodies under a sweep, finished or cut off.
    points : int
        Number p of frequencies of the result, from 2.

    Returns
    -------
    xarray.Dataset
        On ``frequency`` (p,) [Hz], increasing: ``displacement`` [m], ``phase`` behind the drive, from -pi
        to pi [rad], and ``stroke`` of the piston over the cell [m] where there is a piston.

    Raises
    ------
    InputError
        If the host has no bodies or is not shaken by a sweep, ``points`` is below 2, or the run holds
        less than 6 periods of the sweep.
    """
    import xarray

    host = run.scene.effects.host
    drive = None if host is None else host.excitation
    if host is None or drive is None or drive.kind != "sweep" or not host.bodies:
        raise InputError(
            f"the scene {quote(run.scene.name)} has no host under a sweep; give effects.host "
            "bodies, and an excitation of the kind 'sweep'"
        )
    low, high = float(drive.frequency or 0.0), float(drive.to or 0.0)
    length, data = float(drive.duration or 0.0), run.dataset
    time = data.time.values - drive.start
    seen = {"displacement": data.host_displacement.values}
    if "piston_height" in data:
        seen["stroke"] = data.piston_height.values
    frequencies, swings = swept_amplitudes(time, list(seen.values()), (low, high, length), points)
    result = {
        name: ("frequency", np.abs(swing), {"units": "m"}) for name, swing in zip(seen, swings, strict=True)
    }
    result["phase"] = ("frequency", -np.angle(swings[0]), {"units": "rad"})
    return xarray.Dataset(result, coords={"frequency": ("frequency", frequencies, {"units": "Hz"})})


def swept_amplitudes(
    time: Float[np.ndarray, "n"], values: list[np.ndarray], sweep: tuple[float, float, float], points: int
) -> tuple[Float[np.ndarray, "p"], list[np.ndarray]]:
    """Complex amplitudes in an exponential sweep by local least squares; time [s], sweep [Hz, Hz, s]."""
    low, high, length = sweep
    if points < 2:
        raise InputError(f"points = {points}; give at least 2")
    rate = math.log(high / low) / length
    phase = math.tau * low * np.expm1(rate * time) / rate
    middles = math.log1p(rate * 0.5 * PERIODS / low) / rate  # half the first span
    last = min(length, float(time[-1]))
    moments = np.linspace(middles, last - 0.5 * PERIODS / (low * math.exp(rate * last)), points)
    if moments[-1] <= moments[0]:
        raise InputError(
            f"the run holds {last:g} s of the sweep, less than {PERIODS:g} of its periods; run longer"
        )
    frequencies = low * np.exp(rate * moments)
    swings = [np.empty(points, dtype=np.complex128) for _ in values]
    for k, (moment, frequency) in enumerate(zip(moments, frequencies, strict=True)):
        near = np.abs(time - moment) <= 0.5 * PERIODS / frequency
        for swing, value in zip(swings, values, strict=True):
            swing[k] = _amplitude_over_phase(phase[near], time[near] - moment, value[near])
    return frequencies, swings


DURATION = 20.0
"""Duration of a sine [s], if not given."""
DENSE = 4001
"""Frequencies at which peaks of closed forms are looked for."""
AMPLITUDES = ("force", "acceleration", "displacement")


@dataclasses.dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """A host's response to sines.

    Attributes
    ----------
    scene : Scene
        Scene of the damper and its host.
    dataset : xarray.Dataset
        On ``amplitude`` (of the force or the base) and ``frequency`` [Hz], in SI: ``displacement``
        of the last body (of the load, where the cell stands on the base), ``alone`` without damper
        and ``ideal`` with Den Hartog's tuned mass of the damper's weight; ``stroke`` of the piston
        over the cell; ``effective_mass``, ``added_damping``, ``added_stiffness`` and
        ``loss_factor`` of the damper; ``transmissibility``; energies taken in a period;
        ``unsteady``.
    settings : dict
        Settings of the simulation: ``dt``, ``duration`` [s], and ``sweep``, the first and last
        frequency [Hz], where one sweep gave it.
    """

    scene: Scene
    dataset: xarray.Dataset
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def quantity(self) -> str:
        """Quantity of the drive, a key of `AMPLITUDES`."""
        return str(self.dataset.amplitude.attrs["long_name"])

    @property
    def peak(self) -> float:
        """Greatest displacement of the machine over all frequencies and amplitudes, float [m]."""
        return float(self.dataset.displacement.max())

    def peaks(self) -> list[dict[str, float]]:
        """List the peaks [m] and their frequencies [Hz] with the damper, without it, with the tuned mass."""
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
        """Exact amplitudes [m] of the host alone and with the tuned mass, at `DENSE` frequencies [Hz]."""
        host, known = self.scene.effects.host, self.dataset.frequency.values
        assert host is not None
        dense, quantity = np.geomspace(known.min(), known.max(), DENSE), self.quantity
        alone, ideal = without_damper(self.scene, host, quantity, amplitude, dense)
        return {"frequency": dense, "alone": alone, "ideal": ideal}

    @property
    def table(self) -> Table:
        """Table of `peaks`, in SI."""
        rows = self.peaks()
        return Table(tuple(rows[0]), [[format_number(value) for value in row.values()] for row in rows])

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the displacement [mm] over the frequency [Hz], with and without the damper."""
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
    """Run a scene for each frequency of the sine that shakes its host.

    The sine begins at the excitation's ``start`` and acts for ``duration``; the last 0.4 of that
    are taken for steady, which ``unsteady`` judges.

    Parameters
    ----------
    scene : Scene
        With a host under a sine.
    frequencies : sequence of float, f long
        Frequencies of the sines [Hz], each above 0, none twice.
    amplitudes : sequence of float, s long, optional
        Amplitudes of the force [N], or of the base's acceleration [m/s^2] or displacement [m], each
        above 0, none twice; the scene's own if not given.
    duration : float
        Time that each sine acts [s], 10 periods of the lowest frequency at least.
    dt : float or str
        Time step [s]; "auto" follows the stiffest mode that the bed can meet, and "auto/2" or
        "auto*2" is half or twice as long.
    out : str or Path, optional
        Directory that keeps what is done; the same call goes on from there.
    workers : int, optional
        Processes, from 1; as many as there are processors if not given.
    progress : bool
        Show a progress bar.

    Returns
    -------
    FrequencyResponse
        Amplitudes [m], phases [rad] and more, float64 (s, f) each, over the amplitudes and frequencies [Hz].

    Raises
    ------
    InputError
        If the scene has no host under a sine, a frequency or amplitude is not positive, there is none or
        one twice, the duration is too short, ``dt`` is no time step, or ``out`` cannot be written.
    GranularError
        If a run failed; the others are kept in ``out``.

    Warns
    -----
    UserWarning
        Where runs raised warnings: how many, and the first.
    """
    host = _require_host_under_sine(scene, frequencies, duration)
    assert host.excitation is not None
    (key,) = (name for name in AMPLITUDES if getattr(host.excitation, name) is not None)
    sizes = [getattr(host.excitation, key)] if amplitudes is None else list(amplitudes)
    if not all(size > 0.0 for size in sizes):
        raise InputError(f"amplitudes {sizes}: each must be above 0")
    made = sweep(
        scene,
        measure=steady_figures,
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
    result = _steady_dataset(scene, host, key, sizes, frequencies, made.outcomes)
    return FrequencyResponse(scene, result, {"dt": dt, "duration": duration})


def _require_host_under_sine(scene: Scene, frequencies: Sequence[float], duration: float) -> Host:
    host = scene.effects.host
    if host is None or host.excitation is None or host.excitation.kind != "sine":
        raise InputError(
            f"the scene {quote(scene.name)} has no host under a sine; give effects.host an "
            "excitation of the kind 'sine', or take the packaged scene 'machine'"
        )
    if not len(frequencies) or not all(f > 0.0 for f in frequencies):
        raise InputError(f"frequencies {list(frequencies)}: give some, each above 0 Hz")
    # Then the last `FRACTION` of the run has the `LEAST_PERIODS` that amplitudes are read from.
    if duration * min(frequencies) < 10.0:
        raise InputError(
            f"duration = {duration:g} s is less than 10 periods of {min(frequencies):g} Hz; give "
            f"{10.0 / min(frequencies):g} s"
        )
    return host


def _steady_dataset(
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

    swing = field("real") + 1j * field("imaginary")
    stroke = field("stroke_real") + 1j * field("stroke_imaginary")
    result: dict[str, tuple[str, str, np.ndarray]] = {
        "displacement": ("m", "amplitude of the last body", np.abs(swing)),
        "phase": ("rad", "phase of the last body behind the drive", -np.angle(swing)),
        "greatest": ("m", "half the range of the last body", field("greatest")),
        "stroke": ("m", "amplitude of the piston over the cell", np.abs(stroke)),
        "unsteady": ("1", "change of the amplitude while it is taken", field("unsteady")),
    }
    for name in figures[0]:
        if name.endswith("_a_period"):
            what = name.removesuffix("_a_period").replace("_", " ")
            result[name] = ("J", f"{what} in a period", field(name))
    omega = math.tau * np.array(frequencies)
    if host.bodies:
        result |= linear_host_comparison(scene, host, key, sizes, frequencies, swing)
    if host.excitation is not None and host.excitation.is_base_motion:
        shake = np.array(sizes)[:, None] * (np.ones_like(omega) if key == "acceleration" else -(omega**2))
        total = swing - shake / omega**2
        ratio = np.abs(total) / np.abs(shake / omega**2)
        result["transmissibility"] = ("1", "amplitude over that of the base", ratio)
    return response_dataset(key, sizes, frequencies, result)


def response_dataset(
    quantity: str,
    amplitudes: Sequence[float],
    frequencies: Sequence[float],
    fields: Mapping[str, tuple[str, str, np.ndarray]],
) -> xarray.Dataset:
    """Put fields (s, f) of a response into one dataset; amplitudes [N; m/s^2; m], frequencies [Hz]."""
    import xarray

    dims = ("amplitude", "frequency")
    units = {"force": "N", "acceleration": "m/s^2", "displacement": "m"}[quantity]
    return xarray.Dataset(
        {
            name: (dims, values, {"units": unit, "long_name": what})
            for name, (unit, what, values) in fields.items()
        },
        coords={
            "amplitude": ("amplitude", list(amplitudes), {"units": units, "long_name": quantity}),
            "frequency": ("frequency", list(frequencies), {"units": "Hz"}),
        },
    )


FILE = "response.json"
MOST_BYTES = 64 * 2**20


def save_response(response: FrequencyResponse, directory: str | Path) -> Path:
    """Write a response to ``response.json`` in a directory; the path of the file.

    Its numbers keep every bit, NaN and infinite ones too; a file that is there is replaced.

    Parameters
    ----------
    response : FrequencyResponse
        Measured response.
    directory : str or Path
        Directory of the result; it is made where there is none.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    InputError
        If the directory cannot be made or the file not written.
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
    """Read a response that `save_response` or the command ``response`` wrote.

    Parameters
    ----------
    directory : str or Path
        Directory with ``response.json``.

    Returns
    -------
    FrequencyResponse
        The response, in SI units, with the bits that were written.

    Raises
    ------
    InputError
        If the directory has none, or its file is damaged, above 64 MiB, or of a scene with an effect or
        stage of the user's own that was not imported.
    """
    path = Path(directory) / FILE
    if not path.exists():
        raise InputError(
            f"{quote(str(directory))} holds no {FILE}; write one by granular-damper response SCENE -o DIR"
        )
    text = read_text(path, MOST_BYTES)
    try:
        return _response_from_plain(json.loads(text))
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError) as error:
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__} "
        raise InputError(
            f"{sanitize(path)} cannot be read: {kind}{error}; write it anew by granular-damper response"
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
        raise InputError("it has no amplitudes over frequencies")
    return response
