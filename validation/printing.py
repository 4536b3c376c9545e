"""The parts' results as text for the console."""

from __future__ import annotations

from collections.abc import Sequence

from validation.convergence_result import ConvergenceResult, convergence_table
from validation.energy import EnergyStudy
from validation.energy import summary as energy_table
from validation.outcomes import Outcome
from validation.parts import FAILED, Plain
from validation.sections.cost import choices, studies
from validation.sections.glance import advice_table, effect_table, hard_row
from validation.sections.stability import stability_table
from validation.source_experiment import SourceExperiment


def part_text(name: str, results: Sequence[Plain]) -> str:
    """A part's tables."""
    sound = [one for one in results if FAILED not in one]
    failed = [f"{one['label']} failed: {one[FAILED]}" for one in results if FAILED in one]
    return "\n".join([_TEXTS[name](sound), *failed, ""])


def _convergence(results: Sequence[Plain]) -> str:
    return convergence_table([ConvergenceResult.from_plain(one) for one in results]).text()


def _source(results: Sequence[Plain]) -> str:
    return "\n".join(SourceExperiment.from_plain(one).table().text() for one in results)


def _energy(results: Sequence[Plain]) -> str:
    return energy_table([EnergyStudy.from_plain(one) for one in results]).text()


def _work_precision(results: Sequence[Plain]) -> str:
    found = studies(results)
    tables = [f"{one.quantity} of {one.scene}\n{one.table().text()}\n" for one in found]
    return "\n".join([*tables, choices(found).text()])


def _stability(results: Sequence[Plain]) -> str:
    return stability_table([Outcome.from_plain(one) for one in results]).text()


def _glance(results: Sequence[Plain]) -> str:
    lines = []
    for one in results:
        if "studies" in one:
            found = studies([one])
            lines += [f"{found[0].scene}: what accuracy costs", advice_table(found).text(), ""]
        elif "effects" in one:
            plain = one["effects"]
            lines += [f"{plain['scene']}: what its effects cost", effect_table(plain).text(), ""]
        else:
            outcomes = [Outcome.from_plain(row) for row in one["outcomes"]]
            lines.append(hard_row(outcomes).text())
    return "\n".join(lines)


_TEXTS = {
    "glance": _glance,
    "convergence": _convergence,
    "source-experiment": _source,
    "energy": _energy,
    "work-precision": _work_precision,
    "stability": _stability,
}
