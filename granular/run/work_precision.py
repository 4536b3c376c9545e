"""Errors and prices of methods and steps, from measured tables.

``work_precision.toml`` comes with the package and is made by ``python -m benchmarks --prices``. A scene is
looked up there by what damps it and by its number of grains. What a user has measured of a scene, by
``granular-damper validate cheapest``, is kept among his caches, and is looked up for the same scene with any
random start.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.methods.tables import method_named
from granular.run.summary import active_effect_names, custom_code_digests
from granular.scene.scene import Scene
from granular.shared.errors import InputError, StoreError
from granular.shared.files import ResultCache, digest, parse_toml, toolkit_cache_folder
from granular.shared.version import __version__

if TYPE_CHECKING:
    from granular.run.trajectory import Trajectory

TABLE = Path(__file__).with_name("work_precision.toml")

KNOWN = frozenset({"dipole", "walls", "gravity", "drag", "friction"})
"""Effects that the scenes of the packaged table have; it says nothing of others."""

ALIKE = 8.0
"""Ratio of numbers of grains up to which a scene of the table represents another."""

MARGIN = 1.5
"""Factor of a bound of the packaged table: scenes differ."""

FLOORS = 3.0
"""A tolerance of fewer standard deviations of the starts cannot be met by one run of any setting: three hold
all but one start in four hundred."""

FARTHEST = 4.0
"""Largest factor by which a step may be shorter than the table's shortest, by its method's order."""

RESOLVED = 1.0
"""Step times highest frequency up to which a method shows its order; half the limit."""

MOTION = ("rest height", "period", "damping ratio")
"""Quantities of a piston that comes to rest, in the packaged table."""


class WorkPrecisionEntry(NamedTuple):
    """A method at a step, in a measured scene."""

    method: str
    dt: str
    fraction: float  # automatic step times the highest frequency that it is chosen for
    frequency: float  # the same product as seen in the run
    seconds: float  # computing time of a run [s]
    bounds: Mapping[str, float]  # largest error of each quantity
    clear: list[str]  # quantities whose error stands out from the scatter

    def error_bound(self, quantity: str, ratio: float) -> float:
        """Largest error of a quantity at a step of this ratio to the entry's, by the method's order."""
        scale = ratio ** method_named(self.method).order
        return self.bounds[quantity] * (scale if quantity in self.clear else max(1.0, scale))


class SceneWorkPrecision(NamedTuple):
    """A measured scene."""

    name: str
    kind: str
    grains: int
    starts: int
    reference: str
    floors: Mapping[str, float]  # scatter of each quantity over random starts
    entries: tuple[WorkPrecisionEntry, ...]
    date: str
    margin: float = MARGIN  # factor of the bounds

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> SceneWorkPrecision:
        """Make the measured scene from its table."""
        entries = tuple(WorkPrecisionEntry(**entry) for entry in plain["entries"])
        return cls(**{**plain, "entries": entries})

    def scatter_for_grain_count(self, quantity: str, grains: int) -> float:
        """Scatter of a quantity over random starts, for a number of grains."""
        # With the inverse root of the number of grains, and never less than was measured.
        return self.floors[quantity] * max(1.0, math.sqrt(self.grains / max(grains, 1)))

    def entries_of(self, method: str, product: str = "fraction") -> list[WorkPrecisionEntry]:
        """Entries of a method by their product of step and highest frequency, the shortest step first."""
        entries = (entry for entry in self.entries if entry.method == method)
        return sorted(entries, key=lambda entry: float(getattr(entry, product)))

    def longest_step(self, method: str, quantity: str, tolerance: float) -> float | None:
        """Longest step times highest frequency that keeps a tolerance; None where none does."""
        # Between two steps of the table, and below its shortest, errors follow the method's order; beyond its
        # longest no step is promised.
        entries, order = self.entries_of(method), method_named(method).order
        held = [entry for entry in entries if entry.bounds[quantity] <= tolerance]
        if not held:
            finest = entries[0]
            shorter = (tolerance / finest.bounds[quantity]) ** (1.0 / order)
            clear = quantity in finest.clear and shorter * FARTHEST >= 1.0
            return shorter * finest.fraction if clear else None
        best = held[-1]
        following = entries[entries.index(best) + 1 :]
        # Where the next one's error is scatter, it follows no order.
        if not following or not best.bounds[quantity] > 0.0 or quantity not in following[0].clear:
            return best.fraction
        longer = (tolerance / best.bounds[quantity]) ** (1.0 / order)
        return min(best.fraction * longer, following[0].fraction)

    def longest_hidden_step(self, method: str) -> float:
        """Longest step times highest frequency whose errors the scatter over random starts hides; else 0."""
        fraction = 0.0
        for entry in self.entries_of(method):
            # From here on an error of the step stands out from the scatter of the starts.
            if entry.frequency > RESOLVED or not set(entry.clear).isdisjoint(MOTION):
                break
            fraction = entry.fraction
        return fraction


def steps_within(
    costs: SceneWorkPrecision, quantity: str, tolerance: float, grains: int
) -> list[tuple[float, float, str, float]]:
    """Price [s], step times frequency, method and bound of all that keep a tolerance, the cheapest first."""
    floor = costs.scatter_for_grain_count(quantity, grains)
    if tolerance < FLOORS * floor:
        raise InputError(
            f"random starts scatter by {floor:.2g}, so no single run can be promised below "
            f"{FLOORS * floor:.2g}; ask for that, or average {starts_for_tolerance(floor, tolerance):d} "
            "starts (arrangement.seed)"
        )
    priced = []
    for method in dict.fromkeys(entry.method for entry in costs.entries):
        fraction = costs.longest_step(method, quantity, tolerance / costs.margin)
        if fraction is not None:
            ratios = [(entry, fraction / entry.fraction) for entry in costs.entries_of(method)]
            near, ratio = min(ratios, key=lambda pair: abs(math.log(pair[1])))
            bound = near.error_bound(quantity, ratio)
            priced.append((near.seconds / ratio, fraction, method, bound))
    return sorted(priced)


def starts_for_tolerance(floor: float, tolerance: float) -> int:
    """Return the number of random starts whose mean is within a tolerance, at two standard errors."""
    return max(1, math.ceil((2.0 * floor / tolerance) ** 2))


def damping_kind(scene: Scene) -> str:
    """Kind of damping in a scene."""
    friction = scene.effects.friction
    if friction is not None:
        return "friction" if friction.scheme == "velocity" else "regularised friction"
    return "drag" if scene.effects.drag is not None else "nothing"


@cache
def load_work_precision_scenes() -> tuple[SceneWorkPrecision, ...]:
    """Scenes of the packaged table, as a tuple of `SceneWorkPrecision`."""
    plain = parse_toml(TABLE.read_text(encoding="utf-8"))
    date = {"date": plain["made"]["date"]}
    return tuple(SceneWorkPrecision.from_plain(scene | date) for scene in plain["scenes"])


def user_table() -> ResultCache | None:
    """Return the table of the user's own; None where there is no folder for it."""
    folder = toolkit_cache_folder()
    return None if folder is None else ResultCache(folder / "work-precision")


def _measurement_key(scene: Scene, quantity: str, t_end: float | None) -> str:
    """Key of a measured quantity of a scene until a time [s], the same for any random start."""
    plain = scene.to_plain() | {"name": None}
    plain["arrangement"] = {**plain["arrangement"], "seed": None}
    return digest([plain, custom_code_digests(scene), quantity, t_end, __version__], 20)


def keep_measured_scene(
    scene: Scene, quantity: str, t_end: float | None, measured: SceneWorkPrecision
) -> None:
    """Keep what was measured of a quantity of a scene until a time [s] in the table of the user's own."""
    plain = measured._asdict() | {"entries": [entry._asdict() for entry in measured.entries]}
    try:
        if (table := user_table()) is not None:
            table.keep(_measurement_key(scene, quantity, t_end), plain)
    except StoreError as error:
        warnings.warn(f"what was measured is not kept: {error}", stacklevel=2)


def measured_scenes(scene: Scene, quantity: str, t_end: float | None = None) -> list[SceneWorkPrecision]:
    """Measured scenes that tell of another one: of the packaged table, then of the user's own; t_end [s]."""
    packaged, table = most_similar_measured_scene(scene, quantity), user_table()
    plain = None if table is None else table.read(_measurement_key(scene, quantity, t_end))
    measured = None if plain is None else SceneWorkPrecision.from_plain(plain)
    return [item for item in (packaged, measured) if item is not None]


def most_similar_measured_scene(scene: Scene, quantity: str) -> SceneWorkPrecision | None:
    """Find the scene of the packaged table that is most like another one."""
    if not KNOWN.issuperset(active_effect_names(scene)) or not scene.has_closed_walls:
        return None
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)
    near = []
    for entry in load_work_precision_scenes():
        apart = abs(math.log(entry.grains / max(scene.grains.count, 1)))
        if entry.kind == damping_kind(scene) and quantity in entry.floors and apart <= math.log(ALIKE):
            near.append((("rest height" in entry.floors) is not rests, apart, entry))
    return min(near, key=lambda item: item[:2])[2] if near else None


def work_precision_text(run: Trajectory) -> str:
    """Say in a line how long a run took, its error by the step, and both for half the step [s]."""
    seen = run.settings().get("step_times_highest_frequency", 0.0)
    rested = any(stage.reason == "rest" for stage in run.stages)
    quantity = "rest height" if rested else "piston force"  # that a run is first looked at for
    for costs in measured_scenes(run.scene, quantity) if run.scene.piston is not None else ():
        entries = costs.entries_of(run.method.name, "frequency")
        if entries and 0.0 < seen <= 2.0 * entries[-1].frequency:
            entry = next((entry for entry in entries if entry.frequency >= seen), entries[-1])
            error = entry.error_bound(quantity, seen / entry.frequency)
            scatter = costs.scatter_for_grain_count(quantity, run.scene.grains.count)
            if quantity in entry.clear:
                return price_text(run, quantity, error, scatter=scatter)
            return price_text(run, quantity, error, "or better by the step", scatter, hidden=True)
    return price_text(run, "energy", run.settings()["ledger_residual"])


def price_text(
    run: Trajectory,
    quantity: str,
    error: float,
    by: str = "by the step",
    scatter: float = 0.0,
    *,
    hidden: bool = False,
) -> str:
    """Say in a line how long a run took, and the error of a quantity, which random starts may hide."""
    seconds = run.settings()["seconds"]
    finer = "and no better where the starts decide" if hidden else f"{error / 2.0**run.method.order:.1g}"
    scattered = f"; starts scatter it by {scatter:.1g}" if scatter else ""
    return (
        f"price: {seconds:.3g} s; {quantity} to {error:.1g} {by}{scattered}; "
        f"twice as fine: {2.0 * seconds:.3g} s, {finer}"
    )
