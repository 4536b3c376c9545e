"""Sections of the report with plots: record and laws, comparison of the laws, falls, and the run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.scene.bed_drawing import draw_bed
from granular.shared.blocks import Block, Caution, Heading, Picture, Printout, Table, Text, format_number
from granular.shared.plotting import COLOURS, GREY, READABLE, STYLES, figure, figure_label, line_style
from reduced_models.falls.unseen_fall_scores import DropScores
from reduced_models.identification.comparison_table import Comparison
from reduced_models.models.at_rest import signal_units
from reduced_models.models.model import ReducedModel
from reduced_models.models.quantities import QuantityWithError
from reduced_models.records.record_overview import GAP_RATIO
from reduced_models.records.sources import time_step_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from granular.run.trajectory import Trajectory

_MAXIMUM_POINTS = 3000  # number of points of a line; more are not visible
_MAXIMUM_LIFT_LINES, _MAXIMUM_FALL_LINES = 4, 3  # number of laws over a lift or a fall; more overlap
_STACKED: dict[str, Any] = {"size": READABLE, "sharex": True, "height_ratios": (2, 1)}
_ENERGIES = {
    "kinetic_energy": "grains, kinetic",
    "pair_energy": "pairs",
    "wall_energy": "walls",
    "weight_energy": "grains, weight",
    "piston_energy": "piston",
    "drag_loss": "lost to drag",
    "work": "external work",
}


def downsample_columns(*columns: np.ndarray) -> list[np.ndarray]:
    """Return columns with only as many samples as a plot can show."""
    every = max(1, len(columns[0]) // _MAXIMUM_POINTS)
    return [column[::every] for column in columns]


class _DrawnCoordinate(NamedTuple):
    """A coordinate for plots: its name, unit and scale factor."""

    name: str
    unit: str
    scale: float

    @property
    def label(self) -> str:
        return f"{self.name} [{self.unit}]"


def _drawn_coordinate_of_record(record: PistonRecord) -> _DrawnCoordinate:
    units = signal_units(record.measured, record.coordinate_unit)
    name = record.coordinate if record.measured == "height" else record.measured
    return _DrawnCoordinate(name, units.length, units.scale)


def drawn_coordinate_of_residuals(measured: str, coordinate_unit: str) -> _DrawnCoordinate:
    """Return the axis of residuals: micrometres for heights, otherwise the unit of the measured quantity."""
    units = signal_units(measured, coordinate_unit)
    if units.length == "mm":
        return _DrawnCoordinate("residual", "µm", 1e6)
    return _DrawnCoordinate("residual", units.length, units.scale)


def _break_at_gaps(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Insert a NaN where samples are missing, as at a clipped crest, so that no line is drawn across."""
    steps = np.diff(time)
    behind = np.flatnonzero(steps > GAP_RATIO * np.median(steps)) + 1
    return np.insert(time, behind, np.nan), np.insert(values, behind, np.nan)


def _draw_curves_and_residuals(
    record: PistonRecord,
    curves: Iterable[tuple[str, np.ndarray, Any]],
    *,
    label: str = "record",
    difference: _DrawnCoordinate | None = None,
    tested: Sequence[tuple[float, float]] = (),
    height: float = 6.2,
    legend: bool = True,
) -> Figure:
    """Draw a record with curves over it, and the residuals of the curves in a panel below."""
    shown, time = _drawn_coordinate_of_record(record), record.time - record.time[0]
    with figure(2, 1, height=height, **_STACKED) as (drawing, (top, bottom)):
        signal = record.signal
        difference = difference or drawn_coordinate_of_residuals(record.measured, record.coordinate_unit)
        seen = _break_at_gaps(*downsample_columns(time, shown.scale * signal))
        top.plot(*seen, color=GREY, linewidth=3.0, label=label)
        for name, values, look in curves:
            count = len(values)
            top.plot(
                *downsample_columns(time[:count], shown.scale * values),
                label=figure_label(name),
                linewidth=1.2,
                **look,
            )
            missed = difference.scale * (signal[:count] - values)
            bottom.plot(*_break_at_gaps(*downsample_columns(time[:count], missed)), linewidth=1.2, **look)
        for axes in (top, bottom):
            for start, end in tested:
                axes.axvspan(start, end, color=GREY, alpha=0.15, linewidth=0.0)
        top.set_ylabel(shown.label)
        bottom.set(ylabel=difference.label, xlabel="time [s]")
        if legend:
            drawing.legend(loc="outside upper left", ncols=2)
        else:
            top.legend(loc="upper right")
        return drawing


def record_section(record: PistonRecord, best: ReducedModel) -> Iterator[Block]:
    """Section with the record and the best law."""
    yield Heading("The record")
    yield Picture(
        partial(
            _draw_curves_and_residuals,
            record,
            [(best.law.name, best.simulate_signal(record), {})],
            tested=best.quality.test_swings,
            height=6.0,
            legend=False,
        ),
        "The record, the best law, and its residual. The prediction error is measured on the shaded "
        f"part ({best.quality.held_out_part_text}), with fits that exclude this part.",
    )


def fits_section(record: PistonRecord, models: Sequence[ReducedModel], best: ReducedModel) -> Iterator[Block]:
    """Section with the record, all fits and their residuals."""
    yield Heading("The record and the fits")
    curves = [
        (model.law.name, model.simulate_signal(record), line_style(k)) for k, model in enumerate(models)
    ]
    tested, height = best.quality.test_swings, 6.0 + 0.15 * len(models)
    yield Picture(
        partial(_draw_curves_and_residuals, record, curves, tested=tested, height=height),
        "The fits of all laws, and their residuals.",
    )


def phase_portrait_section(record: PistonRecord, best: ReducedModel) -> Iterator[Block]:
    """Section with velocity against height (or force against stroke) of the record and the best law."""
    if best.law.prescribed:
        yield Picture(partial(_draw_force_loop, record, best), "Force against stroke, with the best law.")
    if record.measured == "height":
        yield Picture(partial(_draw_phase_portrait, record, best), "Phase portrait, with the best law.")


def _draw_force_loop(record: PistonRecord, best: ReducedModel) -> Figure:
    with figure(height=4.8, size=READABLE) as (drawing, axes):
        best.plot(record, axes)
        return drawing


def _draw_phase_portrait(record: PistonRecord, best: ReducedModel) -> Figure:
    shown = _drawn_coordinate_of_record(record)
    with figure(height=4.8, size=READABLE) as (drawing, axes):
        speed = record.velocity
        if speed is None:
            speed = np.gradient(record.height, record.time)
        motion = best.simulate_record(record)
        assert motion.velocity is not None
        for height, velocity, name, look in (
            (record.height, speed, "record", {"color": GREY, "linewidth": 3}),
            (motion.height, motion.velocity, figure_label(best.law.name), {"linewidth": 1.0}),
        ):
            axes.plot(*downsample_columns(shown.scale * height, shown.scale * velocity), label=name, **look)
        axes.set(xlabel=shown.label, ylabel=f"velocity [{shown.unit}/s]")
        axes.legend(loc="upper right")
        return drawing


def higher_lift_section(lift: PistonRecord, table: Comparison) -> Iterator[Block]:
    """Make the section with the held-out higher lift and the predictions of the laws."""
    ranked = table.ranking_on_last_record()
    best = ranked[0][0].relative
    yield Heading("A held-out higher lift")
    yield Text(
        "The same scene with a lift three times as high. Each law starts from the height and velocity "
        "that are estimated from the first period, and predicts the rest."
    )
    rows = []
    for score, name in ranked:
        ratio, error = score.relative / max(best, 1e-300), 100.0 * score.relative
        finite = (format_number(error, 3), format_number(ratio, 3))
        rows.append((name, *(finite if math.isfinite(error) else ("diverges", ""))))
    yield Table(("law", "error [% of rms displacement]", "times the best"), rows)
    best_ranked = ranked[:_MAXIMUM_LIFT_LINES]
    curves = [(name, score.motion.height, line_style(k)) for k, (score, name) in enumerate(best_ranked)]
    missed = _drawn_coordinate_of_record(lift)._replace(name="missed")
    yield Picture(
        partial(_draw_curves_and_residuals, lift, curves, label="simulated", difference=missed),
        "The higher lift, and the predictions of the best laws.",
    )


def comparison_section(table: Comparison) -> Iterator[Block]:
    """Section with a table of the laws and their held-out errors."""
    yield Heading("The laws compared")
    header, cells = table.header, table.cells()
    baseline = "constant force" if table.best.law.prescribed else "motionless piston"
    if not any(row.divergence_count for row in table.rows):
        header, cells = header[:-1], [row[:-1] for row in cells]
    yield Table(header, cells)
    yield Text(
        "Errors are root mean squares of record minus simulation over held-out data, divided by "
        f"{table.best.error_reference_text.removeprefix('of ')}. For comparison, a {baseline} has an error "
        f"of {100 * table.at_rest:.3g} %, and the noise is {100 * table.noise:.2g} %. Held-out data are "
        "cycles excluded from a first fit (held-out cycles) and whole records excluded from all fits "
        "(record 1, which the terminal calls '3x higher lift'). AIC and BIC (Akaike's and the Bayesian "
        "information criterion) are the misfit of the fits to whole records plus a penalty for each "
        "parameter, minus the lowest value in the table."
    )
    yield Picture(partial(_draw_test_errors, table, table.drawing_height), "Held-out errors of the laws.")


def _draw_test_errors(scored: Comparison | DropScores, height: float) -> Figure:
    with figure(height=height, size=READABLE) as (drawing, axes):
        scored.plot(axes)
        return drawing


def falls_section(falls: DropScores) -> Iterator[Block]:
    """Section with predictions of held-out falls and the errors of the predictions."""
    yield falls.table
    yield Text(
        "Each law was fitted to the scene's fall, and predicts the other falls from only the height at "
        "which the piston is released. Errors are root mean squares "
        "divided by the height of the drop. No law can predict the difference between falls onto different "
        "random packings."
    )
    yield Picture(
        partial(_draw_highest_fall, falls),
        "A fall from a larger height, and the predictions of the best laws.",
    )
    yield Picture(
        partial(_draw_test_errors, falls, 4.4), "Errors of the laws relative to the height of the drop."
    )


def _draw_highest_fall(falls: DropScores) -> Figure:
    far = max(falls.unseen, key=lambda fall: float(fall.height[0]))
    time = far.time - far.time[0]
    with figure(height=4.4, size=READABLE) as (drawing, axes):
        axes.plot(*downsample_columns(time, 1e3 * far.height), color=GREY, linewidth=3.0, label="simulated")
        sound = [row for row in falls.rows if row.model is not None and np.isfinite(row.median_error)]
        for k, row in enumerate(sound[:_MAXIMUM_FALL_LINES]):
            assert row.model is not None
            motion = row.model.simulate(far.time, z0=float(far.height[0]), v0=0.0)
            axes.plot(
                *downsample_columns(time, 1e3 * motion.height),
                linewidth=1.2,
                label=figure_label(row.name),
                **line_style(k),
            )
        axes.set(xlabel="time [s]", ylabel="height [mm]")
        axes.legend(loc="upper right")
        return drawing


def simulation_run_sections(run: Trajectory, frequency: QuantityWithError | None) -> Iterator[Block]:
    """Sections with the bed before and after the run, the energy ledger, and the settings."""
    yield from _bed_section(run)
    yield from _energy_ledger_section(run)
    yield from _settings_section(run, frequency)


def _bed_section(run: Trajectory) -> Iterator[Block]:
    yield Heading("The bed before and after")
    yield Picture(partial(_draw_beds, run), "The grains to scale; the piston is the thick line.")
    lines = [
        (
            stage.name,
            format_number(stage.start),
            format_number(stage.end),
            stage.reason,
            format_number(1e3 * stage.height, 6),
        )
        for stage in run.stages
    ]
    yield Table(("stage", "from [s]", "to [s]", "ended by", "piston height [mm]"), lines)
    closest = run.settings().get("closest_distance")
    diameter = min(species.diameter for species in run.scene.grains.species)
    if closest is not None and closest < diameter and run.scene.effects.contact is None:
        yield Caution(
            f"The minimum distance of two grains was {1e3 * closest:.3g} mm, less than a diameter "
            f"({1e3 * diameter:g} mm): in reality they would have touched, but the scene has no contact "
            "force."
        )


def _draw_beds(run: Trajectory) -> Figure:
    from granular.run.trajectory import piston_heights_in_frames

    data, scene = run.dataset, run.scene
    tallest = float(data["frame_height"][[0, -1]].max()) if scene.piston else scene.cell.width
    heights = piston_heights_in_frames(scene, data)
    height = min(4.0, 3.1 * tallest / scene.cell.width + 1.0)
    with figure(1, 2, height=height, size=READABLE) as (drawing, pair):
        for axes, k, when in zip(pair, (0, -1), ("before", "after"), strict=True):
            draw_bed(axes, scene, data["position"][k].values, heights[k])
            axes.set_title(f"{when}, t = {float(data['frame_time'][k]):.4g} s")
        return drawing


def _energy_ledger_section(run: Trajectory) -> Iterator[Block]:
    from granular.scene.scene import degraded_energy_residual_limit

    yield Heading("Energy balance")
    yield Picture(
        partial(_draw_energies, run),
        "Parts of the energy, the gravitational one relative to the start, and the residual of their sum.",
    )
    worst = run.settings()["ledger_residual"]
    words = f"The energy balance has a maximum residual of {worst:.1e} of the energy turned over."
    yield Caution(words) if worst > degraded_energy_residual_limit(run.scene) else Text(words)


def _draw_energies(run: Trajectory) -> Figure:
    data = run.dataset
    time = data["time"].values
    parts = {key: data[key].values for key in _ENERGIES if key in data}
    stored_energy = np.sum([value for key, value in parts.items() if key.endswith("_energy")], axis=0)
    residual = stored_energy - stored_energy[0] + parts.get("drag_loss", 0.0) - parts.get("work", 0.0)
    with figure(2, 1, height=6.2, **_STACKED) as (drawing, (top, bottom)):
        for k, (key, value) in enumerate(parts.items()):
            shown = value - value[0] if key in ("weight_energy", "piston_energy") else value
            t, energy = downsample_columns(time, 1e3 * shown)
            top.plot(t, energy, label=_ENERGIES[key], linestyle=STYLES[k % len(STYLES)])
        top.set_ylabel("energy [mJ]")
        top.legend(ncols=2, loc="upper right")
        bottom.plot(*downsample_columns(time, 1e6 * residual), color=COLOURS[0])
        bottom.set(ylabel="residual [µJ]", xlabel="time [s]")
        return drawing


def _settings_section(run: Trajectory, frequency: QuantityWithError | None) -> Iterator[Block]:
    yield Heading("Settings")
    settings = run.settings()
    yield Table(
        ("setting", "value"),
        [
            ("method", run.method.name),
            ("sum over pairs", run.scene.pair_method),
            ("time step", time_step_text(run)),
            ("steps", settings["steps"]),
            (
                "largest step times highest frequency (stable below 2)",
                format_number(settings["step_times_highest_frequency"], 3),
            ),
            ("computing time of the run [s]", format_number(settings["seconds"], 3)),
        ],
    )
    yield Text(checked_work_precision_text(run, frequency))
    yield Printout(run.scene.to_toml())


def checked_work_precision_text(run: Trajectory, frequency: QuantityWithError | None) -> str:
    """State a run's computing time, and its frequency error if the time step was checked."""
    # Imported here, since fits alone do not need the simulation.
    from granular.run.work_precision import cost_and_error_text, work_precision_text

    if frequency is None or "step" not in frequency.parts or not frequency.value > 0.0:
        return work_precision_text(run)
    scatter, step = frequency.parts.get("start", 0.0), frequency.parts["step"]
    error, hidden = step / frequency.value, step <= scatter
    scattered = scatter / frequency.value
    return cost_and_error_text(
        run, "natural frequency", error, "by the step check", scattered, within_spread=hidden
    )
