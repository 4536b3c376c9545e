"""Random scenes that most often can be run, and how they are to be run."""

import math
from typing import Any

import numpy as np
from draws import between, one_of, some
from trials import Random

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
    """The effects of those names, for a cell of a width and height, and the widest grain."""
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
        damped = "drag" in effects or plain.get("piston", {}).get("drag")
        found["method"] = one_of(random, METHODS if dry or damped else METHODS + CONTROLS)
        if found["method"].startswith("adaptive") and some(random, 0.9):
            found["dt"] = "auto"
    if some(random, 0.3):
        found["t_end"] = record * random.uniform(0.2, 8.0)
    return found
