"""Forces, energies and friction loads of random scenes, compared with brute-force sums over pairs.

Every two features that can be combined occur together in one of the scenes. `test_compiled.py` tests
the same scenes with compiled code.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from granular import Scene, effect, evaluate, quantity, simulate
from granular.shared.errors import InputError
from tests.granular.pairs.test_periodic import ewald_energy
from tests.plain_python.brute_force import (
    SIDES,
    Bed,
    Reach,
    Sums,
    WallLaw,
    bed_of,
    dipoles,
    disc_row_wall,
    discs,
    field,
    hertz,
    normal_loads,
    power_law_wall,
    slab_wall,
    sum_pairs,
    sum_wall,
)
from tests.plain_python.test_every_effect import Bumpers, HeightSpring, Soft

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

MM = 1e-3
SPECIES = (
    {"name": "big", "diameter": 6 * MM, "thickness": 3 * MM, "density": 7368.0, "remanence": 1.3},
    {"name": "small", "diameter": 4.5 * MM, "thickness": 3 * MM, "density": 7368.0, "remanence": 1.3},
    {"name": "flat", "diameter": 5 * MM, "thickness": 2 * MM, "density": 7000.0, "remanence": 1.1},
)
DISC_ENERGIES = 2.0
"""Error of the energy of discs by the mesh, over its tolerance for forces: the far field uses
one mean shift for all species, 3.6e-4 of the energy here."""
OUTPUT = 4e-6
"""Step and interval of records [s]."""
LOAD = 0.01
"""Constant load of friction [N]."""
SPACING, JITTER, CUT_OFF = 10.8 * MM, 0.9 * MM, 30 * MM
"""[m]: big grains alone are packed as at the full compression that the mesh's tolerance is for, 0.24."""
EXACT, OF_LAWS, OF_DISCS, OF_ROWS, OF_LOADS = 1e-12, 1e-9, 9e-6, 1e-6, (2e-4, 6e-4)
"""Errors over the rms of a grain's sum of sizes; of own pair laws, which may be tables, of discs
(`disc_near_law.RELATIVE`), of rows of them (test_law_of_a_row_of_discs_equals_the_sum_over_magnets) and of
their loads (test_friction_load_law_of_discs_is_accurate_beyond_the_tabulated_distances)."""

Part = tuple[dict[str, Any], Callable[[Bed], Sums]]
"""Sections of a scene, and the sums that they bring."""
PairLaw = Callable[[Bed, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Energy [J] and repulsion [N] of pairs of a bed at the distances r [m] of grains i and j."""


@effect
class Screened:
    """A screened repulsion of charges between all pairs."""

    a: float = quantity("J*m", default=3e-3)
    length: float = quantity("m", default=6e-4)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        return first.moment * second.moment * p.a * math.exp(-r / p.length) / r

    @staticmethod
    def pair_force(p: Any, r: float, first: Any, second: Any) -> Any:
        return first.moment * second.moment * p.a * math.exp(-r / p.length) / r * (1.0 / r + 1.0 / p.length)


A, LENGTH, C = 1.0, 0.5 * MM, 1e-9
"""[J m], [m], [J m^3]: the tail is a dipole law; the remainder, a quarter of it at contact of big grains,
is negligible at the cut-off."""


@effect
class Tailed:
    """A Yukawa repulsion with a tail of dipoles."""

    a: float = quantity("J*m", default=A)
    length: float = quantity("m", default=LENGTH)
    c: float = quantity("J*m^3", default=C)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        return first.moment * second.moment * (p.a * math.exp(-r / p.length) / r + p.c / r**3)

    @staticmethod
    def tail(p: Any, first: Any, second: Any) -> Any:
        return first.moment * second.moment * p.c


@effect
class ByMass:
    """A screened repulsion proportional to both masses, with a cut-off."""

    a: float = quantity("J*m/kg", default=0.3)
    length: float = quantity("m", default=2 * MM)
    end: float = quantity("m", default=25 * MM)

    @staticmethod
    def pair_energy(p: Any, r: float, first: Any, second: Any) -> Any:
        rest = max(p.end - r, 0.0) / p.end
        return p.a * (first.mass + second.mass) * math.exp(-r / p.length) / r * rest**4

    @staticmethod
    def reach(p: Any) -> Any:
        return p.end


FORMULA = {
    "energy": "q1*q2*(a*exp(-r/l)/r + c/r**3)",
    "tail": "q1*q2*c",
    "a": f"{A} J*m",
    "l": f"{LENGTH} m",
    "c": f"{C} J*m^3",
}


def gravity(draw: np.random.Generator) -> Part:
    g = draw.uniform(5.0, 15.0)

    def sums(bed: Bed) -> Sums:
        weight = bed.masses * g
        return field(bed, weight * bed.places[:, 1], np.stack((0.0 * weight, -weight), axis=1))

    return {"gravity": {"acceleration": g}}, sums


def gradient(draw: np.random.Generator) -> Part:
    slope = draw.uniform(-0.1, 0.1, 2)

    def sums(bed: Bed) -> Sums:
        force = bed.moments[:, None] * slope
        return field(bed, -(force * bed.places).sum(axis=1), force)

    return {"gradient": {"x": float(slope[0]), "y": float(slope[1])}}, sums


def formula_fields(draw: np.random.Generator) -> Part:
    k, a, length, big = draw.uniform(1.0, 3.0), draw.uniform(0.1, 0.3), 6 * MM, draw.uniform(0.2, 2.0)

    def sums(bed: Bed) -> Sums:
        x, y = bed.places.T
        factor = np.where(bed.of_species("name") == "big", big, 1.0)
        energy = factor * 0.5 * k * (y - 0.02) ** 2 + a * bed.masses * np.sin(x / length)
        force = (-a * bed.masses * np.cos(x / length) / length, -factor * k * (y - 0.02))
        return field(bed, energy, np.stack(force, axis=1))

    known = {"energy": "k*(y - h)**2/2*(1 + sin(w*t)/4)", "k": f"{k} N/m", "h": "2 cm", "w": "60 1/s"}
    second = {"energy": "a*mass*sin(x/l)", "a": f"{a} m^2/s^2", "l": f"{length} m"}
    return {"field": [known | {"factor": {"big": big}}, second]}, sums


def own_field(draw: np.random.Generator) -> Part:
    k = draw.uniform(0.5, 2.0)

    def sums(bed: Bed) -> Sums:
        up = bed.places[:, 1] - 0.015
        return field(bed, 0.5 * k * up**2, np.stack((0.0 * up, -k * up), axis=1))

    return {HeightSpring.key: {"k": k, "height": 0.015}}, sums


def contact(draw: np.random.Generator) -> Part:
    modulus = draw.uniform(1e6, 1e8)
    return {"contact": {"modulus": modulus}}, lambda bed: sum_pairs(bed, hertz(bed, modulus))


def sum_of(law: PairLaw) -> Callable[[Bed], Sums]:
    return lambda bed: sum_pairs(bed, functools.partial(law, bed))


def formula_pair_laws(draw: np.random.Generator) -> Part:
    """Return a pair law with a cut-off, and a law for all pairs that decays within a few diameters."""
    a, length, k, end = draw.uniform(1e-3, 3e-3), 6e-4, draw.uniform(0.5, 2.0), draw.uniform(0.012, 0.02)

    def law(bed: Bed, r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        screened = a * bed.ratios[i] * bed.ratios[j] * np.exp(-r / length)
        rest = np.maximum(end - r, 0.0)
        return screened + k * rest**4 / end**2, screened / length + 4.0 * k * rest**3 / end**2

    screened = {"energy": "a*q1*q2*exp(-r/l)", "a": f"{a} J", "l": f"{length} m"}
    short = {"energy": "k*max(end - r, 0)**4/end**2", "k": f"{k} N/m", "end": f"{end} m", "reach": end}
    return {"pair_law": [screened, short]}, sum_of(law)


def own_short_law(draw: np.random.Generator) -> Part:
    k, end = draw.uniform(1.0, 3.0), draw.uniform(0.012, 0.02)

    def law(bed: Bed, r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        strength, rest = k * bed.ratios[i] * bed.ratios[j], np.maximum(end - r, 0.0)
        return strength * rest**4 / end**2, 4.0 * strength * rest**3 / end**2

    return {Bumpers.key: {"k": k, "end": end}}, sum_of(law)


def own_screened_law(draw: np.random.Generator) -> Part:
    a, length = draw.uniform(6e-6, 18e-6), 6e-4
    return {Screened.key: {"a": a, "length": length}}, sum_of(yukawa(a, length))


def yukawa(a: float, length: float) -> PairLaw:
    def law(bed: Bed, r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        energy = a * bed.ratios[i] * bed.ratios[j] * np.exp(-r / length) / r
        return energy, energy * (1.0 / r + 1.0 / length)

    return law


def law_with_a_tail(sections: dict[str, Any]) -> Callable[[np.random.Generator], Part]:
    """Return a Yukawa repulsion plus c/r^3, whose power-law part is summed like dipoles."""
    short = sum_of(yukawa(A, LENGTH))

    def tail(bed: Bed) -> Sums:
        def law(r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            strength = C * bed.ratios[i] * bed.ratios[j]
            return strength / r**3, 3.0 * strength / r**4

        result = sum_pairs(bed, law, bed.reach)
        if bed.reach.images:
            result.energy = 4.0 * C / bed.size**3 * energy_of_images(bed)
        return result

    return lambda draw: (sections, lambda bed: short(bed) + tail(bed))


def law_by_mass(draw: np.random.Generator) -> Part:
    a, length, end = draw.uniform(0.1, 0.3), 2 * MM, 25 * MM

    def law(bed: Bed, r: np.ndarray, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rest = np.maximum(end - r, 0.0) / end
        energy = a * (bed.masses[i] + bed.masses[j]) * np.exp(-r / length) / r
        return energy * rest**4, energy * ((1.0 / r + 1.0 / length) * rest**4 + 4.0 * rest**3 / end)

    return {ByMass.key: {"a": a, "length": length, "end": end}}, sum_of(law)


def friction(draw: np.random.Generator) -> Part:
    """Return friction, whose load is summed with the pairs; here it exerts no force."""
    tilt = str(draw.choice(["bound", "aligned", "independent"]))
    torque = str(draw.choice(["first", "second"])) if tilt == "bound" else "first"
    return nothing({"friction": {"tilt": tilt, "torque": torque, "load": LOAD}})(draw)


def nothing(sections: dict[str, Any]) -> Callable[[np.random.Generator], Part]:
    """Return a feature that exerts no force on grains at rest and has no energy."""
    return lambda draw: (sections, lambda bed: field(bed, np.zeros(1), np.zeros((len(bed.places), 2))))


HOST = {"mount": "cell", "bodies": [{"mass": 0.5, "stiffness": 400.0, "damping": 0.2}]}
ACTING: dict[str, Callable[[np.random.Generator], Part]] = {
    "gravity": gravity,
    "gradient": gradient,
    "field": formula_fields,
    "own field": own_field,
    "contact": contact,
    "pair law": formula_pair_laws,
    "own short law": own_short_law,
    "own screened law": own_screened_law,
    "tail": law_with_a_tail({"pair_law": [FORMULA]}),
    "own tail": law_with_a_tail({Tailed.key: True}),
    "law by mass": law_by_mass,
    "friction": friction,
    "shaking": nothing({"shaking": {"amplitude": 5e-4, "frequency": 20.0, "angle": 1.0}}),
    "host": nothing({"host": HOST}),
    "drag": nothing({"drag": {"coefficient": 0.1}}),
    "eddy": nothing({"eddy": {"conductivity": 59.6e6, "thickness": MM, "distance": 4 * MM, "mutual": False}}),
    "bath": nothing({"bath": {"temperature": 2e-6, "rate": 5.0}}),
    "wall friction": nothing({"wall_friction": {"coefficient": 0.3}}),
}
"""Effects that can act besides dipoles, discs and walls."""
RECORDS = {
    "magnets": "pair_energy",
    "gravity": "weight_energy",
    "shaking": "weight_energy",
    "gradient": "gradient_energy",
    "field": "field_energy",
    "own field": f"{HeightSpring.key}_energy",
    "contact": "contact_energy",
    "pair law": "pair_law_energy",
    "own short law": f"{Bumpers.key}_energy",
    "own screened law": f"{Screened.key}_energy",
    "tail": "pair_law_energy",
    "own tail": f"{Tailed.key}_energy",
    "law by mass": f"{ByMass.key}_energy",
    "host": "host_energy",
} | dict.fromkeys(SIDES, "wall_energy")
"""Energies as a run records them."""


ROW = {"law": "discs", "pitch": 7 * MM}


def wall(name: str, bed_width: float, height: float, side: str) -> tuple[Any, Callable[[Bed], WallLaw]]:
    """Return the scene section of a wall, and the law for the brute-force sum."""
    upright = side in ("left", "right")
    if name == "experimental wall":
        return "experimental", lambda bed: power_law_wall(bed, 0.5, 3.5)
    if name == "infinite wall":
        return "infinite", lambda bed: power_law_wall(bed, 1.0, 3.0)
    if name == "slab":
        length = 1.3 * height if upright else bed_width
        section = {"law": "slab"} | ({"length": length} if upright else {})
        return section, lambda bed: slab_wall(bed, ((0.0, length),))
    if name == "gap":
        start, end = 0.3 * bed_width, 0.45 * bed_width
        section = {"law": "slab", "gap_start": start, "gap_end": end}
        return section, lambda bed: slab_wall(bed, ((0.0, start), (end, bed_width)))
    if name == "wall of discs":
        return ROW, lambda bed: disc_row_wall(bed, 7 * MM)
    if name == "formula wall":
        energy = {"energy": "a*(l/w)**3", "a": "20 uJ", "l": "6 mm"}

        def by_formula(bed: Bed) -> WallLaw:
            return lambda w, along: (
                bed.ratios * 2e-5 * (6 * MM / w) ** 3,
                bed.ratios * 6e-5 / w * (6 * MM / w) ** 3,
                0.0 * w,
            )

        return energy, by_formula

    def soft(bed: Bed) -> WallLaw:
        return lambda w, along: (
            bed.ratios * 4.0 * np.maximum(0.018 - w, 0.0) ** 4 / 0.018**2,
            bed.ratios * 16.0 * np.maximum(0.018 - w, 0.0) ** 3 / 0.018**2,
            0.0 * w,
        )

    return {"law": Soft.definition.key, "k": 4.0, "end": 0.018}, soft


METHODS: dict[str, dict[str, Any]] = {
    "direct": {"method": "direct"},
    "far pairs less often": {"method": "direct", "far_every": 4},
    "cut-off": {"method": "cut-off", "cut_off": CUT_OFF},
    "verlet-list": {"method": "verlet-list", "cut_off": CUT_OFF, "skin": 6 * MM},
    "mesh": {"method": "mesh"},
}
WALLS = ("experimental wall", "infinite wall", "slab", "gap", "wall of discs", "formula wall", "own wall")
CHOICES: dict[str, tuple[str, ...]] = {
    "sum": tuple(METHODS),
    "species": ("one species", "two species", "three species"),
    "moments": ("alike", "scatter"),
    "magnets": ("dipoles", "cylinders"),
    "sides": ("closed", "periodic"),
}
FEATURES = (*itertools.chain(*CHOICES.values()), *ACTING, *WALLS)
TAILS = ("tail", "own tail")
OWN_PAIR_LAWS = ("pair law", "own short law", "own screened law", "law by mass", *TAILS)
WITH_IMAGES = ("friction", "drag", "eddy", "bath", "contact", *OWN_PAIR_LAWS)
NO_IMAGES = "cannot act in a cell with periodic sides|the scene has no piston|the cell has no side wall"
EXCLUDED: dict[frozenset[str], str] = {
    frozenset(pair): words
    for *pair, words in (
        ("cylinders", "verlet-list", "supports only dipoles"),
        *(("cylinders", one, "a tail cannot be combined with") for one in TAILS),
        ("periodic", "verlet-list", "does not support periodic images"),
        ("periodic", "far pairs less often", "has no far field"),
        ("mesh", "gap", "give four walls without a gap"),
        ("host", "gap", "cannot carry a cell with gaps"),
        ("host", "far pairs less often", "needs the whole force"),
        ("host", "shaking", "already moves the cell"),
        ("host", "bath", "ignores the motion of a host"),
        *((one, "bath", "would hold at rest") for one in ("contact", "friction", "wall friction")),
        ("friction", "wall friction", "cannot act together"),
        *((one, "periodic", NO_IMAGES) for one in ACTING if one not in WITH_IMAGES),
        *((one, "periodic", NO_IMAGES) for one in WALLS),
    )
}
"""Pairs that a scene refuses, and words of the line that says so."""


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Features of a scene, and the seed of its dimensions and positions."""

    features: frozenset[str]
    seed: int

    def __str__(self) -> str:
        return "-".join(name.replace(" ", "_") for name in FEATURES if name in self.features)

    def chosen(self, kind: str) -> str:
        return next(name for name in CHOICES[kind] if name in self.features)


def pairs_of(features: frozenset[str]) -> set[frozenset[str]]:
    return {frozenset(pair) for pair in itertools.combinations(sorted(features), 2)}


def draw_features(random: np.random.Generator, wanted: frozenset[str]) -> frozenset[str]:
    """Draw random features of a scene, including the requested ones."""
    while True:
        features = {str(random.choice(names)) for names in CHOICES.values() if not wanted & set(names)}
        if not wanted & set(CHOICES["sides"]) and random.random() < 0.5:  # there more can act
            features = features - {"periodic"} | {"closed"}
        features |= wanted | {name for name in ACTING if random.random() < 0.4}
        if "closed" in features:
            features |= {str(name) for name in random.choice(WALLS, 3)}
        else:
            features -= set(ACTING) - set(WITH_IMAGES)
        if wanted <= features and not pairs_of(frozenset(features)) & set(EXCLUDED) and fits(features):
            return frozenset(features)


def fits(features: set[str]) -> bool:
    """Return False if walls or wall friction have no side to act on."""
    walls = [name for name in WALLS if name in features]
    sides = [name for name in walls if name not in ("slab", "wall of discs", "gap")]
    if "wall friction" in features and ("closed" not in features or not sides):
        return False
    rubbed = "wall friction" in features
    return len(walls) <= 4 and not (rubbed and len(walls) - len(sides) > 2)


def draw_scenes(count: int, seed: int) -> list[Drawn]:
    """Draw scenes; each is the one of several candidates with the most new pairs of features."""
    random, scenes = np.random.default_rng(seed), []
    missing = {pair for pair in every_pair() if pair not in EXCLUDED}
    for number in range(count):
        wanted = min(missing, key=sorted) if missing else frozenset[str]()
        drawn = [draw_features(random, wanted) for _ in range(20)]
        best = max(drawn, key=lambda features: len(pairs_of(features) & missing))
        scenes.append(Drawn(best, number))
        missing -= pairs_of(best)
    return scenes


def every_pair() -> set[frozenset[str]]:
    """Return all pairs of features, except two alternatives of the same choice."""
    alike = {frozenset(pair) for names in CHOICES.values() for pair in itertools.combinations(names, 2)}
    return {frozenset(pair) for pair in itertools.combinations(FEATURES, 2)} - alike


SCENES = [
    *draw_scenes(24, seed=6),
    *(
        Drawn(frozenset({"cylinders", "friction", *more}), number)
        for number, more in enumerate(
            (
                {"mesh", "closed", "two species", "scatter"},
                {"mesh", "periodic", "one species", "alike"},
                {"direct", "periodic", "one species", "alike"},
            ),
            start=24,
        )
    ),
]


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, the bed for its brute-force sums, and the contribution and tolerance of each part."""

    scene: Scene
    bed: Bed
    velocities: np.ndarray
    sums_at: Callable[[Bed], dict[str, Sums]]
    errors: dict[str, float]
    loads: np.ndarray | None

    @functools.cached_property
    def parts(self) -> dict[str, Sums]:
        return self.sums_at(self.bed)


def draw_places(drawn: Drawn, random: np.random.Generator, diameters: np.ndarray, columns: int) -> np.ndarray:
    """Draw positions [m] near a square lattice; with contact forces some neighbours overlap."""
    count = len(diameters)
    sites = np.stack((np.arange(count) % columns, np.arange(count) // columns), axis=1)
    places = SPACING * (sites + 0.5) + random.uniform(-JITTER, JITTER, (count, 2))
    if "contact" in drawn.features:
        depth = 0.99 if "cylinders" in drawn.features else 0.96
        sides = SPACING * np.array([columns, count // columns])
        pairs = [(0, 1), (12, 13), (22, 22 + columns)]
        if "periodic" in drawn.features:  # across a side, and across a corner
            pairs += [(3 * columns - 1, 2 * columns), (7, count - columns + 7)]
        for k, (i, j) in enumerate(pairs):
            near = (depth - 0.001 * k) * 0.5 * (diameters[i] + diameters[j])
            way = places[j] - places[i]
            way -= sides * np.round(way / sides) if "periodic" in drawn.features else 0.0
            places[j] = places[i] + near * way / np.hypot(*way)
    return np.asarray(places)


def walls_of(
    drawn: Drawn, random: np.random.Generator, width: float, height: float
) -> tuple[dict[str, Any], dict[str, Callable[[Bed], WallLaw]]]:
    """Return sections and laws of the four walls, to which the drawn laws are assigned."""
    names = [name for name in WALLS if name in drawn.features]
    rubbing = [name for name in names if name not in ("slab", "wall of discs", "gap")]
    sides: dict[str, str] = {}
    if "gap" in names:
        sides["bottom"] = "gap"
        names.remove("gap")
    for side in ("left", "right"):
        if "wall friction" in drawn.features:
            sides[side] = str(random.choice(rubbing))
            if sides[side] in names:
                names.remove(sides[side])
    for side in SIDES:
        if side not in sides:
            sides[side] = names.pop(0) if names else "experimental wall" if not rubbing else rubbing[0]
    made = {side: wall(name, width, height, side) for side, name in sides.items()}
    return {side: section for side, (section, _) in made.items()}, {
        side: law for side, (_, law) in made.items()
    }


def make_scene(drawn: Drawn) -> Scene:
    return make_case(drawn).scene


def make_case(drawn: Drawn) -> Case:
    """Return the scene with some features, and the sums for comparison."""
    random = np.random.default_rng([7, drawn.seed])
    closed = "closed" in drawn.features
    columns, rows = (8, 5) if closed else (10, 11)
    width, height = columns * SPACING, rows * SPACING
    species = list(SPECIES[: 1 + CHOICES["species"].index(drawn.chosen("species"))])
    # The mesh's tolerance is for a bed packed with the first species; tables of discs take a second each.
    if not drawn.features & {"mesh", "cylinders"}:
        species = [species[k] for k in random.permutation(len(species))]
    grains = {
        "count": columns * rows,
        "species": [one | {"share": 1.0 / len(species)} for one in species],
        "spread": 0.1 if "scatter" in drawn.features else 0.0,
        "magnets": drawn.chosen("magnets"),
    }
    sections: dict[str, Any] = {"dipole": True}
    plain = {
        "grains": grains,
        "cell": {"width": width} | ({} if closed else {"sides": "periodic", "height": height}),
        "pairs": METHODS[drawn.chosen("sum")],
        "effects": sections,
        "protocol": [{"kind": "hold", "name": "rest", "duration": 1.0}],
        "output": {"scalars": OUTPUT, "frames": OUTPUT},
    }
    if closed:
        plain["piston"] = {"height": height, "mass": 0.2}
    laws: dict[str, Callable[[Bed], WallLaw]] = {}
    if closed or drawn.features & set(WALLS):
        sections["walls"], laws = walls_of(drawn, random, width, height)
    brute: dict[str, Callable[[Bed], Sums]] = {}
    for name, part in ACTING.items():
        if name in drawn.features:
            made, brute[name] = part(random)
            for key, section in made.items():  # pair laws are in one list
                sections[key] = [*sections.get(key, []), *section] if isinstance(section, list) else section
    kind = Scene.from_plain(plain | {"effects": {}, "pairs": {}, "protocol": []}).grains.species_indices()
    diameters = np.array([one["diameter"] for one in species])[kind]
    places = draw_places(drawn, random, diameters, columns)
    velocities = random.normal(0.0, 0.02, places.shape)
    plain["arrangement"] = {"positions": places.tolist(), "velocities": velocities.tolist()}
    scene = Scene.from_plain(plain)
    bed = bed_of(scene, places)
    bed = dataclasses.replace(bed, reach=reach_of(drawn, bed))

    def sums_at(bed: Bed) -> dict[str, Sums]:
        found = {"magnets": magnetic_sums(drawn, bed)} | {name: sums(bed) for name, sums in brute.items()}
        return found | {side: sum_wall(bed, side, law(bed)) for side, law in laws.items()}

    loads = None
    if "friction" in drawn.features:
        asked = sections["friction"]
        loads = LOAD + normal_loads(
            bed,
            bed.reach,
            asked["tilt"],
            second=asked["torque"] == "second",
            cylinders="cylinders" in drawn.features,
        )
    errors = {name: OF_LAWS if name in OWN_PAIR_LAWS else EXACT for name in ("magnets", *brute, *laws)}
    if "cylinders" in drawn.features:
        errors["magnets"] = OF_DISCS
    if "mesh" in drawn.features:
        errors |= {name: scene.pairs.tolerance for name in ("magnets", *TAILS) if name in errors}
    for side, section in sections.get("walls", {}).items():
        if section == ROW:
            errors[side] = OF_ROWS
    return Case(scene, bed, velocities, sums_at, errors, loads)


def reach_of(drawn: Drawn, bed: Bed) -> Reach:
    """Return the distances up to which a pair-sum method includes pairs."""
    method = drawn.chosen("sum")
    if method == "mesh":
        return Reach() if bed.periods is None else Reach(3.0 * float(bed.periods.max()), images=True)
    if method in ("cut-off", "verlet-list"):
        return Reach(CUT_OFF, shifted=True)
    return Reach() if bed.periods is None else Reach(0.5 * float(bed.periods.min()), shifted=True)


def magnetic_sums(drawn: Drawn, bed: Bed) -> Sums:
    """Return the magnetic sums over pairs."""
    law, reach = (discs if "cylinders" in drawn.features else dipoles)(bed), bed.reach
    result = sum_pairs(bed, law, reach)
    if reach.images:  # the energy of dipoles converges slowly: by Ewald's sum, and the rest image by image
        result.energy -= sum_pairs(bed, dipoles(bed), reach).energy
        result.energy += bed.unit * bed.size * energy_of_images(bed)
    return result


def energy_of_images(bed: Bed) -> float:
    """Return the energy of dipoles with all periodic images, in units of F* D."""
    assert bed.periods is not None
    return ewald_energy(bed.places / bed.size, bed.periods / bed.size, bed.ratios)


def check_case(case: Case) -> None:
    """Assert that all results of an evaluation agree with the sums."""
    places = case.bed.places
    if case.bed.periods is not None:  # each grain at another of its images
        places = places + case.bed.periods * np.random.default_rng(1).integers(-2, 3, places.shape)
    found = evaluate(case.scene, places, case.velocities, case.bed.piston)
    parts, errors = case.parts.values(), tuple(case.errors.values())
    off = sum(error * rms(part.sizes) for part, error in zip(parts, errors, strict=True))
    np.testing.assert_allclose(found.force, sum(part.force for part in parts), rtol=0.0, atol=off)
    off = math.fsum(energy_errors(case).values())
    energy = math.fsum(part.energy for part in parts)
    assert found.potential_energy == pytest.approx(energy, rel=0.0, abs=off + EXACT * abs(energy))
    for side in SIDES:
        wanted = math.fsum(part.walls[side] for part in parts)
        assert found.wall_forces[side] == pytest.approx(wanted, rel=case.errors.get(side, EXACT))
    assert found.piston_force == found.wall_forces["top"]
    kinetic = 0.5 * math.fsum(case.bed.masses * (case.velocities**2).sum(axis=1))
    assert found.kinetic_energy == pytest.approx(kinetic, rel=EXACT)
    if case.loads is not None:
        by_mesh = case.scene.pair_method == "mesh"
        of_discs = case.scene.grains.magnets == "cylinders"
        bound = OF_LOADS[by_mesh] if of_discs else case.errors["magnets"]
        off = bound * rms(case.loads)
        np.testing.assert_allclose(found.normal_load, case.loads, rtol=0.0, atol=off)


def energy_errors(case: Case) -> dict[str, float]:
    """Return the errors of the energies of the parts [J]."""
    off = {name: case.errors[name] * abs(part.energy) for name, part in case.parts.items()}
    if case.scene.pair_method == "mesh" and case.scene.grains.magnets == "cylinders":
        off["magnets"] *= DISC_ENERGIES
    return off


def rms(sizes: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(sizes))))


def check_records(case: Case) -> None:
    """Assert that the initial energies in a run's records are correct, effect by effect."""
    data = simulate(case.scene, dt=OUTPUT, t_end=OUTPUT, progress=False).dataset
    # A tail is summed with the dipoles, and counts there.
    with_tail = {RECORDS[name] for name in (*TAILS, "magnets") if name in case.parts}
    records = {RECORDS[name] for name in case.parts if name in RECORDS}
    for group in [with_tail, *({record} for record in records - with_tail)]:
        parts = {name: one.energy for name, one in case.parts.items() if RECORDS.get(name) in group}
        found = math.fsum(float(data[record].values[0]) for record in group)
        off = math.fsum(energy_errors(case)[name] for name in parts)
        assert found == pytest.approx(math.fsum(parts.values()), rel=0.0, abs=off)


def test_every_pair_of_features_occurs_in_one_of_the_random_scenes() -> None:
    held = set().union(*(pairs_of(drawn.features) for drawn in SCENES))
    for pair in every_pair():
        assert (pair in held) != (pair in EXCLUDED), sorted(pair)


@pytest.mark.parametrize("pair", EXCLUDED, ids=lambda pair: "-".join(sorted(pair)))
def test_a_scene_with_incompatible_features_is_refused(pair: frozenset[str]) -> None:
    plain = {names[0] for names in CHOICES.values() if not pair & set(names)}
    plain |= {"infinite wall"} if "closed" in plain else set()
    drawn = Drawn(frozenset(plain | pair), 0)
    with pytest.raises(InputError, match=EXCLUDED[pair]):
        simulate(make_scene(drawn), dt=OUTPUT, t_end=OUTPUT, progress=False)


@pytest.mark.parametrize("drawn", SCENES, ids=str)
def test_sums_of_random_scenes_agree_with_brute_force(drawn: Drawn) -> None:
    case = make_case(drawn)
    check_case(case)
    check_records(case)
