"""The table of a comparison: what each law is worth on data that it has not seen."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.shared.blocks import Table, Text, align_columns
from granular.shared.errors import format_factor
from reduced_models.fitting.roll_out import RollOut
from reduced_models.models.model import ReducedModel
from reduced_models.models.printed_model import swing_quantities
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    LEVEL,
    QuantityWithError,
    caution_lines,
    figure_lines,
    format_percent,
    record_lines,
    wrap_words,
)

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


TIE = 0.05
"""Held-out errors closer than this fraction are alike."""
NOISE_TIE = 1.25
"""Held-out errors below so many noise levels are alike."""
LINEAR = "linear"
_LONGEST = 44  # characters of a law's name in a table


@dataclasses.dataclass(frozen=True, eq=False)
class ComparisonRow:
    """One law.

    Attributes
    ----------
    name : str
    models : tuple of ReducedModel
        One a record; empty where the fit failed.
    parameters : int
        Free numbers of the law, the initial states not counted.
    stretches : tuple of float
        Error of the simulation over the test swings of each record, in rms swings of the record;
        infinite where it diverges. Empty without any.
    records : tuple of RollOut
        One a held-out record.
    error : float
        The test error: root mean square over all that was held out; the residual of the fit without
        any.
    standard_error : float
        Of the test error, from how it differs between the test swings; 0 where these are too few.
    deviance, aic, bic : float
        n log of the mean squared residual of the fit to all of the records (n the number of
        independent samples), and with twice, or log n times, the number of parameters added.
    failure : str
        Why there is no model; empty where there is one.
    """

    name: str
    models: tuple[ReducedModel, ...] = ()
    parameters: int = 0
    stretches: tuple[float, ...] = ()
    records: tuple[RollOut, ...] = ()
    error: float = math.inf
    deviance: float = math.inf
    aic: float = math.inf
    bic: float = math.inf
    failure: str = ""
    standard_error: float = 0.0

    @property
    def divergence_count(self) -> int:
        """Number of test swings of a record, and of held-out records, over which the law diverges."""
        errors = (*self.stretches, *(record.relative for record in self.records))
        return sum(math.isinf(error) for error in errors)

    def to_plain(self) -> dict[str, Any]:
        """Return errors, criteria and parameters of the law as plain data."""
        return {
            "law": self.name,
            "parameters": self.parameters,
            "test_error": self.error,
            "test_standard_error": self.standard_error,
            "stretches": list(self.stretches),
            "records": [record.relative for record in self.records],
            "aic": self.aic,
            "bic": self.bic,
            "blow_ups": self.divergence_count,
            "failure": self.failure,
            "values": [dict(model.parameters) for model in self.models],
        }


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Laws on the same data, the best first, as `compare` makes it.

    Attributes
    ----------
    rows : tuple of ComparisonRow
        One law each, with its models, errors and information criteria; one at least, and first
        those that were fitted.
    verdict : str
        Which laws predict best, in plain words.
    noise : float
        White noise of the records, in rms swings, without unit.
    at_rest : float
        Test error of the baseline, a piston that stays at rest, in rms swings, without unit; 1
        where nothing was held out.
    """

    rows: tuple[ComparisonRow, ...]
    verdict: str
    noise: float
    at_rest: float

    @property
    def best(self) -> ReducedModel:
        """The model of the law that is first, for the first of the records that it was fitted to."""
        return self.rows[0].models[0]

    def model_tied_with_best(self, name: str) -> ReducedModel | None:
        """Model of a law that was fitted to one record and predicts as well as the best one.

        That is one whose test error is at most a standard error above the least one (Breiman et al.
        1984, Classification and Regression Trees, ch. 3.4), 5 % above it, or 1.25 times the noise,
        whichever is greatest.

        Parameters
        ----------
        name : str
            Name of a law, as in ``rows``.

        Returns
        -------
        ReducedModel or None
            Its model; None where it predicts less well, there is no law of that name, it could not
            be fitted, or it was fitted to several records together.
        """
        limit = largest_tied_error([row for row in self.rows if not row.failure], self.noise)
        for row in self.rows:
            if row.name == name and len(row.models) == 1 and row.error <= limit:
                return row.models[0]
        return None

    def ranking_on_last_record(self) -> list[tuple[RollOut, str]]:
        """Predictions of the last held-out record and names of the laws, the least error first.

        Returns
        -------
        list of (RollOut, str)
            Prediction of the record, with its errors, and name of each law that was fitted; empty
            where no whole record was held out.
        """
        scored = [(row.records[-1], row.name) for row in self.rows if row.records]
        return sorted(scored, key=lambda pair: pair[0].relative)

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns of `cells`: law, parameters, errors, criteria, divergences.

        Test swings and a column for each held-out record are there where one was held out.
        """
        held = len(self.rows[0].records)
        return (
            "law",
            "parameters",
            *(("all held out",) if held else ()),
            "held-out cycles",
            *(f"record {k + 1}" for k in range(held)),
            "AIC",
            "BIC",
            "diverged",
        )

    def cells(self) -> list[tuple[str, ...]]:
        """Cells of the table as texts: errors in % of the rms swing, AIC and BIC above the least.

        Returns
        -------
        list of tuple of str
            One row a law, the best first, with a text for each column of `header`. An error that is
            infinite is ``"diverges"``; of a law that could not be fitted the second text says why,
            and the others are empty.
        """
        aic, bic = min(row.aic for row in self.rows), min(row.bic for row in self.rows)
        lines: list[tuple[str, ...]] = []
        for row in self.rows:
            cells = [row.failure, *[""] * (len(self.header) - 2)]
            if not row.failure:
                cells = [str(row.parameters), format_percent(row.error, row.standard_error)]
                cells += self._errors_by_part(row) if row.records else ()
                cells += [f"{row.aic - aic:+.1f}", f"{row.bic - bic:+.1f}", str(row.divergence_count)]
            lines.append((row.name, *cells))
        return lines

    @property
    def table(self) -> Table:
        """Table of the laws, the best first."""
        return Table(self.header, self.cells())

    @staticmethod
    def _errors_by_part(row: ComparisonRow) -> list[str]:
        """Errors of a law on held-out cycles and on each held-out record."""
        if not row.records:
            return [format_percent(row.error, row.standard_error)]
        cycles = format_percent(root_mean_square(row.stretches)) if row.stretches else "-"
        return [cycles, *(format_percent(record.relative) for record in row.records)]

    def law_lines(
        self, records: Sequence[str] = (), most: int | None = None, *, criteria: bool = False
    ) -> list[str]:
        """Lines of the laws with their errors, the best first, and whether a linear one suffices.

        Parameters
        ----------
        records : sequence of str
            Heads for the columns of held-out records; their numbers if not given.
        most : int, optional
            Greatest number of laws; all if not given. The linear one is always among them.
        criteria : bool
            Also give AIC and BIC, above the least ones.

        Returns
        -------
        list of str
            Lines of at most a hundred characters.
        """
        sound = [row for row in self.rows if not row.failure]
        shown = sound[:most]
        if most and len(sound) > most:
            shown[-1] = next((row for row in sound[most - 1 :] if row.name == LINEAR), shown[-1])
        count = len(sound[0].records)
        heads = list(records) or [f"record {k + 1}" for k in range(count)]
        aic, bic = (min(getattr(row, name) for row in sound) for name in ("aic", "bic"))
        held = any(row.stretches or row.records for row in sound)
        best = sound[0].name if len(sound[0].name) <= _LONGEST else f"{sound[0].name[: _LONGEST - 3]}..."
        title = f"model: {best}, best of {len(sound)}" if len(sound) > 1 else f"model: {best}"
        table = [[title, "held-out cycles" if held else "residual", *heads, *("AIC", "BIC") * criteria, ""]]
        for row in shown:
            name = row.name if len(row.name) <= _LONGEST else f"{row.name[: _LONGEST - 3]}..."
            parameters = f"{row.parameters} parameter{'s' * (row.parameters != 1)}"
            of = sound[0].models[0].rms_noun if row is shown[0] else ""
            worse = [f"{row.aic - aic:+.1f}", f"{row.bic - bic:+.1f}"] if criteria else []
            table.append([f"  {name} ({parameters})", *self._errors_by_part(row), *worse, of])
        linear = self._linear_text(records)
        return [*align_columns(table).splitlines(), *(wrap_words(linear) if linear else ())]

    def _linear_text(self, records: Sequence[str]) -> str:
        """Sentence on whether a linear model suffices; empty where it was not compared with another."""
        sound = [row for row in self.rows if not row.failure]
        linear = next((row for row in sound if row.name == LINEAR), None)
        if linear is None or len(sound) < 2:
            return ""
        if linear.error <= largest_tied_error(sound, self.noise):
            return "a linear model suffices: more parameters predict no better"
        error, *others = self._errors_by_part(linear)
        heads = list(records) or [f"record {k + 1}" for k in range(len(others))]
        further = "".join(f" ({head}: {other})" for head, other in zip(heads, others, strict=True))
        # The best by the same errors as the first figure of the line.
        own, best = (
            root_mean_square(row.stretches) if row.stretches else row.error for row in (linear, sound[0])
        )
        times = format_factor(own / max(best, 1e-300))
        return f"a linear model suffices for an error of {error}{further}, {times} times the best"

    def __str__(self) -> str:
        best = self.best
        lines = record_lines(best.provenance.get("record", "").splitlines())
        lines += figure_lines(swing_quantities(best, None), confidence=best.confidence)
        lines += [*self.law_lines(criteria=True), *best.equation_lines(), *wrap_words(self.verdict)]
        lines += [f"  {row.name} was not fitted: {row.failure}" for row in self.rows if row.failure]
        return "\n".join([*lines, *caution_lines(best.cautions)])

    def to_plain(self) -> dict[str, Any]:
        """Table and verdict as plain data, such as JSON holds but for infinite errors.

        Returns
        -------
        dict of str to any
            ``verdict``; ``best``, the name of the first law; ``noise`` and ``at_rest`` in rms
            swings, without unit; and ``rows``, a dict for each law as by `ComparisonRow.to_plain`.
        """
        return {
            "verdict": self.verdict,
            "best": self.rows[0].name,
            "noise": self.noise,
            "at_rest": self.at_rest,
            "rows": [row.to_plain() for row in self.rows],
        }

    def __repr__(self) -> str:
        names = ", ".join(row.name for row in self.rows)
        return f"Comparison of {len(self.rows)} laws, the best first: {names}\n  {self.verdict}"

    def _repr_html_(self) -> str:
        from granular.shared.html_pages import blocks_html

        return blocks_html([self.table, Text(self.verdict)])

    def _repr_latex_(self) -> str:
        from granular.shared.blocks import latex_array

        return latex_array(self.table)

    def to_dataframe(self) -> pandas.DataFrame:
        """Make a table of the laws with numbers, where `cells` has texts.

        Returns
        -------
        pandas.DataFrame
            One row a law, the best first: ``law``, ``parameters`` (how many), ``test error``,
            ``standard error``, ``test swings`` and, for each held-out record, ``record 1`` and so
            on, in rms swings, without unit; ``AIC``, ``BIC``, ``diverged`` (over how many) and
            ``failure``. Errors are infinite where a law diverges. Of a law that was not fitted they
            are infinite too, as AIC and BIC, and its test swings and records NaN; so are test
            swings where none were held out.
        """
        import pandas

        rows = [
            {
                "law": row.name,
                "parameters": row.parameters,
                "test error": row.error,
                "standard error": row.standard_error,
                "test swings": root_mean_square(row.stretches) if row.stretches else math.nan,
                **{f"record {k + 1}": record.relative for k, record in enumerate(row.records)},
                "AIC": row.aic,
                "BIC": row.bic,
                "diverged": row.divergence_count,
                "failure": row.failure,
            }
            for row in self.rows
        ]
        return pandas.DataFrame(rows)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the test errors of the laws, next to the noise and a piston at rest.

        Laws that could not be fitted are left out; the bar of one that diverges goes to ten times
        the greatest error of the others and of a piston at rest. Noise and rest are not drawn where
        they are below a thousandth of the least error.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; new ones if not given, `drawing_height` high.

        Returns
        -------
        Axes
            Axes with a bar for each law, the best on top, its test error [% of the rms swing] on a
            logarithmic scale.
        """
        from granular.shared.plotting import COLOURS, GREY, axes_or_new, figure_label, label_log_axis_plainly

        sound = [row for row in self.rows if not row.failure][::-1]
        ax = axes_or_new(ax, height=self.drawing_height)
        greatest = max([self.at_rest, *(row.error for row in sound if math.isfinite(row.error))])
        names = [row.name if len(row.name) < 30 else f"{row.name[:29]}…" for row in sound]
        values = [min(100.0 * row.error, 1e3 * greatest) for row in sound]
        # By place, since names that are cut may be alike.
        ax.barh(range(len(sound)), values, color=COLOURS[0])
        ax.set_yticks(range(len(sound)), [figure_label(name) for name in names])
        for level, words, style in ((self.at_rest, "motionless", "--"), (self.noise, "noise", ":")):
            if level > 1e-3 * min(row.error for row in sound):
                ax.axvline(100.0 * level, color=GREY, linestyle=style, label=words)
        ax.set_xscale("log")
        label_log_axis_plainly(ax.xaxis)
        ax.set_xlabel(f"error on held-out data [% {self.best.rms_noun}]")
        ax.grid(visible=False, axis="y")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
        return ax

    @property
    def drawing_height(self) -> float:
        """Height of a drawing with a bar for each law that was fitted [inch]."""
        return 1.8 + 0.45 * sum(not row.failure for row in self.rows)


def largest_tied_error(rows: Sequence[ComparisonRow], noise: float) -> float:
    """Return the greatest test error that is as good as the least one."""
    # One standard error more (Breiman et al. 1984, Classification and Regression Trees, ch. 3.4; Hastie et
    # al. 2009, The Elements of Statistical Learning, ch. 7.10), 5 %, or 1.25 times the noise.
    least = min(rows, key=lambda row: row.error)
    return max((1.0 + TIE) * least.error, least.error + least.standard_error, NOISE_TIE * noise)


def root_mean_square(errors: Sequence[float]) -> float:
    """Root mean square of some errors."""
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


FREQUENCY = "natural frequency"
_DERIVED = (
    ("frequency", FREQUENCY, "f0", "Hz", 1.0),
    ("damping_ratio", DAMPING_RATIO, "zeta", "%", 100.0),
    ("level", LEVEL, "z0", "mm", 1e3),
)


class DerivedFigures(NamedTuple):
    """Figures of small motions, derived from the stiffness of the bed at rest."""

    level: float  # [m]
    frequency: float  # [Hz]
    damping_ratio: float
    step_errors: tuple[float, float] | None
    """Relative errors of frequency and damping ratio by the run's time step; None if it has no root."""

    def step_error(self, figure: QuantityWithError) -> float:
        """Error of a figure by the time step: none at rest; a bound for other numbers of a law."""
        assert self.step_errors is not None
        of_frequency, of_damping = self.step_errors
        relative = {FREQUENCY: of_frequency, DAMPING_RATIO: of_damping, LEVEL: 0.0, "rest": 0.0}
        return abs(figure.value) * relative.get(figure.name, 2.0 * of_frequency + of_damping)

    def text(self, figures: Sequence[QuantityWithError]) -> str:
        """Figures in words, each with the relative difference of the fitted one, beyond its error or not."""
        fitted = {figure.name: figure for figure in figures}
        words, differences = [], []
        for field, name, symbol, unit, factor in _DERIVED:
            value, figure = factor * getattr(self, field), fitted.get(name)
            words.append(f"{symbol} {value:.5g} {unit}")
            if figure is not None and figure.unit == unit:
                difference = figure.value - value
                error = math.hypot(figure.parts.get("fit", 0.0), figure.parts.get("step", 0.0))
                beyond = " beyond its error" if abs(difference) > error else ""
                differences.append(f"{100.0 * difference / value:+.1g} %{beyond}")
        return ", ".join(words) + (f" (fit {', '.join(differences)})" if differences else "")
