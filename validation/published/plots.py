"""Pictures of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from granular.shared.html import Page
from granular.shared.plotting import COLOURS, STYLES, figure
from validation.published.measures import together
from validation.published.plan import (
    ASPECTS,
    LARGE,
    LISTED,
    RATIOS,
    SIZES,
    VARIANT_RATIOS,
    VARIANTS,
    mixture_name,
)
from validation.published.results import Results
from validation.published.values import published_value

WIDTH = 6.4
_PUBLISHED = {"marker": "x", "linestyle": "none", "markersize": 7.0, "markeredgewidth": 1.6}


def add(page: Page, section: str, results: Results) -> None:
    """Add the pictures of a section of the report."""
    for draw in _PICTURES.get(section, ()):
        draw(page, results)


def _points(
    results: Results, names: Sequence[str], places: Sequence[float], name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, means and deviations of the series that were run, each under its best protocol."""
    found = [
        (place, sample.finding())
        for place, series in zip(places, names, strict=True)
        if (sample := results.sample(series, name)) is not None
    ]
    columns = np.array([(place, one.value, one.spread or 0.0) for place, one in found])
    x, y, errors = columns.reshape(-1, 3).T
    return x, y, errors


def _force_over_size(page: Page, results: Results) -> None:
    sizes = (*LISTED, *LARGE)
    with figure(width=WIDTH) as (drawing, axes):
        for k, (way, section, label) in enumerate((
            ("direct", "piston_force_direct_sum", "every pair"),
            ("list", "piston_force_verlet", "source's list"),
        )):  # fmt: skip
            x, y, errors = _points(results, [f"{way} {n}" for n in sizes], sizes, "force")
            axes.errorbar(x, y, errors, color=COLOURS[k], linestyle=STYLES[k], marker="o",
                          markersize=4, label=f"{label}, ours")  # fmt: skip
            axes.plot(sizes, published_value(f"{section}.mean"), color=COLOURS[k],
                      label=f"{label}, published", **_PUBLISHED)  # fmt: skip
        axes.set(xlabel="number of grains", ylabel="piston force [N]")
        axes.legend()
        page.figure(drawing, "Piston force at full compression over the number of grains.")


def _losses(page: Page, results: Results) -> None:
    from validation.published.measures import percent_difference

    sizes = (*LISTED, *LARGE)
    found = [(n, one) for n in sizes if (one := percent_difference(n)(results)) is not None]
    if not found:
        return
    with figure(width=WIDTH) as (drawing, axes):
        axes.errorbar([n for n, _ in found], [one.value for _, one in found],
                      [one.spread or 0.0 for _, one in found], color=COLOURS[0], marker="o",
                      markersize=4, label="ours")  # fmt: skip
        axes.plot(sizes, published_value("piston_force_verlet.percent_difference"),
                  color=COLOURS[1], label="published", **_PUBLISHED)  # fmt: skip
        axes.set(xlabel="number of grains", ylabel="list less every pair [%]")
        axes.legend()
        page.figure(drawing, "What the source's list loses, in percent of its own force.")


def _distance_over_size(page: Page, results: Results) -> None:
    columns = (
        ("start", "half_start_D", "start"),
        ("end", "half_end_D", "end"),
        ("minimum", "half_full_D", "full compression"),
    )
    with figure(width=WIDTH) as (drawing, axes):
        for k, (column, name, label) in enumerate(columns):
            x, y, errors = _points(results, [f"direct {n}" for n in SIZES], SIZES, name)
            axes.errorbar(x, y, errors, color=COLOURS[k], linestyle=STYLES[k], marker="o",
                          markersize=4, label=f"{label}, ours")  # fmt: skip
            axes.plot(SIZES, published_value(f"half_mean_distance.{column}"), color=COLOURS[k],
                      label="published" if k == 0 else None, **_PUBLISHED)  # fmt: skip
        axes.set(xlabel="number of grains", ylabel="half mean distance [D]")
        axes.legend()
        page.figure(drawing, "Half mean distance over the number of grains.")


def _shares_over_size(page: Page, results: Results) -> None:
    kinds = ("hexagons", "pentagons", "heptagons")
    ways = (("direct", "direct_sum", "every pair"), ("list", "verlet", "source's list"))
    with figure(1, 2, width=WIDTH) as (drawing, both):
        for k, kind in enumerate(kinds):
            axes = both[0 if k == 0 else 1]
            for m, (way, section, label) in enumerate(ways):
                colour = COLOURS[2 * k + m]
                names = [f"{way} {n}" for n in LISTED]
                x, y, errors = _points(results, names, LISTED, f"{kind}_full")
                axes.errorbar(x, y, errors, color=colour, linestyle=STYLES[m], marker="o",
                              markersize=4, label=f"{kind}, {label}")  # fmt: skip
                published = published_value(f"voronoi_shares_{section}.{kind}")
                axes.plot(LISTED, published, color=colour, **_PUBLISHED)
        for axes, limits in zip(both, ((0.8, 1.0), (0.0, 0.12)), strict=True):
            axes.set(xlabel="number of grains", ylim=limits)
            axes.legend(fontsize=8, loc="upper right")
        both[0].set_ylabel("share of polygons")
        page.figure(drawing, "Shares of polygons at full compression; crosses are published.")


def _course(page: Page, results: Results) -> None:
    courses = [np.array(results.lists("starts", way)) for way in ("down", "up")]
    if any(one.ndim != 2 for one in courses):
        return
    stroke = np.linspace(0.0, 1.0, courses[0].shape[1])
    with figure(width=WIDTH) as (drawing, axes):
        for k, (course, label) in enumerate(zip(courses, ("down", "up"), strict=True)):
            x = stroke if k == 0 else 1.0 - stroke
            axes.plot(x, course.T, color=COLOURS[k], linewidth=0.6, alpha=0.6)
            axes.plot(x, course.mean(axis=0), color=COLOURS[k], linestyle=STYLES[k], label=label)
        axes.set(xlabel="stroke of the piston, over its greatest", ylabel="piston force [N]")
        axes.legend()
        page.figure(drawing, "The cycle from ten starts, and its mean (368 grains, 5.63 mm/s).")


_CURVES = (*((f"{a:g}", a, 0.005) for a in ASPECTS), ("0.75 (6:8)", 0.75, 0.008))


def _force_over_ratio(page: Page, results: Results) -> None:
    x_fine = np.linspace(0.0, 1.0, 101)
    with figure(width=WIDTH) as (drawing, axes):
        for k, (label, aspect, big) in enumerate(_CURVES):
            names = [mixture_name(aspect, r, big) for r in RATIOS]
            found = together(names, "force", results)
            if found is not None:
                last = found[-1].values.mean()
                means = [one.values.mean() / last for one in found]
                errors = [(one.finding().spread or 0.0) / last for one in found]
                axes.errorbar(RATIOS, means, errors, color=COLOURS[k], linestyle="none",
                              marker="o", markersize=4, label=f"a = {label}, ours")  # fmt: skip
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
        axes.set(xlabel="share R of small grains", ylabel="F(R)/F(1)")
        axes.legend(fontsize=8)
        page.figure(drawing, "Greatest force over the share of small grains, with the curves of "
                    "the published fits.")  # fmt: skip


def _order_over_ratio(page: Page, results: Results) -> None:
    with figure(1, 2, width=WIDTH, sharex=True) as (drawing, both):
        for k, (label, aspect, big) in enumerate(_CURVES):
            names = [mixture_name(aspect, r, big) for r in RATIOS]
            for axes, name in zip(both, ("hexagons_full", "psi6_full"), strict=True):
                x, y, errors = _points(results, names, RATIOS, name)
                line = STYLES[k] if len(x) == len(RATIOS) else "none"
                axes.errorbar(x, y, errors, color=COLOURS[k], linestyle=line, marker="o",
                              markersize=3.5, label=f"a = {label}")  # fmt: skip
        for axes, label in zip(both, ("share of hexagons", "Ψ₆"), strict=True):
            axes.set(xlabel="R", ylabel=label, ylim=(0.0, 1.0))
        both[1].legend(fontsize=8)
        page.figure(drawing, "Order at full compression over the share of small grains. The source "
                    "draws these, and prints no numbers.")  # fmt: skip


def _grain_forces(page: Page, results: Results) -> None:
    names = [mixture_name(0.6, r) for r in RATIOS]
    with figure(1, 2, width=WIDTH, sharex=True) as (drawing, both):
        for k, kind in enumerate(("big", "small")):
            x, y, errors = _points(results, names, RATIOS, f"{kind}_force")
            both[0].errorbar(x, 1e3 * y, 1e3 * errors, color=COLOURS[k], linestyle="none",
                             marker="os"[k], markersize=4, label=f"{kind} grains")  # fmt: skip
        x, y, errors = _points(results, names, RATIOS, "fluctuation")
        both[1].errorbar(x, y, errors, color=COLOURS[2], linestyle="none", marker="o",
                         markersize=4)  # fmt: skip
        both[0].set(xlabel="R", ylabel="magnetic force on a grain [mN]")
        both[1].set(xlabel="R", ylabel="relative fluctuation", ylim=(0.0, None))
        both[0].legend(fontsize=8)
        page.figure(drawing, "Mean magnetic force on the grains of each species at full "
                    "compression (a = 0.6), and its mean fluctuation [D, eq. 4.35].")  # fmt: skip


def _variants(page: Page, results: Results) -> None:
    beds = {"dry": [mixture_name(0.6, r) for r in VARIANT_RATIOS]}
    beds |= {name: [f"{name}, R = {r:g}" for r in VARIANT_RATIOS] for name in VARIANTS}
    if together([one for some in beds.values() for one in some], "force", results) is None:
        return
    with figure(1, 2, width=WIDTH) as (drawing, both):
        for k, (label, names) in enumerate(beds.items()):
            for axes, name in zip(both, ("force", "hexagons_full"), strict=True):
                x, y, errors = _points(results, names, VARIANT_RATIOS, name)
                scale = y[-1] if name == "force" else 1.0
                axes.errorbar(x, y / scale, errors / scale, color=COLOURS[k],
                              linestyle=STYLES[k], marker="o", markersize=3.5,
                              label=label)  # fmt: skip
        both[0].set(xlabel="R", ylabel="F(R)/F(1)")
        both[1].set(xlabel="R", ylabel="share of hexagons", ylim=(0.0, 1.0))
        both[0].legend(fontsize=8)
        page.figure(drawing, "With drag, and without gravity (a = 0.6).")


_PICTURES: dict[str, Sequence[Callable[[Page, Results], None]]] = {
    "Independence of start and speed": (_course,),
    "Force on the piston": (_force_over_size, _losses),
    "Mean distance": (_distance_over_size,),
    "Polygons": (_shares_over_size,),
    "Mixtures": (_force_over_ratio, _order_over_ratio, _grain_forces, _variants),
}
