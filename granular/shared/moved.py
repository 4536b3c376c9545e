"""Modules that have moved: imports by their former paths go on, with a warning."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from granular.shared.deprecation import deprecated


class _Forwarder(MetaPathFinder, Loader):
    """Imports a module from its new path wherever its former one is asked for."""

    def __init__(self, moved: Mapping[str, str]) -> None:
        self._moved = moved

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        return ModuleSpec(name, self) if name in self._moved else None

    def exec_module(self, module: ModuleType) -> None:
        new = self._moved[module.__name__]
        deprecated(module.__name__, since="0.1.0", until="0.2.0", remedy=f"import {new}")
        # Under both names there is one and the same module; the empty one made here is dropped.
        sys.modules[module.__name__] = importlib.import_module(new)


def forward(package: str, moved: Mapping[str, str]) -> None:
    """Let modules of a package be imported by their former paths; both paths start below it."""
    full = {f"{package}.{old}": f"{package}.{new}" for old, new in moved.items()}
    sys.meta_path.append(_Forwarder(full))
