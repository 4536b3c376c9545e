"""A user's own methods on a user's own scene: order, energy and cost, next to the built-in ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from granular.methods import METHODS, Method, method_named, resolve_method
from granular.methods.registry import method_as_run_setting, register_methods
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from validation.convergence_order import (
    CONVERGENCE,
    convergence_task,
    method_name_to_plot,
    method_suits_problem,
)
from validation.cost.report_section import WORK_PRECISION, work_precision_task
from validation.cost.work_precision import candidate_settings
from validation.energy_drift import ENERGY, energy_task, wall_oscillation_run
from validation.exact import NAMES, exact_problem
from validation.measured_quantities import quantity_named
from validation.report import report
from validation.report_scenes import frictionless_bed
from validation.report_tasks import Task

BESIDE = ("stormer-verlet", "blanes-moan-4", "yoshida-6")
"""Built-in methods that are measured with them; they share their compiled code."""

CONTROL = "explicit-euler"
"""Built-in method whose energy drifts."""

PERIODS = 40
"""Periods of the swing whose energy is tested."""

HORIZON = 0.02
"""Until when the frictionless bed runs [s]: its positions still mean something."""


def method_report(
    directory: str | Path,
    methods: Sequence[str | Method],
    *,
    scene: Scene | None = None,
    quantities: Sequence[str] | None = None,
    until: float | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Measure methods, and write ``report.html`` and ``report.json``.

    Their order of convergence on every exact problem that they fit, the trend of the energy over a
    long run, and error against wall time on a scene; each next to methods that are built in.

    >>> method_report("out", [Method("mine", 2, kicks=(0.5, 0.5), drifts=(1.0,))])

    Parameters
    ----------
    directory : str or Path
        Directory of the report.
    methods : sequence of str or Method
        One or more: a user's own, also by their names where those are known; see
        `granular.user_code.import_user_code`.
    scene : Scene, optional
        What error against wall time is measured on; without, the packaged bed without friction, up
        to 0.02 s.
    quantities : sequence of str, optional
        Of `validation.measured_quantities.QUANTITIES`: what the error is in; without, the energy, and where
        no scene is given the positions.
    until : float, optional
        Stop the runs of ``scene`` at this time [s]; the whole protocol without.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    dict
        What the JSON file holds: the sections' results (steps and times [s], errors with their unit), a
        verdict each, and the machine. A measurement that fails is there as failed, and its section does
        not hold.

    Raises
    ------
    InputError
        If no method is given, one or a quantity is unknown, two have one name, or a method has that of a
        built-in one and is another; if no method can run the scene, or the directory cannot be written.
    """
    if not methods:
        raise InputError("no method is given; give the name of one, or a granular.Method")
    for quantity in quantities or ():
        quantity_named(quantity)
    register_methods(
        method for method in methods if isinstance(method, Method) and method.name not in METHODS
    )
    names = [resolve_method(method).name for method in methods]
    every = tuple(dict.fromkeys((*names, *BESIDE)))
    sections = (
        CONVERGENCE._replace(tasks=lambda full: list(_convergence_tasks(every, full))),
        ENERGY._replace(tasks=lambda _: list(_energy_tasks((*every, CONTROL)))),
        WORK_PRECISION._replace(tasks=lambda _: [_work_precision_task(every, scene, quantities, until)]),
    )
    return report(directory, sections, progress=progress)


def _convergence_tasks(names: Sequence[str], full: bool) -> Iterator[Task]:
    for problem in NAMES:
        for name in names:
            if method_suits_problem(exact_problem(problem), name):
                yield convergence_task(method_name_to_plot(name), problem, full, **_method_table_key(name))


def _energy_tasks(names: Sequence[str]) -> Iterator[Task]:
    for name in names:
        if not method_named(name).variable:
            yield energy_task(wall_oscillation_run(name, PERIODS), **_method_table_key(name))


def _work_precision_task(
    names: Sequence[str], scene: Scene | None, quantities: Sequence[str] | None, until: float | None
) -> Task:
    if scene is None:
        scene, until = frictionless_bed(), HORIZON if until is None else until
        quantities = quantities or ("energy", "positions")
    settings = candidate_settings(scene, names)
    if not settings:
        raise InputError(f"none of {', '.join(names)} can run {scene.name!r}; give another scene")
    tables = {name: table for name in names for table in _method_table_key(name).values()}
    return work_precision_task(
        scene, tuple(quantities or ("energy",)), settings, {"until": until}, tables=tables
    )


def _method_table_key(name: str) -> dict[str, Any]:
    """Key that tells a user's own method from another one of the name."""
    setting = method_as_run_setting(method_named(name))
    return {} if isinstance(setting, str) else {"table": setting}
