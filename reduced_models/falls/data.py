"""How well laws predict falls that they were not fitted to, as data."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.text_columns import in_columns
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclasses.dataclass(frozen=True, eq=False)
class FallRow:
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
    def median(self) -> float:
        return float(np.median(self.errors)) if self.errors else math.inf

    @property
    def greatest(self) -> float:
        return max(self.errors, default=math.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class Falls:
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
    rows : tuple of FallRow
        The law with the least median first.
    scatter : tuple of float
        Of unseen falls from the same height: rms difference from the fitted one over the height of
        the drop. No law can be expected to do better.
    """

    record: PistonRecord
    rest: float
    labels: tuple[str, ...]
    unseen: tuple[PistonRecord, ...]
    rows: tuple[FallRow, ...]
    scatter: tuple[float, ...]

    @property
    def best(self) -> FallRow:
        return self.rows[0]

    @property
    def header(self) -> tuple[str, ...]:
        return ("law", "numbers fitted", *self.labels, "median")

    def cells(self) -> list[tuple[str, ...]]:
        """A law a row: errors in % of the drop."""
        found = []
        for row in self.rows:
            if row.model is None:
                found.append((row.name, "", *("" for _ in self.labels), "not fitted"))
                continue
            errors = (_percent(each) for each in (*row.errors, row.median))
            numbers = len(row.model.parameters) + (2 if row.model.map.fitted else 0)
            found.append((row.name, str(numbers), *errors))
        return found

    @property
    def table(self) -> str:
        return in_columns([self.header, *self.cells()])

    @property
    def verdict(self) -> str:
        """Which law predicts unseen falls best, and by how much."""
        best, *others = [row for row in self.rows if row.model is not None]
        if math.isinf(best.median):
            return "No law that was fitted to one fall follows the others."
        words = (
            f"Falls that no law has seen are predicted best by {best.name}, fitted to one fall: to "
            f"{_percent(best.median)} of the drop at the median and {_percent(best.greatest)} at "
            "worst"
        )
        if self.scatter:
            words += f", where another random start alone changes {_percent(max(self.scatter))}"
        if others:
            said = (
                f"{row.name} {_percent(row.median)}" if math.isfinite(row.median)
                else f"{row.name} diverges"
                for row in others
            )  # fmt: skip
            words += "; " + ", ".join(said)
        return words + "."

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the error of each law over the height that a piston fell from."""
        from granular.shared.plotting import axes_or_new, line_look, plain_label, plain_numbers

        axes = axes_or_new(ax)
        heights = np.array([1e3 * one.height[0] for one in self.unseen])
        order = np.argsort(heights, kind="stable")
        for k, row in enumerate(row for row in self.rows if row.model is not None):
            errors = 100.0 * np.array(row.errors)
            axes.plot(
                heights[order], np.where(np.isfinite(errors), errors, np.nan)[order], marker="o",
                label=plain_label(row.name), **line_look(k),
            )  # fmt: skip
        axes.set_yscale("log")
        plain_numbers(axes.yaxis)
        axes.set_xlabel("height of the drop's start [mm]")
        axes.set_ylabel("error [% of the drop]")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
        return axes

    def to_plain(self) -> dict[str, Any]:
        """Figures and models as plain data."""
        return {
            "verdict": self.verdict,
            "rest": self.rest,
            "labels": list(self.labels),
            "scatter": list(self.scatter),
            "rows": [
                {
                    "name": row.name, "errors": list(row.errors), "failure": row.failure,
                    "model": None if row.model is None else row.model.to_plain(),
                }
                for row in self.rows
            ],
        }  # fmt: skip


def _percent(value: float) -> str:
    return "diverges" if math.isinf(value) else f"{100.0 * value:.2g} %"
