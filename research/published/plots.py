"""Pictures of the report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.shared.blocks import Block, Picture
from granular.shared.plotting import COLOURS, GREY, STYLES, figure
from research.published.both_causes import (
    CREEP_SIZE,
    distances_with_both_causes,
    final_distance_with_creep_by_step,
    steps_distances_and_half_intervals,
)
from research.published.entry import standard_error_of_difference_and_freedom, student_quantile
from research.published.finding import Finding
from research.published.judging import JudgedEntry
from research.published.measures import samples_under_common_protocol
from research.published.plan import (
    ASPECTS,
    GAMMAS,
    LARGE,
    LISTED,
    MASSES,
    RATIOS,
    SIZES,
    SPEEDS,
    VARIANT_RATIOS,
    VARIANTS,
    damper_series_name,
    mixture_series_name,
)
from research.published.results import PublishedResults
from validation.measured_quantities import published_value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 6.4
_PUBLISHED = {"marker": "x", "linestyle": "none", "markersize": 7.0, "markeredgewidth": 1.6}


def pictures_of_section(section: str, results: PublishedResults) -> Iterator[Block]:
    """Return the pictures of a section of the report."""
    for draw in _PICTURES.get(section, ()):
        yield from draw(results)


def relative_figures_picture(rows: Sequence[JudgedEntry]) -> Iterator[Block]:
    """Draw figures over their published values, both with intervals of 95 % of the mean."""
    there = [row for row in rows if row.found is not None]
    if not there:
        return
    with figure(width=WIDTH, height=0.42 * len(there) + 1.0) as (drawing, axes):
        for index, row in enumerate(reversed(there)):
            result, size = row.found, abs(row.published)
            assert result is not None
            error, freedom = standard_error_of_difference_and_freedom(row.published_spread, Finding(0.0))
            theirs = student_quantile(freedom) * error + 0.5 * 10.0**-row.entry.digits
            axes.errorbar(
                1.0,
                index + 0.13,
                xerr=theirs / size,
                color=COLOURS[1],
                marker="x",
                label="published" if index == 0 else None,
                capsize=2.0,
            )
            ours, half = result.value / row.published, (result.half_width() or 0.0) / size
            axes.errorbar(
                ours,
                index - 0.13,
                xerr=half,
                color=COLOURS[0],
                marker="o",
                markersize=4,
                label="ours" if index == 0 else None,
                capsize=2.0,
            )
        axes.axvline(1.0, color=GREY, linewidth=0.8)
        axes.set_ylim(-0.6, len(there) - 0.4)
        axes.set_yticks(range(len(there)), [row.entry.what for row in reversed(there)], fontsize=8)
        axes.set(xlabel="over the published value")
        axes.legend(fontsize=8)
        yield Picture(
            lambda: drawing,
            "Ours and the published values, over the latter; bars are intervals "
            "of 95 % of the means, or half of the last printed digit.",
        )


def both_causes_picture(results: PublishedResults) -> Iterator[Block]:
    """Return the picture of errors of start and end, with and without both causes, and of creep."""
    drawing = draw_both_causes_figure(results)
    if drawing is not None:
        yield Picture(lambda: drawing, BOTH_CAPTION)


def draw_both_causes_figure(results: PublishedResults) -> Figure | None:
    """Draw errors of start and end, and creep over the step; None if runs are missing."""
    if not (distances_with_both_causes(results) and final_distance_with_creep_by_step(results)):
        return None
    with figure(1, 2, width=11.0, height=4.4) as (drawing, axes):
        draw_both_causes_on_axes(axes[0], axes[1], results)
    return drawing


BOTH_CAPTION = (
    "Left: half the mean distance at start and end, minus the published one, by the exact law from "
    "the usual grid, with both causes, and with the velocity of equation 2.17 a step late; bars "
    "are prediction intervals. Right: the end of "
    "the cycle of 368 grains over the time step; dotted: published."
)


def draw_both_causes_on_axes(left: Any, right: Any, results: PublishedResults) -> None:
    """Draw start and end over size on the left, creep over the step on the right."""
    rows = distances_with_both_causes(results)
    labels = ("exact law", "both causes", "equation 2.17 late")
    for k, what in enumerate(("start", "end")):
        chosen = [item for item in rows if item.what == what]
        for m, label in enumerate(labels):
            result = [((item.usual, item.both, item.late)[m], item) for item in chosen]
            known = [(value, item) for value, item in result if value is not None]
            bars = [item.allowed for _, item in known] if m == 1 else None
            left.errorbar(
                [item.grains + 10 * k for _, item in known],
                [value.value - item.published for value, item in known],
                bars,
                color=COLOURS[k],
                linestyle=STYLES[m],
                marker="osD"[m],
                markersize=4,
                linewidth=1.0,
                label=f"{what}, {label}",
            )
    left.axhline(0.0, color=GREY, linewidth=0.8)
    left.set(xlabel="number of grains", ylabel="here less published [D]")
    left.legend(fontsize=8)
    steps, ends, errors = steps_distances_and_half_intervals(final_distance_with_creep_by_step(results))
    right.errorbar(steps, ends, errors, color=COLOURS[0], marker="o", markersize=4)
    printed = published_value(f"half_mean_distance.end[{SIZES.index(CREEP_SIZE)}]")
    right.axhline(printed, color=GREY, linestyle=":")
    right.set(xlabel="time step [1e-6 T]", ylabel="half mean distance\nat the end [D]")


def _positions_means_and_half_intervals(
    results: PublishedResults, names: Sequence[str], places: Sequence[float], name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, means and half intervals of complete series, under their best protocol."""
    result = [
        (index, sample.finding())
        for index, series in zip(places, names, strict=True)
        if (sample := results.figure_sample(series, name)) is not None
    ]
    columns = np.array([(index, item.value, item.half_width() or 0.0) for index, item in result])
    x, y, errors = columns.reshape(-1, 3).T
    return x, y, errors


def _force_over_size_picture(results: PublishedResults) -> Iterator[Block]:
    sizes = (*LISTED, *LARGE)
    with figure(width=WIDTH) as (drawing, axes):
        for k, (way, section, label) in enumerate(
            (
                ("direct", "piston_force_direct_sum", "every pair"),
                ("list", "piston_force_verlet", "de Paula's list"),
            )
        ):
            x, y, errors = _positions_means_and_half_intervals(
                results, [f"{way} {n}" for n in sizes], sizes, "force"
            )
            axes.errorbar(
                x,
                y,
                errors,
                color=COLOURS[k],
                linestyle=STYLES[k],
                marker="o",
                markersize=4,
                label=f"{label}, ours",
            )
            axes.plot(
                sizes,
                published_value(f"{section}.mean"),
                color=COLOURS[k],
                label=f"{label}, published",
                **_PUBLISHED,
            )
        axes.set(xlabel="number of grains", ylabel="piston force [N]")
        axes.legend()
        yield Picture(lambda: drawing, "Piston force at full compression over the number of grains.")


def _list_force_loss_picture(results: PublishedResults) -> Iterator[Block]:
    from research.published.measures import make_list_force_loss_measure

    sizes = (*LISTED, *LARGE)
    result = [(n, item) for n in sizes if (item := make_list_force_loss_measure(n)(results)) is not None]
    if not result:
        return
    with figure(width=WIDTH) as (drawing, axes):
        axes.errorbar(
            [n for n, _ in result],
            [item.value for _, item in result],
            [item.half_width() or 0.0 for _, item in result],
            color=COLOURS[0],
            marker="o",
            markersize=4,
            label="ours",
        )
        axes.plot(
            sizes,
            published_value("piston_force_verlet.percent_difference"),
            color=COLOURS[1],
            label="published",
            **_PUBLISHED,
        )
        axes.set(xlabel="number of grains", ylabel="list less every pair [%]")
        axes.legend()
        yield Picture(lambda: drawing, "Loss of force by de Paula's list, in percent of its force.")


def _distance_over_size_picture(results: PublishedResults) -> Iterator[Block]:
    columns = (
        ("start", "half_start_D", "start"),
        ("end", "half_end_D", "end"),
        ("minimum", "half_full_D", "full compression"),
    )
    with figure(width=WIDTH) as (drawing, axes):
        for k, (column, name, label) in enumerate(columns):
            x, y, errors = _positions_means_and_half_intervals(
                results, [f"direct {n}" for n in SIZES], SIZES, name
            )
            axes.errorbar(
                x,
                y,
                errors,
                color=COLOURS[k],
                linestyle=STYLES[k],
                marker="o",
                markersize=4,
                label=f"{label}, ours",
            )
            axes.plot(
                SIZES,
                published_value(f"half_mean_distance.{column}"),
                color=COLOURS[k],
                label="published" if k == 0 else None,
                **_PUBLISHED,
            )
        axes.set(xlabel="number of grains", ylabel="half mean distance [D]")
        axes.legend()
        yield Picture(lambda: drawing, "Half mean distance over the number of grains.")


def _polygon_fractions_over_size_picture(results: PublishedResults) -> Iterator[Block]:
    kinds = ("hexagons", "pentagons", "heptagons")
    ways = (("direct", "direct_sum", "every pair"), ("list", "verlet", "de Paula's list"))
    with figure(1, 2, width=WIDTH) as (drawing, both):
        for k, kind in enumerate(kinds):
            axes = both[0 if k == 0 else 1]
            for m, (way, section, label) in enumerate(ways):
                colour = COLOURS[2 * k + m]
                names = [f"{way} {n}" for n in LISTED]
                x, y, errors = _positions_means_and_half_intervals(results, names, LISTED, f"{kind}_full")
                axes.errorbar(
                    x,
                    y,
                    errors,
                    color=colour,
                    linestyle=STYLES[m],
                    marker="o",
                    markersize=4,
                    label=f"{kind}, {label}",
                )
                published = published_value(f"voronoi_shares_{section}.{kind}")
                axes.plot(LISTED, published, color=colour, **_PUBLISHED)
        for axes, limits in zip(both, ((0.8, 1.0), (0.0, 0.12)), strict=True):
            axes.set(xlabel="number of grains", ylim=limits)
            axes.legend(fontsize=8, loc="upper right")
        both[0].set_ylabel("fraction of polygons")
        yield Picture(lambda: drawing, "Fractions of polygons at full compression; crosses are published.")


def _force_curves_over_stroke_picture(results: PublishedResults) -> Iterator[Block]:
    courses = [np.array(results.figure_lists_by_start("starts", way)) for way in ("down", "up")]
    if any(item.ndim != 2 for item in courses):
        return
    stroke = np.linspace(0.0, 1.0, courses[0].shape[1])
    with figure(width=WIDTH) as (drawing, axes):
        for k, (trajectory, label) in enumerate(zip(courses, ("down", "up"), strict=True)):
            x = stroke if k == 0 else 1.0 - stroke
            axes.plot(x, trajectory.T, color=COLOURS[k], linewidth=0.6, alpha=0.6)
            axes.plot(x, trajectory.mean(axis=0), color=COLOURS[k], linestyle=STYLES[k], label=label)
        axes.set(xlabel="stroke of the piston, over its maximum", ylabel="piston force [N]")
        axes.legend()
        yield Picture(lambda: drawing, "The cycle from ten starts, and its mean (368 grains, 5.63 mm/s).")


_CURVES = (*((f"{a:g}", a, 0.005) for a in ASPECTS), ("0.75 (6:8)", 0.75, 0.008))


def _force_over_big_grain_fraction_picture(results: PublishedResults) -> Iterator[Block]:
    x_fine = np.linspace(0.0, 1.0, 101)
    with figure(width=WIDTH) as (drawing, axes):
        for k, (label, aspect, big) in enumerate(_CURVES):
            names = [mixture_series_name(aspect, r, big) for r in RATIOS]
            result = samples_under_common_protocol(names, "force", results)
            if result is not None:
                last = result[-1].values.mean()
                means = [item.values.mean() / last for item in result]
                errors = [(item.finding().half_width() or 0.0) / last for item in result]
                axes.errorbar(
                    RATIOS,
                    means,
                    errors,
                    color=COLOURS[k],
                    linestyle="none",
                    marker="o",
                    markersize=4,
                    label=f"a = {label}, ours",
                )
            a, slow, b, fast = (
                float(published_value(f"biexponential_fmax.{name}[{k}]"))
                for name in ("A", "lambda1", "B", "lambda2")
            )
            axes.plot(
                x_fine,
                a * np.exp(slow * x_fine) + b * np.exp(fast * x_fine),
                color=COLOURS[k],
                linestyle=STYLES[k],
                label=f"a = {label}, published fit",
            )
        axes.set(xlabel="fraction R of small grains", ylabel="F(R)/F(1)")
        axes.legend(fontsize=8)
        yield Picture(
            lambda: drawing,
            "Maximum force over the fraction of small grains, with the curves of the published fits.",
        )


def _order_over_big_grain_fraction_picture(results: PublishedResults) -> Iterator[Block]:
    with figure(1, 2, width=WIDTH, sharex=True) as (drawing, both):
        for k, (label, aspect, big) in enumerate(_CURVES):
            names = [mixture_series_name(aspect, r, big) for r in RATIOS]
            for axes, name in zip(both, ("hexagons_full", "psi6_full"), strict=True):
                x, y, errors = _positions_means_and_half_intervals(results, names, RATIOS, name)
                line = STYLES[k] if len(x) == len(RATIOS) else "none"
                axes.errorbar(
                    x,
                    y,
                    errors,
                    color=COLOURS[k],
                    linestyle=line,
                    marker="o",
                    markersize=3.5,
                    label=f"a = {label}",
                )
        for axes, label in zip(both, ("fraction of hexagons", "Ψ₆"), strict=True):
            axes.set(xlabel="R", ylabel=label, ylim=(0.0, 1.0))
        both[1].legend(fontsize=8)
        yield Picture(
            lambda: drawing,
            "Order at full compression over the fraction of small grains. De "
            "Paula draws these, and prints no numbers.",
        )


def _hysteresis_over_size_picture(results: PublishedResults) -> Iterator[Block]:
    names = [f"direct {n}" for n in SIZES]
    x, y, errors = _positions_means_and_half_intervals(results, names, SIZES, "hysteresis_D")
    if not len(x):
        return
    with figure(width=WIDTH) as (drawing, axes):
        axes.errorbar(x, y, errors, color=COLOURS[0], marker="o", markersize=4, label="ours")
        published = published_value("hysteresis_of_distance.hysteresis")
        axes.plot(SIZES, published, color=COLOURS[1], label="published", **_PUBLISHED)
        together_names = [f"direct {n}, source's friction" for n in SIZES]
        x, y, errors = _positions_means_and_half_intervals(results, together_names, SIZES, "hysteresis_D")
        if len(x):
            axes.errorbar(
                x,
                y,
                errors,
                color=COLOURS[2],
                linestyle="none",
                marker="s",
                markersize=4,
                label="de Paula's friction, ours",
            )
        axes.set(xlabel="number of grains", ylabel="hysteresis of the half mean distance [D]")
        axes.legend(fontsize=8)
        yield Picture(lambda: drawing, "Half mean distance at the start minus the end of the cycle.")


def _distance_curves_by_speed_picture(results: PublishedResults) -> Iterator[Block]:
    names = {"8.33": "direct 368"} | {f"{v:g}": f"speed {v:g}" for v in SPEEDS[2:]}
    courses = {
        speed: np.array(results.figure_lists_by_start(name, "half_course_D")) for speed, name in names.items()
    }
    if any(item.ndim != 2 for item in courses.values()):
        return
    with figure(width=WIDTH) as (drawing, axes):
        for k, (speed, trajectory) in enumerate(courses.items()):
            mean = trajectory.mean(axis=0)
            axes.plot(
                np.linspace(0.0, 3.0, len(mean)),
                mean,
                color=COLOURS[k],
                linestyle=STYLES[k % len(STYLES)],
                label=f"{speed} mm/s",
            )
        axes.set(xlabel="time [T]", ylabel="half mean distance [D]")
        axes.legend(fontsize=8)
        yield Picture(lambda: drawing, "Half mean distance over the cycle for several speeds (368 grains).")


def _grain_forces_over_big_grain_fraction_picture(results: PublishedResults) -> Iterator[Block]:
    names = [mixture_series_name(0.6, r) for r in RATIOS]
    with figure(1, 2, width=WIDTH, sharex=True) as (drawing, both):
        for k, kind in enumerate(("big", "small")):
            x, y, errors = _positions_means_and_half_intervals(results, names, RATIOS, f"{kind}_compression")
            both[0].errorbar(
                x,
                y,
                errors,
                color=COLOURS[k],
                linestyle="none",
                marker="os"[k],
                markersize=4,
                label=f"{kind} grains",
            )
        x, y, errors = _positions_means_and_half_intervals(results, names, RATIOS, "fluctuation")
        both[1].errorbar(x, y, errors, color=COLOURS[2], linestyle="none", marker="o", markersize=4)
        both[0].set(xlabel="R", ylabel="compressive force on a grain [N]", ylim=(0.0, None))
        both[1].set(xlabel="R", ylabel="relative fluctuation", ylim=(0.0, None))
        both[0].legend(fontsize=8)
        yield Picture(
            lambda: drawing,
            "Mean compressive force (sum of magnitudes) on the grains of each "
            "species at full compression (a = 0.6), and the mean fluctuation of the "
            "resulting force [D, eq. 4.35].",
        )


def _pooled_force_distributions_picture(results: PublishedResults) -> Iterator[Block]:
    """Draw distributions pooled over the starts, over the maximum force, as in the thesis."""
    beds = {f"R = {r:g}": mixture_series_name(0.6, r) for r in (0.0, 0.1, 0.5, 0.9, 1.0)}
    result = {label: np.array(results.figure_lists_by_start(name, "modes")) for label, name in beds.items()}
    known = {label: item.sum(axis=0) for label, item in result.items() if item.ndim == 2}
    if not known:
        return
    with figure(1, len(known), width=WIDTH, height=2.2, sharey=True) as (drawing, row):
        for k, (label, counts) in enumerate(known.items()):
            axes = np.atleast_1d(row)[k]
            edges = np.linspace(0.0, 1.0, len(counts) + 1)
            density = counts / counts.sum() / np.diff(edges)
            axes.stairs(density, edges, fill=True, color=COLOURS[k])
            sample = results.figure_sample(beds[label], "dip_p")
            p = "" if sample is None else f", p {sample.values.max():.2g}"
            axes.set_title(label + p, fontsize=8)
            axes.set_xlabel("F/F_max", fontsize=8)
        np.atleast_1d(row)[0].set_ylabel("density")
        yield Picture(
            lambda: drawing,
            "Compressive force of the grains at full compression over its maximum, both species together (a "
            "= 0.6), and the maximum p of the dip test for one mode.",
        )


def _damper_law_over_drag_picture(results: PublishedResults) -> Iterator[Block]:
    names = [damper_series_name(MASSES[1], g) for g in GAMMAS]
    x, ratio, errors = _positions_means_and_half_intervals(results, names, GAMMAS, "alpha_over_omega")
    if not len(x):
        return
    with figure(1, 2, width=WIDTH) as (drawing, both):
        both[0].errorbar(x, ratio, errors, color=COLOURS[0], marker="o", markersize=4, label="ours")
        printed = float(published_value("damper_implied.alpha_over_omega"))
        both[0].axhline(printed, color=COLOURS[1], linestyle="--", label="published")
        for k, (figure_name, label) in enumerate(
            (("free_misfit", "Van der Pol-like"), ("free_linear_misfit", "linear"))
        ):
            x, y, errors = _positions_means_and_half_intervals(results, names, GAMMAS, figure_name)
            both[1].errorbar(
                x, 100.0 * y, 100.0 * errors, color=COLOURS[k], marker="os"[k], markersize=4, label=label
            )
        both[0].set(xlabel="drag of a grain [kg/s]", ylabel="alpha/omega", ylim=(0.0, None))
        both[1].set(
            xlabel="drag of a grain [kg/s]", ylabel="residual of the oscillation [%]", ylim=(0.0, None)
        )
        both[0].legend(fontsize=8)
        both[1].legend(fontsize=8)
        yield Picture(
            lambda: drawing,
            "De Paula's law fitted to the oscillation after a lift of 0.2 D, 6.24 kg: its alpha/omega in de "
            "Paula's scaling, and the residuals of it and of the linear law with shift and scale free.",
        )


def _pressed_bed_order_picture(results: PublishedResults) -> Iterator[Block]:
    ratios = (0.0, 0.1, 0.5, 0.9, 1.0)
    with figure(width=WIDTH) as (drawing, axes):
        drawn = 0
        for k, scatter in enumerate(("", ", moments ± 0.1")):
            names = [f"pressed, R = {r:g}{scatter}" for r in ratios]
            x, y, errors = _positions_means_and_half_intervals(results, names, ratios, "hexagons_pressed")
            drawn += len(x)
            axes.errorbar(
                x,
                y,
                errors,
                color=COLOURS[k],
                marker="os"[k],
                markersize=4,
                linestyle=STYLES[k],
                label="scatter of 10 %" if scatter else "equal moments",
            )
        if not drawn:
            return
        axes.set(xlabel="R", ylabel="fraction of hexagons at 110 N", ylim=(0.0, 1.0))
        axes.legend(fontsize=8)
        yield Picture(
            lambda: drawing,
            "Mixtures of a = 0.6 pressed up to 110 N as in the experiment, whose numbers de Paula does not "
            "print.",
        )


def _drag_and_gravity_variants_picture(results: PublishedResults) -> Iterator[Block]:
    beds = {"dry": [mixture_series_name(0.6, r) for r in VARIANT_RATIOS]}
    beds |= {name: [f"{name}, R = {r:g}" for r in VARIANT_RATIOS] for name in VARIANTS}
    if (
        samples_under_common_protocol([item for some in beds.values() for item in some], "force", results)
        is None
    ):
        return
    with figure(1, 2, width=WIDTH) as (drawing, both):
        for k, (label, names) in enumerate(beds.items()):
            for axes, name in zip(both, ("force", "hexagons_full"), strict=True):
                x, y, errors = _positions_means_and_half_intervals(results, names, VARIANT_RATIOS, name)
                scale = y[-1] if name == "force" else 1.0
                axes.errorbar(
                    x,
                    y / scale,
                    errors / scale,
                    color=COLOURS[k],
                    linestyle=STYLES[k],
                    marker="o",
                    markersize=3.5,
                    label=label,
                )
        both[0].set(xlabel="R", ylabel="F(R)/F(1)")
        both[1].set(xlabel="R", ylabel="fraction of hexagons", ylim=(0.0, 1.0))
        both[0].legend(fontsize=8)
        yield Picture(lambda: drawing, "With drag, and without gravity (a = 0.6).")


_PICTURES: dict[str, Sequence[Callable[[PublishedResults], Iterator[Block]]]] = {
    "Independence of start and speed": (_force_curves_over_stroke_picture,),
    "Force on the piston": (_force_over_size_picture, _list_force_loss_picture),
    "Mean distance": (
        _distance_over_size_picture,
        _hysteresis_over_size_picture,
        _distance_curves_by_speed_picture,
    ),
    "Polygons": (_polygon_fractions_over_size_picture,),
    "Mixtures": (
        _force_over_big_grain_fraction_picture,
        _order_over_big_grain_fraction_picture,
        _pooled_force_distributions_picture,
        _grain_forces_over_big_grain_fraction_picture,
        _drag_and_gravity_variants_picture,
    ),
    "Damper": (_damper_law_over_drag_picture,),
    "Experiment": (_pressed_bed_order_picture,),
}
