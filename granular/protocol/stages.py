"""Stages of a protocol: the piston free, driven, or under a user's function.

Stages of a user's own: classes with one static function of time, and a decorator.

    import math

    from granular import quantity, stage

    @stage
    class Tap:
        \"\"\"The piston goes down and up again, softly.\"\"\"

        depth: float = quantity("m", above=0.0)

        @staticmethod
        def height(p, time, start):
            return start - p.depth * math.sin(math.pi * time / p.duration) ** 2

From then on a scene may have ``{ kind = "tap", name = "tap", depth = "1 mm", duration = "0.5 s" }`` in
its protocol. ``height(p, time, start)`` [m] drives the piston from the height ``start`` that it has at
the stage's start; ``force(p, time)`` [N], in its place, pushes a free piston upwards. ``time`` [s] counts
from the stage's start, and ``p`` has the parameters in SI and the ``duration``, which every such stage
has. The function is plain Python; it is called before the run alone, must be smooth, and becomes a
spline.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from granular.effects.custom import CustomSection, make_section_class
from granular.formulas.algebra import LENGTH, TIME, Dimension
from granular.protocol.piston_motion import DESCENT, SINE, TABLE, Motion
from granular.protocol.stage import FormulaStage, SampledStage, Stage, TimedStage
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity, quantity_list_field, text_field
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote


class Free(TimedStage):
    """Free motion from the present height and velocity. Needs ``piston.mass``."""

    needs_piston_mass = True

    def motion(self, height: float, scales: Scales) -> Motion:
        """Free motion from the present height and velocity; height [m]."""
        return Motion(free=True, start=height / scales.length)


class Push(TimedStage):
    """The force F(t) = mean + amplitude sin(2 pi f t) on the free piston, upwards.

    Attributes
    ----------
    amplitude, mean : float
        [N]
    frequency : float
        f [Hz]; t counts from the stage's start.
    """

    needs_piston_mass = True
    has_outer_force = True

    amplitude: float = quantity("N", default=0.0, least=0.0)
    mean: float = quantity("N", default=0.0)
    frequency: float = quantity("Hz", default=0.0, least=0.0)

    def validate(self) -> None:
        """Check that a force with an amplitude has a frequency, and does not wait for rest."""
        super().validate()
        if self.amplitude > 0.0 and self.frequency == 0.0:
            raise FieldError("must be above 0 Hz where the force has an amplitude", "frequency")
        if self.until == "rest" and self.amplitude > 0.0:
            raise FieldError("a piston that is pushed to and fro does not come to rest", "until")

    def outer_force(self, times: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Sinusoidal force [N] at times since the stage's start [s]."""
        return self.mean + self.amplitude * np.sin(2.0 * math.pi * self.frequency * times)

    def motion(self, height: float, scales: Scales) -> Motion:
        """Free motion under a sinusoidal force; height [m]."""
        return Motion(
            free=True,
            start=height / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
            push=self.amplitude / scales.force,
            bias=self.mean / scales.force,
        )


class Force(FormulaStage):
    """A force on the free piston, upwards, such as ``f*exp(-t/s)``.

    Attributes
    ----------
    force : str
        [N]; of the time ``t`` since the stage's start, and parameters, which stand next to it with
        their units. It must be smooth.
    duration : float
        [s]
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME}
    needs_piston_mass = True
    has_outer_force = True
    driven_quantity = "force"
    formula_key: ClassVar[str] = "force"
    unit: ClassVar[str] = "N"

    force: str = text_field()


class Hold(TimedStage):
    """The piston stays where it is. Without duration and ``until``: as long as the run."""

    needs_piston = False  # a bed without a piston can be held, too

    def motion(self, height: float, scales: Scales) -> Motion:
        """Piston at rest at its present height; height [m]."""
        return Motion(start=height / scales.length)


class Move(Stage):
    """Constant speed to a height, as in the compression of [D, 2.3.3].

    Attributes
    ----------
    to : float
        Height at the end [m].
    speed : float or None
        Magnitude of the velocity [m/s].
    duration : float or None
        Duration [s]; one of speed and duration is given.
    until_force : float or None
        Stop before, as soon as the grains push the piston with this force [N]; the experiments of
        de Paula stop at 110 N.
    """

    to: float = quantity("m", above=0.0)
    speed: float | None = quantity("m/s", above=0.0, default=None, optional=True)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    until_force: float | None = quantity("N", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        """Check that one of speed and duration is given."""
        if (self.speed is None) == (self.duration is None):
            raise FieldError("give either speed or duration", "speed")

    @property
    def ends_at_force(self) -> bool:
        """True where ``until_force`` is given."""
        return self.until_force is not None

    def total_duration(self, height: float) -> float | None:
        """Duration of the way at the constant speed [s]; height [m]."""
        if self.duration is not None:
            return self.duration
        assert self.speed is not None
        return abs(self.to - height) / self.speed

    def motion(self, height: float, scales: Scales) -> Motion:
        """Straight motion to ``to``; height [m]."""
        duration = self.total_duration(height)
        velocity = (self.to - height) / duration if duration else 0.0
        limit = math.inf if self.until_force is None else self.until_force / scales.force
        return Motion(start=height / scales.length, speed=velocity / scales.velocity, limit=limit)

    def prescribed_final_height(self) -> float | None:
        """Height that the stage ends at [m]."""
        return self.to


class Descend(Stage):
    """Descent by the exponential law of [D, 2.3.2].

    It is read as

        H(t) = H_s - (H_s - to) (e^(k t/duration) - 1) / (e^k - 1)

    from the present height H_s, with k = 5: de Paula's relaxation of 5 T under exp(t/T - 5).

    Attributes
    ----------
    to : float
        Height at the end [m].
    duration : float
        [s]
    steepness : float
        k
    """

    to: float = quantity("m", above=0.0)
    duration: float = quantity("s", above=0.0)
    steepness: float = quantity("1", default=5.0, above=0.0)

    def motion(self, height: float, scales: Scales) -> Motion:
        """Exponential descent to ``to``, [D, 2.3.2]; height [m]."""
        return Motion(
            kind=DESCENT,
            start=height / scales.length,
            reach=(height - self.to) / scales.length,
            total_duration=self.duration / scales.time,
            steepness=self.steepness,
        )

    def prescribed_final_height(self) -> float | None:
        """Height that the stage ends at [m]."""
        return self.to


class Follow(Stage):
    """Straight lines from row to row of a table; the piston starts at the first height.

    Attributes
    ----------
    times : tuple of float
        [s], increasing from 0, counted from the stage's start.
    heights : tuple of float
        [m]
    """

    times: tuple[float, ...] = quantity_list_field("s", least=0.0)
    heights: tuple[float, ...] = quantity_list_field("m", above=0.0)

    def validate(self) -> None:
        """Check that the times increase from 0, with a height each."""
        if len(self.times) != len(self.heights):
            raise FieldError(f"holds {len(self.heights)} values for {len(self.times)} times", "heights")
        if len(self.times) < 2 or self.times[0] != 0.0 or (np.diff(self.times) <= 0.0).any():
            raise FieldError("must increase from 0, with at least two values", "times")

    def total_duration(self, height: float) -> float | None:
        """Duration of the table [s]; height [m]."""
        return self.times[-1]

    def motion(self, height: float, scales: Scales) -> Motion:
        """Straight lines from row to row of the table; height [m]."""
        return Motion(
            kind=TABLE,
            start=self.heights[0] / scales.length,
            times=np.array(self.times) / scales.time,
            heights=np.array(self.heights) / scales.length,
        )

    def initial_jump(self, height: float) -> float:
        """Jump of the piston to the first height of the table [m]; height [m]."""
        return self.heights[0] - height

    def prescribed_final_height(self) -> float | None:
        """Height that the stage ends at [m]."""
        return self.heights[-1]


class Oscillate(Stage):
    """Height H + amplitude sin(2 pi f t) about the present height H.

    Attributes
    ----------
    amplitude : float
        [m]
    frequency : float
        f [Hz]; t counts from the stage's start.
    duration : float or None
        [s]; without, as long as the run.
    """

    amplitude: float = quantity("m", above=0.0)
    frequency: float = quantity("Hz", above=0.0)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        """Check that the duration is at least a quarter of a period."""
        if self.duration is not None and self.duration * self.frequency < 0.25:
            raise FieldError(
                f"{self.duration:g} s is less than a quarter of a period, {0.25 / self.frequency:g} s",
                "duration",
            )

    def motion(self, height: float, scales: Scales) -> Motion:
        """Sine about the present height; height [m]."""
        return Motion(
            kind=SINE,
            start=height / scales.length,
            reach=self.amplitude / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
        )


class Lift(Stage):
    """The nudge of [D, 5.3]: the piston is set ``by`` higher, faster than the grains can follow.

    Attributes
    ----------
    by : float
        Displacement [m]; negative lowers the piston.
    """

    by: float = quantity("m")

    def initial_jump(self, height: float) -> float:
        """Jump of the piston [m]; height [m]."""
        return self.by

    def total_duration(self, height: float) -> float | None:
        """Duration of the jump; height [m]."""
        return 0.0

    def motion(self, height: float, scales: Scales) -> Motion:
        """Piston at rest at the height that it jumped to; height [m]."""
        return Motion(start=height / scales.length)


class Path(FormulaStage):
    """A height as a formula, such as ``h0 - a*(1 - cos(w*t))/2``.

    Attributes
    ----------
    height : str
        [m]; of the time ``t`` since the stage's start, the height ``h0`` there, and parameters,
        which stand next to it with their units. It must begin at ``h0`` and be smooth.
    duration : float
        [s]
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME, "h0": LENGTH}
    formula_key: ClassVar[str] = "height"
    unit: ClassVar[str] = "m"

    height: str = text_field()


def try_stages(protocol: Sequence[Stage], height: float, scales: Scales) -> None:
    """Raise the errors of all stages that are functions of time; height of the piston at the start [m]."""
    known = True  # the height that a stage begins at; after a free stage only the run tells it
    for stage in protocol:
        height += stage.initial_jump(height) if known else 0.0
        if isinstance(stage, SampledStage):
            with name_stage_in_errors(stage, "tried before the run"):
                if known or stage.needs_piston_mass:
                    end = stage.motion(height, scales).heights[-1] * scales.length
                elif not np.isfinite(stage.sample_values(np.zeros(1), height)[0]):
                    raise FieldError("is not finite at the stage's start", stage.driven_quantity)
            known = known and not stage.needs_piston_mass
            height = float(end) if known else height
            continue
        final = stage.prescribed_final_height()
        known = (known and isinstance(stage, Hold | Lift)) or (final is not None and not stage.ends_at_force)
        height = height if final is None else final


@contextlib.contextmanager
def name_stage_in_errors(stage: Stage, when: str) -> Iterator[None]:
    """Put the name of a stage and a time in front of errors within the block."""
    try:
        yield
    except InputError as error:
        raise InputError(f"stage {quote(stage.name)}, {when}: {error}") from None


class CustomStage(CustomSection, SampledStage):
    """Base of the stages that `stage` makes."""

    noun = "stage"
    needed = ("height", "force")
    partners: ClassVar[Mapping[str, str | None]] = {"height": None, "force": None}

    @classmethod
    def register_class(cls) -> None:
        """Let protocols name it; a custom one of the same name is replaced, a built-in one refused."""
        key, names = cls.definition.key, cls.definition.names
        if len(names) != 1:
            raise InputError(f"stage {key!r} has both 'height' and 'force'; take one of them out")
        if not issubclass(KINDS.get(key, CustomStage), CustomStage):
            raise InputError(f"stage {key!r} is a built-in one; give the class another name")
        cls.driven_quantity = names[0]
        cls.needs_piston_mass = cls.has_outer_force = names == ("force",)
        KINDS[key] = cls

    def sample_values(self, times: Float[np.ndarray, "k"], height: float) -> Float[np.ndarray, "k"]:
        """Sample the user's function [m, N] at any times [s]; height [m]."""
        ((name, function),) = self.definition.functions.items()
        start = () if self.needs_piston_mass else (height,)
        values = np.empty(len(times))
        for k, time in enumerate(times):
            try:
                values[k] = float(function(self, float(time), *start))
            except Exception as error:
                what = f"{name} fails {time:g} s after the stage's start"
                raise self.definition.error(what, error) from None
        return values

    def sample_values_and_slopes(
        self, times: Float[np.ndarray, "k"], height: float
    ) -> Float[np.ndarray, "2 k"]:
        """Sample the user's function [m; N] and its spline's slopes [m/s; N/s]; times [s], height [m]."""
        from scipy.interpolate import CubicSpline

        values = self.sample_values(times, height)
        if not np.isfinite(values).all():
            return np.array([values, values])
        return np.array([values, CubicSpline(times, values)(times, 1)])

    def to_plain(self) -> dict[str, Any]:
        """Stage as plain data, with its kind."""
        return {"kind": self.definition.key, **super().to_plain()}  # also of a class that was edited


def stage(user_class: type) -> Any:
    """Make a class a stage that protocols can name; see the head of this file.

    Parameters
    ----------
    user_class : type
        A class with parameters (`quantity`) and the static function ``height`` [m] or ``force`` [N]. Its
        name in small letters, with underscores between words (``LeafSpring`` is ``leaf_spring``), is the
        ``kind`` that a protocol gives; a custom one of that name is replaced.

    Returns
    -------
    type
        A `CustomStage` with the class's parameters, known to protocols by its name.

    Raises
    ------
    InputError
        If the class has neither or both, another static or a not static function, a parameter that is no
        `quantity`, an attribute whose name has a meaning of its own, or the name of a built-in stage. A
        function that fails does so when a run begins.
    """
    return make_section_class(user_class, CustomStage)


KINDS: dict[str, type[Stage]] = {
    "hold": Hold,
    "move": Move,
    "descend": Descend,
    "follow": Follow,
    "oscillate": Oscillate,
    "free": Free,
    "push": Push,
    "lift": Lift,
    "path": Path,
    "force": Force,
}
