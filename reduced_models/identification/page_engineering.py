"""The first part of a report: what an engineer asks of a damper."""

from __future__ import annotations

import math
from collections.abc import Mapping

from granular.shared.html import Page, number
from reduced_models.identification.data import Figure, IdentificationData
from reduced_models.identification.engineering import (
    DAMPING_RATIO,
    Quantity,
    at_amplitudes,
    swing_words,
    units_of,
)
from reduced_models.identification.words import sentence

_NONE = 5e-3  # per cent of a change that is none
_BY_RATIO = ("ζ", "δ", "Q", "F")  # signs of what is as uncertain as the damping ratio


def engineering_words(found: IdentificationData) -> str:
    """The answer in one paragraph."""
    known = {one.name: _as_sure(one, found.figures) for one in found.engineering}
    if not known:
        return found.verdict
    what = "The angle" if found.record.angle else "The piston"
    rest, frequency = (known[name].text for name in ("level of rest", "natural frequency"))
    words = f"{what} comes to rest at {rest}, and small swings about that have {frequency}"
    words += f"{_damping_words(known)}."
    if found.mass is not None and "damping" in known:
        stiffness, damping = known["stiffness"].text, known["damping"].text
        words += (
            f" A mass of {found.mass:.4g} kg on a spring of {stiffness} with a dashpot of "
            f"{damping} does the same."
        )
    best = found.comparison.rows[0]
    words = f"{words} {_best_words(best.name, best.error)}{_amplitude_words(found)}"
    return words if found.falls is None else f"{found.falls.verdict} {words}"


def _damping_words(known: Mapping[str, Quantity]) -> str:
    """The damping, behind the frequency of small swings."""
    if DAMPING_RATIO in known:
        words = f" and a damping ratio of {known[DAMPING_RATIO].text}"
        if "logarithmic decrement" in known:
            kept = math.exp(-known["logarithmic decrement"].value)
            words += f": each swing is {100 * kept:.3g} % as wide as the one before"
        return words
    ratios = [
        f"{one.text}{name.removeprefix(DAMPING_RATIO)}"
        for name, one in known.items()
        if name.startswith(DAMPING_RATIO)
    ]
    words = f". The damping ratio is {' and '.join(ratios)}"
    return words + (f"; friction is {known['friction'].text}" if "friction" in known else "")


def _as_sure(one: Quantity, figures: Mapping[str, Figure]) -> Quantity:
    """A figure whose interval is no narrower than its step error and scatter."""
    errors = [_error(one, figures, name) for name in ("step_error", "seed_spread")]
    wide = max([0.5 * (one.high - one.low), *(float(each) for each in errors if each)])
    return one._replace(low=one.value - wide, high=one.value + wide)


def _best_words(name: str, error: float) -> str:
    if math.isinf(error):
        return "No law predicts what it has not seen."
    return (
        f"The best law of the record, {name}, predicts what it has not seen to "
        f"{100 * error:.2g} % of the swing."
    )


def _amplitude_words(found: IdentificationData) -> str:
    """How frequency and damping change from a tenth of the greatest amplitude up to it."""
    cycles = at_amplitudes(found.shown, found.record)
    if len(cycles) < 2:
        return ""
    wide, narrow = cycles[0], cycles[-1]
    units = units_of(found.record.angle, found.mass)
    frequency = 100.0 * (wide.frequency / narrow.frequency - 1.0)
    damping = 100.0 * (wide.damping / narrow.damping - 1.0) if narrow.damping else math.inf
    return (
        f" At an amplitude of {units.scale * wide.amplitude:.3g} {units.length} the frequency is "
        f"{_changed(frequency)} and the damping {_changed(damping)} than at "
        f"{units.scale * narrow.amplitude:.3g} {units.length}."
    )


def _changed(per_cent: float) -> str:
    if not math.isfinite(per_cent):
        return "other"
    if abs(per_cent) < _NONE:
        return "no other"
    return f"{abs(per_cent):.2g} % {'higher' if per_cent > 0.0 else 'lower'}"


def add_engineering(page: Page, found: IdentificationData) -> None:
    """The table of figures, and that of what changes with amplitude."""
    figures = found.engineering
    if not figures:
        page.note("The law has no level of rest near the record, so no small swing can be told.")
        return
    page.section("Frequency, damping, stiffness")
    checked = any(
        one.step_error is not None or one.seed_spread is not None for one in found.figures.values()
    )
    rows = []
    for one in figures:
        row = [one.name, one.symbol, one.text, one.interval]
        if checked:
            row += [_error(one, found.figures, name) for name in ("step_error", "seed_spread")]
        rows.append(row)
    header = ["figure", "sign", "value", f"{100 * found.shown.confidence:g} % interval"]
    page.table([*header, "step error", "scatter"] if checked else header, rows)
    page.text(_explained(found))
    if checked:
        page.text(
            "The step error is what twice the time step changes in the same fit (half of it, and "
            "the order of the method, where twice is too coarse), which is more than the error of "
            "the step itself; the scatter is the standard deviation over random starts of the bed. "
            "Where the step error is not smaller than the scatter, it is the scatter that it "
            "shows: another step lets the bed pack in another way."
        )
    if found.averaging is not None:
        page.text(f"{sentence(found.averaging.text)}.")
    _add_amplitudes(page, found)


def _explained(found: IdentificationData) -> str:
    swing = swing_words(found.shown)
    words = f"Of the {swing} about rest, from the fit of {found.figures_law}. "
    if any(one.name.startswith(f"{DAMPING_RATIO} at ") for one in found.engineering):
        words += (
            "A damping ratio at an amplitude is the energy that a harmonic cycle of it loses, over "
            "4π times that of its swing; friction is the constant force that, beside a dashpot, "
            "loses as much at both. "
        )
    if found.record.angle:
        return words + "Stiffness and damping are per unit of the moment of inertia."
    if found.mass is None:
        return words + (
            "Stiffness and damping are per kilogram of what moves; --mass gives them in N/m and "
            "N s/m."
        )
    return words + f"Stiffness and damping are those of the mass, {found.mass:.6g} kg."


def _error(one: Quantity, figures: Mapping[str, Figure], which: str) -> str:
    """What a check says of a figure that follows from rest, period and damping ratio."""
    known = {name: getattr(figure, which) for name, figure in figures.items()}
    if any(known.get(name) is None for name in ("height", "period", "damping_ratio")):
        return ""
    if one.name == "level of rest":
        rest = figures["height"]
        return number(abs(one.value * known["height"] / rest.value), 2) if rest.value else ""
    period = known["period"] / figures["period"].value
    ratio = known["damping_ratio"] / abs(figures["damping_ratio"].value or math.inf)
    if one.symbol in _BY_RATIO:
        share = ratio
    elif one.name == "stiffness":
        share = 2.0 * period
    else:
        share = math.hypot(period, ratio) if one.name == "damping" else period
    return number(abs(one.value) * share, 2)


def _add_amplitudes(page: Page, found: IdentificationData) -> None:
    cycles = at_amplitudes(found.shown, found.record)
    if len(cycles) < 2:
        return
    units = units_of(found.record.angle, found.mass)
    page.text("How they change with amplitude, in harmonic cycles about rest:")
    page.table(
        (f"amplitude [{units.length}]", "frequency [Hz]", "damping ratio [%]",
         f"stiffness [{units.stiffness}]", f"damping [{units.damping}]"),
        [
            (number(units.scale * one.amplitude, 3), number(one.frequency / (2.0 * math.pi), 5),
             number(100.0 * one.damping_ratio, 4), number(units.inertia * one.stiffness, 5),
             number(units.inertia * one.damping, 4))
            for one in cycles
        ],
    )  # fmt: skip
