"""A user's own code on the command line: what ``--import FILE`` brings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from granular.effects.custom import load_user_sections
from granular.methods.method import Method
from granular.methods.registry import register_methods
from granular.methods.tables import METHODS
from granular.observables.frame import Frame, Value, observable_metadata
from granular.shared.user_file import run_user_file, user_definitions
from granular.studies.measures import CustomMeasure, custom_measures


class UserCode(NamedTuple):
    """Measures and observables that a user's files define, by name."""

    measures: dict[str, CustomMeasure]
    observables: dict[str, Callable[[Frame], Value]]


def import_user_code(paths: Iterable[str | Path]) -> UserCode:
    """Run a user's Python files, and collect their measures and observables."""
    user_code = UserCode({}, {})
    for path in paths:
        file = run_user_file(path)
        for section in load_user_sections(file).values():
            section.register_class()  # also of a text that was imported before, and then another one
        values = user_definitions(file).values()
        methods = [function for function in values if isinstance(function, Method)]
        register_methods(function for function in methods if METHODS.get(function.name) is not function)
        user_code.measures.update(custom_measures(file))
        marked = ((observable_metadata(function), function) for function in values)
        user_code.observables.update((mark.name, function) for mark, function in marked if mark is not None)
    return user_code
