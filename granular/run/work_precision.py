"""Tables of measured errors and computing times of methods and steps.

The package's table, ``work_precision.toml``, is made by ``python -m benchmarks --prices``. A run uses the
entries of the scene with the same type of damping and the most similar number of grains. A user measures
another scene with ``granular-damper validate cheapest``. The results are stored in the user's cache and apply
to that scene with any random packing.
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

TABULATED_EFFECTS = frozenset({"dipole", "walls", "gravity", "drag", "friction"})
"""Effects in the scenes of the package's table; the table does not apply to scenes with other effects."""

MAX_GRAIN_RATIO = 8.0
"""Maximum ratio between the numbers of grains in a scene and in the tabulated scene that represents it."""

MARGIN = 1.5
"""Safety factor on the error bounds of the package's table, because scenes differ."""

FLOORS = 3.0
"""Minimum tolerance of a single run, in standard deviations over random packings. About one packing in 400
deviates by more than three standard deviations."""

MAX_REFINEMENT = 4.0
"""Maximum factor by which a step may be shorter than the shortest step in the table. The error of such a step
is extrapolated by the order of the method."""

MAX_RESOLVED_PRODUCT = 1.0
"""Product of step and highest angular frequency up to which errors follow the method's order; half the
stability limit."""

MOTION = ("rest height", "period", "damping ratio")
"""Quantities in the package's table for a piston that comes to rest."""


class WorkPrecisionEntry(NamedTuple):
    """Measured computing time and errors of a method with one time step, in one scene."""

    method: str
    dt: str
    fraction: float  # step times the highest frequency assumed for the automatic step
    frequency: float  # step times the highest frequency measured in the run
    seconds: float  # computing time of the run [s]
    bounds: Mapping[str, float]  # maximum error of each quantity
    clear: list[str]  # quantities whose error exceeds the spread over packings

    def error_bound(self, quantity: str, ratio: float) -> float:
        """Estimate the maximum error with ``ratio`` times the entry's step, from the method's order."""
        scale = ratio ** method_named(self.method).order
        return self.bounds[quantity] * (scale if quantity in self.clear else max(1.0, scale))


class SceneWorkPrecision(NamedTuple):
    """Measured errors and computing times of a scene with several methods and time steps."""

    name: str
    kind: str
    grains: int
    starts: int
    reference: str
    floors: Mapping[str, float]  # spread of each quantity over random packings
    entries: tuple[WorkPrecisionEntry, ...]
    date: str
    margin: float = MARGIN  # factor of the bounds

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> SceneWorkPrecision:
        """Make a measured scene from its table."""
        entries = tuple(WorkPrecisionEntry(**entry) for entry in plain["entries"])
        return cls(**{**plain, "entries": entries})

    def scatter_for_grain_count(self, quantity: str, grains: int) -> float:
        """Return the standard deviation of a quantity over random packings with this number of grains."""
        # The spread varies as the inverse square root of the number of grains, but is never below the
        # measured value.
        return self.floors[quantity] * max(1.0, math.sqrt(self.grains / max(grains, 1)))

    def entries_of(self, method: str, product: str = "fraction") -> list[WorkPrecisionEntry]:
        """Return the entries of a method, sorted by the product of step and highest frequency."""
        entries = (entry for entry in self.entries if entry.method == method)
        return sorted(entries, key=lambda entry: float(getattr(entry, product)))

    def longest_step_times_frequency(self, method: str, quantity: str, tolerance: float) -> float | None:
        """Return the largest product of step and highest frequency that meets a tolerance, or None."""
        # Between the steps of the table, and below the shortest one, errors follow the order of the method.
        # No step beyond the longest is guaranteed.
        entries, order = self.entries_of(method), method_named(method).order
        accurate = [entry for entry in entries if entry.bounds[quantity] <= tolerance]
        if not accurate:
            finest = entries[0]
            shorter = (tolerance / finest.bounds[quantity]) ** (1.0 / order)
            clear = quantity in finest.clear and shorter * MAX_REFINEMENT >= 1.0
            return shorter * finest.fraction if clear else None
        best = accurate[-1]
        following = entries[entries.index(best) + 1 :]
        # If the error of the next entry is within the spread, it follows no order.
        if not following or not best.bounds[quantity] > 0.0 or quantity not in following[0].clear:
            return best.fraction
        longer = (tolerance / best.bounds[quantity]) ** (1.0 / order)
        return min(best.fraction * longer, following[0].fraction)

    def longest_step_times_frequency_within_scatter(self, method: str) -> float:
        """Return the largest step times highest frequency with errors below the packings' spread, or 0."""
        fraction = 0.0
        for entry in self.entries_of(method):
            # From here on errors exceed the spread over packings.
            if entry.frequency > MAX_RESOLVED_PRODUCT or not set(entry.clear).isdisjoint(MOTION):
                break
            fraction = entry.fraction
        return fraction


def settings_within_tolerance(
    costs: SceneWorkPrecision, quantity: str, tolerance: float, grains: int
) -> list[tuple[float, float, str, float]]:
    """List settings within a tolerance, fastest first: (seconds, step x highest frequency, method, error)."""
    floor = costs.scatter_for_grain_count(quantity, grains)
    if tolerance < FLOORS * floor:
        raise InputError(
            f"the spread over random packings is {floor:.2g}, so the minimum tolerance of a single run is "
            f"{FLOORS * floor:.2g}; request this tolerance, or average over "
            f"{packing_count_to_average(floor, tolerance):d} packings (arrangement.seed)"
        )
    settings = []
    for method in dict.fromkeys(entry.method for entry in costs.entries):
        fraction = costs.longest_step_times_frequency(method, quantity, tolerance / costs.margin)
        if fraction is not None:
            ratios = [(entry, fraction / entry.fraction) for entry in costs.entries_of(method)]
            near, ratio = min(ratios, key=lambda pair: abs(math.log(pair[1])))
            bound = near.error_bound(quantity, ratio)
            settings.append((near.seconds / ratio, fraction, method, bound))
    return sorted(settings)


def packing_count_to_average(floor: float, tolerance: float) -> int:
    """Return the number of packings for which two standard errors of the mean are below the tolerance."""
    return max(1, math.ceil((2.0 * floor / tolerance) ** 2))


def damping_kind(scene: Scene) -> str:
    """Return the kind of damping in a scene, by its name in the package's table."""
    friction = scene.effects.friction
    if friction is not None:
        return "friction" if friction.scheme == "velocity" else "regularised friction"
    return "drag" if scene.effects.drag is not None else "nothing"


@cache
def load_work_precision_scenes() -> tuple[SceneWorkPrecision, ...]:
    """Load the measured scenes of the packaged table."""
    plain = parse_toml(TABLE.read_text(encoding="utf-8"))
    date = {"date": plain["made"]["date"]}
    return tuple(SceneWorkPrecision.from_plain(scene | date) for scene in plain["scenes"])


def user_work_precision_table() -> ResultCache | None:
    """Return the user's table; None if the user has no cache folder."""
    folder = toolkit_cache_folder()
    return None if folder is None else ResultCache(folder / "work-precision")


def _measurement_key(scene: Scene, quantity: str, t_end: float | None) -> str:
    """Return a key for a quantity, a scene and a duration [s]; all random packings have the same key."""
    plain = scene.to_plain() | {"name": None}
    plain["arrangement"] = {**plain["arrangement"], "seed": None}
    return digest([plain, custom_code_digests(scene), quantity, t_end, __version__], 20)


def store_measured_scene(
    scene: Scene, quantity: str, t_end: float | None, measured: SceneWorkPrecision
) -> None:
    """Store the measurement of a quantity in a scene up to a time [s] in the user's table."""
    plain = measured._asdict() | {"entries": [entry._asdict() for entry in measured.entries]}
    try:
        if (table := user_work_precision_table()) is not None:
            table.store(_measurement_key(scene, quantity, t_end), plain)
    except StoreError as error:
        warnings.warn(f"the measurement is not stored: {error}", stacklevel=2)


def list_applicable_measured_scenes(
    scene: Scene, quantity: str, t_end: float | None = None
) -> list[SceneWorkPrecision]:
    """List the measurements that apply to a scene up to ``t_end`` [s]: the package's, then the user's."""
    packaged, table = most_similar_measured_scene(scene, quantity), user_work_precision_table()
    plain = None if table is None else table.read(_measurement_key(scene, quantity, t_end))
    measured = None if plain is None else SceneWorkPrecision.from_plain(plain)
    return [item for item in (packaged, measured) if item is not None]


def most_similar_measured_scene(scene: Scene, quantity: str) -> SceneWorkPrecision | None:
    """Find the scene of the packaged table that is most similar to a scene."""
    if not TABULATED_EFFECTS.issuperset(active_effect_names(scene)) or not scene.has_closed_walls:
        return None
    rests = any(getattr(stage, "until", None) == "rest" for stage in scene.protocol)
    near = []
    for entry in load_work_precision_scenes():
        apart = abs(math.log(entry.grains / max(scene.grains.count, 1)))
        if (
            entry.kind == damping_kind(scene)
            and quantity in entry.floors
            and apart <= math.log(MAX_GRAIN_RATIO)
        ):
            near.append((("rest height" in entry.floors) is not rests, apart, entry))
    return min(near, key=lambda item: item[:2])[2] if near else None


def work_precision_text(run: Trajectory) -> str:
    """Return a line with a run's computing time and error due to the step, also for half the step."""
    product = run.settings().get("step_times_highest_frequency", 0.0)
    rested = any(stage.reason == "rest" for stage in run.stages)
    quantity = "rest height" if rested else "piston force"  # the first quantity of interest
    for costs in list_applicable_measured_scenes(run.scene, quantity) if run.scene.piston is not None else ():
        entries = costs.entries_of(run.method.name, "frequency")
        if entries and 0.0 < product <= 2.0 * entries[-1].frequency:
            entry = next((entry for entry in entries if entry.frequency >= product), entries[-1])
            error = entry.error_bound(quantity, product / entry.frequency)
            spread = costs.scatter_for_grain_count(quantity, run.scene.grains.count)
            if quantity in entry.clear:
                return cost_and_error_text(run, quantity, error, spread=spread)
            return cost_and_error_text(
                run, quantity, error, "or better due to the step", spread, within_spread=True
            )
    return cost_and_error_text(run, "energy", run.settings()["ledger_residual"])


def cost_and_error_text(
    run: Trajectory,
    quantity: str,
    error: float,
    cause: str = "due to the step",
    spread: float = 0.0,
    *,
    within_spread: bool = False,
) -> str:
    """Return a line with a run's computing time and error, and both values for half the step."""
    seconds = run.settings()["seconds"]
    finer = "no better because of the spread" if within_spread else f"{error / 2.0**run.method.order:.1g}"
    spread_words = f"; spread over packings {spread:.1g}" if spread else ""
    return (
        f"cost: {seconds:.3g} s; {quantity} to {error:.1g} {cause}{spread_words}; "
        f"half the step: {2.0 * seconds:.3g} s, {finer}"
    )
