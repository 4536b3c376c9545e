"""The part of a report that tells of the simulation: the bed, its energy, its settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.observables.plots import draw_bed
from granular.shared.html import Page, number
from granular.shared.plotting import COLOURS, READABLE, STYLES, figure
from reduced_models.identification.page_record import thinned
from reduced_models.records.sources import step_text

if TYPE_CHECKING:
    from granular.run.trajectory import StageResult, Trajectory

_ENERGIES = {
    "kinetic_energy": "grains, kinetic",
    "pair_energy": "pairs",
    "wall_energy": "walls",
    "weight_energy": "grains, weight",
    "piston_energy": "piston",
    "drag_loss": "lost to drag",
    "work": "work from outside",
}


def add_run(page: Page, run: Trajectory) -> None:
    """The bed before and after, the energy ledger, and the settings."""
    _bed(page, run)
    _ledger(page, run)
    _settings(page, run)


def _bed(page: Page, run: Trajectory) -> None:
    page.section("The bed before and after")
    data, scene = run.dataset, run.scene
    tallest = float(data["frame_height"][[0, -1]].max()) if scene.piston else scene.cell.width
    height = min(4.0, 3.1 * tallest / scene.cell.width + 1.0)
    with figure(1, 2, height=height, size=READABLE) as (drawing, pair):
        for axes, k, when in zip(pair, (0, -1), ("before", "after"), strict=True):
            top = float(data["frame_height"][k]) if scene.piston is not None else None
            draw_bed(axes, scene, data["position"][k].values, top)
            axes.set_title(f"{when}, t = {float(data['frame_time'][k]):.4g} s")
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
    from granular.scene.dryness import doubtful

    page.section("Energy ledger")
    data = run.dataset
    time = data["time"].values
    parts = {key: data[key].values for key in _ENERGIES if key in data}
    stored = np.sum([value for key, value in parts.items() if key.endswith("_energy")], axis=0)
    residual = stored - stored[0] + parts.get("drag_loss", 0.0) - parts.get("work", 0.0)
    with figure(2, 1, height=6.2, size=READABLE, sharex=True, height_ratios=(2, 1)) as (
        drawing,
        (top, bottom),
    ):
        for k, (key, value) in enumerate(parts.items()):
            shown = value - value[0] if key in ("weight_energy", "piston_energy") else value
            t, energy = thinned(time, 1e3 * shown)
            top.plot(t, energy, label=_ENERGIES[key], linestyle=STYLES[k % len(STYLES)])
        top.set_ylabel("energy [mJ]")
        top.legend(ncols=2, loc="upper right")
        bottom.plot(*thinned(time, 1e6 * residual), color=COLOURS[0])
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
