"""Result of a calibration: parameters of a scene, uncertainties, and remaining discrepancies."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.records.record import PistonRecord
from granular.scene.scene import Scene
from granular.shared.blocks import Heading, Picture, Printout, Table, make_cautions
from granular.shared.files import write_json
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, GREY, figure
from reduced_models.models.quantities import ParameterDirection
from reduced_models.records.sources import make_directory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class CalibratedValue:
    """A calibrated parameter of a scene.

    Attributes
    ----------
    key, unit : str
    value : float
    interval : (float, float)
        Confidence interval from the record's noise and the scatter over random packings together.
    start : float
        Value in the given scene.
    noise, scatter : float
        Standard errors, relative to the value: ``noise`` due to the record's residual, ``scatter`` due
        to the unknown packing of the laboratory's bed and the finite number of simulated packings.
    step : float or None
        Estimated relative error due to the simulation's time step.
    """

    key: str
    unit: str
    value: float
    interval: tuple[float, float]
    start: float
    noise: float
    scatter: float
    step: float | None = None

    def __str__(self) -> str:
        low, high = self.interval
        step = "" if self.step is None else f", time step {100 * self.step:.2g} %"
        return (
            f"{self.key} = {self.value:.6g} {self.unit} [{low:.6g}, {high:.6g}], from "
            f"{self.start:.6g} (noise {100 * self.noise:.2g} %, random packings "
            f"{100 * self.scatter:.2g} %{step})"
        )


@dataclasses.dataclass(frozen=True)
class RecordAndSimulatedFeature:
    """A feature of the record and of the final simulations."""

    name: str
    record: float
    simulated: float  # mean over the random starts
    noise: float  # relative standard error of the record's
    scatter: float  # relative standard deviation over the random starts


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """Parameters of a scene, calibrated to a record.

    Attributes
    ----------
    parameters : tuple of CalibratedValue
    confidence : float
        Confidence level of the intervals.
    matches : tuple of RecordAndSimulatedFeature
    undetermined : tuple of ParameterDirection
        Combinations of parameters that can change without changing the features; they keep the values of the
        given scene.
    scene : Scene
        Scene with the calibrated values.
    record : PistonRecord
    motions : tuple of PistonRecord
        Motions of the final simulations, one for each random packing.
    simulations : int
        Number of simulations.
    notes : tuple of str
        Texts on weak points of the calibration.
    """

    parameters: tuple[CalibratedValue, ...]
    confidence: float
    matches: tuple[RecordAndSimulatedFeature, ...]
    undetermined: tuple[ParameterDirection, ...]
    scene: Scene
    record: PistonRecord
    motions: tuple[PistonRecord, ...]
    simulations: int
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Calibrated values by key, which `Scene.replace` accepts."""
        return {parameter.key: parameter.value for parameter in self.parameters}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Intervals of the calibrated values by key."""
        return {parameter.key: parameter.interval for parameter in self.parameters}

    def __str__(self) -> str:
        lines = [f"scene {self.scene.name!r} against {len(self.record)} samples"]
        lines += [f"  {feature}" for feature in self.parameters]
        lines += [f"  open: {direction}" for direction in self.undetermined]
        lines += [
            f"  {feature.name.replace('_', ' ')}: record {feature.record:.6g}, simulated "
            f"{feature.simulated:.6g} ({100 * feature.noise:.2g} % noise, "
            f"{100 * feature.scatter:.2g} % over random packings)"
            for feature in self.matches
        ]
        lines.append(
            f"  {100 * self.confidence:g} % intervals from noise and random packings; "
            f"{self.simulations} simulations, {len(self.motions)} packings"
        )
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def to_plain(self) -> dict[str, Any]:
        """Return the calibration as plain data (numbers, strings, lists)."""
        return {
            "parameters": {entry.key: dataclasses.asdict(entry) for entry in self.parameters},
            "confidence": self.confidence,
            "features": [dataclasses.asdict(entry) for entry in self.matches],
            "undetermined": [dataclasses.asdict(entry) for entry in self.undetermined],
            "simulations": self.simulations,
            "random_starts": len(self.motions),
            "notes": list(self.notes),
        }

    def plot(self) -> Figure:
        """Plot record and simulations [mm, s], and the differences of their features [%]."""
        with figure(2, 1, height=5.4, height_ratios=(2, 1)) as (drawing, (top, bottom)):
            time = self.record.time - self.record.time[0]
            top.plot(time, 1e3 * self.record.height, color=GREY, linewidth=3, label="record")
            for k, motion in enumerate(self.motions):
                label = "simulated, one line per random packing" if k == 0 else None
                top.plot(motion.time, 1e3 * motion.height, color=COLOURS[0], linewidth=0.7, label=label)
            top.set(ylabel="height [mm]", xlabel="time [s]")
            top.legend()
            names = [feature.name.replace("_", " ") for feature in self.matches]
            bottom.errorbar(
                [100.0 * (feature.simulated / feature.record - 1.0) for feature in self.matches],
                names,
                xerr=[200.0 * math.hypot(feature.noise, feature.scatter) for feature in self.matches],
                fmt="o",
                color=COLOURS[1],
                capsize=3,
            )
            bottom.axvline(0.0, color=GREY)
            bottom.set_xlabel("simulated minus record, with two standard deviations [%]")
            bottom.margins(y=0.3)
            return drawing

    def page(self) -> Page:
        """Report page of the calibration."""
        return Page(
            f"Scene {self.scene.name!r} calibrated",
            "; ".join(map(str, self.parameters)),
            [
                *make_cautions((*map(str, self.undetermined), *self.notes)),
                self._parameter_table,
                Picture(self.plot, "The record, the simulations, and their features."),
                Heading("The scene"),
                Printout(self.scene.to_toml()),
            ],
            result=self,
        )

    @property
    def _parameter_table(self) -> Table:
        rows = []
        for item in self.parameters:
            (low, high), parts = item.interval, (item.noise, item.scatter, item.step)
            errors = ("" if part is None else f"{100 * part:.2g}" for part in parts)
            interval = f"{low:.6g} to {high:.6g}"
            rows.append((item.key, f"{item.value:.6g}", item.unit, interval, f"{item.start:.6g}", *errors))
        interval = f"{100 * self.confidence:g} % interval"
        head = ("number", "value", "unit", interval, "before", "noise [%]", "random packings [%]", "step [%]")
        return Table(head, rows)

    def save(self, out: str | Path) -> None:
        """Write report.html, calibration.json and the calibrated scene.toml."""
        target = make_directory(out)
        write_json(target / "calibration.json", self.to_plain())
        self.scene.save(target / "scene.toml")
        self.page().save(target / "report.html")
