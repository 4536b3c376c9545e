"""The effects that a scene can name: those of the files beside this one, and a user's own."""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Mapping
from pathlib import Path

from granular.effects.effect import Effect

_OWN: dict[str, type[Effect]] = {}


def effects() -> Mapping[str, type[Effect]]:
    """Every effect by its name."""
    return {**_built_in(), **_OWN}


@functools.cache
def _built_in() -> dict[str, type[Effect]]:
    package = __name__.rpartition(".")[0]
    found: dict[str, type[Effect]] = {}
    for file in pkgutil.iter_modules([str(Path(__file__).parent)]):
        module = importlib.import_module(f"{package}.{file.name}")
        for one in vars(module).values():
            if isinstance(one, type) and issubclass(one, Effect) and one.key:
                found.setdefault(one.key, one)
    return found
