"""The cheapest setting that reaches a tolerance, ready for `simulate` and for the command line."""

from __future__ import annotations

import dataclasses
import math
import shlex
from collections.abc import Sequence
from typing import Any

from granular.run.allowed import is_allowed
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from validation.cost import FLOORS, Advice, Point, Setting, WorkPrecision, finest
from validation.cost.advice import advice, duration, holding, unbiased
from validation.cost.measuring import REPEATS, Truth, points, starts_of, truths
from validation.quantities import MeasuredQuantity, quantity_named

STEPS = ("auto*8", "auto*4", "auto*2", "auto", "auto/2", "auto/4", "auto/8")
CANDIDATES = ("stormer-verlet", "adaptive-verlet", "blanes-moan-4", "blanes-moan-6")

SEEDS = 4
"""Further starts of a scene that has random ones: five show a scatter to a third of itself."""

HOPELESS = 2.0
"""A family is given up where its next step would cost this many times what was found."""

RANDOM_REFERENCE = Setting("stormer-verlet", "auto/8")
"""Reference of a bed with random starts: what it comes to scatters by far more than this step's
error, and a reference of order six would cost more than all the settings."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """A setting that reaches a tolerance, by one run or by many starts.

    Attributes
    ----------
    scene, quantity : str
    tolerance, error : float
        What was asked for, and what was measured.
    seconds : float
        What one run takes.
    keywords : dict
        For ``simulate(scene.replace(**choice.changes), **choice.keywords)``.
    changes : dict
        Keys of the scene.
    study : WorkPrecision
        All settings that were tried.
    doubt : float
        Standard error of the error.
    starts : int
        How many random starts to average over: 1 unless the scatter of the starts forbids a single
        run to be that accurate.
    """

    scene: str
    quantity: str
    tolerance: float
    error: float
    seconds: float
    keywords: dict[str, Any]
    changes: dict[str, Any]
    study: WorkPrecision
    doubt: float = 0.0
    starts: int = 1

    @property
    def below_floor(self) -> bool:
        """Whether the starts scatter by too much for a single run."""
        return self.tolerance < FLOORS * self.study.floor

    @property
    def command(self) -> str:
        """The same for the command line."""
        words = ["python", "-m", "granular", "run", self.scene]
        for key, value in self.changes.items():
            words += ["--set", f"{key}={value}"]
        words += ["--dt", str(self.keywords["dt"]), "--method", self.keywords["method"]]
        return shlex.join(words)

    def __str__(self) -> str:
        what = f"{self.quantity} of {self.scene} to {self.tolerance:g}: "
        error = f"error {self.error:.2g}" + (f" +- {self.doubt:.1g}" if self.doubt else "")
        if not self.below_floor:
            return f"{what}{error} in {self.seconds:.3g} s\n  {self.command}"
        price = duration(self.starts * self.seconds)
        return (
            f"{what}any of these: the starts scatter by {self.study.floor:.2g}, which no step "
            f"mends; the mean of {self.starts:.3g} starts (arrangement.seed) costs {price}\n"
            f"  {self.command}    ({error} in {self.seconds:.3g} s)"
        )

    def to_plain(self) -> dict[str, Any]:
        """The choice as plain data, with its command."""
        plain = dataclasses.asdict(self) | {
            "command": self.command, "floor": self.study.floor, "below_floor": self.below_floor,
        }  # fmt: skip
        return plain | {"study": self.study.to_plain()}


def candidates(scene: Scene, methods: Sequence[str] = CANDIDATES) -> tuple[Setting, ...]:
    """The settings that `cheapest` tries: methods and steps, and never another law."""
    return tuple(
        Setting(name, dt) for name in methods for dt in STEPS if is_allowed(scene, dt, name)
    )


def cheapest(
    scene: Scene,
    quantity: str | MeasuredQuantity,
    tolerance: float,
    until: float | None = None,
    seeds: int = SEEDS,
) -> Choice:
    """The setting that gives a quantity to a tolerance in the least time.

    Each method is tried from long steps to short ones, until two in turn are accurate, or the next
    would cost far more than what was found. Where the scene has random starts, each setting is run
    from the same few of them: an error is then a mean deviation with its standard error, and a
    tolerance that the scatter of the starts forbids is answered by how many starts reach it.

    Parameters
    ----------
    scene : Scene
    quantity : str or MeasuredQuantity
        One of `validation.quantities.QUANTITIES`, or one's own.
    tolerance : float
        Error that is allowed; relative, but for the positions (in D) and the energy (over the
        energy turned over).
    until : float, optional
        Stop each run at this time [s]; the whole protocol without.
    seeds : int
        Further random starts.

    Raises
    ------
    InputError
        If the tolerance is not above 0, the quantity is unknown, or no setting tried reaches it.
    RunError
        If the reference fails.
    """
    chosen = quantity_named(quantity)
    if not 0.0 < tolerance < math.inf:
        raise InputError(f"tolerance = {tolerance!r}; give an error above 0, such as 0.01")
    if seeds < 0:
        raise InputError(f"seeds = {seeds}; give a number of further starts, 0 or more")
    scenes = starts_of(scene, seeds)
    (truth,) = truths(scenes, [chosen], [_reference(scene, chosen, len(scenes))], until)
    tried = _tried(scenes, chosen, truth, tolerance, until)
    study = WorkPrecision(
        scene.name, chosen.name, "1" if chosen.relative else chosen.unit, until, tuple(tried),
        truth.floor, truth.told,
    )  # fmt: skip
    return choice(study, tolerance)


def _reference(scene: Scene, quantity: MeasuredQuantity, starts: int) -> Setting | None:
    """What to measure against, where the quantity has no exact value."""
    if quantity.exact is not None:
        return None
    return RANDOM_REFERENCE if starts > 1 and not quantity.of_start else finest(scene)


def _tried(
    scenes: Sequence[Scene],
    quantity: MeasuredQuantity,
    truth: Truth,
    tolerance: float,
    until: float | None,
) -> list[Point]:
    """The points that it takes to choose, family by family."""
    tried: list[Point] = []
    settings = candidates(scenes[0])
    for family in dict.fromkeys(one.family for one in settings):
        own: list[Point] = []
        for setting in (one for one in settings if one.family == family):
            best = advice(tried + own, truth.floor, tolerance)
            if _settled(own, truth.floor, tolerance) or _too_dear(own, best):
                break
            own += points(scenes, [quantity], setting, [truth], until, REPEATS)
        tried += own
    return tried


def _settled(points: Sequence[Point], floor: float, tolerance: float) -> bool:
    """Whether the two finest points of a family are good enough."""
    last = points[-2:]
    if tolerance < FLOORS * floor:
        return len(unbiased(last)) == 2
    return len(holding(last, tolerance)) == 2


def _too_dear(points: Sequence[Point], best: Advice) -> bool:
    """Whether the next step of a family would cost far more than the best one so far."""
    done = [one for one in points if not one.failed]
    if not done or best.point is None or best.point in points[-1:]:
        return False
    return 2.0 * done[-1].seconds > HOPELESS * best.point.seconds


def choice(study: WorkPrecision, tolerance: float) -> Choice:
    """The choice that a study answers.

    Raises
    ------
    InputError
        If no setting of the study reaches the tolerance.
    """
    found = study.advice(tolerance)
    if found.point is None:
        front = study.front()
        best = f"{front[-1].error:.2g}" if front else "none"
        raise InputError(
            f"tolerance = {tolerance:g} for the {study.quantity} is reached by no setting tried; "
            f"the least error is {best}: give a larger tolerance or other settings"
        )
    setting = found.point.setting
    return Choice(
        study.scene, study.quantity, tolerance, found.point.error, found.point.seconds,
        {"dt": setting.dt, "method": setting.method}, dict(setting.changes), study,
        found.point.doubt, found.starts,
    )  # fmt: skip
