"""Effects and laws of walls that a scene can name: those of the files here, and a user's own."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Mapping
from pathlib import Path

from granular.effects.effect import Effect
from granular.schema.sections import Section
from granular.shared.errors import InputError
from granular.shared.registry import entry_point_names, load_entry_point

GROUP, WALL_GROUP = "granular.effects", "granular.wall_laws"
"""Groups of the entry points by which installed packages bring effects, and laws of walls."""

_OWN: dict[str, type[Effect]] = {}
WALL_LAWS: dict[str, type[Section]] = {}
"""A user's own laws of walls, by their names."""


def all_effects() -> Mapping[str, type[Effect]]:
    """Every effect by its name: those of the files here, and a user's own."""
    return {**_built_in_effects(), **_OWN}


def find_effect(name: str) -> type[Effect] | None:
    """Effect of that name; one that an installed package brings is imported now."""
    if name not in all_effects():
        load_entry_point(GROUP, name, "effect")
    return all_effects().get(name)


def effect_names() -> tuple[str, ...]:
    """Names of all effects, those of installed packages included."""
    return tuple(sorted({*all_effects(), *entry_point_names(GROUP)}))


def find_wall_law(name: str) -> type[Section] | None:
    """Own law of a wall of that name; one that an installed package brings is imported now."""
    if name not in WALL_LAWS:
        load_entry_point(WALL_GROUP, name, "wall law")
    return WALL_LAWS.get(name)


def register_effect(effect: type[Effect]) -> None:
    """Let scenes name an own effect; one of the same name that was there before is replaced."""
    if effect.key in _built_in_effects():
        raise InputError(f"an effect {effect.key!r} is there already; give yours another name")
    _OWN[effect.key] = effect


@functools.cache
def _built_in_effects() -> dict[str, type[Effect]]:
    package = __name__.rpartition(".")[0]
    result: dict[str, type[Effect]] = {}
    for file in pkgutil.iter_modules([str(Path(__file__).parent)]):
        module = importlib.import_module(f"{package}.{file.name}")
        for var in vars(module).values():
            if isinstance(var, type) and issubclass(var, Effect) and var.key:
                result.setdefault(var.key, var)
    return dict(sorted(result.items()))
