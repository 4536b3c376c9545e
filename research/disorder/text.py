"""Text of the results, for the console and for the guide."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from research.campaign import markdown_table
from research.disorder import beds
from research.disorder.beds import GROUPS, DisorderBed, bath_temperature
from research.disorder.candidates import CANDIDATES, ORDERS
from research.disorder.cycles import FRAMES as FRAMES_OF_CYCLE
from research.disorder.cycles import SHOWN
from research.disorder.data_collapse import MINIMUM_SKILL, FigureWithInterval
from research.disorder.dislocation_strain import (
    PARTS,
    WINDOW,
    DislocationStrainFraction,
    distinct_rows,
    fit_dislocation_strain_fraction,
)
from research.disorder.force_heterogeneity import QUIET
from research.disorder.forces import (
    FRAMES,
    KINDS,
    MeanWithInterval,
    mean_with_bootstrap_interval,
    means_before_at_and_after_arrivals,
)
from research.disorder.made_dislocations import strain_fractions_from_moves_and_in_total
from research.disorder.results import STUDIES, Results, has_row_for_every_case
from research.disorder.temperature import (
    AGITATED,
    candidates_that_order_all_quantities,
    judge_candidates_by_order,
)

Row = Mapping[str, Any]

_WIDTH = 110
THERMOMETERS = ("kinetic", "local kinetic", "configurational", "piston")
_NAMES = {"defects": "defects", "psi6": "ψ₆", "lindemann": "Lindemann"}


def skill_table_and_conclusion_text(rows: Sequence[Row]) -> str:
    """Return a table of skills, and the conclusion."""
    every, moving = (judge_candidates_by_order(rows, item) for item in (GROUPS, AGITATED))
    later = judge_candidates_by_order([row for row in rows if _is_additional_start(row)], AGITATED)
    heads = [f"{_NAMES[order]}" for order in ORDERS]
    lines = [
        f"| candidate | {' | '.join(heads)} | {' | '.join(f'{h}, agitated' for h in heads)} |",
        f"|---|{'---|' * (2 * len(heads))}",
    ]
    for name, words in CANDIDATES.items():
        cells = [
            _value_with_interval_text(judged[name, order].skill)
            for judged in (every, moving)
            for order in ORDERS
        ]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    for_all, for_moving, for_later = (
        _comma_separated_or_none(candidates_that_order_all_quantities(judged))
        for judged in (every, moving, later)
    )
    chance = max(item.skill.chance for judged in (every, moving) for item in judged.values())
    paragraphs = (
        "The table gives the skill of a monotonically rising curve, which is fitted to the ranks of the "
        "beds with all other kinds of driving and then predicts the remaining kind. The skill is 1 if all "
        "beds lie on one curve, and 0 if the curve predicts no better than the mean. The brackets give the "
        f"interval from resampled beds. For shuffled data, 95 % of the skills are below {chance:.2f}.",
        f"Over all four kinds of driving, the interval lies above {MINIMUM_SKILL:g} for all three quantities "
        f"for these candidates: {for_all}. Over baths and shaken beds only, it does so for: {for_moving}. "
        "The restriction to these two kinds was decided after the first start of each bed had been analysed. "
        "The next table therefore gives the skills for the second starts alone. For these starts the "
        f"candidates whose intervals lie above {MINIMUM_SKILL:g} for all three quantities are: {for_later}. "
        "With only half of the beds the intervals are too wide.",
    )
    skills = [
        (name, *(f"{later[name, order].skill.value:.2f}" for order in ORDERS))
        for name in candidates_that_order_all_quantities(moving)
    ]
    table = markdown_table(("second starts", *heads), skills)
    filled = (textwrap.fill(item, _WIDTH) for item in paragraphs)
    return "\n\n".join(
        [
            "\n".join(lines),
            *filled,
            table,
            *_thermometer_agreement_texts(rows),
            _settled_bed_defects_text(rows),
        ]
    )


def _is_additional_start(row: Row) -> bool:
    return int(row["seed"]) > len(beds.all_beds()) // beds.STARTS


def _thermometer_agreement_texts(rows: Sequence[Row]) -> tuple[str, str]:
    """Return the agreement of the thermometers with the bath, and with each other far from equilibrium."""
    bath = [row for row in rows if row["group"] == "bath"]
    shaken = [row for row in rows if row["group"] == "shaken"]
    cells = []
    for name in THERMOMETERS:
        ratios = [row[name] * row["pair energy"] / bath_temperature(_bed_of_row(row)) for row in bath]
        low, middle, high = np.quantile([row[name] / row["kinetic"] for row in shaken], [0.1, 0.5, 0.9])
        relative = "" if name == "kinetic" else f"{middle:.2f} ({low:.2f} to {high:.2f})"
        cells.append((name, f"{np.mean(ratios):.3f} ± {np.std(ratios, ddof=1):.3f}", relative))
    words = (
        f"Temperatures divided by the temperature of the bath ({len(bath)} beds), and divided by the "
        f"kinetic temperature in shaken beds ({len(shaken)} beds, median and central 80 %):"
    )
    header = ("temperature", "divided by the bath's", "divided by the kinetic one, shaken")
    return textwrap.fill(words, _WIDTH), markdown_table(header, cells)


def _settled_bed_defects_text(rows: Sequence[Row]) -> str:
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
        f"In settled beds the fraction of defects is {spans[0]}, at a configurational temperature of "
        f"{low:.2g} to {high:.2g} and a kinetic temperature of 0. In beds in a bath with a temperature of at "
        f"most 0.03 the fraction is only {spans[1]}.",
        _WIDTH,
    )


def _bed_of_row(row: Row) -> DisorderBed:
    return DisorderBed(*(row[name] for name in DisorderBed._fields))


def forces_text(rows: Sequence[Row]) -> str:
    """Return the ratios at defects, and the means before and after their arrival."""
    columns = [_force_ratio_texts([row for row in rows if row["kind"] == kind]) for kind in KINDS]
    lines = [f"| | {' | '.join(f'{kind} beds' for kind in KINDS)} |", f"|---|{'---|' * len(KINDS)}"]
    lines += [f"| {words} | {' | '.join(column[words] for column in columns)} |" for words in columns[0]]
    return "\n".join(lines)


def _force_ratio_texts(rows: Sequence[Row]) -> dict[str, str]:
    result = {
        words: _value_with_interval_text(mean_with_bootstrap_interval([row[name] for row in rows]), 3)
        for words, name in (
            ("unevenness at defects, relative to elsewhere", "uneven"),
            ("the same, positions shuffled", "uneven, shuffled"),
            ("force on pentagons, relative to elsewhere", "force 5"),
            ("force on heptagons, relative to elsewhere", "force 7"),
        )
    }
    for k, words in enumerate(("at defects", "1 neighbour away", "2 away", "3 away")):
        told = _value_with_interval_text(mean_with_bootstrap_interval([row["shells"][k] for row in rows]))
        result[f"unevenness {words}, relative to 5 away and more"] = told
    for words, name in (("unevenness", "uneven about"), ("force", "force about")):
        for when, item in means_before_at_and_after_arrivals(rows, name).items():
            result[f"{words} {_WHEN[when]}"] = _value_with_interval_text(item, 3)
    result["beds, arrivals"] = f"{len(rows)}, {sum(row['arrivals'] for row in rows)}"
    return result


_STEP = 1e3 * FRAMES
_WHEN = {
    "before": (
        f"{QUIET * _STEP:.0f} to {(QUIET // 2 + 1) * _STEP:.0f} ms before an arrival, relative to calm grains"
    ),
    "just before": f"in the {2 * _STEP:.0f} ms before",
    "at": "at the arrival",
    "after": f"{(QUIET // 2 + 1) * _STEP:.0f} to {QUIET * _STEP:.0f} ms after",
}


def slip_text(rows: Sequence[Row]) -> str:
    """Return the slopes of the dislocations' strain over the plastic strain of the bed."""
    alike = distinct_rows(rows)
    sizes = sorted({row["grains"] for row in rows})
    of_size = {size: [row for row in alike if row["grains"] == size] for size in sizes}
    lines = [
        "| dislocations | "
        + " | ".join(f"{_STRAINS[of]}, {size} grains" for of in _STRAINS for size in sizes)
        + " |",
        f"|---|{'---|' * (2 * len(sizes))}",
    ]
    for words, parts in PARTS.items():
        cells = [
            _slope_and_control_text(fit_dislocation_strain_fraction(of_size[size], parts, of))
            for of in _STRAINS
            for size in sizes
        ]
        lines.append(f"| {words} | {' | '.join(cells)} |")
    made = [strain_fractions_from_moves_and_in_total(size) for size in sizes]
    for words, index in (("tracked", 0), ("to the rim", 1)):
        cells = [f"{item[index]:.2f}" for item in made] + [""] * len(sizes)
        lines.append(f"| {words}, synthetic slip | {' | '.join(cells)} |")
    over = [
        _slope_over_fraction_text(
            fit_dislocation_strain_fraction(of_size[size], ("moves",)),
            strain_fractions_from_moves_and_in_total(size)[0],
        )
        for size in sizes
    ]
    lines.append(
        f"| tracked, divided by tracked synthetic slip | {' | '.join([*over, *[''] * len(sizes)])} |"
    )
    return "\n".join([*lines, "", _slip_conclusion_text(rows, of_size)])


_STRAINS = {"plastic": "fraction of the bonds' strain", "law": "fraction of the law's strain"}


def _slip_conclusion_text(rows: Sequence[Row], of_size: Mapping[int, Sequence[Row]]) -> str:
    most = max(of_size)
    beds_of = " and ".join(
        f"{sum(row['grains'] == size for row in rows)} starts of {size} grains ({len(some)} different beds)"
        for size, some in of_size.items()
    )
    slopes = [
        fit_dislocation_strain_fraction(of_size[most], ("moves",), window=item).slope
        for item in (1, 2, 5, 10, 25)
    ]
    left = [fit_dislocation_strain_fraction(some, ("moves",)).left for some in of_size.values()]
    law = [fit_dislocation_strain_fraction(some, ("law",)) for some in of_size.values()]
    climb = [abs(row["climb"]) for some in of_size.values() for row in some]
    items = (
        "The fractions are slopes of straight lines through zero, fitted to the increments of strain in "
        f"{WINDOW * SHOWN * FRAMES_OF_CYCLE:g} s in {beds_of}. The brackets give the interval from "
        "resampled beds. The last number is the control, the slope for the dislocations of another bed.",
        "If the increments are taken over 0.2 to 5 s instead, the fraction for tracked dislocations in a bed "
        f"of {most} grains is {min(slopes):.2f} to {max(slopes):.2f}.",
        "For tracked dislocations the sum of the squared residuals of the line is "
        f"{' and '.join(f'{100 * part:.0f} %' for part in left)} of "
        f"the sum of the squared increments ({' and '.join(map(str, of_size))} grains).",
        "The plastic strain of the law, divided by the plastic strain of the bonds, is "
        + " and ".join(f"{item.slope:.2f} [{item.low:.2f}, {item.high:.2f}]" for item in law)
        + ".",
        f"Burgers vectors are conserved in {100 * np.nanmean([row['conserved'] for row in rows]):.0f} % of "
        "the events away from the rim.",
        "The measured climb of dislocations implies that the area of the bed changes by "
        f"{np.median(climb):.3f} in a cycle (median; maximum {max(climb):.3f}), although no grain is lost.",
    )
    return "\n".join(textwrap.fill(f"- {item}", _WIDTH, subsequent_indent="  ") for item in items)


def _slope_over_fraction_text(result: DislocationStrainFraction, fraction: float) -> str:
    return f"{result.slope / fraction:.2f} [{result.low / fraction:.2f}, {result.high / fraction:.2f}]"


def _slope_and_control_text(result: DislocationStrainFraction) -> str:
    return f"{result.slope:.2f} [{result.low:.2f}, {result.high:.2f}]; {result.control:.2f}"


def _value_with_interval_text(item: FigureWithInterval | MeanWithInterval, digits: int = 2) -> str:
    return f"{item.value:.{digits}f} [{item.low:.{digits}f}, {item.high:.{digits}f}]"


def _comma_separated_or_none(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"


TEXTS: Mapping[str, Callable[[Sequence[Row]], str]] = {
    "temperature": skill_table_and_conclusion_text,
    "forces": forces_text,
    "slip": slip_text,
}


def results_text(results: Results) -> str:
    """Return tables and text of each question; for an incomplete one the number of finished beds."""
    return "\n\n".join(
        TEXTS[question](item["rows"])
        if has_row_for_every_case(question, item["rows"])
        else f"{question}: {len(item['rows'])} of {len(STUDIES[question].cases)} beds are run"
        for question, item in results.items()
    )


def results_as_plain_data(results: Results) -> dict[str, Any]:
    """Return plain data: rows, and for the temperature the candidates that order them."""
    result: dict[str, Any] = {name: {"rows": item["rows"]} for name, item in results.items()}
    rows = results.get("temperature", {}).get("rows", [])
    if has_row_for_every_case("temperature", rows):
        result["temperature"]["orders"] = {
            "all": candidates_that_order_all_quantities(judge_candidates_by_order(rows, GROUPS)),
            "agitated": candidates_that_order_all_quantities(judge_candidates_by_order(rows, AGITATED)),
        }
    return result
