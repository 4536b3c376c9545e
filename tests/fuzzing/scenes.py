"""Random scenes, sound and unsound, and what becomes of them: fine, refused, stopped, or a fault.

A program, of which `trials` tells:

    NUMBA_DISABLE_JIT=1 python tests/fuzzing/scenes.py --first 0 --count 20
    NUMBA_DISABLE_JIT=1 python tests/fuzzing/scenes.py --first 17 --count 1 --show
"""

from __future__ import annotations

import contextlib
import copy
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
from trials import FAULT, LONGEST, MOST_MEMORY, Hang, Outcome, Random, random_of, tell, wanted

MOST_GRAINS = 12

Plain = dict[str, Any]

ODD: tuple[Any, ...] = (
    0, -1, 1, 2, 2**53 + 1, 2**63, -(2**70), 1e-300, 1e-30, 1e-29, 1e-12, 1e12, 1e29, 1e30, 1e300,
    -1e30, math.nan, math.inf, -math.inf, True, False, None, "", "none", "5 mm", "1 D", "3 kg",
    "1e3", "x" * 300, "\x1b[31mred", "magnétique 磁", [], {}, [1], [[1, 2]], [[1, 2, 3]], {"a": 1},
)  # fmt: skip

COMMON = (
    {"walls", "gravity"},
    {"dipole", "walls", "gravity", "drag"},
    {"dipole", "walls", "gravity", "friction"},
    {"dipole", "walls", "gravity", "drag", "contact"},
)
"""Effects of the cases that are compiled too: what others add makes the compiler work anew."""


def some(random: Random, chance: float) -> bool:
    return bool(random.random() < chance)


def one_of(random: Random, choices: Any) -> Any:
    return choices[int(random.integers(len(choices)))]


def between(random: Random, low: float, high: float) -> float:
    """A number whose logarithm is evenly spread."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


# A sound scene ---------------------------------------------------------------------------------


def species(random: Random) -> list[Plain]:
    count = 1 if some(random, 0.7) else int(random.integers(2, 4))
    shares = random.dirichlet(np.ones(count))
    sizes = between(random, 1e-3, 2e-2) * random.uniform(0.4, 1.5, count)
    rows = zip(sizes.tolist(), shares.tolist(), strict=True)
    return [{"name": f"s{k}", "diameter": d, "share": s} for k, (d, s) in enumerate(rows)]


def walls(random: Random, width: float, height: float, widest: float, piston: bool) -> Plain:
    sides: Plain = {"left": {}, "right": {}, "bottom": {}, "top": {}}
    if not piston:
        sides["top"] = "none"
    for side in sides:
        if sides[side] == "none":
            continue
        if some(random, 0.1):
            sides[side] = "none"
        elif some(random, 0.2):
            sides[side] = {"law": "infinite"}
        elif some(random, 0.15):
            sides[side] = {"law": "slab"}
            if side in ("left", "right"):
                sides[side]["length"] = height * random.uniform(1.2, 3.0)
            elif side == "bottom" and some(random, 0.6):
                start = width * random.uniform(0.05, 0.6)
                sides[side] |= {"gap_start": start, "gap_end": start + 2.0 * widest}
    return sides


def effects(random: Random, names: set[str], size: tuple[float, ...], piston: bool) -> Plain:
    """The effects of those names, for a cell of a width and height, and the widest grain."""
    found: Plain = {name: {} for name in names}
    if "walls" in names:
        found["walls"] = walls(random, *size, piston) if some(random, 0.6) else {}
        if not piston:
            found["walls"] |= {"top": "none"}
    if "gravity" in names and some(random, 0.3):
        found["gravity"] = {"acceleration": between(random, 1e-2, 1e3)}
    if "drag" in names:
        found["drag"] = {"coefficient": between(random, 1e-3, 1e2)}
    if "friction" in names:
        dynamic = random.uniform(0.0, 1.0)
        found["friction"] = {
            "dynamic": dynamic,
            "static": dynamic + random.uniform(0.0, 0.5),
            "torque": one_of(random, ("first", "second")),
            "scheme": "regularised" if some(random, 0.3) else "velocity",
            "threshold": between(random, 1e-12, 1e-3),
            "load": one_of(random, (0.0, 0.01, 1.0)),
        }
    if "contact" in names:
        found["contact"] = {
            "modulus": between(random, 1e4, 1e10), "restitution": random.uniform(0.05, 1.0)
        }  # fmt: skip
    if "shaking" in names:
        found["shaking"] = {
            "amplitude": between(random, 1e-6, 1e-2), "frequency": between(random, 1.0, 200.0),
            "angle": random.uniform(-4.0, 4.0),
        }  # fmt: skip
    return found


def stage(random: Random, name: str, height: float, record: float, free: bool) -> Plain:
    kinds = ("hold", "move", "descend", "follow", "oscillate", "lift")
    kind = one_of(random, (*kinds, "free", "free", "push", "push") if free else kinds)
    duration = record * random.uniform(0.3, 5.0)
    to = height * random.uniform(0.8, 1.2)
    parts: Plain = {
        "hold": {"duration": duration},
        "free": {"duration": duration},
        "push": {
            "duration": duration, "amplitude": between(random, 1e-3, 10.0),
            "frequency": between(random, 1.0, 100.0), "mean": random.normal(),
        },
        "move": {"to": to, "duration": duration},
        "descend": {"to": to, "duration": duration, "steepness": between(random, 0.1, 20.0)},
        "follow": {"times": [0.0, 0.4 * duration, duration], "heights": [height, to, height]},
        "oscillate": {
            "amplitude": height * between(random, 1e-3, 0.3), "duration": duration,
            "frequency": random.uniform(0.3, 5.0) / duration,
        },
        "lift": {"by": height * random.uniform(-0.05, 0.3)},
    }[kind]  # fmt: skip
    if kind == "move" and some(random, 0.4):
        parts |= {"speed": abs(to - height) / duration + 1e-9}
        del parts["duration"]
        if some(random, 0.5):
            parts["until_force"] = between(random, 1e-3, 1.0)
    if kind in ("hold", "free") and some(random, 0.15):
        parts |= {"until": "rest", "window": 0.5 * duration}
    return {"kind": kind, "name": name, **parts}


def sound_scene(random: Random, names: set[str], common: bool) -> Plain:
    """Plain data of a scene that most often can be run."""
    kinds = species(random)[: 1 if common else 3]
    if common:
        kinds[0]["share"] = 1.0
    count = int(random.integers(0, MOST_GRAINS + 1))
    widest = max(one["diameter"] for one in kinds)
    side = (math.ceil(math.sqrt(max(count, 1))) + 1) * widest
    width, height = (side * random.uniform(1.3, 4.0) for _ in range(2))
    piston = common or some(random, 0.75)
    record = between(random, 1e-4, 5e-3)
    plain: Plain = {
        "name": "fuzz",
        "grains": {"count": count, "species": kinds},
        "cell": {"width": width},
        "arrangement": {
            "height": height, "jitter": random.uniform(0.0, 0.2), "seed": int(random.integers(99)),
            "speed": 0.0 if some(random, 0.5) else between(random, 1e-4, 10.0),
        },
        "output": {"scalars": record, "frames": record * int(random.integers(1, 4))},
        "effects": effects(random, names, (width, 1.3 * height, widest), piston),
    }  # fmt: skip
    if "friction" in names:
        plain["grains"]["thickness"] = 0.6 * min(one["diameter"] for one in kinds)
        plain["cell"]["separation"] = 1.03 * plain["grains"]["thickness"]
    top = "walls" in names and plain["effects"]["walls"].get("top") != "none"
    free = piston and top and some(random, 0.5)
    if piston:
        plain["piston"] = {"height": height * random.uniform(1.0, 1.3)}
        if free:
            plain["piston"] |= {"mass": between(random, 1e-3, 10.0)}
            if not common and some(random, 0.5):
                plain["piston"] |= {
                    "drag": one_of(random, (0.0, 0.1, 10.0)),
                    "friction": one_of(random, (0.0, 0.01, 1.0)),
                }
    start = plain["piston"]["height"] if piston else height
    stages = int(random.integers(1, 4))
    plain["protocol"] = [stage(random, f"p{k}", start, record, free) for k in range(stages)]
    if not piston:
        plain["protocol"] = [{"kind": "hold", "name": "p0", "duration": 3.0 * record}]
    if some(random, 0.15):
        plain["arrangement"] |= {
            "positions": (random.uniform(0.1, 0.9, (count, 2)) * [width, height]).tolist(),
            "velocities": random.normal(0.0, 0.1, (count, 2)).tolist(),
        }
    if not common and some(random, 0.5):
        closed = names >= {"walls"} and plain["effects"]["walls"] == {} and piston
        methods = ("direct", "cut-off", "verlet-list", *(("mesh", "mesh") if closed else ()))
        plain["pairs"] = {"method": one_of(random, methods)}
        if plain["pairs"]["method"] != "direct" and some(random, 0.5):
            plain["pairs"]["cut_off"] = widest * random.uniform(0.5, 20.0)
    return plain


METHODS = (
    "symplectic-euler", "position-verlet", "adaptive-verlet", "forest-ruth", "pefrl",
    "blanes-moan-4", "blanes-moan-6", "yoshida-6", "kahan-li-8", "explicit-euler", "runge-kutta-4",
    "stormer-verlet+compensated", "pefrl+compensated", "adaptive-verlet+compensated",
)  # fmt: skip


def arguments(random: Random, plain: Plain, common: bool) -> Plain:
    """How the scene is to be run."""
    record = plain["output"]["scalars"]
    found: Plain = {"dt": "auto"}
    effects = plain["effects"]
    dry = "friction" in effects or "contact" in effects or plain.get("piston", {}).get("friction")
    if some(random, 0.35):
        found["dt"] = one_of(random, ("auto/2", "auto*2", "auto*2" if dry else "auto*8"))
    elif some(random, 0.35):
        found["dt"] = record / random.uniform(1.0, 40.0)
    if not common and some(random, 0.05 if dry else 0.6):
        found["method"] = one_of(random, METHODS)
        if found["method"].startswith("adaptive") and some(random, 0.9):
            found["dt"] = "auto"
    if some(random, 0.3):
        found["t_end"] = record * random.uniform(0.2, 8.0)
    return found


# What is wrong with it -------------------------------------------------------------------------


def leaves(plain: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of a nested structure: its container, and its key or index."""
    items = plain.items() if isinstance(plain, dict) else enumerate(plain)
    for key, value in list(items):
        yield plain, key
        if isinstance(value, dict | list):
            yield from leaves(value)


def spoil(random: Random, plain: Plain) -> None:
    """Change one place into something odd; most often a number."""
    places = list(leaves(plain))
    if some(random, 0.7):
        places = [one for one in places if isinstance(one[0][one[1]], float)] or places
    container, key = one_of(random, places)
    value = container[key]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and some(random, 0.4):
        container[key] = value * 10.0 ** random.uniform(-30.0, 30.0)
    elif number and some(random, 0.6):
        container[key] = value * 10.0 ** random.uniform(-3.0, 3.0)
    elif some(random, 0.1):
        del container[key]
    elif isinstance(container, dict) and some(random, 0.1):
        container[f"{key}x"] = container.pop(key)
    else:
        container[key] = copy.deepcopy(one_of(random, ODD))


class Case:
    """A scene and how it is run, from a seed and a number.

    Attributes
    ----------
    plain : dict
        Plain data of the scene.
    arguments : dict
        Of `simulate`.
    common : bool
        Whether its effects are among the `COMMON` ones.
    compiled : bool
        Whether it is, moreover, one of the many that share compiled code.
    resumed : float or None
        Share of the run after which it is cut and resumed.
    """

    def __init__(self, seed: int, number: int) -> None:
        random = random_of(seed, number)
        self.common = some(random, 0.3)
        names = {one for one in ("dipole", "walls", "gravity") if some(random, 0.8)}
        rare = ("drag", "friction", "contact", "shaking")
        names |= {one for one in rare if some(random, 0.35)}
        if self.common:
            names = set(one_of(random, COMMON))
        self.plain = sound_scene(random, names, self.common)
        found = self.plain["effects"]
        usual = found.get("friction", {}).get("scheme") != "regularised"
        self.compiled = self.common and usual and found.get("walls") == {}
        self.arguments = arguments(random, self.plain, self.common)
        if some(random, 0.4):
            for _ in range(int(random.integers(1, 4))):
                spoil(random, self.plain)
        if some(random, 0.08):
            name = one_of(random, ("dt", "t_end", "method", "threads"))
            self.arguments[name] = copy.deepcopy(one_of(random, ODD))
        self.resumed = random.uniform(0.1, 0.9) if some(random, 0.2) else None


# What becomes of it ----------------------------------------------------------------------------


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Ctrl-C after some seconds of the processor, and `Hang` later."""
    begun = time.process_time()

    def alarm(*_: object) -> None:
        if time.process_time() - begun > LONGEST:
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
            bad = "" if part is None or part.path is not None else unfinite(part)
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


def run_case(case: Case, said: list[warnings.WarningMessage]) -> Any:
    """The run of a case, and assert what holds of every run."""
    import tomllib

    from granular import Scene, simulate
    from granular.run.summary import run_text, scene_figures, scene_text

    scene = Scene.from_plain(case.plain)
    assert Scene.from_plain(tomllib.loads(scene.to_toml())) == scene, "TOML gives another scene"
    assert scene_text(scene)
    json.dumps(scene_figures(scene))
    with nothing_split():
        run = simulate(scene, progress=False, **case.arguments)
    assert run_text(run)
    check_run(run, said)
    if case.resumed is not None and run.dataset.sizes["time"] > 1:
        check_resumed(case, run)
    return run


@contextlib.contextmanager
def nothing_split() -> Iterator[None]:
    """NumPy says what overflows in pure Python, where compiled code is silent."""
    with np.errstate(all="ignore"):
        yield


def check_run(run: Any, said: list[warnings.WarningMessage]) -> None:
    from granular.engine.ledger import doubtful

    assert run.complete
    bad = unfinite(run)
    assert not bad, bad
    data = run.dataset
    assert (np.diff(data["time"].values) >= 0.0).all(), "time runs backward"
    ended = run.stages[-1]
    assert math.isclose(ended.end, float(data["time"].values[-1]), rel_tol=1e-9), "ends elsewhere"
    words = " ".join(str(one.message) for one in said)
    off = run.settings()["ledger_residual"]
    if off > doubtful(run.scene):
        assert "energy ledger is off" in words, f"off by {off:g} without a warning"


def unfinite(run: Any) -> str:
    """What of a run is not finite, in words."""
    data = run.dataset
    gone = "grain_count" in data and (data["grain_count"].values < run.scene.grains.count).any()
    for name in data.variables:
        values = np.asarray(data[name].values)
        if values.dtype.kind != "f" or (gone and "grain" in data[name].dims):
            continue  # a grain that has left is at no place
        # Where there is but one grain, no other one is near.
        bad = np.isnan(values) if name == "closest_distance" else ~np.isfinite(values)
        if bad.any():
            return f"{name} holds {values[bad][0]}"
    return ""


def check_resumed(case: Case, whole: Any) -> None:
    """A run that is cut and goes on has the bits of one that was not."""
    from granular import Scene, load_trajectory, simulate

    assert case.resumed is not None
    scene = Scene.from_plain(case.plain)
    settings = {key: value for key, value in case.arguments.items() if key != "t_end"}
    end = float(whole.dataset["time"].values[-1])
    dt = settings.get("dt")
    first = case.resumed * end
    if isinstance(dt, float) and first < dt:
        return
    folder = Path(tempfile.mkdtemp())
    try:
        with nothing_split():
            simulate(scene, t_end=first, out=folder / "run", progress=False, **settings)
            simulate(
                scene, out=folder / "run", resume=True, progress=False, **case.arguments
            )  # fmt: skip
        again = load_trajectory(folder / "run").dataset
        assert again.equals(whole.dataset), "other bits when resumed"
    finally:
        shutil.rmtree(folder)


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
