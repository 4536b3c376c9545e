"""The report: one self-contained HTML file, and a JSON file with its numbers next to it.

The same sections measure user-defined methods on the user's scene, with built-in methods for comparison.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from granular.methods import METHODS, Method, method_named, resolve_method
from granular.methods.tables import method_as_run_setting, register_methods
from granular.scene.scene import Scene
from granular.shared.blocks import Block, Caution, Heading, Table, Text, make_cautions
from granular.shared.errors import InputError
from granular.shared.files import make_directory, write_json
from granular.shared.html_pages import Page
from granular.shared.registry import Registry
from validation.accuracy_cost import (
    WORK_PRECISION,
    WorkPrecisionPlan,
    bed_scene_without_drag,
    settings_to_try,
    work_precision_task,
)
from validation.convergence_order import (
    CONVERGENCE,
    convergence_task,
    method_name_to_plot,
    method_suits_problem,
)
from validation.depaula_step_test import DEPAULA
from validation.energy_drift import ENERGY, energy_task, wall_oscillation_run
from validation.exact_problems import NAMES, exact_problem
from validation.hard_case_outcomes import STABILITY, outcome_count_table
from validation.measured_quantities import quantity_named
from validation.overview import OVERVIEW
from validation.report_tasks import (
    Outcome,
    Plain,
    Section,
    Task,
    failure_lines,
    machine_info,
    run_tasks,
    successful_results,
)

Outcomes = Mapping[str, Sequence[Outcome]]
"""Outcomes of the tasks of each section, by the section's name."""

_SECTIONS = (OVERVIEW, CONVERGENCE, DEPAULA, ENERGY, WORK_PRECISION, STABILITY)

SECTIONS = Registry[Section](
    "section",
    "validation.sections",
    {section.name: section for section in _SECTIONS},
    lambda name, section: isinstance(section, Section) and section.name == name,
    "a validation.report_tasks.Section of that name",
    lambda section: section.title,
)
"""Sections of the report, by name."""


def report(
    directory: str | Path | None, sections: Sequence[Section], *, full: bool = False, progress: bool = True
) -> dict[str, Any]:
    """Measure sections, write ``report.html`` and ``report.json``, and return the data of the JSON file."""
    folder = None if directory is None else Path(directory)
    if folder is not None:
        make_directory(folder)
    outcomes = {
        section.name: run_tasks(section.name, section.tasks(full), folder, section.kind, progress=progress)
        for section in sections
    }
    parts = {name: [outcome.to_plain() for outcome in group] for name, group in outcomes.items()}
    plain = verdicts_and_passed(outcomes) | {"full": full, "machine": machine_info(), "parts": parts}
    if folder is not None:
        report_page(outcomes, full=full).save(folder / "report.html")
        write_json(folder / "report.json", plain)
    return plain


def report_page(outcomes: Outcomes, *, full: bool) -> Page:
    """Make the page of the report from the outcomes of its sections."""
    verdicts = verdicts_and_passed(outcomes)
    wrong = [name for name, held in verdicts["held"].items() if not held]
    lead = f"Failed: {', '.join(wrong)}." if wrong else "All sections pass."
    words = {True: "yes", False: "NO"}
    summary = [(name, words[verdicts["held"][name]], text) for name, text in verdicts["verdicts"].items()]
    below = [name for name in outcomes if name != OVERVIEW.name]
    blocks = [
        *_first_screen_blocks(outcomes),
        Heading("Verdicts"),
        Table(("part", "holds", "result"), summary),
        *(block for name in below for block in section_blocks(name, outcomes[name])),
    ]
    details = [block for name in below for block in section_details(name, outcomes[name])]
    if details:
        blocks += [Heading("All measurements"), *details]
    made = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    machine = ", ".join(f"{name} {value}" for name, value in machine_info().items())
    return Page(
        "Verification of methods and results",
        lead,
        blocks,
        f"Made on {made} ({'full' if full else 'quick'}) with {machine}",
    )


def _first_screen_blocks(outcomes: Outcomes) -> list[Block]:
    """Return the blocks of the overview with the counts of hard cases; empty without an overview."""
    if OVERVIEW.name not in outcomes:
        return []
    blocks = section_blocks(OVERVIEW.name, outcomes[OVERVIEW.name])
    if STABILITY.name in outcomes:
        hard = successful_results(outcomes[STABILITY.name])
        blocks += [Heading("Hard cases: overview"), outcome_count_table(hard)]
    return blocks


def section_blocks(name: str, outcomes: Sequence[Outcome]) -> list[Block]:
    """Return the blocks of a section: heading, texts, tables, plots and failures."""
    section, results = SECTIONS[name], successful_results(outcomes)
    heading = [Heading(section.title)] if section.title else []
    return [*heading, *(section.blocks(results) if results else ()), *make_cautions(failure_lines(outcomes))]


def section_details(name: str, outcomes: Sequence[Outcome]) -> Sequence[Block]:
    """Return the tables of a section for the end of the page."""
    results = successful_results(outcomes)
    return SECTIONS[name].details(results) if results else ()


def verdicts_and_passed(outcomes: Outcomes) -> dict[str, Any]:
    """Return for each section its verdict, and True if it passes, as plain data."""
    verdicts, held = {}, {}
    for name, group in outcomes.items():
        verdicts[name], right = SECTIONS[name].verdict(successful_results(group))
        failed = len(failure_lines(group))
        if failed:
            verdicts[name] += f" ({failed} could not be measured)"
        held[name] = right and not failed
    return {"verdicts": verdicts, "held": held, "holds": all(held.values())}


def console_blocks(plain: Mapping[str, Any]) -> list[Block]:
    """Return the tables, failures and verdicts of a report for the console, given the report's data."""
    parts = plain["parts"].items()
    tables = [
        block for name, group in parts for block in section_tables(name, outcomes_from_plain(name, group))
    ]
    return [*tables, *(Text(f"{name}: {verdict}") for name, verdict in plain["verdicts"].items())]


def section_tables(name: str, outcomes: Sequence[Outcome]) -> list[Block]:
    """Return headings and tables of a section, and its failures."""
    blocks = section_blocks(name, outcomes)
    shown = [block for block in blocks if isinstance(block, Heading | Table | Caution)]
    return [*shown, *section_details(name, outcomes)]


def outcomes_from_plain(name: str, plain: Sequence[Plain]) -> list[Outcome]:
    """Return the outcomes of a section from the data of a report."""
    return [Outcome.from_plain(name, SECTIONS[name].kind, entry) for entry in plain]


# User-defined methods ---------------------------------------------------------------------------

BESIDE = ("stormer-verlet", "blanes-moan-4", "yoshida-6")
"""Built-in methods measured for comparison; they share compiled code."""

CONTROL = "explicit-euler"
"""Built-in method whose energy drifts, as a control."""

PERIODS = 40
"""Number of periods of the oscillation whose energy is tested."""

HORIZON = 0.02
"""Duration [s] of the frictionless bed's run, short enough for positions to be meaningful."""


def method_report(
    directory: str | Path,
    methods: Sequence[str | Method],
    *,
    scene: Scene | None = None,
    quantities: Sequence[str] | None = None,
    until: float | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Measure user-defined or built-in methods, and write ``report.html`` and ``report.json``.

    The report shows the order of convergence on every exact problem that the methods can run, the trend of
    the energy in a long run, and the error against wall time in a scene. Built-in methods are measured for
    comparison.

    >>> method_report("out", [Method("mine", 2, kicks=(0.5, 0.5), drifts=(1.0,))])

    Parameters
    ----------
    directory : str or Path
        Directory of the report.
    methods : sequence of str or Method
        One or more methods. User-defined methods may be given by name once imported; see
        `granular.user_code.import_user_code_and_collect_measures`.
    scene : Scene, optional
        Scene for error against wall time. Default: the packaged bed without friction, up to 0.02 s.
    quantities : sequence of str, optional
        Quantities whose error is measured, from `validation.measured_quantities.QUANTITIES`. Default: the
        energy, and also the positions if no scene is given.
    until : float, optional
        Stop the runs of ``scene`` at this time [s]. Default: the end of the protocol.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    dict
        Data of the JSON file: results of the sections (steps and times [s], errors with their unit), a
        verdict for each section, and the machine. A failed measurement is marked as failed, and its
        section does not pass.

    Raises
    ------
    InputError
        If no method is given, a method or a quantity is unknown, or two methods have the same name; if a
        method has the name of a different built-in method, no method can run the scene, or the directory
        cannot be written.
    """
    if not methods:
        raise InputError("no method is given; give a method's name or a granular.Method")
    for quantity in quantities or ():
        quantity_named(quantity)
    register_methods(
        method for method in methods if isinstance(method, Method) and method.name not in METHODS.built_in
    )
    names = [resolve_method(method).name for method in methods]
    every = tuple(dict.fromkeys((*names, *BESIDE)))
    sections = (
        CONVERGENCE._replace(tasks=lambda full: list(_convergence_tasks(every, full))),
        ENERGY._replace(tasks=lambda _: list(_energy_tasks((*every, CONTROL)))),
        WORK_PRECISION._replace(
            tasks=lambda _: [_work_precision_task_of_methods(every, scene, quantities, until)]
        ),
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


def _work_precision_task_of_methods(
    names: Sequence[str], scene: Scene | None, quantities: Sequence[str] | None, until: float | None
) -> Task:
    if scene is None:
        scene, until = bed_scene_without_drag(), HORIZON if until is None else until
        quantities = quantities or ("energy", "positions")
    settings = settings_to_try(scene, names)
    if not settings:
        raise InputError(f"none of {', '.join(names)} can run {scene.name!r}; give another scene")
    tables = {name: table for name in names for table in _method_table_key(name).values()}
    plan = WorkPrecisionPlan(scene, tuple(quantities or ("energy",)), settings, {"until": until})
    return work_precision_task(plan, tables=tables)


def _method_table_key(name: str) -> dict[str, Any]:
    """Return the coefficients of a method for a cache key; empty if the name identifies the method."""
    setting = method_as_run_setting(method_named(name))
    return {} if isinstance(setting, str) else {"table": setting}
