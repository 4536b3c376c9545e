"""What a calibration found: numbers of a scene, how sure they are, and where the scene fails."""

from __future__ import annotations

import dataclasses
from typing import Any

from granular.run.record import PistonRecord
from granular.scene.scene import Scene
from reduced_models.models.quality import Direction


@dataclasses.dataclass(frozen=True)
class Calibrated:
    """A number of a scene as a record has it.

    Attributes
    ----------
    key, unit : str
    value : float
    interval : (float, float)
        From the record's noise and the scatter over random starts together.
    start : float
        In the scene that was given.
    noise, scatter : float
        Standard deviations, relative to the value, that the record's residual leaves, and that
        the random starts make (of the record's bed, and of the mean of the simulated ones).
    step : float or None
        Estimated error of the simulation's time step, relative.
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
            f"{self.start:.6g} (noise {100 * self.noise:.2g} %, random starts "
            f"{100 * self.scatter:.2g} %{step})"
        )


@dataclasses.dataclass(frozen=True)
class Match:
    """A feature of the record and of the simulations at the end.

    Attributes
    ----------
    name : str
    record, simulated : float
        The latter a mean over the random starts.
    noise, scatter : float
        Relative standard deviations of the former, and over the random starts.
    """

    name: str
    record: float
    simulated: float
    noise: float
    scatter: float


@dataclasses.dataclass(frozen=True, eq=False)
class CalibrationData:
    """What a record says of the numbers of a scene.

    Attributes
    ----------
    parameters : tuple of Calibrated
    confidence : float
        Of the intervals.
    matches : tuple of Match
    undetermined : tuple of Direction
        Directions in which the parameters can move without the features noticing; along them, the
        values are those of the scene that was given.
    scene : Scene
        With the values.
    record : PistonRecord
    motions : tuple of PistonRecord
        Of the last simulations, one a random start.
    simulations : int
    notes : tuple of str
        What is to be doubted, in plain words.
    """

    parameters: tuple[Calibrated, ...]
    confidence: float
    matches: tuple[Match, ...]
    undetermined: tuple[Direction, ...]
    scene: Scene
    record: PistonRecord
    motions: tuple[PistonRecord, ...]
    simulations: int
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """The values by their keys, ready for `Scene.replace`."""
        return {one.key: one.value for one in self.parameters}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """The intervals by their keys."""
        return {one.key: one.interval for one in self.parameters}

    def __str__(self) -> str:
        lines = [f"scene {self.scene.name!r} against {len(self.record)} samples"]
        lines += [f"  {one}" for one in self.parameters]
        lines += [f"  open: {direction}" for direction in self.undetermined]
        lines += [
            f"  {one.name.replace('_', ' ')}: record {one.record:.6g}, simulated "
            f"{one.simulated:.6g} ({100 * one.noise:.2g} % noise, {100 * one.scatter:.2g} % over "
            "random starts)"
            for one in self.matches
        ]
        lines.append(
            f"  {100 * self.confidence:g} % intervals from noise and random starts; "
            f"{self.simulations} simulations, {len(self.motions)} random starts"
        )
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def to_plain(self) -> dict[str, Any]:
        """The result as plain data (numbers, texts, lists)."""
        return {
            "parameters": {one.key: dataclasses.asdict(one) for one in self.parameters},
            "confidence": self.confidence,
            "features": [dataclasses.asdict(one) for one in self.matches],
            "undetermined": [dataclasses.asdict(one) for one in self.undetermined],
            "simulations": self.simulations,
            "random_starts": len(self.motions),
            "notes": list(self.notes),
        }
