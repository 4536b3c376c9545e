"""Frequency and damping against amplitude, measured from a record (model-free) and computed from a law."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.blocks import Block, Heading, Picture, Table, Text, format_number
from granular.shared.errors import GranularError, RecordError
from granular.shared.plotting import COLOURS, GREY, READABLE, figure, figure_label, label_log_axis_plainly
from reduced_models.laws.equation import compile_rates
from reduced_models.models.at_rest import EngineeringUnits, signal_units
from reduced_models.models.model import ReducedModel
from reduced_models.models.quantities import QuantityWithError
from reduced_models.records.backbone import (
    Backbone,
    backbone_of_driven_oscillation,
    backbone_of_extremes,
    backbone_of_free_oscillation,
)
from reduced_models.records.envelope import describe_extreme_mismatch, find_extremes
from reduced_models.records.inputs import input_column

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FREQUENCY, _DAMPING = 0.01, 0.1  # maximum relative differences at which law and record agree
_KNOWN = 3e-3  # maximum relative error of a frequency measured from peaks; above it only the fit is used
_HOW = {
    "envelope": (
        "Frequency and damping ratio are measured from successive peaks (model-free): the frequency from "
        "their spacing in time, the damping ratio (the fraction of critical damping) from the decrease of "
        "amplitude from one peak to the next."
    ),
    "restoring force": (
        "Frequency and damping ratio are measured from the record's restoring force (drive minus "
        "acceleration): a stiffness and a damping are fitted to this force in each cycle. Only the "
        "acceleration by the drive is taken from the law."
    ),
}


@dataclasses.dataclass(frozen=True, eq=False)
class BackboneComparedWithLaw:
    """Frequency and damping against amplitude, measured from a record and, for comparison, from a law."""

    record: Backbone
    law: Backbone | None
    law_name: str
    amplitudes: tuple[float, ...]  # amplitudes to show [m], the largest first
    figures: tuple[QuantityWithError, ...]
    units: EngineeringUnits

    @property
    def law_agrees(self) -> bool:
        """True if law and record agree in frequency and damping at all displayed amplitudes."""
        if self.law is None:
            return False
        differences, errors = self._relative_differences_and_errors
        return bool((differences <= np.maximum((_FREQUENCY, _DAMPING), errors)).all())

    @property
    def _relative_differences_and_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Relative differences (n, 2) between law and record in frequency and damping, and their errors."""
        assert self.law is not None
        measured, law = (
            np.array([curve.interpolate_at(size) for size in self.amplitudes])
            for curve in (self.record, self.law)
        )
        scale = np.abs(measured[:, 1:3])
        scale[scale == 0.0] = np.inf
        return np.abs(law[:, 1:3] - measured[:, 1:3]) / scale, measured[:, 3:] / scale

    @property
    def agreement_text(self) -> str:
        """State whether law and record agree, with the size of the differences."""
        if self.law is None:
            return f"the law, {self.law_name}, contradicts the record: the law does not oscillate"
        differences, _ = self._relative_differences_and_errors
        if self.law_agrees:
            frequency, damping = (
                f"{_round_up_to_simple_bound(100.0 * value):g} %" for value in differences.max(axis=0)
            )
            return (
                f"the law, {self.law_name}, agrees (frequency within {frequency}, damping within {damping})"
            )
        k = int(differences.sum(axis=1).argmax())
        law = self.law.interpolate_at(self.amplitudes[k])
        return (
            f"the law, {self.law_name}, contradicts the record: at {self.shown_amplitude_text(k)} the law "
            f"has {law.frequency / math.tau:.4g} Hz and {100.0 * law.damping_ratio:.3g} %, the record "
            f"{' and '.join(figure.text_without_error for figure in self.quantities_at_shown_amplitude(k))}"
        )

    def shown_amplitude_text(self, index: int) -> str:
        """Return one of the displayed amplitudes with its unit."""
        return format_amplitude(self.amplitudes[index], self.units)

    def quantities_at_shown_amplitude(self, index: int) -> tuple[QuantityWithError, QuantityWithError]:
        """Frequency [Hz] and damping ratio [%] of the record at one of the displayed amplitudes."""
        return self.figures[2 * index], self.figures[2 * index + 1]

    @property
    def range_text(self) -> str:
        """State how frequency and damping vary over the range of amplitudes; empty for a narrow range."""
        if self.amplitudes[0] < _NARROW * self.amplitudes[-1]:
            return ""
        words: list[str] = []
        limits = ((_FREQUENCY, "frequency"), (_DAMPING, "zeta"))
        for k, (limit, name) in enumerate(limits):
            shown = [self.quantities_at_shown_amplitude(index)[k] for index in range(len(self.amplitudes))]
            values = [item.value for item in shown]
            smallest, largest = (
                min(shown, key=lambda item: item.value),
                max(shown, key=lambda item: item.value),
            )
            spread = (largest.value - smallest.value) / max(float(abs(np.mean(values))), 1e-300)
            if spread <= limit:
                constant = "constant " * (not any("constant" in item for item in words))
                words.append(f"{name} {constant}to {_round_up_to_simple_bound(100.0 * spread):g} %")
            else:
                words.append(f"{name} {smallest.value:.3g} to {largest.value:.3g} {largest.unit}")
        source = "from peaks" if self.record.method == "envelope" else "from the restoring force"
        ends = f"{self.units.scale * self.amplitudes[-1]:.2g} to {self.shown_amplitude_text(0)}"
        return f"{ends}: {', '.join(words)} ({source})"

    def to_plain(self) -> dict[str, Any]:
        """Return method, agreement, and the results at each amplitude as plain data."""
        return {
            "method": self.record.method,
            "agreement": self.agreement_text,
            "agrees": self.law_agrees,
            "figures": {item.name: item.to_plain() for item in self.figures},
        }

    def blocks(self) -> Iterator[Block]:
        """Table and plot of frequency and damping against amplitude."""
        yield Heading("Frequency and damping of the record itself")
        words = _HOW[self.record.method]
        yield Text(f"{words} {self.agreement_text[:1].upper()}{self.agreement_text[1:]}.")
        unit = self.units.length
        header = [f"amplitude [{unit}]", "frequency [Hz]", "damping ratio [%]"]
        if self.law is not None:
            header += ["law: [Hz]", "law: [%]"]
        yield Table(header, [self._table_row(k) for k in range(len(self.amplitudes))])
        yield Picture(
            self._draw, "Points: cycles of the record; line: the law's motion, evaluated in the same way."
        )

    def _draw(self) -> Figure:
        with figure(2, 1, height=5.4, size=READABLE, sharex=True) as (drawing, axes):
            for ax, name, scale in zip(
                axes, ("frequency", "damping_ratio"), (1.0 / math.tau, 100.0), strict=True
            ):
                measured = scale * getattr(self.record, name)
                size = self.units.scale * self.record.amplitude
                ax.plot(size, measured, "o", color=GREY, markersize=4, label="record")
                if self.law is not None:
                    law = self.units.scale * self.law.amplitude, scale * getattr(self.law, name)
                    ax.plot(*law, color=COLOURS[0], linewidth=1.4, label=figure_label(self.law_name))
                middle, reach = float(np.median(measured)), float(np.ptp(measured))
                if reach < _FLAT * abs(middle):  # avoids an axis magnified to show only noise
                    ax.set_ylim(middle - _FLAT * abs(middle), middle + _FLAT * abs(middle))
            axes[0].set_ylabel("frequency [Hz]")
            axes[1].set(ylabel="damping ratio [%]", xlabel=f"amplitude [{self.units.length}]")
            axes[1].set_xscale("log")
            label_log_axis_plainly(axes[1].xaxis)
            axes[0].legend(loc="best")
            return drawing

    def _table_row(self, k: int) -> list[str]:
        size = self.amplitudes[k]
        row = [format_number(self.units.scale * size, 2)]
        row += [quantity.table_cell for quantity in self.quantities_at_shown_amplitude(k)]
        if self.law is not None:
            law = self.law.interpolate_at(size)
            row += [format_number(law.frequency / math.tau, 5), format_number(100.0 * law.damping_ratio, 4)]
        return row


# Minimum range of amplitudes to show a dependence: 20 % at a pendulum's 50 degrees changes f by 2 %.
_NARROW = 1.2
_SMALLEST_BOUND = 0.01  # per cent
_FLAT = 0.02  # minimum half-range of an axis relative to the value


def _round_up_to_simple_bound(value: float) -> float:
    """Round up to the next number of the sequence 0.01, 0.02, 0.05, 0.1 and so on."""
    size = 10.0 ** math.floor(math.log10(max(value, _SMALLEST_BOUND)))
    return next(step * size for step in (1.0, 2.0, 5.0, 10.0) if max(value, _SMALLEST_BOUND) <= step * size)


def format_amplitude(size: float, units: EngineeringUnits) -> str:
    """Amplitude with its unit, to two digits; ``size`` is in m or rad."""
    return f"{units.scale * size:.2g} {units.length}"


def compare_backbone_with_law(record: PistonRecord, model: ReducedModel) -> BackboneComparedWithLaw:
    """Measure frequency and damping of a record against amplitude, and compare them with a law's motion.

    Raises RecordError if there are too few cycles, or if the extremes of record and law do not correspond.
    """
    # Free decay: from the envelope (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003). Driven
    # motion: from the restoring force (Masri & Caughey 1979, doi:10.1115/1.3424568).
    units = signal_units(record.measured, record.coordinate_unit)
    signal = dataclasses.replace(record, height=record.signal)
    law: Backbone | None
    if model.law.inputs:
        measured = _backbone_of_driven_motion_and_law(signal, record, model)
        try:
            law = _backbone_of_driven_motion_and_law(model.simulate_record(record), record, model)
        except GranularError:
            law = None
    else:
        seen = find_extremes(signal)
        measured = backbone_of_extremes(seen)
        try:
            motion = find_extremes(
                dataclasses.replace(record, height=model.simulate_signal(record), velocity=None), exact=True
            )
        except GranularError as error:
            raise RecordError(f"the motion of the fitted law cannot be evaluated: {error}") from None
        if words := describe_extreme_mismatch(seen, motion):
            raise RecordError(words)
        law = backbone_of_extremes(motion)
    amplitudes = measured.amplitudes_to_show(units.scale)
    if not model.law.inputs:
        amplitudes = _precisely_measured_amplitudes(measured, amplitudes)
    return BackboneComparedWithLaw(
        measured, law, model.law.name, amplitudes, _quantities_of_backbone(measured, amplitudes, units), units
    )


def _precisely_measured_amplitudes(measured: Backbone, amplitudes: Sequence[float]) -> tuple[float, ...]:
    """Return the amplitudes at which the frequency from the peaks has a relative error below 0.3 %."""
    points = [measured.interpolate_at(size) for size in amplitudes]
    relative_errors = [point.frequency_error / point.frequency for point in points]
    known = tuple(size for size, error in zip(amplitudes, relative_errors, strict=True) if error < _KNOWN)
    if not known:
        raise RecordError(
            "the scatter of the peaks makes the frequency uncertain by "
            f"{100.0 * min(relative_errors):.2g} %, more than {100.0 * _KNOWN:g} %"
        )
    return known


def quantities_at_amplitudes(
    record: PistonRecord, reference: BackboneComparedWithLaw
) -> tuple[QuantityWithError, ...] | None:
    """Frequency [Hz] and damping ratio [%] of another free decay at the amplitudes of a reference."""
    try:
        return _quantities_of_backbone(
            backbone_of_free_oscillation(record), reference.amplitudes, reference.units
        )
    except GranularError:
        return None


def _backbone_of_driven_motion_and_law(
    motion: PistonRecord, record: PistonRecord, model: ReducedModel
) -> Backbone:
    """Frequency and damping of a driven motion against amplitude; ``record`` has the model's inputs."""
    law = model.law
    rates = compile_rates(law.equation, law.inputs, "numpy")
    values = list(model.all_parameters.values())
    inputs = [input_column(record, name) for name in law.inputs]

    def drive(height: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        still = (0.0,) * len(law.hidden)
        with_drive, without = (
            np.asarray(rates(height, velocity, *still, *given, *values)[0], dtype=float)
            for given in (inputs, [0.0] * len(inputs))
        )
        return with_drive - without

    return backbone_of_driven_oscillation(motion, drive)


def _quantities_of_backbone(
    measured: Backbone, amplitudes: Sequence[float], units: EngineeringUnits
) -> tuple[QuantityWithError, ...]:
    figures = []
    for size in amplitudes:
        cycle, at_amplitude = measured.interpolate_at(size), f" at {format_amplitude(size, units)}"
        for name, symbol, unit, scale, value, error in (
            ("frequency", "f", "Hz", 1.0 / math.tau, cycle.frequency, cycle.frequency_error),
            ("damping ratio", "ζ", "%", 100.0, cycle.damping_ratio, cycle.damping_error),
        ):
            parts = {"fit": scale * error}
            figures.append(QuantityWithError(f"{name}{at_amplitude}", symbol, unit, scale * value, parts))
    return tuple(figures)
