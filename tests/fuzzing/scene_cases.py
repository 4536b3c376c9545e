"""Random scenes with settings of their runs, some valid and some corrupted, each from a seed and a number."""

import copy
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from trials import Random, between, one_of, random_of, some

COMMON = (
    {"walls", "gravity"},
    {"dipole", "walls", "gravity", "drag"},
    {"dipole", "walls", "gravity", "friction"},
    {"dipole", "walls", "gravity", "drag", "contact"},
)
"""Effects of the cases that are compiled too: other effects require further compilation."""


class Case:
    """A random scene with settings of its run, determined by a seed and a number."""

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


MOST_GRAINS = 12

Plain = dict[str, Any]


def species(random: Random) -> list[Plain]:
    count = 1 if some(random, 0.7) else int(random.integers(2, 4))
    fractions = random.dirichlet(np.ones(count))
    sizes = between(random, 1e-3, 2e-2) * random.uniform(0.4, 1.5, count)
    rows = zip(sizes.tolist(), fractions.tolist(), strict=True)
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
    """Return random parameters for the named effects.

    `size` has the width and height of the cell and the diameter of the largest grain.
    """
    found: Plain = {name: {} for name in sorted(names)}
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
        torque = one_of(random, ("first", "second"))
        found["friction"] = {
            "dynamic": dynamic,
            "static": dynamic + random.uniform(0.0, 0.5),
            "torque": torque,
            "tilt": "bound" if torque == "second" else one_of(random, ("bound", "aligned", "independent")),
            "scheme": "regularised" if some(random, 0.3) else "velocity",
            "threshold": between(random, 1e-12, 1e-3),
            "load": one_of(random, (0.0, 0.01, 1.0)),
        }
    if "contact" in names:
        found["contact"] = {"modulus": between(random, 1e4, 1e10), "restitution": random.uniform(0.05, 1.0)}
    if "shaking" in names:
        found["shaking"] = {
            "amplitude": between(random, 1e-6, 1e-2),
            "frequency": between(random, 1.0, 200.0),
            "angle": random.uniform(-4.0, 4.0),
        }
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
            "duration": duration,
            "amplitude": between(random, 1e-3, 10.0),
            "frequency": between(random, 1.0, 100.0),
            "mean": random.normal(),
        },
        "move": {"to": to, "duration": duration},
        "descend": {"to": to, "duration": duration, "steepness": between(random, 0.1, 20.0)},
        "follow": {"times": [0.0, 0.4 * duration, duration], "heights": [height, to, height]},
        "oscillate": {
            "amplitude": height * between(random, 1e-3, 0.3),
            "duration": duration,
            "frequency": random.uniform(0.3, 5.0) / duration,
        },
        "lift": {"by": height * random.uniform(-0.05, 0.3)},
    }[kind]
    if kind == "move" and some(random, 0.4):
        parts |= {"speed": abs(to - height) / duration + 1e-9}
        del parts["duration"]
        if some(random, 0.5):
            parts["until_force"] = between(random, 1e-3, 1.0)
    if kind in ("hold", "free") and some(random, 0.15):
        parts |= {"until": "rest", "window": 0.5 * duration}
    return {"kind": kind, "name": name, **parts}


def sound_scene(random: Random, names: set[str], common: bool) -> Plain:
    """Return the plain data of a scene that can usually be run."""
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
            "height": height,
            "jitter": random.uniform(0.0, 0.2),
            "seed": int(random.integers(99)),
            "speed": 0.0 if some(random, 0.5) else between(random, 1e-4, 10.0),
        },
        "output": {"scalars": record, "frames": record * int(random.integers(1, 4))},
        "effects": effects(random, names, (width, 1.3 * height, widest), piston),
    }
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
        plain["arrangement"] = {
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
    "symplectic-euler",
    "position-verlet",
    "adaptive-verlet",
    "forest-ruth",
    "pefrl",
    "blanes-moan-4",
    "blanes-moan-6",
    "yoshida-6",
    "kahan-li-8",
    "stormer-verlet+compensated",
    "pefrl+compensated",
    "adaptive-verlet+compensated",
)
CONTROLS = ("explicit-euler", "runge-kutta-4")
"""Methods for scenes without dissipation."""


def arguments(random: Random, plain: Plain, common: bool) -> Plain:
    """Return random settings for a run of the scene."""
    record = plain["output"]["scalars"]
    found: Plain = {"dt": "auto"}
    effects = plain["effects"]
    dry = "friction" in effects or "contact" in effects or plain.get("piston", {}).get("friction")
    if some(random, 0.35):
        found["dt"] = one_of(random, ("auto/2", "auto*2", "auto*2" if dry else "auto*8"))
    elif some(random, 0.35):
        found["dt"] = record / random.uniform(1.0, 40.0)
    if not common and some(random, 0.05 if dry else 0.6):
        damped = "drag" in effects or plain.get("piston", {}).get("drag")
        found["method"] = one_of(random, METHODS if dry or damped else METHODS + CONTROLS)
        if found["method"].startswith("adaptive") and some(random, 0.9):
            found["dt"] = "auto"
    if some(random, 0.3):
        found["t_end"] = record * random.uniform(0.2, 8.0)
    return found


ODD: tuple[Any, ...] = (
    0,
    -1,
    1,
    2,
    2**53 + 1,
    2**63,
    -(2**70),
    1e-300,
    1e-30,
    1e-29,
    1e-12,
    1e12,
    1e29,
    1e30,
    1e300,
    -1e30,
    math.nan,
    math.inf,
    -math.inf,
    True,
    False,
    None,
    "",
    "none",
    "5 mm",
    "1 D",
    "3 kg",
    "1e3",
    "x" * 300,
    "\x1b[31mred",
    "magnétique 磁",
    [],
    {},
    [1],
    [[1, 2]],
    [[1, 2, 3]],
    {"a": 1},
)


def leaves(plain: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the place of every value in a nested structure: its container, and the key or index there."""
    items = plain.items() if isinstance(plain, dict) else enumerate(plain)
    for key, value in list(items):
        yield plain, key
        if isinstance(value, dict | list):
            yield from leaves(value)


def spoil(random: Random, plain: Plain) -> None:
    """Replace one value of a scene by an unusual one, in most cases a number."""
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
