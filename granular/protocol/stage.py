"""What all stages share."""

from __future__ import annotations

from collections.abc import Sequence

from granular.protocol.motion import Motion, tabled
from granular.scene.scales import Scales
from granular.scene.schema import FieldError, Section, choice, quantity, text

REST_LIMIT = 60.0
"""Longest wait for rest where the stage gives no duration [s]."""


class Stage(Section):
    """A stage of the protocol.

    Attributes
    ----------
    name : str
        Unique in its protocol.
    """

    name: str = text()

    @property
    def needs_piston(self) -> bool:
        return True

    @property
    def tabled(self) -> bool:
        """Whether its motion is a table or a spline."""
        return False

    @property
    def needs_mass(self) -> bool:
        return False

    @property
    def limits_force(self) -> bool:
        """Whether the stage ends at a force on the piston."""
        return False

    def jump(self, height: float) -> float:
        """How far the piston is set higher at once, at the stage's start from a height [m]."""
        return 0.0

    def span(self, height: float) -> float | None:
        """Longest duration [s] from the piston height [m]; None is without end."""
        raise NotImplementedError

    def motion(self, height: float, scales: Scales) -> Motion:
        """The piston's motion from the height [m] at the stage's start, in natural units."""
        raise NotImplementedError

    def final_height(self) -> float | None:
        """Height [m] that the stage ends at exactly; None where it is not prescribed."""
        return None


class Timed(Stage):
    """A stage that ends after a duration or at rest.

    Attributes
    ----------
    duration : float or None
        Length of the stage [s]; with ``until``, the longest one (60 s if not given).
    until : str or None
        ``"rest"`` ends the stage at rest.
    tolerance : float or None
        At rest the piston stays within this height [m], and no grain goes as far in one natural
        time. 1e-4 D if not given.
    window : float
        How long that must last [s]: longer than a swing of the piston.
    """

    duration: float | None = quantity("s", above=0.0, default=None, optional=True)
    until: str | None = choice("rest", default=None, optional=True)
    tolerance: float | None = quantity("m", above=0.0, default=None, optional=True)
    window: float = quantity("s", default=1.0, above=0.0)

    def validate(self) -> None:
        if self.until is None and self.tolerance is not None:
            raise FieldError("only counts with until = 'rest'", "tolerance")
        if self.until is not None and self.duration is not None and self.duration <= self.window:
            raise FieldError(
                f"{self.duration:g} s is no longer than the window of rest, {self.window:g} s",
                "duration",
            )

    def span(self, height: float) -> float | None:
        if self.duration is None and self.until is not None:
            return REST_LIMIT
        return self.duration


def stage_motion(protocol: Sequence[Stage], stage: Stage, height: float, scales: Scales) -> Motion:
    """Motion of one stage from a height [m], of the type that all stages of its protocol share."""
    motion = stage.motion(height, scales)
    return tabled(motion) if any(one.tabled for one in protocol) else motion
