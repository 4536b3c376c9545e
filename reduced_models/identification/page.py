"""The report of an identification: one HTML file."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence

import numpy as np

from granular.shared.html import Page, number
from granular.shared.messages import times
from granular.shared.plotting import GREY, READABLE, figure, line_look, plain_label
from granular.shared.version import versions
from reduced_models.falls.data import Falls
from reduced_models.identification.comparison_table import Comparison
from reduced_models.identification.data import IdentificationData
from reduced_models.identification.engineering import between, decimals, fixed
from reduced_models.identification.page_engineering import add_engineering, engineering_words
from reduced_models.identification.page_equation import add_equations
from reduced_models.identification.page_record import (
    add_fits,
    add_lift,
    add_portrait,
    add_record,
    thinned,
)
from reduced_models.identification.page_run import add_run
from reduced_models.identification.words import direction_words, sentence
from reduced_models.laws.printing import symbol
from reduced_models.models.model import ReducedModel

_MOST_LINES = 3  # of laws over a fall; more hide each other


def identification_page(found: IdentificationData) -> Page:
    """The report as a page: the answer in an engineer's words, the record, then the rest."""
    name = "a record" if found.run is None else f"scene {found.run.scene.name!r}"
    page = Page(f"The equation of {name}", engineering_words(found))
    add_engineering(page, found)
    add_record(page, found)
    if found.falls is not None:
        add_falls(page, found.falls)
    page.section("Which law")
    page.text(found.verdict)
    for words in found.advice:
        page.note(f"{sentence(words)}.")
    for note in found.notes:
        page.note(f"{sentence(note)}.")
    _table(page, found.comparison)
    _left_out(page, found)
    if found.lift is not None:
        add_lift(page, found)
    _residuals(page, found)
    _equations(page, found)
    add_fits(page, found)
    add_portrait(page, found)
    if found.run is not None:
        add_run(page, found.run)
    _times(page, found)
    page.footer(_made())
    return page


def comparison_page(table: Comparison) -> Page:
    """A comparison of laws as a page."""
    page = Page("Laws compared", table.verdict)
    _table(page, table)
    for row in table.rows:
        for model in row.models[:1]:
            _equation(page, model, " (first)" if row is table.rows[0] else "")
    page.footer(_made())
    return page


def _made() -> str:
    """When, and with which versions of what made the fits."""
    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    found = versions(("scipy", "sympy", "jax", "jaxlib", "pandas", "matplotlib"))
    return f"Made on {now} with " + ", ".join(f"{k} {v}" for k, v in found.items())


def _table(page: Page, table: Comparison) -> None:
    page.section("The laws compared")
    header, cells = table.header, table.cells()
    if not any(row.blow_ups for row in table.rows):
        header, cells = header[:-1], [row[:-1] for row in cells]
    page.table(header, cells)
    page.text(
        "Errors are root mean squares of record minus simulation over what the law has not seen, "
        f"in rms swings; the baseline, a piston at rest, has {100 * table.at_rest:.3g} %, and the "
        f"noise is {100 * table.noise:.2g} %. AIC and BIC, of the fits to whole records, count "
        "from the least."
    )
    with figure(height=table.drawing_height, size=READABLE) as (drawing, axes):
        table.plot(axes)
        page.figure(drawing, "Held-out errors of the laws.")


def _left_out(page: Page, found: IdentificationData) -> None:
    if found.left_out:
        page.text("Laws that cannot win were not fitted:")
        page.listing([f"{sentence(words)}." for words in found.left_out])


def _residuals(page: Page, found: IdentificationData) -> None:
    """What each law leaves over, and whether that is noise."""
    if not found.residuals:
        return
    unit, scale = ("°", 180.0 / math.pi) if found.record.angle else ("µm", 1e6)
    rows = [
        (
            name, one.verdict, f"{number(scale * one.rms, 3)} {unit}", times(one.swing),
            times(one.double), _probability(one.whiteness), _probability(one.signs),
        )
        for name, one in found.residuals.items()
    ]  # fmt: skip
    page.section("What the laws leave over")
    page.table(("law", "so it is", "rms", "at f", "at 2f", "white", "signs"), rows)
    page.text(
        "White and signs: probabilities that white noise is correlated as much (Ljung and Box), "
        "and that its signs change as seldom (Wald and Wolfowitz). At f and at 2f: power about the "
        "swing's frequency, and about twice it, over that of the frequencies beside them; about 1 "
        "where a law leaves no structure. A law that leaves structure is wrong, however small its "
        "error."
    )


def _probability(value: float) -> str:
    return "< 0.001" if value < 1e-3 else number(value, 2)


def _equations(page: Page, found: IdentificationData) -> None:
    for model in found.models:
        _equation(page, model, " (best)" if model is found.best else "")


def _equation(page: Page, model: ReducedModel, remark: str) -> None:
    page.section(f"{model.law.name}{remark}")
    add_equations(page, model)
    meaning = f"z is the {model.coordinate} in {'radians' if model.angle else 'metres'}"
    if model.law.mapped:
        how = "fitted" if model.map.fitted else "given, not fitted"
        height = model.map_text(max(5, model.printed_digits))
        meaning = f"{height} ({how}), a pure number; the law's time unit is 1 s"
    page.text(f"Source of the law: {model.law.source or 'own'}; t is in seconds, {meaning}.")
    page.table(
        ("parameter", "value", "unit", f"{100 * model.confidence:g} % interval"),
        _parameter_rows(model),
    )
    for direction in model.undetermined:
        page.note(f"{sentence(direction_words(direction))}.")
    for note in model.notes:
        page.note(f"{sentence(note)}.")
    quality = model.quality
    words = (
        f"Residual {_small(quality.residual, model.angle)}, {100 * quality.relative:.3g} % of "
        f"the rms swing, over {quality.samples} samples. {quality.converged} of "
        f"{quality.starts} random starts led to this fit."
    )
    if quality.holdout is not None:
        words += (
            f" Fitted to the first {quality.holdout_from:.3g} s only, it predicts the rest to "
            f"{100 * quality.holdout:.3g} % of the rms swing."
        )
    if quality.holdout_at_rest is not None:
        words += (
            f" A piston that stays at the level of rest would score "
            f"{100 * quality.holdout_at_rest:.3g} % there; "
            "only a smaller error speaks for the law."
        )
    page.text(words)


def _small(size: float, angle: bool) -> str:
    if angle:
        return f"{180.0 / math.pi * size:.3g} degrees"
    return f"{1e6 * size:.3g} micrometres"


def _parameter_rows(model: ReducedModel) -> list[Sequence[str]]:
    values = dict(model.parameters)
    if model.map.fitted:
        values |= {"shift": model.map.shift, "scale": model.map.scale}
    rows: list[Sequence[str]] = []
    for name, value in values.items():
        low, high = model.intervals[name]
        size = math.floor(math.log10(abs(value))) if value else 0
        # As many digits as the interval is worth, and no fewer than the equation has.
        places = max(decimals(value, low, high), model.printed_digits - 1 - size)
        rows.append(
            (symbol(name), fixed(value, places), model.unit_of(name),
             interval_text(low, high, value, places))
        )  # fmt: skip
    return rows


def interval_text(low: float, high: float, value: float, places: int) -> str:
    """An interval for people; one that is much wider than the value is called open."""
    if high - low > 20.0 * abs(value):
        return "open"
    return between(low, high, places)


def _times(page: Page, found: IdentificationData) -> None:
    page.section("What it took")
    rows = [(name, f"{seconds:.2f}") for name, seconds in found.seconds.items()]
    page.table(("part", "seconds"), rows)


def add_falls(page: Page, falls: Falls) -> None:
    """The law of the fall, what it says of falls that it has not seen, and the others beside it."""
    page.section("The whole fall")
    best = falls.best.model
    if best is not None:
        add_equations(page, best)
    page.table(falls.header, falls.cells())
    page.text(
        "Each law was fitted to the scene's own fall, and predicts the others from the height that "
        "the piston is let go at, without anything else of them. Errors are root mean squares over "
        "the height of the drop. How far a bed from another random start falls otherwise is what "
        "no law can tell."
    )
    _drawn_fall(page, falls)
    with figure(height=4.4, size=READABLE) as (drawing, axes):
        falls.plot(axes)
        page.figure(drawing, "Errors of the laws over the height that the piston fell from.")


def _drawn_fall(page: Page, falls: Falls) -> None:
    """The fall from farthest away, and what the best laws predict of it."""
    far = max(falls.unseen, key=lambda one: float(one.height[0]))
    time = far.time - far.time[0]
    with figure(height=4.4, size=READABLE) as (drawing, axes):
        axes.plot(*thinned(time, 1e3 * far.height), color=GREY, linewidth=3.0, label="simulated")
        sound = [row for row in falls.rows if row.model is not None and np.isfinite(row.median)]
        for k, row in enumerate(sound[:_MOST_LINES]):
            assert row.model is not None
            motion = row.model.simulate(far.time, z0=float(far.height[0]), v0=0.0)
            axes.plot(
                *thinned(time, 1e3 * motion.height), linewidth=1.2, label=plain_label(row.name),
                **line_look(k),
            )  # fmt: skip
        axes.set_xlabel("time [s]")
        axes.set_ylabel("height [mm]")
        axes.legend(loc="upper right")
        page.figure(drawing, "A fall from farther up, and what the best laws predict of it.")
