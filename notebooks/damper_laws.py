"""Comparison of laws of the damper, fitted to two lifts and tested on a third and on the drop.

Run ``python notebooks/damper_laws.py [DIR]``. The damper is simulated with lifts of 0.2 D, 2 D and 1.5 D
(some minutes each; the first drop is the same in all runs). Every built-in law, and laws discovered in the
first two records, are fitted to these two records together. They predict the third record and the fall from
20 D, each from an initial state estimated from the record's first period. DIR stores records, table and
report.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Literal

import numpy as np

from granular import GranularError, PistonRecord, damper, simulate
from reduced_models import Comparison, ReducedModel, compare, discover
from reduced_models.identification.page import comparison_page
from reduced_models.laws import LAWS

TRAINING, TEST_LIFT = (0.2, 2.0), 1.5
"""Lifts [D]."""
DIAMETER = 0.006
PERIODS = 10.0
SOURCE_LAW = "van-der-pol-like"
METHODS: tuple[Literal["sindy", "operon"], ...] = ("sindy", "operon")


def records(folder: Path) -> dict[str, PistonRecord]:
    """Return the piston's motion after each lift, and its drop; simulate records that are missing."""
    found = {}
    for lift in (*TRAINING, TEST_LIFT):
        paths = {"drop": folder / "drop.csv", f"lift {lift} D": folder / f"lift-{lift}.csv"}
        if not all(path.is_file() for path in paths.values()):
            run = simulate(damper(lift=lift))
            run.piston("drop").to_csv(paths["drop"])
            run.piston("release").to_csv(paths[f"lift {lift} D"])
        found |= {name: PistonRecord.from_csv(path) for name, path in paths.items()}
    return found


def amplitude_errors(table: Comparison, record: PistonRecord) -> dict[str, float]:
    """Return the rms error of each law over ten periods of the test lift, over its amplitude."""
    errors = {}
    for row in table.rows:
        if not row.models:
            continue
        motion = row.records[0].motion
        period = row.models[0].at_rest.period if row.models[0].at_rest else 0.288
        inside = motion.time - motion.time[0] <= PERIODS * period
        left = motion.height[inside] - record.height[: len(motion)][inside]
        errors[row.name] = float(np.sqrt((left**2).mean())) / (TEST_LIFT * DIAMETER)
    return errors


def discovered(training: list[PistonRecord]) -> list[ReducedModel]:
    """Return the discoveries of each method in both lifts together; report methods without any."""
    found = []
    for method in METHODS:
        try:
            law = discover(training, method, library="physical")
            print(f"{law}\n")
            found.append(law.model)
        except GranularError as error:
            print(f"{method}: {error}\n")
    return found


def main(folder: Path) -> None:
    """Simulate, compare, and report the best law and its margin."""
    folder.mkdir(parents=True, exist_ok=True)
    found = records(folder)
    judged = found[f"lift {TEST_LIFT} D"]
    training = [found[f"lift {lift} D"] for lift in TRAINING]
    laws = [*LAWS, *discovered(training)]
    table = compare(training, laws, test_records=[judged, found["drop"]])
    print(f"record 1: lift {TEST_LIFT} D; record 2: drop from 20 D\n{table}\n")
    errors = amplitude_errors(table, judged)
    ranked = sorted(errors.items(), key=lambda pair: pair[1])
    counts = {row.name: row.parameters for row in table.rows}
    print(f"rms error over {PERIODS:g} periods of the {TEST_LIFT} D lift, in amplitudes:")
    for name, error in ranked:
        print(f"  {name:32} {counts[name]:2} parameters {100 * error:8.3f} %")
    best = min(errors, key=errors.__getitem__)
    words = (
        f"{best} wins: {100 * errors[best]:.2g} % of the amplitude, "
        f"{errors[SOURCE_LAW] / errors[best]:.3g} times better than {SOURCE_LAW}"
    )
    print(words + ".")
    page = comparison_page(table)
    lead = f"{page.lead} Over {PERIODS:g} periods of the {TEST_LIFT} D lift {words}."
    dataclasses.replace(page, lead=lead).save(folder / "damper_laws.html")
    lines = [f"{name}: {counts[name]} parameters, {100 * error:.3g} %" for name, error in ranked]
    (folder / "amplitude_errors.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "damper-laws"))
