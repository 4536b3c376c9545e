"""A user's parts and measures, loaded from the Python files given by ``--import FILE``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from granular.effects.custom import load_user_sections
from granular.methods.method import Method
from granular.methods.tables import METHODS, register_methods
from granular.observables.catalogue import OBSERVABLES
from granular.observables.frame import observable_metadata
from granular.shared.user_file import run_user_file, user_definitions
from granular.studies.cases import CustomMeasure, custom_measures


def import_user_code_and_collect_measures(paths: Iterable[str | Path]) -> dict[str, CustomMeasure]:
    """Run a user's Python files, which register custom parts; return the measures they define, by name."""
    measures: dict[str, CustomMeasure] = {}
    for path in paths:
        file = run_user_file(path)
        for section in load_user_sections(file).values():
            section.register_class()  # also of a text that was imported before, and then another one
        values = user_definitions(file).values()
        methods = [function for function in values if isinstance(function, Method)]
        register_methods(method for method in methods if METHODS.registered(method.name) is not method)
        measures.update(custom_measures(file))
        for function in values:
            mark = observable_metadata(function)
            if mark is not None and OBSERVABLES.registered(mark.name) is not function:
                OBSERVABLES.register(mark.name, function)
    return measures
