"""Print-out of a model: record, oscillation, equation, parameters with errors, and cautions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from reduced_models.models.at_rest import small_oscillation_quantities
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.observed import force_cycle_lines
from reduced_models.models.plain_data import Probability
from reduced_models.models.prediction import faster_modes
from reduced_models.models.quantities import (
    LEVEL,
    ParameterDirection,
    Quality,
    QuantityWithError,
    caution_lines,
    equation_lines,
    format_percent,
    quantity_lines,
    record_title_and_property_lines,
    wrap_words,
)
from reduced_models.records.sensor import sensor_report_lines

_COLLOCATION = {
    "same": ", and so does a fit to accelerations",
    "worse": "; a fit to accelerations ends at a larger residual",
    "better": "; a fit to accelerations led here",
}


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PrintedModel(FittedLaw):
    """A fitted law as it is printed, with errors; the attributes are documented in `ReducedModel`."""

    confidence: Probability
    quality: Quality
    undetermined: tuple[ParameterDirection, ...] = ()
    notes: tuple[str, ...] = ()
    no_swing: str = ""
    untold: tuple[str, ...] = ()
    qualities: Mapping[str, Quality] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        figures = oscillation_quantities(self, None)
        lines = record_title_and_property_lines(self.provenance.get("record", "").splitlines())
        if not self.law.prescribed:
            lines += quantity_lines(figures, confidence=self.confidence) or [
                f"  no oscillation: {self.no_swing}"
            ]
        count = len(self.law.parameters)
        title = f"model: {self.law.name} ({count} parameter{'s' * (count != 1)})"
        lines += wrap_words(f"{title}, {self._error_text}", "")
        lines += self.equation_lines()
        if self.quality.zero_drift:
            size = f"{self.quality.zero_drift:.2g} {self.coordinate_unit}"
            relative = self.quality.zero_drift * self.quality.relative / max(self.quality.residual, 1e-300)
            size += f", {format_percent(relative)} {self.error_reference_text}"
            lines.append(f"  drift of the record's zero: {size}, fitted as a random walk")
        lines += [f"  {words}" for words in self.mode_texts]
        for name, quality in self.qualities.items():
            lines.append(f"  residual of {name}: {format_percent(quality.relative)} of its rms")
        lines += [f"  {direction}" for direction in self.undetermined]
        lines += sensor_report_lines(self.sensor, self.untold)
        lines += force_cycle_lines(self)
        if self.quality.starts:
            second = _COLLOCATION.get(self.quality.collocation, "")
            lines.append(f"  search: {self.quality.search_text}{second}")
        return "\n".join([*lines, *caution_lines(self.cautions)])

    @property
    def mode_texts(self) -> list[str]:
        """Descriptions of all modes but the slowest of a law with several coordinates."""
        return [
            f"further mode: {mode.frequency:.5g} ± {mode.frequency_error:.2g} Hz, damping ratio "
            f"{100.0 * mode.damping_ratio:.4g} ± {100.0 * mode.damping_ratio_error:.2g} %"
            for mode in faster_modes(self)
        ]

    @property
    def _error_text(self) -> str:
        """Text that gives the error on held-out cycles and the residual of the fit."""
        if not self.quality.samples:
            return "not compared with a motion"
        residual = f"residual {format_percent(self.quality.relative)}"
        if self.quality.rounded:
            residual = f"within the rounding of the sensor, {residual}"
        if self.quality.test_error is None:
            return f"{residual} {self.error_reference_text}"
        held = format_percent(self.quality.test_error)
        return f"error on held-out cycles {held} {self.error_reference_text}, {residual}"

    @property
    def error_reference_text(self) -> str:
        """Reference of relative errors, in words, such as "of rms displacement" or "of rms force"."""
        quantity = "displacement" if self.sensor is None else self.sensor.quantity
        return f"of rms {(self.observation or quantity).replace('_', ' ')}"

    @property
    def cautions(self) -> tuple[str, ...]:
        """Warnings to print with the model: contradicting peaks, and notes."""
        peaks = () if self.at_rest is None else self.at_rest.peak_texts
        return (*peaks, *self.notes)

    def parameter_quantities(self) -> tuple[QuantityWithError, ...]:
        """Return the parameters that the record determines, with the errors of the fit."""
        quantities = []
        for name, value in self.parameters.items():
            if name in self.untold:
                continue
            (low, high), unit = self.intervals[name], self.unit_of_parameter(name)
            parts = {"fit": 0.5 * (high - low)}
            quantities.append(QuantityWithError(name, name, "" if unit == "1" else unit, value, parts))
        return tuple(quantities)

    def equation_lines(self, parameters: Sequence[QuantityWithError] | None = None) -> list[str]:
        """Return lines with the equation, the meaning of z, and parameters, by default the fitted ones."""
        meaning = f"   (z: {self.coordinate} [{self.coordinate_unit}])"
        values = self.parameter_quantities() if parameters is None else parameters
        has_line = self.law.parsed_equation.line is not None
        return equation_lines(self.law.equation + meaning * (not has_line), values, self.intervals)


def oscillation_quantities(model: PrintedModel, mass: float | None) -> tuple[QuantityWithError, ...]:
    """Return quantities of the oscillation about equilibrium; empty without an equilibrium."""
    # Linear oscillator: k = m (2 pi/T)^2 and c = 4 pi m zeta/T (Inman 2014, Engineering Vibration, ch. 1). A
    # damping ratio that contradicts the record's peaks is not shown.
    rest = model.at_rest
    if rest is None:
        return ()
    figures = small_oscillation_quantities(rest, mass)
    return tuple(figure for figure in figures if figure.name != LEVEL or "level" not in model.untold)
