"""An effect of a user's own: a class with a few static functions, decorated with `effect`.

    from granular import effect, quantity

    @effect
    class Spring:
        \"\"\"A spring that pulls every grain towards a height.\"\"\"

        k: float = quantity("N/m", above=0.0)
        height: float = quantity("m", default=0.0)

        @staticmethod
        def energy(p, grain, time):
            return 0.5 * p.k * (grain.y - p.height) ** 2

        @staticmethod
        def force(p, grain, time):
            return 0.0, -p.k * (grain.y - p.height)

        @staticmethod
        def stiffness(p, grain, time):
            return p.k

From then on a scene may say ``effects.spring = { k = "10 N/m" }``, with units, limits and checks.
The functions are compiled into the loop, so they hold what Numba compiles: arithmetic, `math`, and
functions that are compiled themselves. They see the parameters ``p`` and a ``grain`` with its
``x``, ``y``, ``mass`` and ``moment``, in natural units, in which any formula with consistent units
reads as it does in SI. There may be, each with what belongs to it:

``energy(p, grain, time)``, ``force(p, grain, time) -> (fx, fy)``
    Of a grain; the force is minus the gradient of the energy.
``stiffness(p, grain, time)``
    A bound of the force's slope, which the automatic step follows.
``power(p, grain, time)``
    d(energy)/d(time) at a fixed place, where the energy depends on time: work from outside.
``flow(p, grain, vx, vy, span) -> (vx, vy)``
    Velocity after ``span`` under a dissipative effect alone, exactly, for either sign of ``span``.
    What it takes is entered in the ledger.
``pair_energy(p, r, first, second)``, ``pair_force(p, r, first, second)``
    Of two grains at the distance r; the force is positive where they repel each other.
``pair_stiffness(p, r, first, second)``
    A bound of its slope.
``reach(p)``
    Distance from which on a pair does nothing; all pairs count without it.
``frequency(p)``
    Highest angular frequency with which it changes in time, for the step.

What is not there costs nothing. Compiled code is kept under a digest of the functions and of all
that they use of their file, so a second process starts as fast as with a built-in effect, and an
edited one is compiled anew.
"""

from __future__ import annotations

import math
from typing import Any

from granular.effects.effect import Effect, Setting, in_joules
from granular.effects.own_check import check, check_compiling
from granular.effects.own_definition import FUNCTIONS, Kind
from granular.effects.own_law import OwnLaw
from granular.effects.own_section import OwnSection, define, functions_in, name_of, natural_values
from granular.effects.registry import register
from granular.schema.scales import Scales
from granular.shared.errors import InputError


class OwnEffect(OwnSection, Effect):
    """Base of the effects that `effect` makes."""

    rank = 1

    def law(self, setting: Setting) -> OwnLaw:
        """The law in natural units.

        Raises
        ------
        InputError
            If a function fails, or a force is not the gradient of its energy.
        """
        p = self.natural(setting.scales)
        check(self.definition, p, setting)
        reach = self.definition.functions.get("reach")
        ends = math.inf if reach is None else float(reach(p))
        return OwnLaw(Kind(self.definition.digest), tuple(p), ends, None)

    def check_compiling(self, setting: Setting) -> None:
        check_compiling(self.definition, self.natural(setting.scales))

    def natural(self, scales: Scales) -> Any:
        """The parameters in natural units."""
        return natural_values(self, self.definition, scales)

    @property
    def is_flow(self) -> bool:
        return "flow" in self.definition.functions

    def drive_frequency(self, scales: Scales) -> float:
        found = self.definition.functions.get("frequency")
        return 0.0 if found is None else abs(float(found(self.natural(scales))))


def effect(written: type) -> Any:
    """Make a class an effect that scenes can name; see the head of this file.

    Parameters
    ----------
    written : type
        A class with parameters (`quantity`) and static functions. Its name in small letters is what
        a scene calls it: ``LeafSpring`` is ``leaf_spring``.

    Raises
    ------
    InputError
        If the class is no such.
    """
    key, functions = name_of(written), functions_in(dict(vars(written)))
    if not set(functions) & {"force", "flow", "pair_force"}:
        raise InputError(
            f"effect {key!r} does nothing; give it a static method 'force', 'pair_force' or 'flow'"
        )
    needed = [_NEED[name] for name in functions if name in _NEED]
    meaning = (written.__doc__ or key).strip().splitlines()[0].rstrip(".")
    has_energy = "energy" in functions or "pair_energy" in functions
    made = define(
        written,
        OwnEffect,
        FUNCTIONS,
        needed,
        "effect",
        key=key,
        damps="flow" in functions,
        example=vars(written).get("example", True),
        energy_record=in_joules(f"{key}_energy", f"energy of: {meaning}") if has_energy else None,
        loss_record=in_joules(f"{key}_loss", f"lost to: {meaning}")
        if "flow" in functions
        else None,
    )
    register(made)
    return made


_NEED = {
    "force": "energy", "energy": "force", "stiffness": "energy", "power": "energy",
    "pair_force": "pair_energy", "pair_energy": "pair_force", "pair_stiffness": "pair_energy",
    "reach": "pair_energy",
}  # fmt: skip
"""What a function cannot be without."""

OwnEffect.made_by = staticmethod(effect)
