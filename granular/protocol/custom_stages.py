"""Stages of a user's own: classes with one static function of time, and a decorator.

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

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from granular.effects.custom import OwnSection, make_section_class
from granular.protocol import KINDS
from granular.protocol.stage import SampledStage
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Float


class OwnStage(OwnSection, SampledStage):
    """Base of the stages that `stage` makes."""

    what = "stage"
    needed = ("height", "force")
    partners: ClassVar[Mapping[str, str | None]] = {"height": None, "force": None}

    @classmethod
    def register_class(cls) -> None:
        """Let protocols name it; an own one of the same name is replaced, a built-in one refused."""
        key, names = cls.definition.key, cls.definition.names
        if len(names) != 1:
            raise InputError(f"stage {key!r} has both 'height' and 'force'; take one of them out")
        if not issubclass(KINDS.get(key, OwnStage), OwnStage):
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
        ``kind`` that a protocol gives; an own one of that name is replaced.

    Returns
    -------
    type
        An `OwnStage` with the class's parameters, known to protocols by its name.

    Raises
    ------
    InputError
        If the class has neither or both, another static or a not static function, a parameter that is no
        `quantity`, an attribute whose name has a meaning of its own, or the name of a built-in stage. A
        function that fails does so when a run begins.
    """
    return make_section_class(user_class, OwnStage)
