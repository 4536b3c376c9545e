"""Text of the results, for the console and for the guide."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from research.campaign import markdown_table
from research.disorder import beds
from research.disorder.beds import GROUPS, Bed, bath_temperature
from research.disorder.candidates import CANDIDATES, ORDERS
from research.disorder.cycles import FRAMES as FRAMES_OF_CYCLE
from research.disorder.cycles import SHOWN
from research.disorder.data_collapse import MINIMUM_SKILL, Figure
from research.disorder.dislocation_strain import PARTS, WINDOW, StrainFraction, distinct, strain_fraction
from research.disorder.force_heterogeneity import QUIET
from research.disorder.forces import FRAMES, KINDS, Interval, before_and_after, interval
from research.disorder.made_dislocations import tracked_fraction
from research.disorder.results import STUDIES, Results, is_whole
from research.disorder.temperature import AGITATED, candidates_for_all, score_candidates

Row = Mapping[str, Any]

_WIDTH = 110
THERMOMETERS = ("kinetic", "local kinetic", "configurational", "piston")
_NAMES = {"defects": "defects", "psi6": "ψ₆", "lindemann": "Lindemann"}


def temperature_text(rows: Sequence[Row]) -> str:
    """Return a table of skills, and the conclusion."""
    every, moving = (score_candidates(rows, item) for item in (GROUPS, AGITATED))
    later = score_candidates([row for row in rows if _is_later(row)], AGITATED)
    heads = [f"{_NAMES[order]}" for order in ORDERS]
    lines = [
        f"| candidate | {' | '.join(heads)} | {' | '.join(f'{h}, agitated' for h in heads)} |",
        f"|---|{'---|' * (2 * len(heads))}",
    ]
    for name, words in CANDIDATES.items():
        cells = [_interval(judged[name, order].skill) for judged in (every, moving) for order in ORDERS]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    chance = max(item.skill.chance for judged in (every, moving) for item in judged.values())
    paragraphs = (
        "Skill of a monotonically rising curve, fitted to the ranks of the other kinds of driving, on "
        "the held-out kind, with the interval over beds: 1 if all lie on one curve, 0 if the curve "
        f"predicts no more than the mean. 95 % of shuffled data stay below {chance:.2f} or less.",
        f"The interval lies above {MINIMUM_SKILL:g} in all three quantities, over all four kinds of "
        f"driving for {_words(candidates_for_all(every))}, over baths and shaking for "
        f"{_words(candidates_for_all(moving))}. The restriction to these two kinds was decided after the "
        "first start of each bed. The second starts alone give the skills of the table, and intervals "
        f"above {MINIMUM_SKILL:g} in all three for {_words(candidates_for_all(later))}: half of the beds are "
        "too few.",
    )
    skills = [
        (name, *(f"{later[name, order].skill.value:.2f}" for order in ORDERS))
        for name in candidates_for_all(moving)
    ]
    table = markdown_table(("second starts", *heads), skills)
    filled = (textwrap.fill(item, _WIDTH) for item in paragraphs)
    return "\n\n".join(["\n".join(lines), *filled, table, *_thermometers(rows), _frozen(rows)])


def _is_later(row: Row) -> bool:
    return int(row["seed"]) > len(beds.all_beds()) // beds.STARTS


def _thermometers(rows: Sequence[Row]) -> tuple[str, str]:
    """Return the agreement of the thermometers with the bath, and with each other far from equilibrium."""
    bath = [row for row in rows if row["group"] == "bath"]
    shaken = [row for row in rows if row["group"] == "shaken"]
    cells = []
    for name in THERMOMETERS:
        ratios = [row[name] * row["pair energy"] / bath_temperature(_bed(row)) for row in bath]
        low, middle, high = np.quantile([row[name] / row["kinetic"] for row in shaken], [0.1, 0.5, 0.9])
        relative = "" if name == "kinetic" else f"{middle:.2f} ({low:.2f} to {high:.2f})"
        cells.append((name, f"{np.mean(ratios):.3f} ± {np.std(ratios, ddof=1):.3f}", relative))
    words = (
        f"Temperatures over the temperature of the bath ({len(bath)} beds), and over the kinetic one "
        f"in shaken beds ({len(shaken)} beds, median and central 80 %):"
    )
    header = ("temperature", "over the bath's", "over the kinetic one, shaken")
    return textwrap.fill(words, _WIDTH), markdown_table(header, cells)


def _frozen(rows: Sequence[Row]) -> str:
    """Return the text on defects of settled beds, whose temperature is zero."""
    settled = [row for row in rows if row["group"] == "settled"]
    cold = [row for row in rows if row["group"] == "bath" and row["first"] <= 0.03]
    spans = [
        f"{100 * min(row['defects'] for row in some):.0f} to "
        f"{100 * max(row['defects'] for row in some):.0f} %"
        for some in (settled, cold)
    ]
    low, high = (end([row["configurational"] for row in settled]) for end in (min, max))
    return textwrap.fill(
        f"Settled beds have {spans[0]} of defects at a configurational temperature of {low:.2g} to "
        f"{high:.2g} and a kinetic one of 0. Baths of up to 0.03 have {spans[1]}.",
        _WIDTH,
    )


def _bed(row: Row) -> Bed:
    return Bed(*(row[name] for name in Bed._fields))


def forces_text(rows: Sequence[Row]) -> str:
    """Return the ratios at defects, and the means before and after their arrival."""
    columns = [_forces_of([row for row in rows if row["kind"] == kind]) for kind in KINDS]
    lines = [f"| | {' | '.join(f'{kind} beds' for kind in KINDS)} |", f"|---|{'---|' * len(KINDS)}"]
    lines += [f"| {words} | {' | '.join(column[words] for column in columns)} |" for words in columns[0]]
    return "\n".join(lines)


def _forces_of(rows: Sequence[Row]) -> dict[str, str]:
    result = {
        words: _interval(interval([row[name] for row in rows]), 3)
        for words, name in (
            ("unevenness at defects, relative to elsewhere", "uneven"),
            ("the same, positions shuffled", "uneven, shuffled"),
            ("force on pentagons, relative to elsewhere", "force 5"),
            ("force on heptagons, relative to elsewhere", "force 7"),
        )
    }
    for k, words in enumerate(("at defects", "1 neighbour away", "2 away", "3 away")):
        told = _interval(interval([row["shells"][k] for row in rows]))
        result[f"unevenness {words}, relative to 5 away and more"] = told
    for words, name in (("unevenness", "uneven about"), ("force", "force about")):
        for when, item in before_and_after(rows, name).items():
            result[f"{words} {_WHEN[when]}"] = _interval(item, 3)
    result["beds, arrivals"] = f"{len(rows)}, {sum(row['arrivals'] for row in rows)}"
    return result


_STEP = 1e3 * FRAMES
_WHEN = {
    "before": f"{QUIET * _STEP:.0f} to {(QUIET // 2 + 1) * _STEP:.0f} ms before an arrival, over calm grains",
    "just before": f"in the {2 * _STEP:.0f} ms before",
    "at": "at the arrival",
    "after": f"{(QUIET // 2 + 1) * _STEP:.0f} to {QUIET * _STEP:.0f} ms after",
}


def slip_text(rows: Sequence[Row]) -> str:
    """Return the slopes of the dislocations' strain over the plastic strain of the bed."""
    alike = distinct(rows)
    sizes = sorted({row["grains"] for row in rows})
    of_size = {size: [row for row in alike if row["grains"] == size] for size in sizes}
    lines = [
        "| dislocations | "
        + " | ".join(f"{_STRAINS[of]}, {size} grains" for of in _STRAINS for size in sizes)
        + " |",
        f"|---|{'---|' * (2 * len(sizes))}",
    ]
    for words, parts in PARTS.items():
        cells = [_carried(strain_fraction(of_size[size], parts, of)) for of in _STRAINS for size in sizes]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    made = [tracked_fraction(size) for size in sizes]
    for words, index in (("tracked", 0), ("to the rim", 1)):
        cells = [f"{item[index]:.2f}" for item in made] + [""] * len(sizes)
        lines.append(f"| {words}, synthetic slip | {' | '.join(cells)} |")
    over = [_over(strain_fraction(of_size[size], ("moves",)), tracked_fraction(size)[0]) for size in sizes]
    lines.append(f"| tracked, over synthetic | {' | '.join([*over, *[''] * len(sizes)])} |")
    return "\n".join([*lines, "", _slip_words(rows, of_size)])


_STRAINS = {"plastic": "of the bonds' strain", "law": "of the law's"}


def _slip_words(rows: Sequence[Row], of_size: Mapping[int, Sequence[Row]]) -> str:
    most = max(of_size)
    beds_of = " and ".join(
        f"{sum(row['grains'] == size for row in rows)} starts of {size} grains ({len(some)} different beds)"
        for size, some in of_size.items()
    )
    slopes = [strain_fraction(of_size[most], ("moves",), window=item).slope for item in (1, 2, 5, 10, 25)]
    left = [strain_fraction(some, ("moves",)).left for some in of_size.values()]
    law = [strain_fraction(some, ("law",)) for some in of_size.values()]
    climb = [abs(row["climb"]) for some in of_size.values() for row in some]
    items = (
        f"Slopes through zero over {beds_of}, in increments of "
        f"{WINDOW * SHOWN * FRAMES_OF_CYCLE:g} s. Brackets give the interval over beds; the last "
        "number is the slope with the dislocations of another bed.",
        f"Increments of 0.2 to 5 s give {min(slopes):.2f} to {max(slopes):.2f} for tracked "
        f"dislocations in {most} grains.",
        f"The residual of the line is {' and '.join(f'{100 * part:.0f} %' for part in left)} of the "
        f"square of the increments of tracked dislocations ({' and '.join(map(str, of_size))} grains).",
        "The plastic strain of the law, over the strain of the bonds, is "
        + " and ".join(f"{item.slope:.2f} [{item.low:.2f}, {item.high:.2f}]" for item in law)
        + ".",
        f"Burgers vectors add up in {100 * np.nanmean([row['conserved'] for row in rows]):.0f} % of the "
        "events away from the rim.",
        f"Climb leaves an area change of {np.median(climb):.3f} after a cycle (median; maximum "
        f"{max(climb):.3f}), although no grain is lost.",
    )
    return "\n".join(textwrap.fill(f"- {item}", _WIDTH, subsequent_indent="  ") for item in items)


def _over(result: StrainFraction, fraction: float) -> str:
    return f"{result.slope / fraction:.2f} [{result.low / fraction:.2f}, {result.high / fraction:.2f}]"


def _carried(result: StrainFraction) -> str:
    return f"{result.slope:.2f} [{result.low:.2f}, {result.high:.2f}]; {result.control:.2f}"


def _interval(item: Figure | Interval, digits: int = 2) -> str:
    return f"{item.value:.{digits}f} [{item.low:.{digits}f}, {item.high:.{digits}f}]"


def _words(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"


TEXTS: Mapping[str, Callable[[Sequence[Row]], str]] = {
    "temperature": temperature_text,
    "forces": forces_text,
    "slip": slip_text,
}


def text(results: Results) -> str:
    """Return tables and text of each question; for an incomplete one the number of finished beds."""
    return "\n\n".join(
        TEXTS[question](item["rows"])
        if is_whole(question, item["rows"])
        else f"{question}: {len(item['rows'])} of {len(STUDIES[question].cases)} beds are run"
        for question, item in results.items()
    )


def summary(results: Results) -> dict[str, Any]:
    """Return plain data: rows, and for the temperature the candidates that order them."""
    result: dict[str, Any] = {name: {"rows": item["rows"]} for name, item in results.items()}
    rows = results.get("temperature", {}).get("rows", [])
    if is_whole("temperature", rows):
        result["temperature"]["orders"] = {
            "all": candidates_for_all(score_candidates(rows, GROUPS)),
            "agitated": candidates_for_all(score_candidates(rows, AGITATED)),
        }
    return result
