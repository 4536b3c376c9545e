"""What a measurement of an order of convergence found: errors over steps, and the fitted slope."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from validation.table import TextTable, table

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

CLEAR = 7.0
"""An error this many times the rounding moves the slope of a decade by 0.04 at most, and only where
the finest steps reach so far down: with methods of order four and more."""


class Slope(NamedTuple):
    """A fitted slope.

    Attributes
    ----------
    value : float
    interval : tuple of float
        95 % interval of the straight line's fit. The errors are not random; the interval says how
        straight the line is.
    first, last : int
        Indices of the coarsest and the finest step of the fit.
    """

    value: float
    interval: tuple[float, float]
    first: int
    last: int


@dataclasses.dataclass(frozen=True)
class ConvergenceResult:
    """Errors of one method on one exact problem.

    Attributes
    ----------
    problem, method : str
    order : int
        The order that the method declares.
    smooth : bool
        Whether the problem lets a method show its order.
    steps : tuple of float
        Time steps, from coarse to fine [s].
    errors : tuple of float
        Greatest error of a coordinate at the problem's time [m].
    rounding : float
        What rounding does at the finest step [m].
    fit : Slope or None
        None where too few errors stand clear of rounding, or no step was short enough.
    seconds : tuple of float
        Wall time of a run with each step.
    """

    problem: str
    method: str
    order: int
    smooth: bool
    steps: tuple[float, ...]
    errors: tuple[float, ...]
    rounding: float
    fit: Slope | None
    seconds: tuple[float, ...]

    @property
    def slopes(self) -> tuple[float, ...]:
        """Slope from each step to the next finer one; NaN where an error is zero."""
        return tuple(
            math.log(e0 / e1) / math.log(h0 / h1) if e0 > 0.0 < e1 else math.nan
            for h0, h1, e0, e1 in zip(
                self.steps, self.steps[1:], self.errors, self.errors[1:], strict=False
            )
        )

    @property
    def exact(self) -> bool:
        """Whether no error stands clear of rounding."""
        return max(self.errors) <= CLEAR * self.rounding

    def holds(self, tolerance: float) -> bool:
        """Whether the slope is the declared order within a tolerance, or the method is exact."""
        if self.exact:
            return True
        return self.fit is not None and abs(self.fit.value - self.order) <= tolerance

    @property
    def decades(self) -> float:
        """Over how many decades of steps the slope was fitted."""
        if self.fit is None:
            return 0.0
        return math.log10(self.steps[self.fit.first] / self.steps[self.fit.last])

    def summary(self) -> tuple[str, ...]:
        """The row of this result in a table of results; see `HEADER`."""
        measured = "exact to rounding" if self.exact else "too few steps above rounding"
        interval = span = ""
        if self.fit is not None:
            measured = f"{self.fit.value:.4f}"
            interval = f"{self.fit.interval[0]:.3f} to {self.fit.interval[1]:.3f}"
            first, last = self.steps[self.fit.first], self.steps[self.fit.last]
            span = f"{first:.3g} to {last:.3g} ({self.decades:.2f} decades)"
        declared = str(self.order) if self.smooth else f"{self.order}, motion not smooth"
        return (
            self.problem, self.method, declared, measured, interval, span,
            f"{min(self.errors):.2g}", f"{self.rounding:.1g}",
        )  # fmt: skip

    def table(self) -> TextTable:
        """Step, error, local slope and wall time of each run."""
        rows = zip(self.steps, self.errors, ("", *self.slopes), self.seconds, strict=True)
        return table(
            ("step [s]", "error [m]", "slope", "seconds"),
            [
                (f"{h:.4g}", f"{e:.4g}", s if isinstance(s, str) else f"{s:.3f}", f"{t:.3g}")
                for h, e, s, t in rows
            ],
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """A run a row: step [s], error [m], slope to it from the step before, wall time [s]."""
        import pandas

        slopes = (math.nan, *self.slopes)
        columns = {"step": self.steps, "error": self.errors, "slope": slopes}
        return pandas.DataFrame({**columns, "seconds": self.seconds})

    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Draw error over step, and the fitted line, into logarithmic axes."""
        from granular.shared.plotting import axes_or_new

        axes = axes_or_new(ax)
        errors = np.array(self.errors)
        shown = np.where(errors > 0.0, errors, np.nan)
        label = self.method if self.fit is None else f"{self.method}, slope {self.fit.value:.3f}"
        axes.loglog(self.steps, shown, marker="o", markersize=3.5, label=label, **style)
        if self.fit is not None:
            chosen = slice(self.fit.first, self.fit.last + 1)
            axes.loglog(
                self.steps[chosen], shown[chosen], linewidth=3.0, alpha=0.35,
                color=axes.lines[-1].get_color(),
            )  # fmt: skip
        axes.set_xlabel("time step [s]")
        axes.set_ylabel("error [m]")
        for line in (axes.xaxis, axes.yaxis):
            line.set_minor_formatter("")  # labels between powers of ten would overlap
        return axes

    def to_plain(self) -> dict[str, Any]:
        """The result as plain data."""
        plain = dataclasses.asdict(self)
        plain["fit"] = None if self.fit is None else self.fit._asdict()
        return plain

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> ConvergenceResult:
        """The result from what `to_plain` made, also by way of JSON."""
        fit = plain["fit"]
        return cls(
            **{
                **plain,
                "steps": tuple(plain["steps"]),
                "errors": tuple(plain["errors"]),
                "seconds": tuple(plain["seconds"]),
                "fit": fit and Slope(**{**fit, "interval": tuple(fit["interval"])}),
            }
        )


HEADER = (
    "problem", "method", "order", "slope", "95 % interval", "steps of the fit [s]",
    "least error [m]", "rounding [m]",
)  # fmt: skip


def convergence_table(results: Sequence[ConvergenceResult]) -> TextTable:
    """One row a result."""
    return TextTable(HEADER, tuple(one.summary() for one in results))
