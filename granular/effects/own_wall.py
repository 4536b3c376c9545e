"""Laws of walls of a user's own: a class with static functions, or a formula of the distance.

    from granular import quantity, wall_law

    @wall_law
    class Soft:
        \"\"\"A wall that pushes like a spring that is compressed from a distance on.\"\"\"

        k: float = quantity("N/m", above=0.0)
        reach: float = quantity("m", above=0.0)

        @staticmethod
        def energy(p, w):
            return 0.5 * p.k * max(p.reach - w, 0.0) ** 2

        @staticmethod
        def force(p, w):
            return p.k * max(p.reach - w, 0.0)

        @staticmethod
        def stiffness(p, w):
            return p.k

From then on a scene may say ``effects.walls.left = { law = "soft", k = "9 N/m", reach = "1 cm" }``.
Without any code it may give an energy instead of a law:
``effects.walls.left = { energy = "a*(l/w)**3", a = "1 uJ", l = "6 mm" }``. Both are of a grain of
the first species at the distance w; others feel them in the ratio of their moments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from granular.compiled import compiled
from granular.effects.formula import Formula, Functions
from granular.effects.own_definition import Definition, Kind
from granular.effects.own_law import by_kind
from granular.effects.own_section import OwnSection, define, natural_values
from granular.formulas.dimensions import LENGTH, Dimension
from granular.schema.scales import Scales
from granular.shared.errors import InputError
from granular.shared.offered import offered

GROUP = "granular.wall_laws"
"""Entry points by which an installed distribution offers laws of walls."""

_WALL_LAWS: dict[str, type[OwnWall]] = {}

NEAREST, FARTHEST = 1e-4, 1e3
"""Distances [D] between which a grain's turning point is looked for."""


class OwnWallLaw(NamedTuple):
    """An own law of a wall as the kernels take it.

    Attributes
    ----------
    kind : Kind
    values : tuple of float
    """

    kind: Any
    values: tuple[float, ...]

    @staticmethod
    @compiled(inline=True)
    def force(law: OwnWallLaw, w: float) -> float:
        return _force(law.kind, law.values, w)

    @staticmethod
    @compiled(inline=True)
    def energy(law: OwnWallLaw, w: float) -> float:
        return _energy(law.kind, law.values, w)

    @staticmethod
    @compiled(inline=True)
    def stiffness(law: OwnWallLaw, w: float) -> float:
        return _stiffness(law.kind, law.values, w)

    @staticmethod
    @compiled
    def turning_stiffness(law: OwnWallLaw, speed: float) -> float:
        """Stiffness where a grain of this speed turns, found by bisection of the distance."""
        near, far = math.log(NEAREST), math.log(FARTHEST)
        for _ in range(60):
            middle = 0.5 * (near + far)
            if _energy(law.kind, law.values, math.exp(middle)) > 0.5 * speed * speed:
                near = middle
            else:
                far = middle
        return abs(_stiffness(law.kind, law.values, math.exp(near)))


def _maker(name: str) -> Any:
    def make(definition: Definition) -> Any:
        function, values_of = definition.kernels[name], definition.parameters

        def call(kind: Any, values: tuple[float, ...], w: float) -> Any:
            return function(values_of(*values), w)

        return call

    return by_kind(make)


_force, _energy, _stiffness = (_maker(name) for name in ("force", "energy", "stiffness"))


class OwnWall(OwnSection):
    """Base of the wall laws that `wall_law` makes."""

    def law(self, scales: Scales) -> OwnWallLaw:
        """The law in natural units."""
        values = natural_values(self, self.definition, scales)
        _check(self.definition, values)
        return OwnWallLaw(Kind(self.definition.digest), tuple(values))


class WallText(Formula):
    """A law of a wall as a formula of the distance ``w``."""

    variables: ClassVar[Mapping[str, Dimension]] = {"w": LENGTH}

    @classmethod
    def names_given(cls, energy: str) -> tuple[str, ...]:
        return ("energy", "force", "stiffness")

    @staticmethod
    def derived(energy: Any, symbols: Mapping[str, Any]) -> dict[str, Any]:
        w = symbols["w"]
        return {"energy": energy, "force": -energy.diff(w), "stiffness": energy.diff(w, 2)}

    @staticmethod
    def functions_of(made: Functions) -> Functions:
        def wrapped(of: Any) -> Any:
            return lambda p, w: of(w, *p)

        return {name: wrapped(of) for name, of in made.items()}

    def law(self, scales: Scales) -> OwnWallLaw:
        """The law in natural units."""
        return OwnWallLaw(Kind(self.definition.digest), self.natural(scales))


def wall_law(written: type) -> Any:
    """Make a class a law that scenes can name for a wall; see the head of this file.

    Raises
    ------
    InputError
        If the class is no such.
    """
    made = define(
        written, OwnWall, ("energy", "force", "stiffness"), ("energy", "force", "stiffness"), "wall"
    )
    _WALL_LAWS[made.definition.key] = made
    return made


def wall_laws() -> Mapping[str, type[OwnWall]]:
    """Own laws by their names."""
    return _WALL_LAWS


def find_wall_law(name: str) -> type[OwnWall] | None:
    """The own law of that name; one that an installed package brings is imported now.

    Raises
    ------
    InputError
        If a package says that it brings one, and it cannot be loaded.
    """
    if name not in _WALL_LAWS:
        offered(GROUP, name, "wall law")
    return _WALL_LAWS.get(name)


def _check(definition: Definition, p: Any) -> None:
    for w in (0.31, 0.83, 2.2):
        h = 1e-4 * w
        energy, force = definition.functions["energy"], definition.functions["force"]
        try:
            slope = (energy(p, w + h) - energy(p, w - h)) / (2.0 * h)
            found, size = float(force(p, w)), abs(energy(p, w)) / w
        except Exception as error:
            raise InputError(
                f"wall law {definition.key!r} fails: {type(error).__name__}: {error}; mend it"
            ) from None
        if abs(found + slope) > 1e-4 * max(abs(found), abs(slope)) + 1e-6 * size:
            raise InputError(
                f"wall law {definition.key!r}: 'force' gives {found:.6g} where its energy asks for "
                f"{-slope:.6g} (natural units); mend one of them"
            )


OwnWall.made_by = staticmethod(wall_law)
