"""Base classes of stages: all stages, stages with a duration, and stages given by a function of time."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any, ClassVar

import numpy as np

from granular.protocol.piston_motion import SPLINE, PistonMotion
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import Section, SectionWithFormula, choice_field, quantity, text_field
from granular.shared.array_types import Float

REST_LIMIT = 60.0
"""Default maximum time until rest [s], for a stage without a duration."""


class Stage(Section):
    """A stage of the protocol.

    Attributes
    ----------
    name : str
        Name, unique in the protocol.
    needs_piston : bool
        True if the scene must have a piston.
    needs_piston_mass : bool
        True if the piston moves freely and must have a mass.
    has_outer_force : bool
        True if an outer force acts on the free piston.
    """

    needs_piston: ClassVar[bool] = True
    needs_piston_mass: ClassVar[bool] = False
    has_outer_force: ClassVar[bool] = False

    name: str = text_field()

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digests of user-defined functions in the stage."""
        return ()

    @property
    def ends_at_force(self) -> bool:
        """True if the stage ends when the force on the piston reaches a given value."""
        return False

    def outer_force(self, times: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Outer force on the free piston, for stages with ``has_outer_force``.

        Parameters
        ----------
        times : float64 (k,)
            Times since the stage's start [s].

        Returns
        -------
        float64 (k,)
            Upward force [N].

        Raises
        ------
        NotImplementedError
            In the base class.
        """
        raise NotImplementedError

    def initial_jump(self, height: float) -> float:
        """Jump of the piston at the stage's start.

        Parameters
        ----------
        height : float
            Height before the jump [m].

        Returns
        -------
        float
            Upward displacement [m]; 0 without a jump.
        """
        return 0.0

    def maximum_duration(self, height: float) -> float | None:
        """Maximum duration of the stage.

        Parameters
        ----------
        height : float
            Height of the piston at the stage's start [m].

        Returns
        -------
        float or None
            Duration [s]; None: unlimited.
        """
        duration: float | None = getattr(self, "duration", None)
        return duration

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Motion of the piston in the stage, after the jump at its start.

        Parameters
        ----------
        height : float
            Height of the piston at the stage's start [m].
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        Motion
            Motion in natural units.

        Raises
        ------
        NotImplementedError
            In the base class.
        """
        raise NotImplementedError

    def prescribed_final_height(self) -> float | None:
        """Height at the end of the stage, if it is prescribed.

        Returns
        -------
        float or None
            Height [m]; None if it is not prescribed.
        """
        return None


class TimedStage(Stage):
    """A stage that ends after a duration or at rest.

    Attributes
    ----------
    duration : float or None
        Duration of the stage [s]; with ``until``, the maximum duration (60 s if not given).
    until : str or None
        ``"rest"`` ends the stage at rest.
    tolerance : float or None
        Tolerance for rest [m]: the height of the piston varies by at most this length, and no grain moves
        farther than this length in one natural time unit tau. 1e-4 D if not given.
    window : float
        Time for which the rest must last [s]; longer than an oscillation of the piston.
    """

    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    until: str | None = choice_field("rest", default=None, optional=True)
    tolerance: float | None = quantity("m", above=0.0, default=None, optional=True)
    window: float = quantity("s", default=1.0, above=0.0)

    def validate(self) -> None:
        """Check that ``tolerance`` is given only with ``until``, and that ``duration`` exceeds ``window``."""
        if self.until is None and self.tolerance is not None:
            raise FieldError(
                "has an effect only with until = 'rest'; remove it, or add until = 'rest'", "tolerance"
            )
        if self.until is not None and self.duration is not None and self.duration <= self.window:
            raise FieldError(
                f"{self.duration:g} s does not exceed window = {self.window:g} s, for which the rest must "
                "last; give a longer duration",
                "duration",
            )

    def maximum_duration(self, height: float) -> float | None:
        """Duration, or maximum time until rest [s]; ``height`` in m."""
        if self.duration is None and self.until is not None:
            return REST_LIMIT
        return self.duration


CLOSE = 1e-11
"""Maximum error of a spline between the knots, relative to the range of the values."""
# A period equal to the knot spacing looks constant halfway between knots, but not at the golden section.
CHECKED_FRACTIONS = (0.5, 0.3819660112501051)
MINIMUM_KNOTS, MAXIMUM_KNOTS = 64, 2**17  # 2**17 hold 195 periods of a sine to `CLOSE`


class SplineStage(Stage):
    """A stage in which a function of time gives the piston height or the force; a run uses its spline.

    Attributes
    ----------
    duration : float
        Duration of the stage [s].
    driven_quantity : str
        Quantity that the function gives, ``"height"`` or ``"force"``.
    """

    driven_quantity: ClassVar[str] = "height"

    duration: float = quantity("s", above=0.0)

    def outer_force(self, times: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Force [N] at times since the stage's start [s]."""
        return self.driven_height_or_force(times, 0.0)

    def driven_height_or_force(self, times: Float[np.ndarray, "k"], height: float) -> Float[np.ndarray, "k"]:
        """Sample the height [m] or force [N] at any times [s]; ``height``: initial piston height [m]."""
        return self.driven_height_or_force_and_slope(times, height)[0]

    def driven_height_or_force_and_slope(
        self, times: Float[np.ndarray, "k"], height: float
    ) -> Float[np.ndarray, "2 k"]:
        """Sample the driven quantity (height or force) and its slope.

        Parameters
        ----------
        times : float64 (k,)
            Equidistant times since the stage's start [s].
        height : float
            Height of the piston at the stage's start [m].

        Returns
        -------
        float64 (2, k)
            Values [m] or [N], and slopes [m/s] or [N/s].

        Raises
        ------
        NotImplementedError
            In the base class.
        """
        raise NotImplementedError

    def piston_motion(self, height: float, scales: Scales) -> PistonMotion:
        """Return a cubic spline through dense samples of the height or force; ``height`` in m."""
        times, values = self._times_and_samples_of_refined_knots(height)
        if not self.needs_piston_mass and abs(values[0, 0] - height) > 1e-9 * max(height, 1e-3):
            raise FieldError(
                f"starts at {values[0, 0]:g} m, but the piston is at {height:g} m; choose a "
                "function that equals the piston's height (h0) at the stage's start",
                self.driven_quantity,
            )
        unit = scales.force if self.needs_piston_mass else scales.length
        values, slopes = values * np.array([[1.0 / unit], [scales.time / unit]])
        return PistonMotion(
            free=self.needs_piston_mass,
            kind=SPLINE,
            start=height / scales.length,
            times=times / scales.time,
            heights=values,
            slopes=slopes,
        )

    def _times_and_samples_of_refined_knots(self, height: float) -> tuple[np.ndarray, np.ndarray]:
        """Return equidistant times (k,) [s] and samples (2, k), dense enough for an accurate spline."""
        count = MINIMUM_KNOTS
        while True:
            times = np.linspace(0.0, self.duration, count + 1)
            knots = self.driven_height_or_force_and_slope(times, height)
            if not np.isfinite(knots).all():
                raise FieldError(
                    "is infinite or not a number at some time in the stage; correct the function",
                    self.driven_quantity,
                )
            h = self.duration / count
            error = max(self._spline_error(times[:-1], h, knots, u, height) for u in CHECKED_FRACTIONS)
            if error <= CLOSE * max(np.ptp(knots[0]), np.abs(knots[0]).max()):
                return times, knots
            count *= 2
            if count > MAXIMUM_KNOTS:
                raise FieldError(
                    "changes too fast for a spline, or is not smooth; choose a smoother function",
                    self.driven_quantity,
                )

    def _spline_error(
        self,
        starts: Float[np.ndarray, "k"],
        h: float,
        knots: Float[np.ndarray, "2 k+1"],
        u: float,
        height: float,
    ) -> float:
        """Maximum error [m or N] of the spline at the fraction ``u`` of each interval of length ``h`` [s]."""
        (value, slope), v = knots, 1.0 - u
        spline = v**2 * (1.0 + 2.0 * u) * value[:-1] + u**2 * (1.0 + 2.0 * v) * value[1:]
        spline += h * u * v * (v * slope[:-1] - u * slope[1:])
        return float(np.abs(spline - self.driven_height_or_force_and_slope(starts + u * h, height)[0]).max())


class FormulaStage(SectionWithFormula, SplineStage):
    """A stage whose height or force is a formula of time."""

    def driven_height_or_force_and_slope(
        self, times: Float[np.ndarray, "k"], height: float
    ) -> Float[np.ndarray, "2 k"]:
        """Sample the formula [m or N] and its derivative [m/s or N/s]; times [s], height [m]."""
        given = [number for number, _ in self.parameters]
        value, slope = _make_value_and_slope_functions(
            self.formula, tuple(self.variables), tuple(dict(self.values))
        )
        start = [height] if "h0" in self.variables else []
        with np.errstate(all="ignore"):
            values = [np.broadcast_to(of(given, times, *start), times.shape) for of in (value, slope)]
        return np.array(values, dtype=np.float64)


@functools.cache
def _make_value_and_slope_functions(
    formula: str, variables: tuple[str, ...], parameters: tuple[str, ...]
) -> Iterable[Callable[..., Any]]:
    from granular.formulas.algebra import compile_formula

    return compile_formula(
        formula,
        parameters,
        (parameters, *variables),
        lambda value, symbols: {"value": value, "slope": value.diff(symbols["t"])},
    ).values()
