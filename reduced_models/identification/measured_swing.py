"""The record's own swing: frequency and damping against amplitude without a law, and the law's next to it."""

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
from reduced_models.records.backbone import Backbone, backbone_of_extremes, driven_backbone, free_backbone
from reduced_models.records.envelope import describe_extreme_mismatch, find_extremes
from reduced_models.records.inputs import input_column

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FREQUENCY, _DAMPING = 0.01, 0.1  # relative differences, up to which law and record agree
_KNOWN = 3e-3  # relative error of a frequency above which extremes are left to the fit
_HOW = {
    "envelope": (
        "Frequency and damping ratio are read off the record's own extremes, without a law: the frequency "
        "by the time between them, the damping ratio (the fraction of the damping at which nothing swings) "
        "by how the amplitude falls from one to the next."
    ),
    "restoring force": (
        "Frequency and damping ratio are read off the record's own restoring force (what the acceleration "
        "leaves of the drive), whose stiffness and damping are fitted cycle by cycle; only how the drive "
        "enters is taken from the law."
    ),
}


@dataclasses.dataclass(frozen=True, eq=False)
class MeasuredSwing:
    """Frequency and damping against amplitude."""

    record: Backbone
    law: Backbone | None
    law_name: str
    amplitudes: tuple[float, ...]  # that are shown [m], the greatest first
    figures: tuple[QuantityWithError, ...]
    units: EngineeringUnits

    @property
    def law_agrees(self) -> bool:
        """True where the law swings as the record does, at all amplitudes that are shown."""
        if self.law is None:
            return False
        differences, errors = self._relative_differences
        return bool((differences <= np.maximum((_FREQUENCY, _DAMPING), errors)).all())

    @property
    def _relative_differences(self) -> tuple[np.ndarray, np.ndarray]:
        """Relative differences (n, 2) of frequency and damping ratio at each amplitude, and their errors."""
        assert self.law is not None
        own, law = (
            np.array([curve.interpolate_at(size) for size in self.amplitudes])
            for curve in (self.record, self.law)
        )
        scale = np.abs(own[:, 1:3])
        scale[scale == 0.0] = np.inf
        return np.abs(law[:, 1:3] - own[:, 1:3]) / scale, own[:, 3:] / scale

    @property
    def agreement_text(self) -> str:
        """Sentence that says whether the law agrees with the record, and by how much not."""
        if self.law is None:
            return f"the law, {self.law_name}, contradicts the record: by it nothing swings"
        differences, _ = self._relative_differences
        if self.law_agrees:
            frequency, damping = (
                f"{_round_up_bound(100.0 * value):g} %" for value in differences.max(axis=0)
            )
            return (
                f"the law, {self.law_name}, agrees (frequency within {frequency}, damping within {damping})"
            )
        k = int(differences.sum(axis=1).argmax())
        law = self.law.interpolate_at(self.amplitudes[k])
        return (
            f"the law, {self.law_name}, contradicts the record: at {self.amplitude_text(k)} it has "
            f"{law.frequency / math.tau:.4g} Hz and {100.0 * law.damping_ratio:.3g} %, the record "
            f"{' and '.join(figure.text_without_error for figure in self.quantities_at(k))}"
        )

    def amplitude_text(self, index: int) -> str:
        """Return an amplitude that is shown, with its unit."""
        return format_amplitude(self.amplitudes[index], self.units)

    def quantities_at(self, index: int) -> tuple[QuantityWithError, QuantityWithError]:
        """Frequency [Hz] and damping ratio [%] of the record at an amplitude that is shown."""
        return self.figures[2 * index], self.figures[2 * index + 1]

    @property
    def range_text(self) -> str:
        """Range of amplitudes, and how constant frequency and damping are in it; empty for one amplitude."""
        if self.amplitudes[0] < _NARROW * self.amplitudes[-1]:
            return ""
        words: list[str] = []
        limits = ((_FREQUENCY, "frequency"), (_DAMPING, "zeta"))
        for k, (limit, name) in enumerate(limits):
            shown = [self.quantities_at(index)[k] for index in range(len(self.amplitudes))]
            values = [item.value for item in shown]
            least, most = min(shown, key=lambda item: item.value), max(shown, key=lambda item: item.value)
            spread = (most.value - least.value) / max(float(abs(np.mean(values))), 1e-300)
            if spread <= limit:
                constant = "constant " * (not any("constant" in item for item in words))
                words.append(f"{name} {constant}to {_round_up_bound(100.0 * spread):g} %")
            else:
                words.append(f"{name} {least.value:.3g} to {most.value:.3g} {most.unit}")
        how = "from peaks" if self.record.method == "envelope" else "from the restoring force"
        ends = f"{self.units.scale * self.amplitudes[-1]:.2g} to {self.amplitude_text(0)}"
        return f"{ends}: {', '.join(words)} ({how})"

    def to_plain(self) -> dict[str, Any]:
        """Return method, agreement, and figures by amplitude as plain data."""
        return {
            "method": self.record.method,
            "agreement": self.agreement_text,
            "agrees": self.law_agrees,
            "figures": {item.name: item.to_plain() for item in self.figures},
        }

    def blocks(self) -> Iterator[Block]:
        """Table and picture of frequency and damping against amplitude."""
        yield Heading("Frequency and damping of the record itself")
        words = _HOW[self.record.method]
        yield Text(f"{words} {self.agreement_text[:1].upper()}{self.agreement_text[1:]}.")
        unit = self.units.length
        header = [f"amplitude [{unit}]", "frequency [Hz]", "damping ratio [%]"]
        if self.law is not None:
            header += ["law: [Hz]", "law: [%]"]
        yield Table(header, [self._table_row(k) for k in range(len(self.amplitudes))])
        yield Picture(
            self._draw, "Each point is a cycle of the record; the line is the law's motion, read likewise."
        )

    def _draw(self) -> Figure:
        with figure(2, 1, height=5.4, size=READABLE, sharex=True) as (drawing, axes):
            for ax, name, scale in zip(
                axes, ("frequency", "damping_ratio"), (1.0 / math.tau, 100.0), strict=True
            ):
                own = scale * getattr(self.record, name)
                size = self.units.scale * self.record.amplitude
                ax.plot(size, own, "o", color=GREY, markersize=4, label="record")
                if self.law is not None:
                    law = self.units.scale * self.law.amplitude, scale * getattr(self.law, name)
                    ax.plot(*law, color=COLOURS[0], linewidth=1.4, label=figure_label(self.law_name))
                middle, reach = float(np.median(own)), float(np.ptp(own))
                if reach < _FLAT * abs(middle):  # noise alone is not blown up
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
        row += [quantity.table_cell for quantity in self.quantities_at(k)]
        if self.law is not None:
            law = self.law.interpolate_at(size)
            row += [format_number(law.frequency / math.tau, 5), format_number(100.0 * law.damping_ratio, 4)]
        return row


# A narrower range of amplitudes shows no dependence on them: 20 % of a pendulum's 50 degrees move f by 2 %.
_NARROW = 1.2
_LEAST_BOUND = 0.01  # per cent
_FLAT = 0.02  # of a value, that a picture shows at least


def _round_up_bound(value: float) -> float:
    """Least number of 0.01, 0.02, 0.05, 0.1 and so on that is no less."""
    size = 10.0 ** math.floor(math.log10(max(value, _LEAST_BOUND)))
    return next(step * size for step in (1.0, 2.0, 5.0, 10.0) if max(value, _LEAST_BOUND) <= step * size)


def format_amplitude(size: float, units: EngineeringUnits) -> str:
    """Amplitude with its unit, in two digits; size [m, rad]."""
    return f"{units.scale * size:.2g} {units.length}"


def measure_swing(record: PistonRecord, model: ReducedModel) -> MeasuredSwing:
    """Frequency and damping of a record against amplitude, next to those of a law's motion there.

    Raises RecordError if too few cycles are seen, or if extremes are not those of the fitted motion.
    """
    # Free: from the envelope (Londono, Neild & Cooper 2015, doi:10.1016/j.jsv.2015.02.003); driven: from the
    # restoring force (Masri & Caughey 1979, doi:10.1115/1.3424568).
    units = signal_units(record.measured, record.coordinate_unit)
    signal = dataclasses.replace(record, height=record.signal)
    law: Backbone | None
    if model.law.inputs:
        own = _driven_backbone(signal, record, model)
        try:
            law = _driven_backbone(model.simulate_record(record), record, model)
        except GranularError:
            law = None
    else:
        seen = find_extremes(signal)
        own = backbone_of_extremes(seen)
        try:
            motion = find_extremes(
                dataclasses.replace(record, height=model.simulate_signal(record), velocity=None), exact=True
            )
        except GranularError as error:
            raise RecordError(f"the fitted law has no motion to compare them with: {error}") from None
        if words := describe_extreme_mismatch(seen, motion):
            raise RecordError(words)
        law = backbone_of_extremes(motion)
    amplitudes = own.amplitudes_to_show(units.scale)
    if not model.law.inputs:
        amplitudes = _known_amplitudes(own, amplitudes)
    return MeasuredSwing(
        own, law, model.law.name, amplitudes, _frequency_and_damping(own, amplitudes, units), units
    )


def _known_amplitudes(own: Backbone, amplitudes: Sequence[float]) -> tuple[float, ...]:
    """Amplitudes at which the extremes tell the frequency as well as a fit is expected to."""
    points = [own.interpolate_at(size) for size in amplitudes]
    open_by = [point.frequency_error / point.frequency for point in points]
    known = tuple(size for size, error in zip(amplitudes, open_by, strict=True) if error < _KNOWN)
    if not known:
        raise RecordError(f"their scatter leaves the frequency open by {100.0 * min(open_by):.2g} %")
    return known


def quantities_at_amplitudes(
    record: PistonRecord, reference: MeasuredSwing
) -> tuple[QuantityWithError, ...] | None:
    """Frequency [Hz] and damping [%] of another free record at the amplitudes of one."""
    try:
        return _frequency_and_damping(free_backbone(record), reference.amplitudes, reference.units)
    except GranularError:
        return None


def _driven_backbone(motion: PistonRecord, record: PistonRecord, model: ReducedModel) -> Backbone:
    """Curves of a driven motion; ``record`` has the inputs of the model."""
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

    return driven_backbone(motion, drive)


def _frequency_and_damping(
    own: Backbone, amplitudes: Sequence[float], units: EngineeringUnits
) -> tuple[QuantityWithError, ...]:
    figures = []
    for size in amplitudes:
        swing, where = own.interpolate_at(size), f" at {format_amplitude(size, units)}"
        for name, symbol, unit, scale, value, error in (
            ("frequency", "f", "Hz", 1.0 / math.tau, swing.frequency, swing.frequency_error),
            ("damping ratio", "ζ", "%", 100.0, swing.damping_ratio, swing.damping_error),
        ):
            parts = {"fit": scale * error}
            figures.append(QuantityWithError(f"{name}{where}", symbol, unit, scale * value, parts))
    return tuple(figures)
