"""Error against wall time: what accuracy costs.

Each setting is run warm, and the least time of its repeats counts. A setting that fails stays in
the picture as a failure. Where the quantity depends on how the bed happened to pack, the scatter
over seeds is the floor: below it accuracy buys nothing. Positions may also be computed by outside
references (`validation.outside`); these are shown and never chosen.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.run.allowed import is_allowed
from granular.run.trajectory import Trajectory
from granular.scene.scales import Scales
from granular.scene.scene import Scene
from granular.shared.errors import GranularError, InputError
from validation.outside import ORDERS, adaptive
from validation.quantities import MeasuredQuantity, quantity_named
from validation.table import TextTable, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

REPEATS = 2
LONG = 1.0
"""A run of this length is timed well enough, and not repeated [s]."""

LEVELS = {"1 %": 1e-2, "1e-6": 1e-6}
"""Tolerances that a picture answers for."""


class Setting(NamedTuple):
    """How a scene is run.

    Attributes
    ----------
    method : str
        Or the name of an outside reference, one of `validation.outside.ORDERS`.
    dt : float or str
        For an outside reference its tolerance.
    changes : mapping of str to anything
        Changes to the scene, by dotted keys.
    """

    method: str
    dt: float | str
    changes: Mapping[str, Any] = {}

    @property
    def outside(self) -> bool:
        """Whether it is an outside reference."""
        return self.method in ORDERS

    @property
    def fineness(self) -> str:
        """The step, or an outside reference's tolerance, in words."""
        return f"tolerance {self.dt}" if self.outside else str(self.dt)

    @property
    def family(self) -> str:
        """What settings that differ in their step alone have in common."""
        changes = (f"{key.rpartition('.')[2]} {one}" for key, one in self.changes.items())
        return ", ".join([self.method, *changes])


USUAL = ("stormer-verlet", "auto")
"""Method and step that `granular.simulate` takes where nothing is said."""

Reference = Setting | float | np.ndarray | None
"""A setting to take the true value from, the value, or None for `finest` or the exact one."""


@dataclasses.dataclass(frozen=True)
class Point:
    """What one setting gave.

    Attributes
    ----------
    setting : Setting
    error, seconds : float
        NaN where it failed.
    steps : int
    failure : str or None
        The error's class and message.
    """

    setting: Setting
    error: float
    seconds: float
    steps: int
    failure: str | None = None

    @property
    def failed(self) -> bool:
        return self.failure is not None


@dataclasses.dataclass(frozen=True)
class WorkPrecision:
    """Errors and wall times of many settings.

    Attributes
    ----------
    scene, quantity, unit : str
        ``unit`` of the errors: ``"1"`` where they are relative.
    horizon : float or None
        Until when the scene was run [s]; None for its whole protocol.
    points : tuple of Point
    floor : float
        Scatter over seeds, as an error; 0 where it was not asked for.
    reference : str
        What the errors are measured against.
    """

    scene: str
    quantity: str
    unit: str
    horizon: float | None
    points: tuple[Point, ...]
    floor: float
    reference: str

    def front(self) -> tuple[Point, ...]:
        """The Pareto front, from fast to accurate: no setting is both faster and more accurate."""
        own = [one for one in self.points if not one.failed and not one.setting.outside]
        done = sorted(own, key=_cost)
        front: list[Point] = []
        for one in done:
            if not front or one.error < front[-1].error:
                front.append(one)
        return tuple(front)

    def cheapest(self, tolerance: float) -> Point | None:
        """The fastest setting that is accurate to a tolerance, and not so by luck.

        A setting counts only if all settings of its family with more steps are accurate as well.
        """
        own = [one for one in self.families().values() if not one[0].setting.outside]
        sound = [one for family in own for one in _sound(family, tolerance)]
        return min(sound, key=_cost, default=None)

    def usual(self) -> Point | None:
        """The default method and step, in the first form that was tried and did not fail."""
        ones = (one for one in self.points if not one.failed)
        return next((one for one in ones if one.setting[:2] == USUAL), None)

    def families(self) -> dict[str, tuple[Point, ...]]:
        """The points by family, from coarse to fine."""
        found: dict[str, list[Point]] = {}
        for one in self.points:
            found.setdefault(one.setting.family, []).append(one)
        return {name: tuple(sorted(ones, key=_work)) for name, ones in found.items()}

    def table(self) -> TextTable:
        """One row a setting, the front marked with a star."""
        front = self.front()
        rows = []
        for one in self.points:
            star = "*" if one in front else ""
            shown = (f"{one.error:.3g}", f"{one.seconds:.3g}", f"{one.steps}")
            said = "" if one.failure is None else one.failure.split(":", 1)[0]
            rows.append(
                (star, one.setting.family, one.setting.fineness, *(("", "", "") if said else shown),
                 said)
            )  # fmt: skip
        header = (
            "",
            "setting",
            "dt",
            f"error of the {self.quantity}",
            "seconds",
            "steps",
            "failed",
        )
        return table(header, rows)

    def plot(self, axes: Axes) -> None:
        """Draw error over seconds, a line a family, what to take ringed, the floor as a band.

        A family's label says how many of its settings failed.
        """
        from granular.shared.plotting import COLOURS, GREY, STYLES

        for k, (name, points) in enumerate(self.families().items()):
            done = [one for one in points if not one.failed and one.error > 0.0]
            failed = sum(one.failed for one in points)
            outside = points[0].setting.outside
            axes.loglog(
                [one.seconds for one in done], [one.error for one in done],
                marker="x" if outside else "o", markersize=3.5, color=COLOURS[k % len(COLOURS)],
                linestyle=":" if outside else STYLES[k // len(COLOURS) % len(STYLES)],
                linewidth=0.9 if outside else 1.5,
                label=f"{name} ({failed} failed)" if failed else name,
            )  # fmt: skip
        front = [one for one in self.front() if one.error > 0.0]
        axes.loglog(
            [one.seconds for one in front], [one.error for one in front],
            color=GREY, linewidth=5.0, alpha=0.35, zorder=0, label="best of all",
        )  # fmt: skip
        for words, level in LEVELS.items():
            axes.axhline(level, color="#333333", linewidth=0.6, linestyle=":")
            self._mark(axes, words, level)
        if self.floor > 0.0:
            low, high = axes.get_ylim()
            axes.axhspan(low, self.floor, color=GREY, alpha=0.2, linewidth=0.0)
            axes.set_ylim(low, max(high, 1.2 * self.floor))
        _plain_numbers(axes)
        axes.set_xlabel("wall time [s]")
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        axes.set_ylabel(f"error of the {self.quantity}{unit}")

    def _mark(self, axes: Axes, words: str, level: float) -> None:
        """Ring the setting to take for a level, and name it at the level's line."""
        best = self.cheapest(level)
        named = f"{words}: none reaches it"
        if best is not None:
            named = f"{words}: {best.setting.family}, {best.setting.dt}"
            if best.error > 0.0:
                axes.plot(best.seconds, best.error, "o", markersize=11.0, color="#333333",
                          markerfacecolor="none", markeredgewidth=1.4)  # fmt: skip
        axes.annotate(
            named, (0.99, level), xycoords=("axes fraction", "data"), xytext=(0, 3),
            textcoords="offset points", ha="right", fontsize=8,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )  # fmt: skip

    def to_plain(self) -> dict[str, Any]:
        """The result as plain data; None for what was not measured."""
        plain = dataclasses.asdict(self)
        for row, one in zip(plain["points"], self.points, strict=True):
            row["setting"] = {**one.setting._asdict(), "changes": dict(one.setting.changes)}
            row |= {name: _finite(row[name]) for name in ("error", "seconds")}
        return plain

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> WorkPrecision:
        """The result from what `to_plain` made, also by way of JSON."""
        points = tuple(
            Point(
                Setting(**row["setting"]), _number(row["error"]), _number(row["seconds"]),
                row["steps"], row["failure"],
            )
            for row in plain["points"]
        )  # fmt: skip
        return cls(**{**plain, "points": points})


def _plain_numbers(axes: Axes) -> None:
    """Label seconds as they are read: 0.02, 0.05, 0.1; fewer of them over many decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axes.get_xlim()
    subs = (1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _cost(point: Point) -> tuple[float, float]:
    return point.seconds, point.error


def _work(point: Point) -> int:
    # What failed is taken for the coarsest: too long a step is why a run fails.
    return point.steps if not point.failed else 0


def _sound(family: Sequence[Point], tolerance: float) -> list[Point]:
    """The points, from fine to coarse, before the first that misses the tolerance."""
    sound = []
    for one in reversed(family):
        if one.failed or not one.error <= tolerance:
            break
        sound.append(one)
    return sound


def work_precision(
    scene: Scene,
    quantity: str | MeasuredQuantity,
    settings: Iterable[Setting],
    *,
    reference: Reference = None,
    until: float | None = None,
    seeds: int = 0,
    repeats: int = REPEATS,
) -> WorkPrecision:
    """Run a scene with many settings, and compare a quantity with its reference.

    Parameters
    ----------
    scene : Scene
    quantity : str or MeasuredQuantity
        One of `validation.quantities.QUANTITIES`, or one's own.
    settings : iterable of Setting
    reference : Setting or float or ndarray, optional
        A setting to take the true value from, or the value; without, the quantity's exact value,
        or what `finest` gives.
    until : float, optional
        Stop each run at this time [s]; the position error of a chaotic bed means something over a
        short horizon only.
    seeds : int
        Further starts to measure the scatter with; at least two make one.
    repeats : int
        Runs of each setting; those longer than `LONG` are run once.

    Raises
    ------
    InputError
        If the quantity is unknown, or no setting is given.
    RunError
        If the reference itself fails.
    """
    return work_precisions(
        scene, [quantity], settings, references=[reference], until=until, seeds=seeds,
        repeats=repeats,
    )[0]  # fmt: skip


def work_precisions(
    scene: Scene,
    quantities: Sequence[str | MeasuredQuantity],
    settings: Iterable[Setting],
    *,
    references: Sequence[Reference] | None = None,
    until: float | None = None,
    seeds: int = 0,
    repeats: int = REPEATS,
) -> tuple[WorkPrecision, ...]:
    """`work_precision` of several quantities from the same runs, a result each."""
    chosen = [quantity_named(one) for one in quantities]
    wanted = tuple(settings)
    if not wanted:
        raise InputError("no settings are given; give at least one method and step")
    told, values = _references(scene, chosen, references or [None] * len(chosen), until)
    own = [one for one in wanted if not one.outside]
    rows = [_points(scene, chosen, one, values, until, repeats) for one in own]
    scatters = _scatter(scene, chosen, wanted[0], until, seeds)
    outside = [one for one in wanted if one.outside]
    return tuple(
        WorkPrecision(
            scene.name, one.name, "1" if one.relative else one.unit, until,
            (*(row[k] for row in rows), *_outside_points(scene, one, outside, values[k], until)),
            scatters[k], told[k],
        )
        for k, one in enumerate(chosen)
    )  # fmt: skip


def _outside_points(
    scene: Scene,
    quantity: MeasuredQuantity,
    settings: Sequence[Setting],
    value: float | np.ndarray,
    until: float | None,
) -> list[Point]:
    """Points of the outside references, which give positions only; compiled before they count."""
    if quantity.name != "positions" or until is None:
        return []
    length = Scales.of(scene.grains).length
    points = []
    for one in settings:
        adaptive(one.method, scene, 1e-3 * until, 1e-2)
        begun = time.perf_counter()
        found = adaptive(one.method, scene, until, float(one.dt))
        seconds = time.perf_counter() - begun
        error = quantity.error(found.positions / length, value)
        points.append(Point(one, error, seconds, found.steps or 0))
    return points


def _references(
    scene: Scene,
    quantities: Sequence[MeasuredQuantity],
    given: Sequence[Reference],
    until: float | None,
) -> tuple[list[str], list[float | np.ndarray]]:
    """What each quantity is measured against, in words and as a value; no run is made twice."""
    runs: dict[str, Trajectory] = {}
    told: list[str] = []
    values: list[float | np.ndarray] = []
    for quantity, one in zip(quantities, given, strict=True):
        wanted = one
        if wanted is None:
            wanted = finest(scene) if quantity.exact is None else quantity.exact
        if isinstance(wanted, Setting):
            words = f"{wanted.family}, dt = {wanted.dt}"
            if words not in runs:
                runs[words] = _run(scene, wanted, until)
            told.append(words)
            values.append(quantity.measure(runs[words]))
        else:
            told.append(f"the value {wanted:g}" if isinstance(wanted, float) else "exact values")
            values.append(wanted)
    return told, values


def finest(scene: Scene) -> Setting:
    """A setting far more accurate than any that is worth while: order six where it can run."""
    best = Setting("blanes-moan-6", "auto/2")
    if is_allowed(scene, best.dt, best.method):
        return best
    return Setting("stormer-verlet", "auto/16")


def _run(scene: Scene, setting: Setting, until: float | None) -> Trajectory:
    from granular.run.simulation import simulate

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error is measured here, and shown
        return simulate(
            scene.replace(**setting.changes), dt=setting.dt, t_end=until, method=setting.method,
            progress=False,
        )  # fmt: skip


def _points(
    scene: Scene,
    quantities: Sequence[MeasuredQuantity],
    setting: Setting,
    values: Sequence[float | np.ndarray],
    until: float | None,
    repeats: int,
) -> list[Point]:
    """A point for each quantity, from the same runs."""
    try:
        _warm(scene, setting)
        seconds = math.inf
        for _ in range(repeats):
            begun = time.perf_counter()
            run = _run(scene, setting, until)
            seconds = min(seconds, time.perf_counter() - begun)
            if seconds > LONG:
                break
    except GranularError as stop:
        return [_failed(setting, stop)] * len(quantities)
    points = []
    for quantity, value in zip(quantities, values, strict=True):
        try:
            error = quantity.error(quantity.measure(run), value)
            points.append(Point(setting, error, seconds, int(run.settings()["steps"])))
        except GranularError as stop:
            points.append(_failed(setting, stop))
    return points


def _failed(setting: Setting, stop: GranularError) -> Point:
    return Point(setting, math.nan, math.nan, 0, f"{type(stop).__name__}: {stop}")


def _warm(scene: Scene, setting: Setting) -> None:
    """Compile, by a run so short that it costs nothing; a long step may not even fit into it."""
    import contextlib

    with contextlib.suppress(GranularError):
        _run(scene, setting._replace(dt="auto"), 1e-3 * scene.output.scalars)


def _scatter(
    scene: Scene,
    quantities: Sequence[MeasuredQuantity],
    setting: Setting,
    until: float | None,
    seeds: int,
) -> list[float]:
    """Standard deviation of each quantity over further starts, as an error."""
    if seeds < 2:
        return [0.0] * len(quantities)
    first = scene.arrangement.seed + 1
    runs = [
        _run(scene.replace(**{"arrangement.seed": seed}), setting, until)
        for seed in range(first, first + seeds)
    ]
    return [_spread(one, [np.asarray(one.measure(run)) for run in runs]) for one in quantities]


def _spread(quantity: MeasuredQuantity, values: Sequence[np.ndarray]) -> float:
    spread = float(np.std(values, axis=0, ddof=1).max())
    return spread / float(np.abs(np.mean(values, axis=0)).max()) if quantity.relative else spread
