"""The report of an identification: one HTML file."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.shared.html import Page, number
from granular.shared.plotting import COLOURS, GREY, STYLES, draw_bed, figure, line_look, plain_label
from granular.shared.version import versions
from reduced_models.identification.comparison import Comparison
from reduced_models.identification.data import IdentificationData
from reduced_models.laws.printing import mathml
from reduced_models.models.model import ReducedModel
from reduced_models.records.sources import step_text

if TYPE_CHECKING:
    from granular.run.trajectory import StageResult, Trajectory

_MOST_POINTS = 3000  # of a line; more cannot be seen
_ENERGIES = {
    "kinetic_energy": "grains, kinetic",
    "pair_energy": "pairs",
    "wall_energy": "walls",
    "weight_energy": "grains, weight",
    "piston_energy": "piston",
    "drag_loss": "lost to drag",
    "work": "work from outside",
}


def identification_page(found: IdentificationData) -> Page:
    """The report as a page."""
    name = "a record" if found.run is None else f"scene {found.run.scene.name!r}"
    page = Page(f"The equation of {name}", found.verdict)
    for note in found.notes:
        page.note(f"{_sentence(note)}.")
    _table(page, found.comparison)
    _equations(page, found)
    _figures(page, found)
    _record(page, found)
    if found.run is not None:
        _bed(page, found.run)
        _ledger(page, found.run)
        _settings(page, found.run)
    _times(page, found)
    made = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    page.footer(f"Made on {made} with " + ", ".join(f"{k} {v}" for k, v in versions().items()))
    return page


def comparison_page(table: Comparison) -> Page:
    """A comparison of laws as a page."""
    page = Page("Laws compared", table.verdict)
    _table(page, table)
    for row in table.rows:
        for model in row.models[:1]:
            _equation(page, model, " (first)" if row is table.rows[0] else "")
    page.footer("Made with " + ", ".join(f"{k} {v}" for k, v in versions().items()))
    return page


def _table(page: Page, table: Comparison) -> None:
    page.section("The laws compared")
    page.table(table.header, table.cells())
    page.text(
        "Errors are root mean squares of height minus roll-out over what the law has not seen, in "
        f"rms swings; a piston that stays at rest would score {100 * table.at_rest:.3g} %, and the "
        f"noise is {100 * table.noise:.2g} %. AIC and BIC, of the fits to whole records, count "
        "from the least."
    )
    page.figure(table.plot(), "Held-out errors of the laws.")


def _equations(page: Page, found: IdentificationData) -> None:
    for model in found.models:
        _equation(page, model, " (best)" if model is found.best else "")


def _equation(page: Page, model: ReducedModel, remark: str) -> None:
    page.section(f"{model.law.name}{remark}")
    page.equation(mathml(model.equation))
    page.equation(mathml(model.printed_equation))
    for name, rate in model.law.parsed.hidden.items():
        page.text(f"Hidden state: {name}' = {rate}".replace("z_first", "z'"))
    meaning = "z is the height in metres"
    if model.law.mapped:
        how = "fitted" if model.map.fitted else "given, not fitted"
        height = model.map.text(max(5, model.printed_digits))
        meaning = f"{height} ({how}), a pure number; the law's time unit is 1 s"
    page.text(f"Source of the law: {model.law.source or 'own'}; t is in seconds, {meaning}.")
    page.table(
        ("parameter", "value", "unit", f"{100 * model.confidence:g} % interval"),
        _parameter_rows(model),
    )
    for direction in model.undetermined:
        page.note(f"A direction is left open: {direction}.")
    for note in model.notes:
        page.note(f"{_sentence(note)}.")
    quality = model.quality
    words = (
        f"Residual {1e6 * quality.residual:.3g} micrometres, {100 * quality.relative:.3g} % of "
        f"the rms swing, over {quality.samples} samples. {quality.converged} of "
        f"{quality.starts} random starts led to this fit."
    )
    if quality.holdout is not None:
        words += (
            f" Fitted to the first {quality.holdout_from:.3g} s only, it predicts the rest to "
            f"{100 * quality.holdout:.3g} % of the rms swing."
        )
    if quality.holdout_at_rest is not None:
        words += (
            f" A piston that stays at the level of rest would score "
            f"{100 * quality.holdout_at_rest:.3g} % there; "
            "only a smaller error speaks for the law."
        )
    page.text(words)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _parameter_rows(model: ReducedModel) -> list[Sequence[str]]:
    values, digits = dict(model.parameters), max(6, model.printed_digits)
    units = dict(model.law.units)
    if model.map.fitted:
        values |= {"shift": model.map.shift, "scale": model.map.scale}
        units |= {"shift": "m", "scale": "m"}
    return [
        (
            name,
            number(value, digits),
            units.get(name, ""),
            interval_text(*model.intervals[name], value),
        )
        for name, value in values.items()
    ]


def interval_text(low: float, high: float, value: float) -> str:
    """An interval for people; one that is much wider than the value is called open."""
    if high - low > 20.0 * abs(value):
        return "open"
    return f"{low:.6g} to {high:.6g}"


def _diameter(run: Trajectory) -> float:
    from granular.scene.scales import Scales

    return Scales.of(run.scene.grains).length


def _figures(page: Page, found: IdentificationData) -> None:
    if not found.figures:
        return
    page.section("The small swing about rest")
    length = None if found.run is None else _diameter(found.run)
    rows = []
    for name, figure_ in found.figures.items():
        unit, scale = {"height": ("mm", 1e3), "period": ("ms", 1e3)}.get(name, ("", 1.0))
        views = [(name.replace("_", " "), unit, scale)]
        if name == "height" and length is not None:
            views.append(("height", "D", 1.0 / length))
        for title, shown, factor in views:
            errors = [
                "" if error is None else number(factor * error, 2)
                for error in (figure_.step_error, figure_.seed_spread)
            ]
            low, high = figure_.interval
            interval = f"{factor * low:.6g} to {factor * high:.6g}"
            rows.append((title, f"{factor * figure_.value:.6g}", shown, interval, *errors))
    page.table(("figure", "value", "unit", "interval of the fit", "step error", "scatter"), rows)
    page.text(
        f"From the fit of the law {found.figures_law!r}. The step error is what twice the step "
        "changes in the same fit (half of it, and the order of the method, where twice is too "
        "coarse), which is more than the error of the step itself; the scatter is the standard "
        "deviation over random starts of the bed. Where the step error is not smaller "
        "than the scatter, it is the scatter that it shows: another step lets the bed pack in "
        "another way."
    )


def _thin(*columns: np.ndarray) -> list[np.ndarray]:
    every = max(1, len(columns[0]) // _MOST_POINTS)
    return [column[::every] for column in columns]


def _record(page: Page, found: IdentificationData) -> None:
    page.section("The record and the fits")
    record = found.record
    time = record.time - record.time[0]
    motions = {model.law.name: model.follow(record) for model in found.models}
    with figure(2, 1, height=5.2, sharex=True, height_ratios=(2, 1)) as (drawing, (top, bottom)):
        t, height = _thin(time, 1e3 * record.height)
        top.plot(t, height, color=GREY, linewidth=3.0, label="record")
        for k, (name, motion) in enumerate(motions.items()):
            t, height, residual = _thin(
                time, 1e3 * motion.height, 1e6 * (record.height - motion.height)
            )
            style = {"linewidth": 1.2, **line_look(k)}
            top.plot(t, height, label=plain_label(name), **style)
            bottom.plot(t, residual, label=plain_label(name), **style)
        start = found.best.quality.holdout_from
        if start is not None:
            for axes in (top, bottom):
                axes.axvspan(start, time[-1], color=GREY, alpha=0.15, linewidth=0.0)
        top.set_ylabel("height [mm]")
        top.legend(ncols=3)
        bottom.set_ylabel("residual [µm]")
        bottom.set_xlabel("time [s]")
        page.figure(
            drawing,
            "Height of the piston, the fits over it, and what they leave over. The hold-out error "
            "is measured on the shaded stretch.",
        )
    with figure(height=4.2) as (drawing, axes):
        speed = record.velocity
        if speed is None:
            speed = np.gradient(record.height, record.time)
        axes.plot(*_thin(1e3 * record.height, 1e3 * speed), color=GREY, linewidth=3, label="record")
        for k, (name, motion) in enumerate(motions.items()):
            assert motion.velocity is not None
            axes.plot(
                *_thin(1e3 * motion.height, 1e3 * motion.velocity),
                linewidth=1.0, label=plain_label(name), **line_look(k),
            )  # fmt: skip
        axes.set_xlabel("height [mm]")
        axes.set_ylabel("velocity [mm/s]")
        axes.legend()
        page.figure(drawing, "Phase portrait.")


def _bed(page: Page, run: Trajectory) -> None:
    page.section("The bed before and after")
    data, scene = run.dataset, run.scene
    tallest = float(data["frame_height"][[0, -1]].max()) if scene.piston else scene.cell.width
    height = min(4.0, 3.1 * tallest / scene.cell.width + 1.0)
    with figure(1, 2, height=height) as (drawing, pair):
        for axes, k, when in zip(pair, (0, -1), ("before", "after"), strict=True):
            top = float(data["frame_height"][k]) if scene.piston is not None else None
            draw_bed(axes, scene, data["position"][k].values, top)
            axes.set_title(f"{when}, t = {float(data['frame_time'][k]):.4g} s", fontsize=10)
        page.figure(drawing, "The grains to scale; the piston is the thick line.")
    lines = [_stage_row(stage) for stage in run.stages]
    page.table(("stage", "from [s]", "to [s]", "ended by", "piston height [mm]"), lines)
    _overlap_note(page, run)


def _stage_row(stage: StageResult) -> Sequence[str]:
    start, end = number(stage.start), number(stage.end)
    return stage.name, start, end, stage.reason, number(1e3 * stage.height, 6)


def _overlap_note(page: Page, run: Trajectory) -> None:
    closest = run.settings().get("closest_distance")
    least = min(species.diameter for species in run.scene.grains.species)
    if closest is not None and closest < least:
        page.note(
            f"At the closest, two grains were {1e3 * closest:.3g} mm apart, less than a diameter "
            f"({1e3 * least:g} mm): in reality they would have touched. The scene has no contact."
        )


def _ledger(page: Page, run: Trajectory) -> None:
    from granular.engine.ledger import doubtful

    page.section("Energy ledger")
    data = run.dataset
    time = data["time"].values
    parts = {key: data[key].values for key in _ENERGIES if key in data}
    stored = np.sum([value for key, value in parts.items() if key.endswith("_energy")], axis=0)
    residual = stored - stored[0] + parts.get("drag_loss", 0.0) - parts.get("work", 0.0)
    with figure(2, 1, height=5.0, sharex=True, height_ratios=(2, 1)) as (drawing, (top, bottom)):
        for k, (key, value) in enumerate(parts.items()):
            shown = value - value[0] if key in ("weight_energy", "piston_energy") else value
            t, energy = _thin(time, 1e3 * shown)
            top.plot(t, energy, label=_ENERGIES[key], linestyle=STYLES[k % len(STYLES)])
        top.set_ylabel("energy [mJ]")
        top.legend(ncols=3, fontsize=8)
        bottom.plot(*_thin(time, 1e6 * residual), color=COLOURS[0])
        bottom.set_ylabel("residual [µJ]")
        bottom.set_xlabel("time [s]")
        page.figure(
            drawing,
            "Where the energy is (the weights' relative to the start), and what the ledger misses.",
        )
    worst = run.settings()["ledger_residual"]
    words = f"The ledger closes to {worst:.1e} of the energy turned over."
    (page.note if worst > doubtful(run.scene) else page.text)(words)


def _settings(page: Page, run: Trajectory) -> None:
    page.section("Settings")
    settings = run.settings()
    page.table(
        ("setting", "value"),
        [
            ("method", run.method.name),
            ("time step", step_text(run)),
            ("steps", settings["steps"]),
            (
                "greatest step times highest frequency (stable below 2)",
                number(settings["step_times_highest_frequency"], 3),
            ),
            ("seconds of the run", number(settings["seconds"], 3)),
        ],
    )
    page.preformatted(run.scene.to_toml())


def _times(page: Page, found: IdentificationData) -> None:
    page.section("What it took")
    rows = [(name, f"{seconds:.2f}") for name, seconds in found.seconds.items()]
    page.table(("part", "seconds"), rows)
