"""HTML report of a measured response, with the response predicted from small motions of the bed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from granular.linear.equilibrium import Equilibrium, equilibrium
from granular.linear.roots import coordinate_index_of_free_piston, displacements_under_harmonic_force
from granular.response.response import FrequencyResponse
from granular.response.transients import relative_sweep_rate_at_peak
from granular.shared.array_types import Complex, Float
from granular.shared.blocks import Block, Caution, Heading, Picture, Printout, Table, Text, format_number
from granular.shared.errors import GranularError, one_line
from granular.shared.html_pages import Page, page_footer
from granular.shared.plotting import COLOURS, READABLE, figure, label_log_axis_plainly

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


UNSTEADY = 0.05
"""Relative change of the amplitude during the measurement above which the page shows a warning."""
MAX_SWEEP_RATE = 0.3
"""Relative rate of a sweep (`relative_sweep_rate_at_peak`) above which the page shows a warning."""
_DASHES: tuple[Literal["--", ":", "-."], ...] = ("--", "-.", ":")
_DENSE = 60
"""Maximum number of frequencies for which each point of a curve is drawn with a marker."""


@dataclasses.dataclass(frozen=True, eq=False)
class PredictedResponseForPage:
    """Response predicted by another model, which the page compares with the measured response."""

    title: str
    words: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    frequencies: Float[np.ndarray, "f"]  # frequencies of the curves [Hz]
    curves: Mapping[str, Mapping[float, np.ndarray]]  # [m]
    notes: Sequence[str] = ()


def response_page(
    response: FrequencyResponse, comparison: PredictedResponseForPage | None = None, missing: str = ""
) -> Page:
    """Make the HTML report of a response: curves, peaks, effect of the damper and settings."""
    return Page(
        f"The response of scene {response.scene.name!r}",
        peak_summary_sentence(response),
        tuple(_blocks(response, comparison, missing)),
        page_footer(("matplotlib", "scipy", "xarray")),
        response,
    )


def _blocks(
    response: FrequencyResponse, comparison: PredictedResponseForPage | None, missing: str
) -> Iterator[Block]:
    yield Picture(partial(_draw_response_curves, response, comparison), _curve_caption(response, comparison))
    if "no_linear" in response.dataset.attrs:
        yield Text(
            f"The response from small motions could not be computed: {response.dataset.attrs['no_linear']}."
        )
    yield from _peak_table(response)
    yield from unsteadiness_warnings(response)
    if comparison is not None:
        yield Heading(comparison.title)
        yield Table(comparison.header, comparison.rows)
        yield Text(comparison.words)
        yield from map(Caution, comparison.notes)
    elif missing:
        yield Caution(missing)
    yield from added_mass_and_damping_section(response)
    yield from dissipated_energy_section(response)
    yield from _settings_blocks(response)


def peak_summary_sentence(response: FrequencyResponse) -> str:
    """Return a sentence with the peak at the largest drive amplitude, with and without the damper."""
    row = max(response.peaks(), key=lambda peak: peak["amplitude"])
    words = (
        f"{amplitude_phrase(response, row['amplitude'])}: {_format_in_mm(row['peak'])} mm "
        f"maximum, at {row['frequency']:.3g} Hz"
    )
    if "alone" not in row:
        return f"{words}."
    return (
        f"{words}. Without the damper the maximum is {_format_in_mm(row['alone'])} mm, "
        f"{row['reduction']:.3g} times as much, and with the ideal tuned mass of the same weight it is "
        f"{_format_in_mm(row['ideal'])} mm."
    )


def _draw_response_curves(response: FrequencyResponse, comparison: PredictedResponseForPage | None) -> Figure:
    with figure(height=5.4, size=READABLE) as (drawing, axes):
        response.plot(axes)
        axes.get_legend().remove()
        label_log_axis_plainly(axes.yaxis)
        count = response.dataset.sizes["amplitude"]
        measured_lines = axes.get_lines()[:count]
        for k, line in enumerate(measured_lines):
            line.set(color=COLOURS[k % len(COLOURS)], linestyle="-", linewidth=1.6)
            if response.dataset.sizes["frequency"] < _DENSE:
                line.set(marker="o", markersize=5)
        if "linear" in response.dataset:
            for k, curve in enumerate(response.dataset.linear.values):
                style = {"color": COLOURS[k % len(COLOURS)], "linewidth": 1.0, "linestyle": (0, (4, 3))}
                name = "small motions" if k == 0 else None
                axes.plot(response.dataset.frequency, 1e3 * curve, label=name, **style)
        names = _draw_predicted_curves(axes, response, comparison)
        handles, words = axes.get_legend_handles_labels()
        drawing.legend(
            [*handles, *names.values()],
            [*words, *names],
            loc="outside upper left",
            ncols=1 if len(words) + len(names) < 4 else 2,
        )
        return drawing


def _draw_predicted_curves(
    axes: Axes, response: FrequencyResponse, comparison: PredictedResponseForPage | None
) -> Mapping[str, object]:
    """Draw the predicted curves; return one line per name for the legend."""
    from matplotlib.lines import Line2D

    handles: dict[str, object] = {}
    if comparison is None:
        return handles
    sizes = response.dataset.amplitude.values.tolist()
    for (name, curves), style in zip(comparison.curves.items(), _DASHES, strict=False):
        for size, curve in curves.items():
            colour = COLOURS[sizes.index(size) % len(COLOURS)]
            axes.plot(comparison.frequencies, 1e3 * curve, color=colour, linestyle=style, lw=1.3)
        handles[name] = Line2D([], [], color=COLOURS[-1], linestyle=style, lw=1.3)
    return handles


def _curve_caption(response: FrequencyResponse, comparison: PredictedResponseForPage | None) -> str:
    words = "Displacement of the machine"
    if response.scene.effects.host is not None and not response.scene.effects.host.bodies:
        words = "Displacement of the load on the piston"
    if "alone" in response.dataset:
        words += ", with the damper, without it, and with Den Hartog's tuned mass instead"
    if "linear" in response.dataset:
        words += "; dashed, in the colour of each amplitude: small motions of the bed about its equilibrium"
    if comparison is not None:
        words += f"; in the colour of each amplitude: {', '.join(comparison.curves)}"
    return f"{words}."


def _peak_table(response: FrequencyResponse) -> Iterator[Block]:
    yield Heading("The peaks")
    rows = response.peaks()
    head = [_NAMES[response.quantity][0], "at [Hz]", "peak [mm]"]
    keys = ["alone", "ideal"] if "alone" in rows[0] else []
    head += ["alone [mm]", "ideal [mm]", "times lower"] if keys else []
    cells = [
        [
            f"{row['amplitude']:g}",
            format_number(row["frequency"]),
            _format_in_mm(row["peak"]),
            *(_format_in_mm(row[key]) for key in keys),
            *([format_number(row["reduction"], 3)] if keys else []),
        ]
        for row in rows
    ]
    yield Table(head, cells)
    if keys:
        yield Text(
            "Alone: the machine without the damper. Ideal: the machine with Den Hartog's tuned mass, which "
            "has the damper's weight and the optimal spring and dashpot. Both responses are exact; their "
            "peaks are searched between the lowest and the highest frequency above."
        )
        curve = response.linear_curves(rows[-1]["amplitude"])["alone"]
        if int(curve.argmax()) in (0, len(curve) - 1):
            yield Caution(
                "The peak of the machine without the damper lies outside these frequencies; compute "
                "a wider range to see by which factor the damper reduces it."
            )


def unsteadiness_warnings(response: FrequencyResponse) -> Iterator[Block]:
    """Make warnings about unsteady oscillations and about a sweep that is too fast."""
    data = response.dataset
    rate = relative_sweep_rate_at_peak(response)
    if rate is not None and rate > MAX_SWEEP_RATE:
        wanted = response.settings["duration"] * rate / (0.5 * MAX_SWEEP_RATE)
        yield Caution(
            f"The sweep was too fast for the peak: its frequency changes {rate:.2g} times as fast as the "
            f"machine with its damper can follow. Use a sweep of  {wanted:.0f} s or more, or steady sines."
        )
    if "unsteady" not in data:
        return
    worst = data.unsteady.where(data.unsteady == data.unsteady.max(), drop=True)
    if float(worst.max()) > UNSTEADY:
        yield Caution(
            f"Not all oscillations are steady. {amplitude_phrase(response, float(worst.amplitude[0]))}, "
            f"at {float(worst.frequency[0]):.4g} Hz, the amplitude still changes "
            f"by {100.0 * float(worst.max()):.2g} % during the measurement. For more accuracy, "
            "use longer sines (--duration)."
        )


def _settings_blocks(response: FrequencyResponse) -> Iterator[Block]:
    yield Heading("Settings")
    rows = [("time step", str(response.settings.get("dt", "not told")))]
    sweep, lasts = response.settings.get("sweep"), response.settings.get("duration")
    if sweep is not None:
        rows.append(("one sweep", f"{sweep[0]:g} to {sweep[1]:g} Hz in {lasts:g} s"))
        rate = relative_sweep_rate_at_peak(response)
        rows.append(("sweep rate at the peak", "not known" if rate is None else format_number(rate, 2)))
    elif lasts is not None:
        rows.append(("duration of each sine", f"{lasts:g} s; amplitudes are measured in the last 40 % of it"))
    rows.append(("frequencies", str(response.dataset.sizes["frequency"])))
    yield Table(("setting", "value"), rows)
    if table_frequency_count(response) < response.dataset.sizes["frequency"]:
        yield Text("The tables show a selection of the frequencies; response.csv contains all of them.")
    yield Printout(response.scene.to_toml())


def _format_in_mm(metres: float) -> str:
    return format_number(1e3 * metres, 3)


MARKS = "os^vDP*X"
LOSSES = {
    "affine_loss_a_period": "affine drag",
    "rearranging": "rearranging",
    "friction_loss_a_period": "friction",
    "wall_friction_loss_a_period": "wall friction",
    "contact_loss_a_period": "contacts",
    "eddy_loss_a_period": "eddy currents",
    "piston_loss_a_period": "piston",
    "host_loss_a_period": "dashpots",
}


def added_mass_and_damping_section(response: FrequencyResponse) -> Iterator[Block]:
    """Make tables and plots of the damper's added mass and damping against frequency and displacement."""
    yield Heading("Amplitudes, and the effect of the damper on the machine")
    data = response.dataset
    if "added_damping" in data:
        yield Picture(
            partial(_draw_equivalent_damping, response),
            "Damping and stiffness that the damper adds to the machine, plotted against the machine's "
            "displacement, with one point per frequency. For a linear damper the values at one "
            "frequency do not depend on amplitude.",
        )
        yield Text(
            "The added mass and damping are the mass and dashpot that would give the machine "
            "the same displacement. The added stiffness is the added mass times -omega². The loss factor is "
            "the ratio of dissipated to reactive power; it is large and not meaningful if the reactive power "
            "is almost zero."
        )
    for size in data.amplitude.values.tolist():
        yield from _damper_table_by_displacement(response, size)
    words = "Piston: amplitude of the piston relative to the cell"
    if "unsteady" in data:
        words += "; unsteady: change of the machine's amplitude during the measurement"
    yield Text(f"{words}.")


def _draw_equivalent_damping(response: FrequencyResponse) -> Figure:
    with figure(2, 1, height=6.4, size=READABLE, sharex=True) as (drawing, both):
        for k, size in enumerate(response.dataset.amplitude.values.tolist()):
            part = response.dataset.sel(amplitude=size)
            displacement, colour = 1e3 * part.displacement, COLOURS[k % len(COLOURS)]
            style = {"color": colour, "linestyle": "none", "marker": MARKS[k % len(MARKS)]}
            both[0].plot(displacement, part.added_damping, label=amplitude_phrase(response, size), **style)
            both[1].plot(displacement, 1e-3 * part.added_stiffness, **style)
        both[0].set_ylabel("added damping [kg/s]")
        both[1].set(ylabel="stiffness [kN/m]", xlabel="displacement of the machine [mm]")
        drawing.legend(loc="outside upper left", ncols=2)
        return drawing


def _damper_table_by_displacement(response: FrequencyResponse, size: float) -> Iterator[Block]:
    part, diameter = response_at_table_frequencies(response, size), response.scene.grains.species[0].diameter
    columns = {
        "Hz": (part.frequency, 1.0, 4),
        "mm": (part.displacement, 1e3, 3),
        "small motions [mm]": (part.get("linear"), 1e3, 3),
        "piston [D]": (part.get("stroke"), 1.0 / diameter, 2),
        "added kg": (part.get("effective_mass"), 1.0, 3),
        "added kg/s": (part.get("added_damping"), 1.0, 3),
        "loss factor": (part.get("loss_factor"), 1.0, 2),
        "unsteady": (part.get("unsteady"), 1.0, 2),
    }
    known = {
        head: [_format_table_number(scale * float(x), digits) for x in values.values]
        for head, (values, scale, digits) in columns.items()
        if values is not None
    }
    yield Text(f"{amplitude_phrase(response, size)}:")
    yield Table(tuple(known), list(zip(*known.values(), strict=True)))


def _format_table_number(value: float, digits: int) -> str:
    """Format a number for a table, without an exponent if possible."""
    if value == 0.0 or not np.isfinite(value) or not 1e-3 <= abs(value) < 1e6:
        return format_number(value, digits)
    decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{value:.{decimals}f}"


def dissipated_energy_section(response: FrequencyResponse) -> Iterator[Block]:
    """Make tables of the energies dissipated per period at each amplitude."""
    if "work_a_period" not in response.dataset:
        return
    yield Heading("Energy dissipated per period")
    for size in response.dataset.amplitude.values.tolist():
        part = response_at_table_frequencies(response, size)
        losses = energy_losses_per_period(part)
        columns = {"work": part.work_a_period.values, **losses}
        head = ["Hz", *(f"{name} [mJ]" for name in columns)]
        rows = [
            [
                _format_table_number(float(f), 4),
                *(_format_table_number(1e3 * float(column[k]), 3) for column in columns.values()),
            ]
            for k, f in enumerate(part.frequency.values)
        ]
        yield Text(f"{amplitude_phrase(response, size)}:")
        yield Table(head, rows)
    yield Text(
        "'Work' is done by the drive in a period; the other columns are losses. 'Affine drag' is the drag of "
        "grains that follow the piston in proportion to height; it is a third of the drag that they would "
        "have at the piston's speed. 'Rearranging' is the drag in excess of the affine drag, due to grains "
        "that change places; it is negative if the grains follow the piston less than in affine motion. Any "
        "remaining difference is due to oscillations that have not yet become steady."
    )


def energy_losses_per_period(part: xarray.Dataset) -> dict[str, np.ndarray]:
    """Return the work of the drive and the energy dissipated by each cause in a period of the drive [J]."""
    values = {str(name): column.values for name, column in part.data_vars.items()}
    if "affine_loss_a_period" in values and "drag_loss_a_period" in values:
        values["rearranging"] = values["drag_loss_a_period"] - values["affine_loss_a_period"]
    known = {name: values[key] for key, name in LOSSES.items() if key in values}
    shown = {*LOSSES, "drag_loss_a_period", "work_a_period"}
    for key, column in values.items():  # user-defined effects
        if key.endswith("_loss_a_period") and key not in shown:
            known[key.removesuffix("_loss_a_period").replace("_", " ")] = column
    return {name: column for name, column in known.items() if np.any(column != 0.0)}


MAXIMUM_ROWS = 25
_NAMES = {
    "force": ("force [N]", "Under {size:g} N", 1.0),
    "acceleration": ("base [m/s²]", "On a base that accelerates with {size:g} m/s²", 1.0),
    "displacement": ("base [mm]", "On a base that moves by {size:g} mm", 1e3),
}


def amplitude_phrase(response: FrequencyResponse, amplitude: float) -> str:
    """Return a phrase such as "Under 5 N" for an amplitude of the drive [N, m/s^2 or m]."""
    _, words, scale = _NAMES[response.quantity]
    return words.format(size=scale * amplitude)


def table_frequency_count(response: FrequencyResponse) -> int:
    """Return the number of frequencies in the page's tables, up to `MAXIMUM_ROWS`."""
    return min(response.dataset.sizes["frequency"], MAXIMUM_ROWS)


def response_at_table_frequencies(response: FrequencyResponse, amplitude: float) -> xarray.Dataset:
    """Select the response at one drive amplitude (SI) and the tables' frequencies, including the peak."""
    part = response.dataset.sel(amplitude=amplitude)
    count = part.sizes["frequency"]
    indices = np.unique(np.linspace(0, count - 1, table_frequency_count(response)).round().astype(int))
    peak = int(part.displacement.values.argmax())
    indices[int(np.abs(indices - peak).argmin())] = peak
    return part.isel(frequency=indices)


def add_linear_response(response: FrequencyResponse) -> FrequencyResponse:
    """Add the displacements [m] predicted for small motions as ``linear``, or an error as ``no_linear``."""
    data = response.dataset
    quantity, frequencies = response.quantity, data.frequency.values
    try:
        single = np.abs(linear_displacements_per_drive(equilibrium(response.scene), quantity, frequencies))
    except GranularError as error:
        return dataclasses.replace(response, dataset=data.assign_attrs(no_linear=one_line(str(error))))
    attributes = {"units": "m", "long_name": "amplitude of the last body from the bed's small motions"}
    field = (data.displacement.dims, data.amplitude.values[:, None] * single, attributes)
    return dataclasses.replace(response, dataset=data.assign(linear=field))


def linear_displacements_per_drive(
    rest: Equilibrium, quantity: str, frequencies: Float[np.ndarray, "f"]
) -> Complex[np.ndarray, "f"]:
    """Return the last body's (or the piston load's) displacement per unit drive [m/N, s^2 or 1]."""
    bed = rest.pencil.bed
    piston, host = coordinate_index_of_free_piston(rest), rest.scene.effects.host
    assert host is not None
    push = np.zeros(bed.size)
    if quantity == "force":
        push[bed.bodies + (len(host.bodies) - 1 if host.excited is None else host.excited)] = 1.0
    else:
        push = -(rest.pencil.mass @ bed.cell_displacement_coefficients_and_uplift()[1])
    answer = bed.size - 1 if host.bodies else piston
    return displacements_under_harmonic_force(
        rest, frequencies, push, 2 if quantity == "displacement" else 0
    )[:, answer]
