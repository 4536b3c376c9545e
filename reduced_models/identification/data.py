"""What an identification found, as data."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from granular.run.record import PistonRecord
from granular.shared.messages import times
from reduced_models.falls.data import Falls
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.elliptic_words import (
    Averaging,
    averaging_of,
    elliptic_of,
    elliptic_words,
)
from reduced_models.identification.engineering import Quantity, engineering, swing_words
from reduced_models.identification.residual_tests import ResidualTests
from reduced_models.laws.elliptic import EllipticMotion
from reduced_models.models.model import ReducedModel
from reduced_models.records.sources import step_text

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory


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
        What is to be doubted in the run or its checks, and what was not used.
    seconds : mapping of str to float
        Wall time of each part.
    mass : float or None
        Of what moves [kg], where it is known.
    left_out : tuple of str
        Laws that were not fitted, and why.
    residuals : mapping of str to ResidualTests
        Of each law, what it leaves over of the record.
    advice : tuple of str
        What to try where even the best law is poor.
    lift : PistonRecord or None
        A lift that no law has seen.
    falls : Falls or None
        Laws of the whole fall, judged on falls that no law has seen.
    """

    record: PistonRecord
    models: tuple[ReducedModel, ...]
    comparison: Comparison
    run: Trajectory | None
    figures: Mapping[str, Figure]
    figures_law: str
    notes: tuple[str, ...]
    seconds: Mapping[str, float]
    mass: float | None = None
    left_out: tuple[str, ...] = ()
    residuals: Mapping[str, ResidualTests] = dataclasses.field(default_factory=dict)
    advice: tuple[str, ...] = ()
    lift: PistonRecord | None = None
    falls: Falls | None = None

    @property
    def best(self) -> ReducedModel:
        """The model of the law that the comparison puts first."""
        first = self.comparison.rows[0].name
        return next(model for model in self.models if model.law.name == first)

    @property
    def shown(self) -> ReducedModel:
        """The model that the figures come from: the best one with a level of rest."""
        return next((one for one in self.models if one.law.name == self.figures_law), self.best)

    @property
    def elliptic(self) -> EllipticMotion | None:
        """The elliptic motion of the fitted Duffing law; None where that is not the best law."""
        return elliptic_of(self.comparison, self.record)

    @functools.cached_property
    def averaging(self) -> Averaging | None:
        """Elliptic averaging of the best law, where that is Duffing's or the Van der Pol-like."""
        return averaging_of(self.best, self.record)

    @property
    def engineering(self) -> tuple[Quantity, ...]:
        """Rest, frequency, damping, stiffness of the swing about rest, with intervals."""
        return engineering(self.shown, self.record.angle, self.mass)

    @property
    def verdict(self) -> str:
        """Of unseen falls, of the comparison, of an unseen lift, and of the residuals, in words."""
        words = [] if self.falls is None else [self.falls.verdict]
        words.append(self.comparison.verdict)
        if one_motion := elliptic_words(self.comparison, self.record):
            words.append(one_motion)
        if self.lift is not None:
            words.append(lift_verdict(self.comparison))
        tests = self.residuals.get(self.best.law.name)
        if tests is not None and tests.structured:
            share = f"{100 * tests.relative:.2g} %"
            words.append(
                f"What {self.best.law.name} leaves of the record is {share} of its swing, but no "
                f"white noise ({tests.verdict})."
            )
        return " ".join(words)

    def to_plain(self) -> dict[str, Any]:
        """Figures, verdict and models as plain data."""
        return {
            "verdict": self.verdict,
            "best": self.best.law.name,
            "elliptic": None if self.elliptic is None else self.elliptic._asdict(),
            "averaging": None if self.averaging is None else self.averaging._asdict(),
            "comparison": self.comparison.to_plain(),
            "models": [model.to_plain() for model in self.models],
            "figures": {name: dataclasses.asdict(figure) for name, figure in self.figures.items()},
            "figures_law": self.figures_law,
            "notes": list(self.notes),
            "time_step": None if self.run is None else step_text(self.run),
            "seconds": dict(self.seconds),
            "engineering": [one._asdict() for one in self.engineering],
            "mass": self.mass,
            "left_out": list(self.left_out),
            "residuals": {name: one.to_plain() for name, one in self.residuals.items()},
            "advice": list(self.advice),
            "falls": None if self.falls is None else self.falls.to_plain(),
        }

    def __str__(self) -> str:
        lines = [*map(str, self.models), "", self.comparison.table]
        if self.falls is not None:
            lines += ["", "whole falls, errors over the height of the drop:", self.falls.table]
            if self.falls.best.model is not None:
                lines += ["", str(self.falls.best.model)]
        lines += ["", self.verdict]
        if self.figures:
            lines.append(f"{swing_words(self.shown)} about rest, by {self.figures_law}:")
        lines += [f"  {one.name}: {one.text}  [{one.interval}]" for one in self.engineering]
        lines += [
            f"  {_checks_text(name, figure, self.shown)}"
            for name, figure in self.figures.items()
            if figure.step_error is not None or figure.seed_spread is not None
        ]
        if self.averaging is not None:
            lines.append(self.averaging.text)
        if self.run is not None:
            method = self.run.method.name
            lines.append(f"simulated with {method}, time step {step_text(self.run)}")
            height = self.figures.get("height")
            checked = (0.0, None, None) if height is None else height.checked()
            lines.append(checked_price_text(self.run, *checked))
        lines += [f"left out: {words}" for words in self.left_out]
        lines += [f"to try: {words}" for words in self.advice]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])


def _checks_text(name: str, figure: Figure, model: ReducedModel) -> str:
    unit = {"height": model.unit, "period": "s"}.get(name, "")
    words = [f"{name.replace('_', ' ')} {figure.value:.5g} {unit}".rstrip()]
    if figure.step_error is not None:
        words.append(f"step error {figure.step_error:.2g}")
    if figure.seed_spread is not None:
        words.append(f"scatter over random starts {figure.seed_spread:.2g}")
    return ", ".join(words)


def lift_verdict(table: Comparison) -> str:
    """Which law predicts the last held-out record best, and by how much."""
    judged = sorted(
        ((row.records[-1].relative, row.name) for row in table.rows if row.records),
        key=lambda pair: pair[0],
    )
    (best, name), *others = judged
    if math.isinf(best):
        return "No law follows a lift three times as high, which none has seen."
    words = (
        f"A lift three times as high, which no law has seen, is predicted best by {name}, to "
        f"{100 * best:.2g} % of its rms swing"
    )
    if others:
        worse = [
            f"{other} is {times(error / max(best, 1e-300))} times worse"
            if math.isfinite(error) else f"{other} diverges"
            for error, other in others
        ]  # fmt: skip
        words += "; " + ", ".join(worse)
    return words + "."


def checked_price_text(
    run: Trajectory, height: float, step_error: float | None, seed_spread: float | None
) -> str:
    """The price of a run whose rest height [m] was checked; without a check, `price_text`.

    Parameters
    ----------
    run : Trajectory
    height, step_error, seed_spread : float
        Rest height, what twice the step changed in it, and its scatter over starts [m].
    """
    if step_error is None or not height > 0.0:
        from granular.run.price import price_text  # fits alone need nothing of the simulation

        return price_text(run)
    seconds = run.settings()["seconds"]
    scatter = f"; starts scatter it by {seed_spread / height:.1g}" if seed_spread else ""
    finer = f"twice as fine: {2.0 * seconds:.3g} s"
    if seed_spread is not None and step_error <= 2.0 * seed_spread:
        finer += ", and no better where the starts decide"
    return (
        f"price: {seconds:.3g} s; rest height to {step_error / height:.1g} by the step check"
        f"{scatter}; {finer}"
    )
