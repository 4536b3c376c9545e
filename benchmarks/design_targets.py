"""Processor time and errors of `design` for drawn targets: ``python -m benchmarks.design_targets 0 20``."""

from __future__ import annotations

import math
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from granular import InputError, simulate
from reduced_models import DesignTarget, design, fit, propose_design
from reduced_models.designs.design import DesignError

FREQUENCIES, DAMPINGS = (2.4, 5.6), (0.024, 0.25)
"""Box of the targets [Hz, 1]; those out of reach are drawn again."""


def drawn_targets(count: int) -> list[tuple[float, float]]:
    """Frequencies [Hz] and damping ratios within the range that `design` states."""
    random = np.random.default_rng(67)
    result: list[tuple[float, float]] = []
    while len(result) < count:
        frequency = random.uniform(*FREQUENCIES)
        damping = math.exp(random.uniform(*np.log(DAMPINGS)))
        try:
            propose_design(DesignTarget(frequency, damping))
        except InputError:
            continue
        result.append((round(frequency, 3), round(damping, 4)))
    return result


def main(first: int, last: int, own_falls: bool) -> None:
    """Print a line for each target of a range."""
    warnings.simplefilter("ignore")
    with ThreadPoolExecutor(1) as pool:
        for index, (frequency, damping) in enumerate(drawn_targets(last)[first:], first):
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
