"""Stages of a protocol: a free piston, a driven piston, and user-defined stages.

User-defined stages are classes with one static function of time, and a decorator:

    import math

    from granular import quantity, stage

    @stage
    class Tap:
        \"\"\"The piston moves smoothly down and up again.\"\"\"

        depth: float = quantity("m", above=0.0)

        @staticmethod
        def height(p, time, start):
            return start - p.depth * math.sin(math.pi * time / p.duration) ** 2

A protocol can then contain ``{ kind = "tap", name = "tap", depth = "1 mm", duration = "0.5 s" }``.
``height(p, time, start)`` [m] drives the piston from its height ``start`` at the stage's start; ``force(p,
time)`` [N], given instead of ``height``, is an upward force on a free piston. ``time`` [s] is measured from
the stage's start. ``p`` contains the parameters in SI, and the ``duration`` of the stage. The function is
plain Python and must be smooth. It is called only before the run; the run itself uses a spline through the
values.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from granular.effects.custom import CustomSection, make_and_register_section_class
from granular.formulas.algebra import LENGTH, TIME, Dimension
from granular.protocol.piston_motion import DESCENT, SINE, TABLE, PistonMotion
from granular.protocol.stage import FormulaStage, SplineStage, Stage, TimedStage
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import quantity, quantity_list_field, text_field
from granular.shared.array_types import Float
from granular.shared.errors import InputError, quote


class Free(TimedStage):
    """Free motion of the piston from its present height and velocity; requires ``piston.mass``."""

    needs_piston_mass = True

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Free motion from the present height and velocity; ``height`` in m."""
        return PistonMotion(free=True, start=height / scales.length)


class Push(TimedStage):
    """Upward force F(t) = mean + amplitude sin(2 pi f t) on the free piston.

    Attributes
    ----------
    amplitude, mean : float
        Amplitude and mean of the force [N].
    frequency : float
        Frequency f [Hz]; t is measured from the stage's start.
    """

    needs_piston_mass = True
    has_outer_force = True

    amplitude: float = quantity("N", default=0.0, least=0.0)
    mean: float = quantity("N", default=0.0)
    frequency: float = quantity("Hz", default=0.0, least=0.0)

    def validate(self) -> None:
        """Check that a force with an amplitude has a frequency, and that the stage does not end at rest."""
        super().validate()
        if self.amplitude > 0.0 and self.frequency == 0.0:
            raise FieldError(
                "is missing or 0, but the force has an amplitude; give a frequency above 0 Hz", "frequency"
            )
        if self.until == "rest" and self.amplitude > 0.0:
            raise FieldError(
                "a piston under an oscillating force does not come to rest; remove until", "until"
            )

    def outer_force(self, times: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Sinusoidal force [N] at times since the stage's start [s]."""
        return self.mean + self.amplitude * np.sin(2.0 * math.pi * self.frequency * times)

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Free motion under a sinusoidal force; ``height`` in m."""
        return PistonMotion(
            free=True,
            start=height / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
            push=self.amplitude / scales.force,
            bias=self.mean / scales.force,
        )


class Force(FormulaStage):
    """Upward force on the free piston as a formula, such as ``f*exp(-t/s)``.

    Attributes
    ----------
    force : str
        Formula of the force [N], a smooth function of the time ``t`` since the stage's start. The values of
        its parameters are given with units next to the formula.
    duration : float
        Duration of the stage [s].
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME}
    needs_piston_mass = True
    has_outer_force = True
    driven_quantity = "force"
    formula_key: ClassVar[str] = "force"
    unit: ClassVar[str] = "N"

    force: str = text_field()


class Hold(TimedStage):
    """Hold the piston at its present height; by default until the end of the run."""

    needs_piston = False  # a bed without a piston can be held, too

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Piston at rest at its present height; ``height`` in m."""
        return PistonMotion(start=height / scales.length)


class Move(Stage):
    """Motion at constant speed to a given height, as in the compression of [D, 2.3.3].

    Attributes
    ----------
    to : float
        Height at the end [m].
    speed : float or None
        Magnitude of the velocity [m/s].
    duration : float or None
        Duration [s]; give either speed or duration.
    until_force : float or None
        The stage ends earlier if the force of the grains on the piston reaches this value [N]; de Paula's
        experiments stop at 110 N.
    """

    to: float = quantity("m", above=0.0)
    speed: float | None = quantity("m/s", above=0.0, default=None, optional=True)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    until_force: float | None = quantity("N", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        """Check that either speed or duration is given."""
        if (self.speed is None) == (self.duration is None):
            raise FieldError("speed or duration is needed, but not both; give one of them", "speed")

    @property
    def ends_at_force(self) -> bool:
        """True if ``until_force`` is given."""
        return self.until_force is not None

    def maximum_duration(self, height: float) -> float | None:
        """Duration of the motion at constant speed [s]; ``height`` in m."""
        if self.duration is not None:
            return self.duration
        assert self.speed is not None
        return abs(self.to - height) / self.speed

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Motion at constant speed to ``to``; height at the start [m]."""
        duration = self.maximum_duration(height)
        velocity = (self.to - height) / duration if duration else 0.0
        limit = math.inf if self.until_force is None else self.until_force / scales.force
        return PistonMotion(start=height / scales.length, speed=velocity / scales.velocity, limit=limit)

    def prescribed_final_height(self) -> float | None:
        """Height at the end of the stage [m]."""
        return self.to


class Descend(Stage):
    """Descent by the exponential law of [D, 2.3.2].

    The law is interpreted as

        H(t) = H_s - (H_s - to) (e^(k t/duration) - 1) / (e^k - 1)

    from the initial height H_s. With k = 5 and duration 5 T, the law is de Paula's relaxation with exp(t/T -
    5).

    Attributes
    ----------
    to : float
        Height at the end [m].
    duration : float
        Duration of the descent [s].
    steepness : float
        Exponent k.
    """

    to: float = quantity("m", above=0.0)
    duration: float = quantity("s", above=0.0)
    steepness: float = quantity("1", default=5.0, above=0.0)

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Exponential descent to ``to`` (de Paula, sec. 2.3.2); ``height`` in m."""
        return PistonMotion(
            kind=DESCENT,
            start=height / scales.length,
            reach=(height - self.to) / scales.length,
            total_duration=self.duration / scales.time,
            steepness=self.steepness,
        )

    def prescribed_final_height(self) -> float | None:
        """Height at the end of the stage [m]."""
        return self.to


class Follow(Stage):
    """Piston height by linear interpolation of a table; the piston first jumps to the first height.

    Attributes
    ----------
    times : tuple of float
        Times [s], increasing from 0, measured from the stage's start.
    heights : tuple of float
        Heights of the piston at these times [m].
    """

    times: tuple[float, ...] = quantity_list_field("s", least=0.0)
    heights: tuple[float, ...] = quantity_list_field("m", above=0.0)

    def validate(self) -> None:
        """Check that the times increase from 0, and that there are as many heights as times."""
        if len(self.times) != len(self.heights):
            raise FieldError(
                f"has {len(self.heights)} values for {len(self.times)} times; give one for each", "heights"
            )
        if len(self.times) < 2 or self.times[0] != 0.0 or (np.diff(self.times) <= 0.0).any():
            raise FieldError(
                "are fewer than 2 or do not increase from 0; give 2 or more increasing values from 0", "times"
            )

    def maximum_duration(self, height: float) -> float | None:
        """Duration of the table [s]; ``height`` in m."""
        return self.times[-1]

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Linear interpolation of the table; ``height`` in m."""
        return PistonMotion(
            kind=TABLE,
            start=self.heights[0] / scales.length,
            times=np.array(self.times) / scales.time,
            heights=np.array(self.heights) / scales.length,
        )

    def initial_jump(self, height: float) -> float:
        """Jump of the piston to the first height of the table [m]; ``height`` in m."""
        return self.heights[0] - height

    def prescribed_final_height(self) -> float | None:
        """Height at the end of the stage [m]."""
        return self.heights[-1]


class Oscillate(Stage):
    """Oscillation H + amplitude sin(2 pi f t) about the initial height H.

    Attributes
    ----------
    amplitude : float
        Amplitude of the piston [m].
    frequency : float
        Frequency f [Hz]; t is measured from the stage's start.
    duration : float or None
        Duration of the stage [s]; by default until the end of the run.
    """

    amplitude: float = quantity("m", above=0.0)
    frequency: float = quantity("Hz", above=0.0)
    duration: float | None = quantity("s", above=0.0, default=None, optional=True)

    def validate(self) -> None:
        """Check that the duration is at least a quarter of a period."""
        if self.duration is not None and self.duration * self.frequency < 0.25:
            raise FieldError(
                f"{self.duration:g} s is less than a quarter of a period, {0.25 / self.frequency:g} s; "
                "give a longer duration",
                "duration",
            )

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Sinusoidal motion about the present height [m]."""
        return PistonMotion(
            kind=SINE,
            start=height / scales.length,
            reach=self.amplitude / scales.length,
            omega=2.0 * math.pi * self.frequency * scales.time,
        )


class Lift(Stage):
    """Instantaneous displacement of the piston, as in [D, 5.3]; the grains stay in place.

    Attributes
    ----------
    by : float
        Displacement [m]; negative lowers the piston.
    """

    by: float = quantity("m")

    def initial_jump(self, height: float) -> float:
        """Jump of the piston [m]; ``height`` in m."""
        return self.by

    def maximum_duration(self, height: float) -> float | None:
        """Return 0, since a jump takes no time."""
        return 0.0

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Piston at rest at the height after the jump; ``height`` in m."""
        return PistonMotion(start=height / scales.length)


class Path(FormulaStage):
    """Height of the piston as a formula, such as ``h0 - a*(1 - cos(w*t))/2``.

    Attributes
    ----------
    height : str
        Formula of the height [m], a smooth function of the time ``t`` since the stage's start. At t = 0 the
        value must be the initial height ``h0``, which the formula may contain. The values of parameters are
        given with units next to the formula.
    duration : float
        Duration of the stage [s].
    """

    variables: ClassVar[Mapping[str, Dimension]] = {"t": TIME, "h0": LENGTH}
    formula_key: ClassVar[str] = "height"
    unit: ClassVar[str] = "m"

    height: str = text_field()


def check_spline_stages(protocol: Sequence[Stage], height: float, scales: Scales) -> None:
    """Check the stages with functions of time before the run; ``height`` is the initial piston height [m]."""
    known = True  # whether the initial height of the stage is known; after a free stage it is not
    for stage in protocol:
        height += stage.initial_jump(height) if known else 0.0
        if isinstance(stage, SplineStage):
            with name_stage_in_errors(stage, "checked before the run"):
                if known or stage.needs_piston_mass:
                    end = stage.piston_motion(height, scales).heights[-1] * scales.length
                elif not np.isfinite(stage.driven_height_or_force(np.zeros(1), height)[0]):
                    raise FieldError(
                        "is infinite or not a number at the stage's start; correct the function",
                        stage.driven_quantity,
                    )
            known = known and not stage.needs_piston_mass
            height = float(end) if known else height
            continue
        final = stage.prescribed_final_height()
        known = (known and isinstance(stage, Hold | Lift)) or (final is not None and not stage.ends_at_force)
        height = height if final is None else final


@contextlib.contextmanager
def name_stage_in_errors(stage: Stage, when: str) -> Iterator[None]:
    """Put the name of a stage and ``when`` in front of error messages from the ``with`` block."""
    try:
        yield
    except InputError as error:
        raise InputError(f"stage {quote(stage.name)}, {when}: {error}") from None


class CustomStage(CustomSection, SplineStage):
    """Base class of the stages made by `stage`."""

    noun = "stage"
    needed = ("height", "force")
    partners: ClassVar[Mapping[str, str | None]] = {"height": None, "force": None}

    @classmethod
    def register_class(cls) -> None:
        """Register the stage for protocols; it may replace a custom stage, but not a built-in one."""
        key, names = cls.definition.key, cls.definition.names
        if len(names) != 1:
            raise InputError(f"stage {key!r} has both 'height' and 'force'; remove one of them")
        if not issubclass(KINDS.get(key, CustomStage), CustomStage):
            raise InputError(f"stage {key!r} is built in; give the class another name")
        cls.driven_quantity = names[0]
        cls.needs_piston_mass = cls.has_outer_force = names == ("force",)
        KINDS[key] = cls

    def driven_height_or_force(self, times: Float[np.ndarray, "k"], height: float) -> Float[np.ndarray, "k"]:
        """Sample the user's function [m or N] at any times [s]; ``height`` in m."""
        ((name, function),) = self.definition.functions.items()
        start = () if self.needs_piston_mass else (height,)
        values = np.empty(len(times))
        for k, time in enumerate(times):
            try:
                values[k] = float(function(self, float(time), *start))
            except Exception as error:
                failure = f"{name} fails {time:g} s after the stage's start"
                raise self.definition.error(failure, error) from None
        return values

    def driven_height_or_force_and_slope(
        self, times: Float[np.ndarray, "k"], height: float
    ) -> Float[np.ndarray, "2 k"]:
        """Sample the user's function [m or N] and the slopes of its spline [per s]; times [s], height [m]."""
        from scipy.interpolate import CubicSpline

        values = self.driven_height_or_force(times, height)
        if not np.isfinite(values).all():
            return np.array([values, values])
        return np.array([values, CubicSpline(times, values)(times, 1)])

    def to_plain(self) -> dict[str, Any]:
        """Return the stage as plain data that includes its ``kind``."""
        return {"kind": self.definition.key, **super().to_plain()}  # also for an edited class


def stage(user_class: type) -> Any:
    """Turn a class into a stage for protocols; `granular.protocol.stages` describes the functions.

    Parameters
    ----------
    user_class : type
        A class with parameters (`quantity`) and the static function ``height`` [m] or ``force`` [N]. The
        ``kind`` in a protocol is the name of the class in lower case, with underscores between words:
        ``leaf_spring`` for ``LeafSpring``. An earlier custom stage with this name is replaced.

    Returns
    -------
    type
        A subclass of `CustomStage` with the class's parameters, registered for protocols by its name.

    Raises
    ------
    InputError
        If the class has neither or both of the functions, another function, or a function that is not static.
        Also if a parameter is not a `quantity`, or the class or an attribute has the name of a built-in stage
        or a reserved name. If a function itself fails, this error is raised only at the start of a run.
    """
    return make_and_register_section_class(user_class, CustomStage)


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
