"""Random scenes, each of which must run to its end, be refused, or stop with an error."""

import contextlib
import itertools
import json
import math
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scene_cases import Case
from trials import FAULT, LONGEST, MOST_MEMORY, Hang, Outcome, tell, wanted


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Send Ctrl-C after some seconds of processor time, and raise `Hang` if that does not stop the run."""
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
    """Run a case and return its outcome with a remark.

    On request, the remark of a completed run consists of the values of its second record.
    """
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


def run_case(case: Case, said: list[warnings.WarningMessage]) -> Any:
    """Run a case, and assert properties that every run has."""
    import tomllib

    from granular import Scene, simulate
    from granular.run.summary import derived_scene_values, run_text, scene_text

    scene = Scene.from_plain(case.plain)
    assert Scene.from_plain(tomllib.loads(scene.to_toml())) == scene, "TOML gives another scene"
    assert scene_text(scene)
    json.dumps(derived_scene_values(scene))
    with silent_overflow():
        run = simulate(scene, progress=False, **case.arguments)
    assert run_text(run)
    check_run(run, said)
    if case.resumed is not None and run.dataset.sizes["time"] > 1:
        check_resumed(case, run)
    return run


def check_run(run: Any, said: list[warnings.WarningMessage]) -> None:
    from granular.scene.scene import degraded_energy_residual_limit

    assert run.complete
    bad = not_finite(run)
    assert not bad, bad
    data = run.dataset
    assert (np.diff(data["time"].values) >= 0.0).all(), "time runs backward"
    ended = run.stages[-1]
    # Times increase: of two records at time 0 the later one is at the next floating-point number.
    last = float(data["time"].values[-1])
    assert math.isclose(ended.end, last, rel_tol=1e-9, abs_tol=1e-15), "ends elsewhere"
    words = " ".join(str(one.message) for one in said)
    off = run.settings()["ledger_residual"]
    if off > degraded_energy_residual_limit(run.scene):
        assert "energy balance is off" in words, f"off by {off:g} without a warning"


def not_finite(run: Any) -> str:
    """Return a description of the first variable of a run that is not finite, or an empty string."""
    data = run.dataset
    gone = "grain_count" in data and (data["grain_count"].values < run.scene.grains.count).any()
    for name in data.variables:
        values = np.asarray(data[name].values)
        if values.dtype.kind != "f" or (gone and "grain" in data[name].dims):
            continue  # a grain that has left is at no place
        # With a single grain there is no closest pair.
        bad = np.isnan(values) if name == "closest_distance" else ~np.isfinite(values)
        if bad.any():
            return f"{name} holds {values[bad][0]}"
    return ""


def check_resumed(case: Case, integer: Any) -> None:
    """Assert that an interrupted and resumed run is bit-identical to an uninterrupted one."""
    from granular import Scene, load_trajectory, simulate

    assert case.resumed is not None
    scene = Scene.from_plain(case.plain)
    settings = {key: value for key, value in case.arguments.items() if key != "t_end"}
    end = float(integer.dataset["time"].values[-1])
    dt = settings.get("dt")
    first = case.resumed * end
    if isinstance(dt, float) and first < dt:
        return
    folder = Path(tempfile.mkdtemp())
    try:
        with silent_overflow():
            simulate(scene, t_end=first, out=folder / "run", progress=False, **settings)
            rest = {"resume": True, **case.arguments}
            simulate(scene, out=folder / "run", progress=False, **rest)
        again = load_trajectory(folder / "run").dataset
        assert again.equals(integer.dataset), "other bits when resumed"
    finally:
        shutil.rmtree(folder)


@contextlib.contextmanager
def silent_overflow() -> Iterator[None]:
    """Silence NumPy's overflow warnings in plain Python, since compiled code gives none."""
    with np.errstate(all="ignore"):
        yield


if __name__ == "__main__":
    main()
