"""What the results say, for the console and for the guide."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from validation.defects import beds
from validation.defects.beds import GROUPS, Bed, set_temperature
from validation.defects.candidates import CANDIDATES, ORDERS
from validation.defects.carried import PARTS, Carried, carried
from validation.defects.collapse import LEAST_SKILL, Figure
from validation.defects.forces import FRAMES, KINDS, QUIET, Interval, before_and_after, interval
from validation.defects.temperature import AGITATED, judged_candidates, orders_all

Row = Mapping[str, Any]

THERMOMETERS = ("kinetic", "local kinetic", "configurational", "piston")
_NAMES = {"defects": "defects", "psi6": "ψ₆", "lindemann": "Lindemann"}


def temperature_text(rows: Sequence[Row]) -> str:
    """A table of skills, and what they decide."""
    every, moving = (judged_candidates(rows, one) for one in (GROUPS, AGITATED))
    later = judged_candidates([row for row in rows if _is_later(row)], AGITATED)
    heads = [f"{_NAMES[order]}" for order in ORDERS]
    lines = [
        f"| candidate | {' | '.join(heads)} | {' | '.join(f'{one}, agitated' for one in heads)} |",
        f"|---|{'---|' * (2 * len(heads))}",
    ]
    for name, words in CANDIDATES.items():
        cells = [_interval(judged[name, order].skill)
                 for judged in (every, moving) for order in ORDERS]  # fmt: skip
        lines.append(f"| {words} | {' | '.join(cells)} |")
    chance = max(one.skill.chance for judged in (every, moving) for one in judged.values())
    lines += [
        "",
        "Skill of a rising curve in ranks, fitted to the other ways of driving, for the way it has "
        "not seen: 1 if all lie on",
        f"one curve, 0 if it tells no more than the mean. 95 % of shuffled data stay below "
        f"{chance:.2f} or less.",
        f"Order all three (interval above {LEAST_SKILL:g}): over all four ways of driving "
        f"{_words(orders_all(every))}; over baths and shaking",
        f"{_words(orders_all(moving))}.",
        "To leave out the other two was decided after the first start of each bed; in the second "
        "starts alone the skills of these are",
        "; ".join(
            f"{name} " + ", ".join(f"{later[name, order].skill.value:.2f}" for order in ORDERS)
            for name in orders_all(moving)
        )
        + ".",
        _thermometers(rows),
        _frozen(rows),
    ]
    return "\n".join(lines)


def _is_later(row: Row) -> bool:
    return int(row["seed"]) > len(beds.all_beds()) // beds.STARTS


def _thermometers(rows: Sequence[Row]) -> str:
    """How well they agree with the bath, and with each other where nothing is in equilibrium."""
    bath = [row for row in rows if row["group"] == "bath"]
    shaken = [row for row in rows if row["group"] == "shaken"]
    told = []
    for name in THERMOMETERS:
        ratios = [row[name] * row["pair energy"] / set_temperature(_bed(row)) for row in bath]
        told.append(f"{name} {np.mean(ratios):.3f} ± {np.std(ratios, ddof=1):.3f}")
    apart = []
    for name in THERMOMETERS[1:]:
        low, middle, high = np.quantile([row[name] / row["kinetic"] for row in shaken],
                                        [0.1, 0.5, 0.9])  # fmt: skip
        apart.append(f"{name} {middle:.2f} ({low:.2f} to {high:.2f})")
    return (
        f"Over the bath's own temperature they read, over {len(bath)} beds: {', '.join(told)}. "
        f"Over the kinetic one, in {len(shaken)}\nshaken beds, median and eight of ten: "
        f"{', '.join(apart)}."
    )


def _frozen(rows: Sequence[Row]) -> str:
    """What is left without a temperature."""
    settled = [row for row in rows if row["group"] == "settled"]
    cold = [row for row in rows if row["group"] == "bath" and row["first"] <= 0.03]
    spans = [
        f"{100 * min(row['defects'] for row in some):.0f} to "
        f"{100 * max(row['defects'] for row in some):.0f} %" for some in (settled, cold)
    ]  # fmt: skip
    low, high = (end([row["configurational"] for row in settled]) for end in (min, max))
    return (
        f"Settled beds hold {spans[0]} of defects at a configurational temperature of {low:.2g} to "
        f"{high:.2g} and a kinetic one of 0;\nbaths of up to 0.03 hold {spans[1]}."
    )


def _bed(row: Row) -> Bed:
    return Bed(*(row[name] for name in Bed._fields))


def forces_text(rows: Sequence[Row]) -> str:
    """Ratios at defects, and what comes before and after their arrival."""
    lines = ["| | " + " | ".join(f"{kind} beds" for kind in KINDS) + " |", "|---|---|---|"]
    of_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}

    def line(words: str, tell: Callable[[Sequence[Row]], str]) -> None:
        lines.append(f"| {words} | {' | '.join(tell(some) for some in of_kind.values())} |")

    for words, name in (
        ("unevenness at defects over that elsewhere", "uneven"),
        ("the same, places shuffled", "uneven, shuffled"),
        ("force on pentagons over that elsewhere", "force 5"),
        ("force on heptagons over that elsewhere", "force 7"),
    ):
        line(words, lambda some, name=name: _interval(interval([row[name] for row in some]), 3))
    for k in (1, 2, 3):
        line(f"unevenness, {k} neighbour{'s' if k > 1 else ''} away",
             lambda some, k=k: _interval(interval([row["shells"][k] for row in some])))  # fmt: skip
    for name, words in (("uneven about", "unevenness"), ("force about", "force")):
        for when in ("before", "just before", "at", "after"):
            line(f"{words} {_WHEN[when]}",
                 lambda some, name=name, when=when: _interval(
                     before_and_after(some, name)[when], 3))  # fmt: skip
    line("beds, arrivals", lambda some: f"{len(some)}, {sum(row['arrivals'] for row in some)}")
    return "\n".join([*lines, ""])


_STEP = 1e3 * FRAMES
_WHEN = {
    "before": f"{QUIET * _STEP:.0f} to {(QUIET // 2 + 1) * _STEP:.0f} ms before an arrival",
    "just before": f"in the {2 * _STEP:.0f} ms before",
    "at": "at the arrival",
    "after": f"{(QUIET // 2 + 1) * _STEP:.0f} to {QUIET * _STEP:.0f} ms after",
}


def slip_text(rows: Sequence[Row]) -> str:
    """Slopes of the strain by dislocations over the plastic strain of the bed."""
    sizes = sorted({row["grains"] for row in rows})
    lines = [
        "| of the dislocations | "
        + " | ".join(f"{of}, {size} grains" for of in ("bonds", "law") for size in sizes)
        + " |",
        f"|---|{'---|' * (2 * len(sizes))}",
    ]
    for words, parts in PARTS.items():
        cells = []
        for of in ("plastic", "law"):
            for size in sizes:
                found = carried([row for row in rows if row["grains"] == size], parts, of)
                cells.append(_carried(found))
        lines.append(f"| {words} | {' | '.join(cells)} |")
    starts = ", ".join(
        f"{sum(row['grains'] == size for row in rows)} of {size} grains" for size in sizes
    )
    law = [carried([row for row in rows if row["grains"] == size], ("law",)) for size in sizes]
    climb = [abs(row["climb"]) for row in rows]
    lines += [
        "",
        f"Slopes over {starts}; in brackets the interval over starts, then the slope with the "
        "dislocations of another start.",
        "The law's plastic strain over that of the bonds: "
        + ", ".join(f"{one.slope:.2f} [{one.low:.2f}, {one.high:.2f}]" for one in law)
        + f". Area by climb after a cycle: {np.median(climb):.3f} (median), {max(climb):.3f} "
        "(greatest), where no grain is lost.",
    ]
    return "\n".join(lines)


def _carried(found: Carried) -> str:
    return f"{found.slope:.2f} [{found.low:.2f}, {found.high:.2f}]; {found.control:.2f}"


def _interval(one: Figure | Interval, digits: int = 2) -> str:
    return f"{one.value:.{digits}f} [{one.low:.{digits}f}, {one.high:.{digits}f}]"


def _words(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"


TEXTS: Mapping[str, Callable[[Sequence[Row]], str]] = {
    "temperature": temperature_text, "forces": forces_text, "slip": slip_text,
}  # fmt: skip


def summary(question: str, rows: Sequence[Row]) -> dict[str, Any]:
    """For JSON: the rows, and for the temperature which candidates order them."""
    found: dict[str, Any] = {"question": question, "rows": list(rows)}
    if question == "temperature":
        found["orders"] = {
            "all": orders_all(judged_candidates(rows, GROUPS)),
            "agitated": orders_all(judged_candidates(rows, AGITATED)),
        }
    return found
