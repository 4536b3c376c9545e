"""What an identification found, as data."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from granular.run.record import PistonRecord
from reduced_models.identification.comparison import Comparison
from reduced_models.identification.price import checked_price_text
from reduced_models.models.model import ReducedModel
from reduced_models.records.sources import step_text

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory

_UNITS = {"height": "m", "period": "s", "damping_ratio": ""}


@dataclasses.dataclass(frozen=True)
class Figure:
    """A number with all its uncertainties.

    Attributes
    ----------
    value : float
    interval : (float, float)
        Confidence interval of the fit.
    step_error : float or None
        Estimated error of the simulation's time step, from a run with another step and the same fit
        of the same law; see `reduced_models.identification.checks.step_check`.
    seed_spread : float or None
        Standard deviation over random starts of the bed.
    """

    value: float
    interval: tuple[float, float]
    step_error: float | None = None
    seed_spread: float | None = None

    def checked(self) -> tuple[float, float | None, float | None]:
        """The value, its step error, and its scatter over starts."""
        return self.value, self.step_error, self.seed_spread


@dataclasses.dataclass(frozen=True, eq=False)
class IdentificationData:
    """What was identified.

    Attributes
    ----------
    record : PistonRecord
    models : tuple of ReducedModel
        One a law, in the order asked for.
    comparison : Comparison
        Table of the laws, and the verdict.
    run : Trajectory or None
        Where the record comes from a simulation.
    figures : mapping of str to Figure
        ``height`` [m], ``period`` [s] and ``damping_ratio`` of the small swing about rest.
    figures_law : str
        The law whose fit they come from.
    notes : tuple of str
        What is to be doubted in the run or its checks.
    seconds : mapping of str to float
        Wall time of each part.
    """

    record: PistonRecord
    models: tuple[ReducedModel, ...]
    comparison: Comparison
    run: Trajectory | None
    figures: Mapping[str, Figure]
    figures_law: str
    notes: tuple[str, ...]
    seconds: Mapping[str, float]

    @property
    def best(self) -> ReducedModel:
        """The model of the law that the comparison puts first."""
        first = self.comparison.rows[0].name
        return next(model for model in self.models if model.law.name == first)

    @property
    def verdict(self) -> str:
        """Of the comparison, in plain words."""
        return self.comparison.verdict

    def to_plain(self) -> dict[str, Any]:
        """Figures, verdict and models as plain data."""
        return {
            "verdict": self.verdict,
            "best": self.best.law.name,
            "comparison": self.comparison.to_plain(),
            "models": [model.to_plain() for model in self.models],
            "figures": {name: dataclasses.asdict(figure) for name, figure in self.figures.items()},
            "figures_law": self.figures_law,
            "notes": list(self.notes),
            "time_step": None if self.run is None else step_text(self.run),
            "seconds": dict(self.seconds),
        }

    def __str__(self) -> str:
        lines = [*map(str, self.models), "", str(self.comparison)]
        if self.figures:
            lines.append(f"small swing about rest, by {self.figures_law}:")
        lines += [f"  {_figure_text(name, figure)}" for name, figure in self.figures.items()]
        if self.run is not None:
            method = self.run.method.name
            lines.append(f"simulated with {method}, time step {step_text(self.run)}")
            height = self.figures.get("height")
            checked = (0.0, None, None) if height is None else height.checked()
            lines.append(checked_price_text(self.run, *checked))
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def _figure_text(name: str, figure: Figure) -> str:
    low, high = figure.interval
    text = f"{name.replace('_', ' ')} {figure.value:.5g} {_UNITS[name]}".rstrip()
    text += f"  [{low:.5g}, {high:.5g}]"
    if figure.step_error is not None:
        text += f", step error {figure.step_error:.2g}"
    if figure.seed_spread is not None:
        text += f", scatter over random starts {figure.seed_spread:.2g}"
    return text
