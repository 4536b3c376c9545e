"""The report: one HTML file with everything in it, and its figures as JSON beside it."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.scene.scene import Scene
from granular.shared.files import make_directory, write_json
from granular.shared.html import Page
from validation.convergence_result import ConvergenceResult
from validation.cost import USUAL
from validation.energy import EnergyStudy
from validation.glance import glance_part
from validation.outcomes import Outcome
from validation.parts import FAILED, Part, Plain, machine, measured
from validation.programme import PARTS, part_named
from validation.sections.convergence import convergence_holds, convergence_section
from validation.sections.cost import studies, work_precision_section
from validation.sections.energy import energy_holds, energy_section
from validation.sections.glance import glance_section
from validation.sections.measurements import measurements
from validation.sections.source import source_section
from validation.sections.stability import stability_section, stability_verdict
from validation.source_experiment import COMPENSATED, SourceExperiment

Results = Mapping[str, Sequence[Plain]]

ALL = tuple(part.name for part in PARTS)
"""Names of all parts."""


def report(
    directory: str | Path,
    *,
    full: bool = False,
    parts: Sequence[str | Part] = ALL,
    scenes: Sequence[Scene] = (),
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
    scenes : sequence of Scene
        Scenes of the user's own: then the first screen alone is made, for these.
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
    if scenes:
        wanted = [glance_part(scenes, hard=True)]
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
    wrong = [name for name, held in found["held"].items() if not held]
    lead = f"Not all holds: {', '.join(wrong)}." if wrong else "All holds."
    shown = Page("Proof of the numbers", lead)
    if "glance" in results:
        stable = [one for one in results.get("stability", ()) if FAILED not in one]
        glance_section(shown, results["glance"], [Outcome.from_plain(one) for one in stable])
    shown.section("What holds")
    words = {True: "yes", False: "NO"}
    shown.table(
        ("part", "holds", "what was found"),
        [(name, words[found["held"][name]], one) for name, one in found["verdicts"].items()],
    )
    for name, ones in results.items():
        if name in _SECTIONS:
            _SECTIONS[name](shown, ones)
    if set(results) - {"glance"}:
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


def _glance_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    fresh = [row for one in results for row in one.get("fresh", ())]
    hard = [Outcome.from_plain(row) for one in results for row in one.get("outcomes", ())]
    missed = [f"{row['quantity']} of {row['scene']} to {row['level']} by {row['setting']}"
              for row in fresh if not row["holds"]]  # fmt: skip
    words = f"{len(fresh) - len(missed)} of {len(fresh)} advised settings hold for a fresh start"
    if missed:
        words += f", not {'; '.join(missed)}"
    if hard:
        words += f"; {stability_verdict(hard).rstrip('.')}"
    return words, not missed and all(one.allowed for one in hard)


def _convergence_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [ConvergenceResult.from_plain(one) for one in results]
    right = sum(map(convergence_holds, found))
    return f"{right} of {len(found)} slopes are as declared", right == len(found)


def _source_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    slopes = [SourceExperiment.from_plain(one).slope(COMPENSATED) for one in results]
    words = f"de Paula's test has the slope {', '.join(f'{one:.4f}' for one in slopes)}"
    return words, all(abs(one - 2.0) <= 0.01 for one in slopes)


def _energy_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [EnergyStudy.from_plain(one) for one in results]
    right = sum(map(energy_holds, found))
    words = f"{right} of {len(found)} energy runs are of their kind (no trend, or a control's)"
    return words, right == len(found)


def _work_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = studies(results)
    usual = [one for one in found if any(each.setting[:2] == USUAL for each in one.points)]
    right = sum(one.usual() is not None for one in usual)
    words = (
        f"cost of accuracy shown for {len(found)} quantities; the default setting runs in "
        f"{right} of {len(usual)}"
    )
    return words, right == len(usual)


def _stability_verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    found = [Outcome.from_plain(one) for one in results]
    return stability_verdict(found).rstrip("."), all(one.allowed for one in found)


_SECTIONS = {
    "convergence": convergence_section,
    "source-experiment": source_section,
    "energy": energy_section,
    "work-precision": work_precision_section,
    "stability": stability_section,
}
"""The parts below the first screen."""

_VERDICTS = {
    "glance": _glance_verdict,
    "convergence": _convergence_verdict,
    "source-experiment": _source_verdict,
    "energy": _energy_verdict,
    "work-precision": _work_verdict,
    "stability": _stability_verdict,
}
