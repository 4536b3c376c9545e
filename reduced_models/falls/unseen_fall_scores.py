"""Scores of laws on falls that they were not fitted to."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.blocks import Table
from granular.shared.errors import GranularError, InputError
from granular.shared.message_text import quote
from reduced_models.falls.predicted_law import predict_bed_parameters
from reduced_models.fitting.fit import fit, resolve_law
from reduced_models.fitting.options import STARTS, FitOptions
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from granular.scene.scene import Scene


@dataclasses.dataclass(frozen=True, eq=False)
class DropScore:
    """A law, fitted to one fall.

    Attributes
    ----------
    name : str
    model : ReducedModel or None
        None where the fit failed.
    errors : tuple of float
        Of each unseen fall: rms difference of the heights over the height of the drop; infinite
        where the law diverges.
    failure : str
        Why the fit failed.
    """

    name: str
    model: ReducedModel | None
    errors: tuple[float, ...] = ()
    failure: str = ""

    @property
    def median_error(self) -> float:
        """Median of the errors over the height of the drop; infinite without an error."""
        return float(np.median(self.errors)) if self.errors else math.inf

    @property
    def greatest_error(self) -> float:
        """Greatest of the errors over the height of the drop; infinite without an error."""
        return max(self.errors, default=math.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class DropScores:
    """Laws fitted to one fall, and judged on others.

    Attributes
    ----------
    record : PistonRecord
        The fall that was fitted.
    rest : float
        Where the piston comes to rest [m].
    labels : tuple of str
        What each unseen fall differs by.
    unseen : tuple of PistonRecord
    rows : tuple of DropScore
        The law with the least median first.
    scatter : tuple of float
        Of unseen falls from the same height: rms difference from the fitted one over the height of
        the drop. No law can be expected to do better.
    """

    record: PistonRecord
    rest: float
    labels: tuple[str, ...]
    unseen: tuple[PistonRecord, ...]
    rows: tuple[DropScore, ...]
    scatter: tuple[float, ...]

    @property
    def best(self) -> DropScore:
        """Score of the law with the least median error."""
        return self.rows[0]

    @property
    def header(self) -> tuple[str, ...]:
        """Headings of the table: law, numbers fitted, a label for each unseen fall, median."""
        return ("law", "numbers fitted", *self.labels, "median")

    def cells(self) -> list[tuple[str, ...]]:
        """Cells of the table, a law a row: errors in percent of the drop."""
        rows = []
        for row in self.rows:
            cells = ["", *("" for _ in self.labels), "not fitted"]
            if row.model is not None:
                cells = [str(len(row.model.parameters))]
                cells += [format_percent_of_drop(value) for value in (*row.errors, row.median_error)]
            rows.append((row.name, *cells))
        return rows

    @property
    def table(self) -> Table:
        """Table of all laws and falls."""
        return Table(self.header, self.cells())

    @property
    def verdict(self) -> str:
        """Verdict in words: the law that predicts unseen falls best, and the errors of the others."""
        best, *others = [row for row in self.rows if row.model is not None]
        if math.isinf(best.median_error):
            return "No law that was fitted to one fall follows the others."
        words = (
            f"Falls that no law has seen are predicted best by {best.name}, fitted to one fall: to "
            f"{format_percent_of_drop(best.median_error)} of the drop at the median and "
            f"{format_percent_of_drop(best.greatest_error)} at worst"
        )
        if self.scatter:
            words += f", where another random start alone changes {format_percent_of_drop(max(self.scatter))}"
        said = ", ".join(f"{row.name} {format_percent_of_drop(row.median_error)}" for row in others)
        return f"{words}; {said}." if said else f"{words}."

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the error [% of the drop] of each law over the height [mm] that a piston fell from."""
        from granular.shared.plotting import axes_or_new, figure_label, label_log_axis_plainly, line_style

        axes = axes_or_new(ax)
        heights = np.array([1e3 * fall.height[0] for fall in self.unseen])
        order = np.argsort(heights, kind="stable")
        for k, row in enumerate(row for row in self.rows if row.model is not None):
            errors = 100.0 * np.array(row.errors)[order]
            errors[np.isinf(errors)] = np.nan
            axes.plot(heights[order], errors, marker="o", label=figure_label(row.name), **line_style(k))
        axes.set_yscale("log")
        label_log_axis_plainly(axes.yaxis)
        axes.set(xlabel="height of the drop's start [mm]", ylabel="error [% of the drop]")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
        return axes

    def to_plain(self) -> dict[str, Any]:
        """Figures and models as plain data, in SI units."""
        return {
            "verdict": self.verdict,
            "rest": self.rest,
            "labels": list(self.labels),
            "scatter": list(self.scatter),
            "rows": [
                {"name": row.name, "errors": list(row.errors), "failure": row.failure}
                | {"model": None if row.model is None else row.model.to_plain()}
                for row in self.rows
            ],
        }


def format_percent_of_drop(value: float) -> str:
    """Text of an error over the height of the drop, in percent."""
    return "diverges" if math.isinf(value) else f"{100.0 * value:.2g} %"


FALL_LAWS = ("elastoplastic-bed", "power-law-spring", "van-der-pol-like", "linear")
SAME = 1e-3
"""Heights of two starts, over the drop, that are the same."""


def score_drops(
    record: PistonRecord,
    unseen: Mapping[str, PistonRecord],
    laws: Sequence[str | Law] = FALL_LAWS,
    *,
    rest: float | None = None,
    scene: Scene | None = None,
    starts: int = STARTS,
) -> DropScores:
    """Fit laws to one fall from rest, and predict others from their first heights alone.

    Parameters
    ----------
    record : PistonRecord
        Fall that is fitted, times [s] and heights [m] from the moment the piston is released.
    unseen : mapping of str to PistonRecord
        Other falls from rest, under labels that say what they differ in.
    laws : sequence of str or Law
        Names, equations or laws to fit.
    rest : float, optional
        Level where the piston comes to rest [m]; the mean of the record's last tenth if not given.
    scene : Scene, optional
        Scene of the fall; fits of ``elastoplastic-bed`` begin at the parameters that
        `reduced_models.predict` has for it, where it was compared with falls.
    starts : int
        Number of random starts of each fit, from 1 to 10000.

    Returns
    -------
    DropScores
        Rms difference of the heights of each law on each fall, over the height of its drop, without
        unit, the law with the least median first; infinite where a law diverges. A law that could
        not be fitted comes last, without errors and with the reason.

    Raises
    ------
    InputError
        If there is no unseen fall, no law or none of that name, no law that can be fitted (as for a
        record of fewer than 20 samples, or ``starts`` out of its range), ``rest`` is no finite
        number, or a record does not begin above the level of rest.
    """
    if not laws:
        raise InputError("give at least one law")
    if not isinstance(unseen, Mapping):
        raise InputError(f"unseen is a {type(unseen).__name__}; give a mapping of labels to records")
    if rest is not None and not (isinstance(rest, Real) and math.isfinite(rest)):
        raise InputError(f"rest = {quote(rest)}; give a finite number [m]")
    rest_height = float(record.height[-max(1, len(record) // 10) :].mean()) if rest is None else rest
    _check_falls(record, unseen, rest_height)  # before the fits, which take minutes
    fits = [fit_law_to_fall(law, record, scene, starts) for law in laws]
    return score_fitted_laws(record, fits, unseen, rest_height)


def _check_falls(record: PistonRecord, unseen: Mapping[str, PistonRecord], rest_height: float) -> None:
    """Refuse falls that are none, and a call without an unseen one."""
    if not unseen:
        raise InputError("give at least one unseen fall")
    for label, item in {"the fall": record, **unseen}.items():
        if not item.height[0] > rest_height:
            raise InputError(
                f"{label} begins at {item.height[0]:g} m, not above the level of rest, "
                f"{rest_height:g} m; give a fall"
            )


def score_fitted_laws(
    record: PistonRecord, fits: Sequence[DropScore], unseen: Mapping[str, PistonRecord], rest_height: float
) -> DropScores:
    """Score the laws of `fit_law_to_fall` on falls that they were not fitted to; record, rest_height [m]."""
    _check_falls(record, unseen, rest_height)
    rows = []
    for row in fits:
        models = [] if row.model is None else [row.model]
        errors = [fall_prediction_error(own, fall, rest_height) for own in models for fall in unseen.values()]
        rows.append(dataclasses.replace(row, errors=tuple(errors)))
    if all(row.model is None for row in rows):
        raise InputError(f"no law could be fitted; {rows[0].name}: {rows[0].failure}")
    rows.sort(key=lambda row: (row.model is None, row.median_error))
    drop = float(record.height[0]) - rest_height
    alike = [fall for fall in unseen.values() if abs(fall.height[0] - record.height[0]) <= SAME * drop]
    scatter = tuple(_rms_difference(fall, record.time, record.height) / drop for fall in alike)
    return DropScores(record, rest_height, tuple(unseen), tuple(unseen.values()), tuple(rows), scatter)


def fit_law_to_fall(name: str | Law, record: PistonRecord, scene: Scene | None, starts: int) -> DropScore:
    """Fit a law to one fall from rest, without judging it yet; record [s, m]."""
    law = resolve_law(name, record)
    known: dict[str, float] = {}
    if scene is not None and law.name == "elastoplastic-bed":
        with contextlib.suppress(InputError):
            known = predict_bed_parameters(scene)
    try:
        with warnings.catch_warnings(action="ignore"):  # the model keeps its notes
            model = fit(
                record,
                law,
                parameters=known,
                starts=starts,
                test_fraction=0.0,
                options=FitOptions(initial={"height": float(record.height[0]), "velocity": 0.0}),
            )
    except GranularError as cause:
        return DropScore(law.name, None, failure=str(cause))
    return DropScore(law.name, model)


def fall_prediction_error(model: ReducedModel, fall: PistonRecord, rest_height: float) -> float:
    """Rms error of a law that predicts a fall from its first height alone, over the drop; rest_height [m]."""
    first = float(fall.height[0])
    try:
        motion = model.simulate(fall.time, z0=first, v0=0.0)
    except InputError:
        return math.inf
    return _rms_difference(fall, motion.time, motion.height) / (first - rest_height)


def _rms_difference(record: PistonRecord, time: np.ndarray, height: np.ndarray) -> float:
    """Rms difference of a record from heights at other times, while both last [m]."""
    end = min(record.time[-1] - record.time[0], time[-1] - time[0])
    since = record.time - record.time[0]
    other = np.interp(since, time - time[0], height)
    return float(np.sqrt(np.mean((record.height - other)[since <= end] ** 2)))
