"""The table of a comparison: errors of each law on held-out data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.shared.blocks import Table, Text, align_columns
from granular.shared.errors import format_factor
from reduced_models.fitting.roll_out import RollOut
from reduced_models.models.model import ReducedModel
from reduced_models.models.printed_model import oscillation_quantities
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    LEVEL,
    QuantityWithError,
    caution_lines,
    format_percent,
    quantity_lines,
    record_title_and_property_lines,
    wrap_words,
)

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


TIE = 0.05
"""Relative difference below which two held-out errors count as equal."""
NOISE_TIE = 1.25
"""Held-out errors below this multiple of the noise count as equal."""
LINEAR = "linear"
_MAXIMUM_NAME_LENGTH = 44  # characters of a law's name in a table


def _shorten_name(name: str) -> str:
    return name if len(name) <= _MAXIMUM_NAME_LENGTH else f"{name[: _MAXIMUM_NAME_LENGTH - 3]}..."


@dataclasses.dataclass(frozen=True, eq=False)
class ComparisonRow:
    """Errors and fits of one law.

    Attributes
    ----------
    name : str
    models : tuple of ReducedModel
        One model for each record; empty if the fit failed.
    parameters : int
        Number of free parameters of the law, without the initial states.
    stretches : tuple of float
        Prediction error over the held-out cycles of each record, relative to the record's rms
        displacement; infinite if the simulation diverges. Empty without held-out cycles.
    records : tuple of RollOut
        Prediction of each held-out record.
    error : float
        Test error: root mean square over all held-out data; if nothing was held out, the residual of
        the fit.
    standard_error : float
        Standard error of the test error, from the scatter between held-out cycles; 0 if there are too
        few cycles.
    deviance, aic, bic : float
        The deviance is n times the logarithm of the mean squared residual of the fit to all records,
        where n is the number of independent samples. AIC is the deviance plus 2 for each fitted value,
        BIC the deviance plus log n for each; initial states count as fitted values.
    failure : str
        Reason for a missing model; empty if the law was fitted.
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
        """Number of divergent predictions, both of held-out cycles and of whole held-out records."""
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
    """Laws compared on the same data by `compare`, the best first.

    Attributes
    ----------
    rows : tuple of ComparisonRow
        One row for each law, with its models, errors and information criteria; never empty. Fitted
        laws come first.
    verdict : str
        Text that names the laws that predict best.
    noise : float
        White noise of the records relative to the rms displacement, without unit.
    at_rest : float
        Test error of a motionless piston (the baseline) relative to the rms displacement, without
        unit; 1 if nothing was held out.
    """

    rows: tuple[ComparisonRow, ...]
    verdict: str
    noise: float
    at_rest: float

    @property
    def best(self) -> ReducedModel:
        """Model of the best law for the first record."""
        return self.rows[0].models[0]

    def model_tied_with_best(self, name: str) -> ReducedModel | None:
        """Model of a law that was fitted to one record and predicts as well as the best law.

        A law predicts as well as the best one if its test error is at most the largest of three
        limits: the smallest test error plus its standard error (Breiman et al. 1984, Classification
        and Regression Trees, ch. 3.4), 1.05 times the smallest test error, and 1.25 times the noise.

        Parameters
        ----------
        name : str
            Name of a law, as in ``rows``.

        Returns
        -------
        ReducedModel or None
            Model of the law; None if the law predicts less well, could not be fitted, or was fitted to
            several records together, or if the name is unknown.
        """
        limit = largest_tied_error([row for row in self.rows if not row.failure], self.noise)
        for row in self.rows:
            if row.name == name and len(row.models) == 1 and row.error <= limit:
                return row.models[0]
        return None

    def ranking_on_last_record(self) -> list[tuple[RollOut, str]]:
        """Predictions of the last held-out record by all laws, the smallest error first.

        Returns
        -------
        list of (RollOut, str)
            For each fitted law the prediction, with its errors, and the name of the law; empty if no
            whole record was held out.
        """
        scored = [(row.records[-1], row.name) for row in self.rows if row.records]
        return sorted(scored, key=lambda pair: pair[0].relative)

    @property
    def header(self) -> tuple[str, ...]:
        """Names of the columns of `cells`: law, parameters, errors, criteria, divergences.

        There is a column for held-out cycles only if cycles were held out, and one for each held-out
        record.
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
        """Return the table's cells: errors in % of the rms displacement, AIC and BIC minus their minimum.

        Returns
        -------
        list of tuple of str
            One row for each law, the best first, with a string for each column of `header`. An infinite
            error is ``"diverges"``. For a law that could not be fitted, the string after its name gives
            the reason, and the others are empty.
        """
        aic, bic = min(row.aic for row in self.rows), min(row.bic for row in self.rows)
        lines: list[tuple[str, ...]] = []
        for row in self.rows:
            cells = [row.failure, *[""] * (len(self.header) - 2)]
            if not row.failure:
                cells = [str(row.parameters), format_percent(row.error, row.standard_error)]
                cells += self._error_texts_by_part(row) if row.records else ()
                cells += [f"{row.aic - aic:+.1f}", f"{row.bic - bic:+.1f}", str(row.divergence_count)]
            lines.append((row.name, *cells))
        return lines

    @property
    def table(self) -> Table:
        """Printable table of the laws, the best first."""
        return Table(self.header, self.cells())

    @staticmethod
    def _error_texts_by_part(row: ComparisonRow) -> list[str]:
        """Return the errors of a law on held-out cycles and on each held-out record as texts."""
        if not row.records:
            return [format_percent(row.error, row.standard_error)]
        cycles = format_percent(root_mean_square(row.stretches)) if row.stretches else "-"
        return [cycles, *(format_percent(record.relative) for record in row.records)]

    def law_lines(
        self, records: Sequence[str] = (), most: int | None = None, *, criteria: bool = False
    ) -> list[str]:
        """List the laws with their errors, the best first, and state whether a linear law suffices.

        Parameters
        ----------
        records : sequence of str
            Headings for the columns of held-out records; by default the numbers of the records.
        most : int, optional
            Maximum number of laws; all if not given. The linear law is always included.
        criteria : bool
            True to add AIC and BIC, minus their lowest values.

        Returns
        -------
        list of str
            Lines of at most 100 characters.
        """
        sound = [row for row in self.rows if not row.failure]
        shown = sound[:most]
        if most and len(sound) > most:
            shown[-1] = next((row for row in sound[most - 1 :] if row.name == LINEAR), shown[-1])
        count = len(sound[0].records)
        headings = list(records) or [f"record {k + 1}" for k in range(count)]
        aic, bic = (min(getattr(row, name) for row in sound) for name in ("aic", "bic"))
        held = any(row.stretches or row.records for row in sound)
        best = _shorten_name(sound[0].name)
        title = f"model: {best}, best of {len(sound)}" if len(sound) > 1 else f"model: {best}"
        header = [title, "held-out cycles" if held else "residual", *headings, *("AIC", "BIC") * criteria, ""]
        table = [header]
        for row in shown:
            name = _shorten_name(row.name)
            parameters = f"{row.parameters} parameter{'s' * (row.parameters != 1)}"
            reference = sound[0].models[0].error_reference_text if row is shown[0] else ""
            differences = [f"{row.aic - aic:+.1f}", f"{row.bic - bic:+.1f}"] if criteria else []
            table.append(
                [f"  {name} ({parameters})", *self._error_texts_by_part(row), *differences, reference]
            )
        linear = self._linear_law_text(records)
        return [*align_columns(table).splitlines(), *(wrap_words(linear) if linear else ())]

    def _linear_law_text(self, records: Sequence[str]) -> str:
        """State whether a linear model suffices; empty if the linear law was not compared with other laws."""
        sound = [row for row in self.rows if not row.failure]
        linear = next((row for row in sound if row.name == LINEAR), None)
        if linear is None or len(sound) < 2:
            return ""
        if linear.error <= largest_tied_error(sound, self.noise):
            return "a linear model suffices: more parameters do not predict better"
        error, *others = self._error_texts_by_part(linear)
        headings = list(records) or [f"record {k + 1}" for k in range(len(others))]
        further = "".join(f" ({heading}: {other})" for heading, other in zip(headings, others, strict=True))
        # The ratio uses the same kind of error as the first number of the line.
        linear_error, best_error = (
            root_mean_square(row.stretches) if row.stretches else row.error for row in (linear, sound[0])
        )
        times = format_factor(linear_error / max(best_error, 1e-300))
        return f"a linear model suffices for an error of {error}{further}, {times} times the best"

    def __str__(self) -> str:
        best = self.best
        lines = record_title_and_property_lines(best.provenance.get("record", "").splitlines())
        lines += quantity_lines(oscillation_quantities(best, None), confidence=best.confidence)
        lines += [*self.law_lines(criteria=True), *best.equation_lines(), *wrap_words(self.verdict)]
        lines += [f"  {row.name} was not fitted: {row.failure}" for row in self.rows if row.failure]
        return "\n".join([*lines, *caution_lines(best.cautions)])

    def to_plain(self) -> dict[str, Any]:
        """Table and verdict as plain data (JSON, except that errors may be infinite).

        Returns
        -------
        dict of str to any
            ``verdict``; ``best``, the name of the first law; ``noise`` and ``at_rest`` relative to the
            rms displacement, without unit; and ``rows``, a dict for each law as from
            `ComparisonRow.to_plain`.
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
        """Make a numerical table of the laws; `cells` gives texts.

        Returns
        -------
        pandas.DataFrame
            One row for each law, the best first. Columns: ``law``; ``parameters`` (their number);
            ``test error``; ``standard error``; ``test swings`` (error on held-out cycles);
            ``record 1`` and so on (error on each held-out record); ``AIC``; ``BIC``; ``diverged``
            (number of divergences); ``failure``. Errors are relative to the rms displacement, without
            unit, and infinite if a law diverges. For a law that was not fitted, errors, AIC and BIC
            are infinite, and ``test swings``, ``record 1`` and so on are NaN. ``test swings`` is also NaN
            without held-out cycles.
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
        """Draw the test errors of the laws, with the noise level and the error of a motionless piston.

        Laws that could not be fitted are omitted. The bar of a law that diverges extends to ten times the
        largest other error in the drawing. The lines of noise level and motionless piston are omitted if
        they are below a thousandth of the smallest error.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; by default new axes with a height of `drawing_height`.

        Returns
        -------
        Axes
            Axes with a bar for each law, the best on top: test error [% of the rms displacement] on a
            logarithmic scale.
        """
        from granular.shared.plotting import COLOURS, GREY, axes_or_new, figure_label, label_log_axis_plainly

        sound = [row for row in self.rows if not row.failure][::-1]
        ax = axes_or_new(ax, height=self.drawing_height)
        greatest = max([self.at_rest, *(row.error for row in sound if math.isfinite(row.error))])
        names = [row.name if len(row.name) < 30 else f"{row.name[:29]}…" for row in sound]
        values = [min(100.0 * row.error, 1e3 * greatest) for row in sound]
        # Bars are placed by index, since shortened names may coincide.
        ax.barh(range(len(sound)), values, color=COLOURS[0])
        ax.set_yticks(range(len(sound)), [figure_label(name) for name in names])
        for level, words, style in ((self.at_rest, "motionless", "--"), (self.noise, "noise", ":")):
            if level > 1e-3 * min(row.error for row in sound):
                ax.axvline(100.0 * level, color=GREY, linestyle=style, label=words)
        ax.set_xscale("log")
        label_log_axis_plainly(ax.xaxis)
        ax.set_xlabel(f"error on held-out data [% {self.best.error_reference_text}]")
        ax.grid(visible=False, axis="y")
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
        return ax

    @property
    def drawing_height(self) -> float:
        """Height [inch] of a drawing with a bar for each fitted law."""
        return 1.8 + 0.45 * sum(not row.failure for row in self.rows)


def largest_tied_error(rows: Sequence[ComparisonRow], noise: float) -> float:
    """Return the largest test error that counts as equal to the smallest one."""
    # One standard error above (Breiman et al. 1984, Classification and Regression Trees, ch. 3.4; Hastie et
    # al. 2009, The Elements of Statistical Learning, ch. 7.10), 5 % above, or 1.25 times the noise.
    best = min(rows, key=lambda row: row.error)
    return max((1.0 + TIE) * best.error, best.error + best.standard_error, NOISE_TIE * noise)


def root_mean_square(errors: Sequence[float]) -> float:
    """Root mean square of the errors."""
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


FREQUENCY = "natural frequency"
_DERIVED = (
    ("frequency", FREQUENCY, "f0", "Hz", 1.0),
    ("damping_ratio", DAMPING_RATIO, "zeta", "%", 100.0),
    ("level", LEVEL, "z0", "mm", 1e3),
)


class DerivedOscillation(NamedTuple):
    """Small oscillations derived from the stiffness of the bed at equilibrium."""

    level: float  # equilibrium height [m]
    frequency: float  # [Hz]
    damping_ratio: float
    step_errors: tuple[float, float] | None
    """Relative errors of frequency and damping ratio due to the run's time step; None if unknown."""

    def step_error(self, figure: QuantityWithError) -> float:
        """Return the error due to the time step; for stiffness and most parameters, an upper bound."""
        assert self.step_errors is not None
        of_frequency, of_damping = self.step_errors
        relative = {FREQUENCY: of_frequency, DAMPING_RATIO: of_damping, LEVEL: 0.0, "rest": 0.0}
        return abs(figure.value) * relative.get(figure.name, 2.0 * of_frequency + of_damping)

    def text(self, figures: Sequence[QuantityWithError]) -> str:
        """Return the derived values as text, with the relative deviations of the fitted values from them."""
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
