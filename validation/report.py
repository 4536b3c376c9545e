"""The report: one HTML file with everything in it, and its figures as JSON beside it."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.shared.files import make_directory, write_json
from granular.shared.html import Page
from validation.energy import EnergyStudy
from validation.order import ConvergenceResult
from validation.outcomes import Outcome
from validation.parts import FAILED, Part, Plain, machine, measured
from validation.programme import PARTS, part_named
from validation.sections import (
    SECTIONS,
    convergence_holds,
    energy_holds,
    measurements,
    stability_verdict,
)
from validation.source_experiment import COMPENSATED, SourceExperiment

Results = Mapping[str, Sequence[Plain]]

ALL = tuple(part.name for part in PARTS)
"""Names of all parts."""


def report(
    directory: str | Path,
    *,
    full: bool = False,
    parts: Sequence[str | Part] = ALL,
    progress: bool = True,
) -> dict[str, Any]:
    """Measure the parts, and write ``report.html`` and ``report.json``.

    What was measured before with the same sources is read from ``directory``/pieces.

    Parameters
    ----------
    directory : str or Path
    full : bool
        Everything, which takes an hour or so; without, what fits into a few minutes.
    parts : sequence of str or Part
        Which ones: of the programme by name, or others, which have a name of the programme's.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    dict
        What the JSON file holds: the parts' results, a verdict each, and the machine.

    Raises
    ------
    InputError
        If the directory cannot be written.
    """
    where = Path(directory)
    make_directory(where)
    wanted = [part_named(part) if isinstance(part, str) else part for part in parts]
    results: dict[str, Sequence[Plain]] = {
        part.name: measured(part, where, full=full, progress=progress) for part in wanted
    }
    found = summary(results) | {"full": full, "machine": machine(), "parts": results}
    page(results, full=full).save(where / "report.html")
    write_json(where / "report.json", found)
    return found


def page(results: Results, *, full: bool) -> Page:
    """The report as a page."""
    found = summary(results)
    shown = Page("Proof of the numbers", "All holds." if found["holds"] else "Not all holds.")
    words = {True: "yes", False: "NO"}
    shown.table(
        ("part", "holds", "what was found"),
        [(name, words[found["held"][name]], one) for name, one in found["verdicts"].items()],
    )
    for name, ones in results.items():
        SECTIONS[name](shown, ones)
    measurements(shown, results)
    made = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    kind = "full" if full else "quick"
    shown.footer(
        f"Made on {made} ({kind}) with " + ", ".join(f"{k} {v}" for k, v in machine().items())
    )
    return shown


def summary(results: Results) -> dict[str, Any]:
    """A verdict for each part, whether it holds, and whether all of them do."""
    verdicts, held = {}, {}
    for name, ones in results.items():
        verdicts[name], sound = _VERDICTS[name]([one for one in ones if FAILED not in one])
        failed = sum(FAILED in one for one in ones)
        if failed:
            verdicts[name] += f" ({failed} could not be measured)"
        held[name] = sound and not failed
    return {"verdicts": verdicts, "held": held, "holds": all(held.values())}


def _convergence_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [ConvergenceResult.from_plain(one) for one in results]
    right = sum(map(convergence_holds, found))
    return f"{right} of {len(found)} slopes are as declared", right == len(found)


def _source_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    slopes = [SourceExperiment.from_plain(one).slope(COMPENSATED) for one in results]
    words = f"the source's test has the slope {', '.join(f'{one:.4f}' for one in slopes)}"
    return words, all(abs(one - 2.0) <= 0.01 for one in slopes)


def _energy_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [EnergyStudy.from_plain(one) for one in results]
    right = sum(map(energy_holds, found))
    words = f"{right} of {len(found)} energy runs are of their kind (no trend, or a control's)"
    return words, right == len(found)


def _work_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    shown = sum(len(one["studies"]) for one in results)
    return f"cost of accuracy shown for {shown} quantities", True


def _stability_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [Outcome.from_plain(one) for one in results]
    return stability_verdict(found).rstrip("."), all(one.allowed for one in found)


_VERDICTS = {
    "convergence": _convergence_verdict,
    "source-experiment": _source_verdict,
    "energy": _energy_verdict,
    "work-precision": _work_verdict,
    "stability": _stability_verdict,
}
