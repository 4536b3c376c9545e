"""The report: one HTML file with everything in it, and its figures as JSON beside it."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.scene.scene import Scene
from granular.shared.files import make_directory, write_json
from granular.shared.html import Page
from validation.glance import glance_part
from validation.outcomes import Outcome
from validation.parts import FAILED, Part, Plain, machine, measured
from validation.programme import PARTS, part_named
from validation.sections.common import Shown, sound
from validation.sections.convergence import CONVERGENCE
from validation.sections.cost import WORK_PRECISION
from validation.sections.energy import ENERGY
from validation.sections.glance import GLANCE, glance_section
from validation.sections.source import SOURCE
from validation.sections.stability import STABILITY

Results = Mapping[str, Sequence[Plain]]

ALL = tuple(part.name for part in PARTS)
"""Names of all parts."""

SHOWN: Mapping[str, Shown] = {
    "glance": GLANCE,
    "convergence": CONVERGENCE,
    "source-experiment": SOURCE,
    "energy": ENERGY,
    "work-precision": WORK_PRECISION,
    "stability": STABILITY,
}


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
        stable = [Outcome.from_plain(one) for one in sound(results.get("stability", ()))]
        glance_section(shown, results["glance"], stable)
    shown.section("What holds")
    words = {True: "yes", False: "NO"}
    shown.table(
        ("part", "holds", "what was found"),
        [(name, words[found["held"][name]], one) for name, one in found["verdicts"].items()],
    )
    below = {name: ones for name, ones in results.items() if name != "glance"}
    for name, ones in below.items():
        SHOWN[name].section(shown, ones)
    if below:
        shown.section("All measurements")
        for name, one in SHOWN.items():
            if one.measurements is not None and (ones := sound(below.get(name, ()))):
                one.measurements(shown, ones)
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
        verdicts[name], right = SHOWN[name].verdict(sound(ones))
        failed = sum(FAILED in one for one in ones)
        if failed:
            verdicts[name] += f" ({failed} could not be measured)"
        held[name] = right and not failed
    return {"verdicts": verdicts, "held": held, "holds": all(held.values())}


def part_text(name: str, results: Sequence[Plain]) -> str:
    """The tables of a part for the console, and what failed."""
    failed = [f"{one['label']} failed: {one[FAILED]}" for one in results if FAILED in one]
    return "\n".join([SHOWN[name].text(sound(results)), *failed, ""])
