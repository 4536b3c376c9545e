"""Combinations of every two features of a scene: energy gradient, energy balance and bit-identical
resumption.

The rows of a table cover every pair of choices. Small beds run in plain Python with the quick tests;
`test_compiled.py` runs larger ones.
"""

import itertools
import random
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, effect, evaluate, load_scene, simulate
from granular.effects.effect import EFFECTS
from granular.shared.errors import InputError
from tests.granular.run.test_simulate import pull
from tests.plain_python.test_drawn_scenes import FORMULA
from tests.plain_python.test_every_effect import EXAMPLES

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

STEP, STEPS = 4e-5, 4
WALLS = dict.fromkeys(("left", "right", "bottom", "top"), "experimental")


TILTS: dict[str, dict[str, Any]] = {
    "friction of second order": {"torque": "second"},
    "aligned tilts": {"tilt": "aligned"},
    "independent tilts": {"tilt": "independent"},
}
LAW = {"energy": "a*q1*q2*exp(-r/l)", "a": "30 uJ", "l": "3 mm"}
REACH = {"pair law below a spacing": 0.8, "pair law above spacings": 6.0}
"""[D]"""
MACHINES: dict[str, dict[str, Any]] = {
    "cell": {"bodies": [{"mass": "0.5 kg", "stiffness": "400 N/m", "damping": "0.2 kg/s"}]},
    "piston": {"bodies": [{"mass": "0.5 kg", "stiffness": "400 N/m"}], "cell_mass": "0.3 kg"},
    "base": {"bodies": [], "excitation": {"acceleration": "5 m/s^2", "frequency": "90 Hz"}},
}
"""Carriers of the cell, by mount."""
STAGES: dict[str, dict[str, Any]] = {
    "hold": {},
    "move": {"to": -0.05},
    "path": {"height": "h0 - a*(1 - cos(w*t))", "a": "0.02 D", "w": "5000 1/s"},
    "follow": {"times": [0.0, 1.5 * STEP, STEPS * STEP], "heights": [0.0, -0.02, -0.01]},
    "free": {},
    "force": {"force": "f*exp(-t/s)", "f": "-0.5 N", "s": "0.1 ms"},
}
"""Heights relative to the initial height of the piston [D]."""
OWN = ("Time", "Grain")
"""Names of own effects that a dataset or a kernel might take for something else."""
for own in OWN:
    effect(pull(own))
ACTING = {name: one for name, one in EXAMPLES.items() if name != "host"} | {
    name: [LAW | {"reach": f"{reach} D"}] for name, reach in REACH.items()
}
ACTING |= TILTS
TAILED = "pair law with a tail"
ACTING[TAILED] = [FORMULA]
PERIODIC = {name for name, one in EFFECTS.items() if one.periodic} | {*TILTS, *REACH, TAILED}
METHODS: dict[str, dict[str, Any]] = {
    "direct": {"method": "direct"},
    "far pairs less often": {"method": "direct", "far_every": 4},
    "cut-off": {"method": "cut-off", "cut_off": "4 D"},
    "verlet-list": {"method": "verlet-list", "cut_off": "4 D", "skin": "1 D"},
    "mesh": {"method": "mesh"},
}
SMALL, FULL = (8, 14), (92, 368)
MESH_REACH = {8: (6.0, 5.5), 14: (7.5, 7.0), 92: (30.0, 11.0), 368: (60.0, 20.0)}
"""Width and height of a closed cell [D]."""

FACTORS: dict[str, tuple[Any, ...]] = {
    "effect": tuple(ACTING),
    "method": tuple(METHODS),
    "species": (1, 2),
    "spread": (0.0, 0.1),
    "sides": ("closed", "periodic"),
    "magnets": ("dipoles", "cylinders"),
    "threads": (1, 2),
    "size": (0, 1),
    "resumed": (False, True),
    "stage": tuple(STAGES),
    "mount": ("none", *MACHINES),
    "own": ("none", *OWN),
    "aspect": ("square", "flat"),
    "fields": (0, 3),
}
Row = dict[str, Any]

BOUNDED = {
    "walls": "the scene has no piston",
    "own walls": "the scene has no piston",
    "walls of the guide": "the scene has no piston",
    "wall_friction": "the cell has no side wall for friction",
}
"""What misses the bounds of a closed cell before anything else."""

REFUSED: list[tuple[Row, str]] = [
    *(
        ({"effect": name, "sides": "periodic"}, BOUNDED.get(name, "in a cell with periodic sides"))
        for name in ACTING
        if name not in PERIODIC
    ),
    ({"effect": "far_pairs", "sides": "periodic"}, "does not vanish within"),
    ({"effect": TAILED, "magnets": "cylinders"}, "a tail cannot be combined with"),
    ({"method": "verlet-list", "sides": "periodic"}, "does not support periodic images"),
    ({"method": "verlet-list", "magnets": "cylinders"}, "supports only dipoles"),
    ({"method": "far pairs less often", "sides": "periodic"}, "has no far field"),
    *(
        ({"mount": name, "method": "far pairs less often"}, "a host needs the whole force")
        for name in MACHINES
    ),
    *(({"mount": name, "effect": "shaking"}, "already moves the cell") for name in MACHINES),
    *(({"mount": name, "effect": "bath"}, "ignores the motion of a host") for name in MACHINES),
    *(
        ({"mount": name, "sides": "periodic"}, "periodic sides|a piston on a host or spring needs a mass")
        for name in MACHINES
    ),
    *(({"own": name, "sides": "periodic"}, "in a cell with periodic sides") for name in OWN),
    ({"fields": 3, "sides": "periodic"}, "in a cell with periodic sides"),
    *(({"stage": name, "sides": "periodic"}, "moves the piston") for name in STAGES if name != "hold"),
]
"""Pairs that exclude each other, and the words that say so: what knows of no images or needs a piston, and a
host, whose motion needs the whole force and which alone moves the cell."""


def refused(row: Row) -> bool:
    return any(one.items() <= row.items() for one, _ in REFUSED)


def parameter_bounds(row: Row) -> set[tuple[Any, ...]]:
    return {(a, row[a], b, row[b]) for a, b in itertools.combinations(FACTORS, 2)}


CHEAPER = ("sides", "resumed", "threads", "size", "mount", "stage", "own", "aspect", "fields", "magnets")
"""Factors whose first level takes less time."""


def table_of_pairs(seed: int) -> list[Row]:
    """Return rows that cover every allowed pair of choices.

    Each row is the candidate with the most new pairs.
    """
    draw = random.Random(seed)
    allowed = [
        (a, one, b, other)
        for a, b in itertools.combinations(FACTORS, 2)
        for one, other in itertools.product(FACTORS[a], FACTORS[b])
        if not refused({a: one, b: other})
    ]
    missing, rows = set(allowed), []
    for a, one, b, other in sorted(allowed, key=repr):
        if (a, one, b, other) not in missing:
            continue
        drawn: list[Row] = []
        while len(drawn) < 30:
            row = {name: draw.choice(levels) for name, levels in FACTORS.items()}
            row |= {a: one, b: other}
            if not refused(row):
                drawn.append(row)
        rows.append(max(drawn, key=lambda row: len(parameter_bounds(row) & missing)))
        missing -= parameter_bounds(rows[-1])
    held = Counter(pair for row in rows for pair in parameter_bounds(row))
    for row in rows:
        make_cheaper(row, held)
    return rows


def make_cheaper(row: Row, held: Counter[tuple[Any, ...]]) -> None:
    """Simplify the row in place if every pair remains covered; ``held`` counts the rows of each pair."""
    for name in CHEAPER:
        pairs = {pair for pair in parameter_bounds(row) if name in pair}
        if all(held[pair] > 1 for pair in pairs):
            held.subtract(pairs)
            row[name] = FACTORS[name][0]
            held.update(pair for pair in parameter_bounds(row) if name in pair)


ROWS = table_of_pairs(1)


def named(row: Row) -> str:
    return "-".join(str(value) for value in row.values())


def stage_of(kind: str, height: float) -> dict[str, Any]:
    """Return a stage of the run's duration, in a cell of a given height [D]."""
    more = dict(STAGES[kind])
    if kind == "follow":
        more["heights"] = [f"{height + over} D" for over in more["heights"]]
    else:
        more["duration"] = STEPS * STEP
    if kind == "move":
        more["to"] = f"{height + more['to']} D"
    return {"name": "only", "kind": kind} | more


def scene_of(row: Row, sizes: tuple[int, int]) -> Scene:
    """Return a bed with the features of a row and moving grains."""
    count, name, around = sizes[row["size"]], row["effect"], row["sides"] == "periodic"
    if around and row["method"] in ("mesh", "cut-off"):
        count = max(count, 40)
    key: dict[str, Any] = {"own walls": "walls", "walls of the guide": "walls"}
    key |= dict.fromkeys((*REACH, TAILED), "pair_law") | dict.fromkeys(TILTS, "friction")
    width, height = (max(2.0 * count**0.5, 17.5),) * 2 if around else MESH_REACH[count]
    if row["aspect"] == "flat":  # the mesh's error is over the forces of a bed as dense as a periodic one
        width, count = (2.0 * width, 2 * count) if around else (4.0 * width, count)
    species = [{"name": "big", "diameter": "6 mm", "share": 1.0 if row["species"] == 1 else 0.6}]
    if row["species"] == 2:
        species.append({"name": "small", "diameter": "4 mm", "share": 0.4})
    acting: dict[str, Any] = {"dipole": True} | ({} if around else {"walls": WALLS})
    acting |= {key.get(name, name): ACTING[name]}
    if row["mount"] != "none":
        acting["host"] = MACHINES[row["mount"]] | {"mount": row["mount"]}
    if row["own"] != "none":
        acting[row["own"].lower()] = {"k": "0.1 N/m"}
    if row["fields"]:
        more = [{"energy": "k*y**2/2", "k": f"{0.1 * k} N/m"} for k in range(1, row["fields"] + 1)]
        acting["field"] = [*acting.get("field", []), *more]
    bed = load_scene("bed").to_plain()
    plain = {
        "grains": bed["grains"]
        | {"count": count, "species": species, "spread": row["spread"], "magnets": row["magnets"]},
        "cell": {"width": f"{width} D"} | ({"sides": "periodic", "height": f"{height} D"} if around else {}),
        "effects": acting,
        "pairs": METHODS[row["method"]],
        "arrangement": {"speed": "30 D/s", "jitter": 0.1},
        "protocol": [stage_of(row["stage"], height)],
        "output": {"scalars": STEPS * STEP, "frames": STEPS * STEP},  # far pairs act every fourth step
    }
    if not around:
        plain["piston"] = {"height": f"{height} D", "mass": "0.2 kg"}
    scene = Scene.from_plain(plain)
    if name == "contact":
        place, velocity = scene.initial_positions_and_velocities()
        near = (0.97 if row["magnets"] == "dipoles" else 0.995) * scene.grains.diameters()[:2].mean()
        place[1] = place[0] + [near, 0.0]
        moved = {"positions": place.tolist(), "velocities": velocity.tolist()}
        scene = scene.replace(arrangement=moved)
    return scene


def check_forces(scene: Scene, row: Row) -> None:
    """Assert that forces are finite and the negative gradient of the energy."""
    place = scene.initial_positions_and_velocities()[0]
    found = evaluate(scene, place)
    assert np.isfinite(found.force).all()
    assert np.isfinite(found.potential_energy)
    way = np.random.default_rng(3).normal(size=place.shape)
    h = 2e-5 * 0.006 / np.abs(way).max()

    def energy(steps: float) -> float:
        return evaluate(scene, place + steps * h * way).potential_energy

    slope = (8.0 * (energy(1) - energy(-1)) - (energy(2) - energy(-2))) / (12.0 * h)
    size = float(np.abs(found.force * way).sum())
    error = 1e-4 if row["method"] == "mesh" else 1e-7
    assert abs(float((found.force * way).sum()) + slope) < error * size


def check_run(scene: Scene, row: Row, out: Path) -> None:
    """Assert that a short run has a closed energy balance, no negative losses, and a bit-identical
    resumption.
    """
    words: dict[str, Any] = {"dt": STEP, "progress": False}
    integer = simulate(scene, t_end=STEPS * STEP, threads=row["threads"], **words)
    # Impacts take few of these steps, and discs push each other twice as hard there.
    impact = {"dipoles": 2e-3, "cylinders": 4e-3}[row["magnets"]]
    assert float(integer.settings()["ledger_residual"]) < (impact if row["effect"] == "contact" else 1e-3)
    for variable, values in integer.dataset.items():
        assert np.isfinite(values.values).all(), variable
        if str(variable).endswith("_loss") and row["effect"] != "bath":
            assert (np.diff(values.values) >= -1e-18).all(), variable
    other = integer
    if row["resumed"]:
        simulate(scene, t_end=STEP, threads=row["threads"], out=out, **words)
        other = simulate(scene, t_end=STEPS * STEP, out=out, resume=True, **words)
    elif row["threads"] > 1:
        other = simulate(scene, t_end=STEPS * STEP, **words)
    for variable in ("position", "velocity"):
        np.testing.assert_array_equal(
            integer.dataset[variable].values[-1], other.dataset[variable].values[-1], strict=True
        )


def check(row: Row, sizes: tuple[int, int], out: Path) -> None:
    scene = scene_of(row, sizes)
    check_forces(scene, row)
    check_run(scene, row, out)


def test_table_of_feature_combinations_contains_every_allowed_pair() -> None:
    held = set().union(*map(parameter_bounds, ROWS))
    for a, b in itertools.combinations(FACTORS, 2):
        for one, other in itertools.product(FACTORS[a], FACTORS[b]):
            assert ((a, one, b, other) in held) != refused({a: one, b: other})


@pytest.mark.parametrize("row", ROWS, ids=named)
def test_every_pair_of_scene_features_works_in_a_small_bed(row: Row, tmp_path: Path) -> None:
    check(row, SMALL, tmp_path)


@pytest.mark.parametrize(("levels", "words"), REFUSED, ids=str)
def test_pairs_of_scene_features_absent_from_the_table_are_refused_in_one_line(
    levels: Row, words: str
) -> None:
    plain = {name: values[0] for name, values in FACTORS.items()} | {"effect": "dipole"}
    with pytest.raises(InputError, match=words):
        simulate(scene_of(plain | levels, SMALL), dt=STEP, t_end=STEP, progress=False)
