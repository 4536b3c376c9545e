"""Numbered trials: the outcome of each as a line of JSON, and counts of outcomes.

A trial depends only on the seed and its number. The programs next to this file are run like this:

    NUMBA_DISABLE_JIT=1 python tests/fuzzing/scenes.py --count 5000
    python tests/fuzzing/records.py --first 17 --count 1 --show
    python tests/fuzzing/law_texts.py --seed 7 --count 5000
    python tests/fuzzing/fits.py --count 60

A program exits with 1 after a trial with a forbidden outcome: a traceback, a number that is not finite,
more than a minute, or more memory than a laboratory computer has.
"""

import argparse
import contextlib
import json
import math
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from granular.shared.errors import InputError

SEED = 20260515
LONGEST = 60.0  # seconds
MOST_MEMORY = 4 * 2**30  # bytes
FAULT = "fault"

Random = np.random.Generator
Outcome = tuple[str, str]
"""In a word, and what there is to say of it."""


class Hang(BaseException):
    """Raised if a trial does not end."""


def random_of(seed: int, number: int) -> Random:
    return np.random.default_rng([seed, number])


def wanted(program: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options shared by all programs."""
    parser = argparse.ArgumentParser(description=(program or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--show", action="store_true", help="also print the trials")
    return parser


@contextlib.contextmanager
def a_minute() -> Iterator[None]:
    """Raise `Hang` if a trial takes longer than a minute."""

    def over(*_: object) -> None:
        raise Hang

    former = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, former)


def refused(error: InputError) -> Outcome:
    """Return the outcome of a refusal, and assert that its message is one readable line."""
    text = str(error)
    assert text.isprintable(), repr(text)
    assert len(text) < 1000, text
    return "refused", f"{type(error).__name__}: {text}"


def watched(trial: Callable[[int], Outcome], number: int) -> Outcome:
    """Run a trial and return its outcome; crashes and hanging trials are faults."""
    try:
        return trial(number)
    except Hang:
        return FAULT, f"hangs for more than {LONGEST:g} s"
    except Exception:
        return FAULT, traceback.format_exc(limit=-6)


def tell(trial: Callable[[int], Outcome], numbers: Iterable[int]) -> None:
    """Run the trials, print each outcome as a line of JSON, and finally print the counts."""
    count: Counter[str] = Counter()
    for number in numbers:
        started = time.monotonic()
        outcome, what = watched(trial, number)
        seconds = round(time.monotonic() - started, 2)
        line = {"case": number, "outcome": outcome, "what": what, "seconds": seconds}
        print(json.dumps(line), flush=True)
        count[outcome] += 1
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if memory > MOST_MEMORY:
        count[FAULT] += 1
    print(f"{dict(count)}, {memory / 2**20:.0f} MB", file=sys.stderr)
    sys.exit(1 if count[FAULT] else 0)


def some(random: Random, chance: float) -> bool:
    return bool(random.random() < chance)


def one_of(random: Random, choices: Any) -> Any:
    return choices[int(random.integers(len(choices)))]


def between(random: Random, low: float, high: float) -> float:
    """Return a random number whose logarithm is uniformly distributed."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))
