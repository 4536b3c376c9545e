"""Processor time and errors of `design` for random targets: ``python -m benchmarks.design_targets 0 20``."""

from __future__ import annotations

import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

from granular import simulate
from reduced_models import design, fit
from reduced_models.designs.design import DesignError

TARGETS = (
    *((3.726, 0.0323), (4.045, 0.0482), (4.314, 0.0659), (3.387, 0.0552), (2.683, 0.2035)),
    *((3.115, 0.0247), (5.015, 0.1773), (3.483, 0.0581), (3.129, 0.0528), (4.668, 0.0470)),
    *((3.376, 0.1065), (2.950, 0.0879), (4.967, 0.0306), (2.716, 0.0870), (3.449, 0.1801)),
    *((2.935, 0.0377), (3.687, 0.0578), (4.598, 0.1157), (4.731, 0.0271), (3.452, 0.0503)),
)
"""Frequencies [Hz] and damping ratios: uniform from 2.4 to 5.6 Hz, and log-uniform from 0.024 to 0.25,
without targets that `design` could not reach."""


def main(first: int, last: int, own_falls: bool) -> None:
    """Print a line for each target of a range."""
    warnings.simplefilter("ignore")
    with ThreadPoolExecutor(1) as pool:
        for index, (frequency, damping) in enumerate(TARGETS[first:last], first):
            started = time.process_time()
            try:
                made = design(frequency, damping, executor=pool, progress=False)
            except DesignError as error:
                print(index, frequency, damping, f"{time.process_time() - started:.1f} s", error, flush=True)
                continue
            seconds, check = time.process_time() - started, made.checks[0]
            found = [(check.frequency, check.damping_ratio)]
            if own_falls:
                rest = fit(simulate(made.scene, progress=False).piston("release")).at_rest
                assert rest is not None
                found.append((1.0 / rest.period, rest.damping_ratio))
            errors = ", ".join(
                f"{100.0 * (f / frequency - 1.0):+.2f} % {100.0 * (z / damping - 1.0):+.2f} %"
                for f, z in found
            )
            print(index, frequency, damping, f"{seconds:.1f} s", len(made.rounds), errors, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), "falls" in sys.argv)
