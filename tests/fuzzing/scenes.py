"""Random scenes, sound and unsound, and what becomes of them: fine, refused, stopped, or a fault.

A program, of which `trials` tells:

    NUMBA_DISABLE_JIT=1 python tests/fuzzing/scenes.py --first 0 --count 20
    NUMBA_DISABLE_JIT=1 python tests/fuzzing/scenes.py --first 17 --count 1 --show
"""

import contextlib
import itertools
import json
import resource
import signal
import sys
import time
import warnings
from collections.abc import Iterator

from scene_cases import Case
from scene_runs import not_finite, run_case
from trials import FAULT, LONGEST, MOST_MEMORY, Hang, Outcome, tell, wanted


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Ctrl-C after some seconds of the processor, and `Hang` later."""
    started = time.process_time()

    def alarm(*_: object) -> None:
        if time.process_time() - started > LONGEST:
            raise Hang
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        signal.raise_signal(signal.SIGINT)

    former = signal.signal(signal.SIGPROF, alarm)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, former)


def tried(case: Case, seconds: float, *, figures: bool = False) -> Outcome:
    """The outcome of a case, and what is to be said of it; or figures of its second record."""
    from granular.shared.errors import InputError, RunError

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            with within(seconds):
                run = run_case(case, said)
        except KeyboardInterrupt as stop:
            part = getattr(stop, "trajectory", None)
            bad = "" if part is None or part.path is not None else not_finite(part)
            return (FAULT, bad) if bad else ("cut", f"after {seconds:g} s")
        except InputError as error:
            return judged("refused", error)
        except RunError as error:
            if error.trajectory is None:
                return FAULT, f"no trajectory: {error}"
            return judged("stopped", error)
    if figures:
        data = run.dataset.isel(time=slice(2))
        rows = {name: data[name].values for name in data if data[name].dims == ("time",)}
        return "fine", json.dumps({str(name): float(row[-1]) for name, row in rows.items()})
    return "fine", "; ".join(sorted({str(one.message)[:60] for one in said}))


def judged(outcome: str, error: Exception) -> Outcome:
    text = str(error)
    printed = "\n" not in text and text.isprintable()
    return (outcome, f"{type(error).__name__}: {text}") if printed else (FAULT, repr(text))


def main() -> None:
    parser = wanted(__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="from when on a case is cut")
    parser.add_argument("--common", action="store_true", help="only cases that share compiled code")
    parser.add_argument("--figures", action="store_true", help="what two programs may compare")
    options = parser.parse_args()
    import granular.run.simulation
    import granular.run.summary  # noqa: F401

    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))

    def numbers() -> Iterator[int]:
        found = itertools.count(options.first)
        if options.common:
            found = (number for number in found if Case(options.seed, number).compiled)
        return itertools.islice(found, options.count)

    def trial(number: int) -> Outcome:
        case = Case(options.seed, number)
        if options.show:
            print(json.dumps({"scene": case.plain, **case.arguments}, indent=1), file=sys.stderr)
        return tried(case, options.seconds, figures=options.figures)

    tell(trial, numbers())


if __name__ == "__main__":
    main()
