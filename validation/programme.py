"""What the report measures, part by part: quick within minutes, full with everything."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from granular.methods import METHODS, method_named
from granular.methods.method import COMPENSATED
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from validation.order import HIGH_ORDER
from validation.parts import Part, Piece, Plain

if TYPE_CHECKING:
    from validation.cost import Setting
    from validation.energy import EnergyRun
    from validation.outcomes import HardCase

QUICK_METHODS = ("stormer-verlet", "blanes-moan-4", "yoshida-6")
"""On every problem; they share their compiled code."""

QUICK_PROBLEM = "oscillation"
"""The problem that all methods are shown on, also quickly."""

OUTSIDE_PROBLEMS = ("oscillation", "bounce", "scattering", "drag")
"""Problems for the outside references; quickly the first one."""


# Convergence ------------------------------------------------------------------------------------


def convergence_pieces(full: bool) -> list[Piece]:
    """Every method on every exact problem it fits."""
    from validation.exact import NAMES, exact_problem
    from validation.order import fits
    from validation.outside import ORDERS

    pieces = [
        convergence_piece(shown_method(method), name, full)
        for name in NAMES
        for method in METHODS
        if (full or method in QUICK_METHODS or name == QUICK_PROBLEM)
        and fits(exact_problem(name), method)
    ]
    problems = OUTSIDE_PROBLEMS if full else OUTSIDE_PROBLEMS[:1]
    return pieces + [
        convergence_piece(reference, name, full) for name in problems for reference in ORDERS
    ]


def convergence_piece(method: str, problem: str, full: bool, **more: Any) -> Piece:
    """A method on an exact problem; ``more`` tells it from others of the name."""
    key = {"problem": problem, "method": method, "full": full, **more}
    return Piece(f"{method} on {problem}", key, partial(_converge, problem, method, full))


def shown_method(name: str) -> str:
    """The form in which a method shows its order: high orders with compensated sums.

    Six decades of error fit above rounding only if sums do not add to it.
    """
    method = method_named(name)
    high = method.order >= HIGH_ORDER and method.tableau is None
    return f"{name}{COMPENSATED}" if high else name


def _converge(name: str, method: str, full: bool) -> Plain:
    from validation.exact import bounce, exact_problem
    from validation.order import convergence, step_counts
    from validation.outside import ORDERS, solver

    outside = method in ORDERS
    # Methods of order one would need too many steps for all of de Paula's 2 s; those of high
    # order have too few steps that are short enough for every turn and still clear of rounding.
    short = not full or outside or _is_shown_briefly(method)
    problem = exact_problem(name)
    if short and name == "bounce":
        problem = bounce.problem(time=bounce.SHORT)
    if outside:
        solve, order = solver(method), ORDERS[method]
        # A Runge-Kutta method shows its order at shorter steps than a symmetric composition.
        counts = step_counts(dataclasses.replace(problem, fewest=2 * problem.fewest), solve, order)
        return convergence(problem, method, counts, solver=solve, order=order).to_plain()
    return convergence(problem, method).to_plain()


def _is_shown_briefly(method: str) -> bool:
    one = method_named(method)
    return one.order == 1 or one.order >= HIGH_ORDER or one.tableau is not None


# De Paula's experiment ------------------------------------------------------------------------


def source_pieces(full: bool) -> list[Piece]:
    """[D, 2.3.4], with what of it is rounding."""

    def measure() -> Plain:
        from validation.source_experiment import source_experiment

        return source_experiment(full=full).to_plain()

    return [Piece("seven steps" if full else "four steps", {"full": full}, measure)]


# Energy -----------------------------------------------------------------------------------------


def energy_pieces(full: bool) -> list[Piece]:
    """Long runs of every method, and of the controls."""
    from validation.energy import energy_runs

    return [energy_piece(run) for run in energy_runs(full=full)]


def energy_piece(run: EnergyRun, **more: Any) -> Piece:
    """A long run; ``more`` tells it from others with a method of the name."""
    from validation.energy import energy_study

    key = {
        "system": run.system, "scene": run.scene.digest(), "method": run.method, "dt": run.dt,
        "time": run.time, **more,
    }  # fmt: skip
    return Piece(f"{run.method}: {run.system}", key, lambda: energy_study(run).to_plain())


# Work and precision -----------------------------------------------------------------------------


def compression_scene() -> Scene:
    """A quarter of de Paula's bed with dry friction, compressed at 33 mm/s [D, 2.3.3]."""
    return load_scene("bed").replace(
        **{
            "name": "compression",
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "45 D",
            "arrangement.height": "40 D",
            "effects.drag": None,
            "effects.friction": {},
            "protocol": [
                {"kind": "hold", "name": "relax", "duration": 1.0},
                {"kind": "move", "name": "compress", "to": "10 D", "speed": "33 mm/s"},
            ],
            "output.scalars": 0.01,
            "output.frames": 1.0,
        }
    )


def frictionless_bed() -> Scene:
    """The packaged bed without drag: it keeps its energy."""
    return load_scene("bed").replace(**{"name": "bed without friction", "effects.drag": None})


OUTSIDE_TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
"""Of the outside references; for the bed the first and the third, which take seconds."""

DAMPER_STEPS = {
    "stormer-verlet": ("auto*8", "auto*4", "auto*2", "auto", "auto/2"),
    "blanes-moan-4": ("auto*8", "auto*4", "auto*2"),
}
"""Fewer than for the others: the damper's runs are long, and soon within the scatter of starts."""


def work_precision_pieces(full: bool) -> list[Piece]:
    """What accuracy costs: grain, frictionless bed and compression; in full also the damper."""
    from validation.choice import candidates
    from validation.cost import Setting
    from validation.outside import ORDERS

    grain, bed, squeezed = load_scene("single-particle"), frictionless_bed(), compression_scene()
    kept = ("energy", "positions")
    many = [Setting(name, limit) for name in ORDERS for limit in OUTSIDE_TOLERANCES]
    few = [Setting(name, limit) for name in ORDERS for limit in OUTSIDE_TOLERANCES[:3:2]]
    wanted: list[tuple[Scene, tuple[str, ...], Sequence[Setting], dict[str, Any]]] = [
        (grain, kept, [*candidates(grain), *many], {"until": 1.0, "references": _exact_grain()}),
        (bed, kept, [*candidates(bed), *few], {"until": 0.02}),
        (squeezed, ("piston force", "mean distance"), candidates(squeezed), {"seeds": 4}),
    ]
    if full:
        damper = [Setting(name, dt) for name, steps in DAMPER_STEPS.items() for dt in steps]
        quantities = ("rest height", "period", "damping ratio")
        options: dict[str, Any] = {
            "seeds": 4,
            "repeats": 1,
            "references": [Setting("stormer-verlet", "auto/8")] * len(quantities),
        }
        wanted.append((load_scene("damper"), quantities, damper, options))
        wanted.append(_pair_sums())
    return [work_precision_piece(*one) for one in wanted]


def work_precision_piece(
    scene: Scene,
    quantities: Sequence[str],
    settings: Sequence[Setting],
    options: dict[str, Any],
    **more: Any,
) -> Piece:
    """A scene with many settings; ``more`` tells it from others with methods of the names."""
    key = {
        "scene": scene.digest(), "quantities": quantities, "settings": str(settings),
        "options": str(options), **more,
    }  # fmt: skip
    return Piece(scene.name, key, partial(_weigh, scene, quantities, settings, options))


SUMS: tuple[dict[str, Any], ...] = (
    {"pairs.method": "direct"},
    *({"pairs.method": "mesh", "pairs.tolerance": one} for one in (3e-3, 3e-4, 3e-5)),
    {"pairs.method": "mesh", "pairs.far_every": 1},
    *({"pairs.method": "cut-off", "pairs.cut_off": f"{one} D"} for one in (5, 8, 11.26, 16)),
    *({"pairs.method": "verlet-list", "pairs.cut_off": f"{one} D"} for one in (5, 8, 11.26, 16)),
)
"""Ways of summing pairs, and the radii of de Paula's list about its own 11.26 D [D, 5.2]."""


def _pair_sums() -> tuple[Scene, tuple[str, ...], Sequence[Any], dict[str, Any]]:
    """The piston's force on 1472 grains as they settle, by ways of summing pairs."""
    from validation.cost import Setting
    from validation.lattice import lattice

    scene = lattice(1472).replace(name="1472 grains, by sum over pairs")
    settings = [Setting("stormer-verlet", "auto", sums) for sums in SUMS]
    exact = Setting("stormer-verlet", "auto/2", SUMS[0])
    return scene, ("piston force",), settings, {"until": 0.3, "references": [exact], "repeats": 1}


def _exact_grain() -> list[Any]:
    """The lone grain's exact energy error and position [D] after 1 s."""
    from granular.schema.scales import Scales
    from validation.exact import exact_problem

    problem = exact_problem("bounce")
    return [0.0, problem.exact(1.0).positions / Scales.of(problem.scene.grains).length]


def _weigh(
    scene: Scene, quantities: Sequence[str], settings: Sequence[Any], options: dict[str, Any]
) -> Plain:
    from validation.cost import work_precisions

    found = work_precisions(scene, quantities, settings, **options)
    return {"studies": [one.to_plain() for one in found]}


# Hard cases -------------------------------------------------------------------------------------

VARIATIONS = (
    (f"stormer-verlet{COMPENSATED}", "auto", 1.0),
    ("adaptive-verlet", "auto", 10.0),
    ("blanes-moan-4", "auto", 10.0),
    ("stormer-verlet", "auto*4", 16.0),
    ("stormer-verlet", "auto/4", 1.0),
)
"""Other methods and steps for the hard cases, and how many times the case's own error they may
leave: a step four times as long leaves sixteen times the error, and methods differ in theirs."""


def stability_pieces(full: bool) -> list[Piece]:
    """The catalogue at its own settings; in full up to late times, and by methods and steps."""
    from validation.hard_cases import catalogue
    from validation.outcomes import outcome

    def piece(case: HardCase, method: str, dt: float | str | None, *, late: bool) -> Piece:
        return Piece(
            case.name,
            {"case": case.name, "method": method, "dt": str(dt), "full": late},
            lambda: outcome(case, method, dt, full=late).to_plain(),
        )

    cases = catalogue()
    pieces = [piece(case, "stormer-verlet", None, late=full) for case in cases]
    if full:
        pieces += [
            piece(_varied(case, times), method, dt, late=False)
            for method, dt, times in VARIATIONS
            for case in cases
            if case.dt == "auto"
        ]
    return pieces


def _varied(case: HardCase, times: float) -> HardCase:
    """The case with other settings than its own, which may end it, but never silently."""
    from validation.outcomes import BROKEN

    return dataclasses.replace(
        case, limit=case.limit * times, may_degrade=True,
        errors=(*case.errors, *BROKEN, "InputError"),
    )  # fmt: skip


# The first screen --------------------------------------------------------------------------------


def glance_pieces(full: bool) -> Sequence[Piece]:
    """The packaged damper, and the compression with dry friction."""
    from validation.glance import glance_part

    return glance_part([load_scene("damper"), compression_scene()], hard=False).pieces(full)


PARTS: Sequence[Part] = (
    Part("glance", glance_pieces),
    Part("convergence", convergence_pieces),
    Part("source-experiment", source_pieces),
    Part("energy", energy_pieces),
    Part("work-precision", work_precision_pieces),
    Part("stability", stability_pieces),
)


def part_named(name: str) -> Part:
    """The part of that name."""
    return next(part for part in PARTS if part.name == name)
