"""Short descriptions of scenes and runs, for the command line and reports."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.parts.liquids import find_liquid
from granular.parts.magnets import REFERENCE_TEMPERATURE, REMANENCE_SLOPE, find_grade
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import dimensionless_groups, dimensionless_groups_text
from granular.schema.field_kinds import QuantityKind
from granular.schema.natural_units import Scales
from granular.schema.sections import Section

if TYPE_CHECKING:
    from granular.scene.scene import Scene


_REPORTED_COMPILE_SECONDS = 1.0
"""Compile time [s] above which it is reported."""


def packing_fraction(scene: Scene, height: float) -> float:
    """Return the packing fraction [D, eq. 2.2]: area of the grains divided by the area of the cell."""
    area = float((math.pi / 4.0 * scene.grains.diameters() ** 2).sum())
    return area / (scene.cell.width * height)


def derived_scene_values(scene: Scene) -> dict[str, Any]:
    """Return natural units, numbers of grains, packing fraction and dimensionless groups of a scene."""
    scales = Scales.from_grains(scene.grains)
    names = [specy.name for specy in scene.grains.species]
    figures: dict[str, Any] = {
        "grain_diameter": scales.length,
        "grain_mass": scales.mass,
        "force_unit": scales.force,
        "time_unit": scales.time,
        "counts": dict(zip(names, scene.grains.species_counts(), strict=True)),
    }
    height = scene.cell.height if scene.piston is None else scene.piston.height
    if height is not None:
        figures["packing_fraction"] = packing_fraction(scene, height)
    figures["groups"] = dimensionless_groups(scene)
    return figures


def active_effect_names(scene: Scene) -> tuple[str, ...]:
    """Names of the effects that act in a scene."""
    return tuple(key for key in scene.effects.key_names() if getattr(scene.effects, key))


def custom_code_digests(scene: Scene) -> list[str]:
    """Return digests of a scene's user-defined functions, including functions made from formulas."""
    parts: list[Any] = [*scene.effects.in_loop_order, *scene.protocol]
    return sorted(digest for part in parts for digest in part.user_code_digests)


def scene_text(scene: Scene) -> str:
    """Describe a scene: grains, natural units, cell, piston, effects and stages.

    Parameters
    ----------
    scene : Scene
        Scene to describe.

    Returns
    -------
    str
        Lines with, in this order,

        - the name of the scene, and number and diameter [mm] of each species;
        - the natural units D [mm], m [g], F* [N] and tau [ms];
        - width of the cell, and height of the piston or the periodic cell, in mm and in diameters;
        - mass of the piston [kg], packing fraction (eq. 2.2 of [D]), dimensionless groups of a damper;
        - the effects with their values;
        - the moment [A m^2] and drags [kg/s], if they are derived from magnets and liquids;
        - the stages with their values.

    Examples
    --------
    >>> from granular import load_scene, scene_text
    >>> print(scene_text(load_scene("bed")).splitlines()[0])
    scene bed
    """
    scales = Scales.from_grains(scene.grains)
    counts, fractions = scene.grains.species_counts(), scene.grains.species_fractions()
    lines = [f"scene {scene.name}"]
    for specy, count, fraction in zip(scene.grains.species, counts, fractions, strict=True):
        mixed = "" if len(counts) == 1 else f", fraction {fraction:.4g}"
        lines.append(f"  {count} grains {specy.name!r} of {1e3 * specy.diameter:g} mm{mixed}")
    lines.append(
        f"  natural units: D = {1e3 * scales.length:g} mm, m = {1e3 * scales.mass:.5g} g, "
        f"F* = {scales.force:.5g} N, tau = {1e3 * scales.time:.5g} ms"
    )
    width = scene.cell.width
    lines.append(f"  cell {1e3 * width:g} mm wide ({width / scales.length:g} D)")
    if scene.cell.height is not None:
        high = scene.cell.height
        lines[-1] += (
            f", {1e3 * high:g} mm high ({high / scales.length:g} D), periodic, packing fraction "
            f"{packing_fraction(scene, high):.4f}"
        )
    if scene.piston is not None:
        height, mass = scene.piston.height, scene.piston.mass
        lines.append(
            f"  piston at {1e3 * height:g} mm ({height / scales.length:g} D)"
            + ("" if mass is None else f", {mass:g} kg")
            + f", packing fraction {packing_fraction(scene, height):.4f}"
        )
    if groups := dimensionless_groups_text(scene):
        lines.append(f"  groups: {groups}")
    lines.append(f"  effects: {', '.join(active_effect_names(scene)) or 'none'}")
    lines += [
        f"    {effect.key}: {description}"
        for effect in scene.effects.acting
        if (description := describe_fields(effect))
    ]
    lines += [f"  {line}" for line in moment_and_drag_lines(scene)]
    for stage in scene.protocol:
        description = describe_fields(stage, without=("name",))
        lines.append(f"  stage {stage.name!r}: {type(stage).__name__.lower()}, {description}")
    return "\n".join(lines)


def run_statistics(run: Trajectory) -> dict[str, Any]:
    """Return the last values, stages, step counts, energy residual and timings of a run, in SI."""
    data, last = run.dataset, {}
    for name in ("piston_height", "piston_force", "kinetic_energy"):
        if name in data and data.sizes["time"]:
            last[name] = float(data[name][-1])
    return {
        "scene": run.scene.name,
        "complete": run.complete,
        "time": float(np.asarray(data["time"])[-1]),
        "stages": [vars(stage) for stage in run.stages],
        **last,
        **run.settings(),
        "out": None if run.path is None else str(run.path),
    }


def run_text(run: Trajectory) -> str:
    """Describe a run: stages, steps, wall time and energy balance.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.

    Returns
    -------
    str
        Lines with, in this order,

        - the start and end [s] of each stage, the reason for its end, and the piston's final height, in mm
          and in diameters;
        - steps, method, time step, wall time [s], and the residual of the energy balance relative to the
          energy turned over;
        - the run directory, if any.
    """
    figures, scales = run_statistics(run), Scales.from_grains(run.scene.grains)
    lines = []
    for stage in run.stages:
        height = ""
        if run.scene.piston is not None:
            height = f", piston at {1e3 * stage.height:.4f} mm ({stage.height / scales.length:.4f} D)"
        lines.append(f"{stage.name}: {stage.start:.4g} to {stage.end:.4g} s ({stage.reason}){height}")
    compiled = run.settings().get("compile_seconds", 0.0)
    more = f" and {compiled:.2g} s of compiling" if compiled >= _REPORTED_COMPILE_SECONDS else ""
    lines.append(
        f"{figures['steps']} steps ({run.method.name}, dt {figures['dt']}) in "
        f"{figures['seconds']:.3g} s{more}; ledger closed to {figures['ledger_residual']:.1e} of "
        "the energy turned over"
    )
    if run.path is not None:
        lines.append(f"written to {run.path}")
    return "\n".join(lines)


def describe_fields(section: Section, *, without: tuple[str, ...] = ()) -> str:
    """Return the values of a section's fields as text, with units; empty if no field has a value."""
    descriptions = []
    for field in dataclasses.fields(section):
        value = getattr(section, field.name)
        if value is None or value == () or field.name in without:
            continue
        if isinstance(value, tuple):
            descriptions.append("; ".join(map(_value_text, value)))
            continue
        kind = field.metadata["kind"]
        unit = kind.unit if isinstance(kind, QuantityKind) and kind.unit != "1" else ""
        descriptions.append(f"{field.name} {_value_text(value)} {unit}".strip())
    return ", ".join(descriptions)


def _value_text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.12g}"  # 0.2 D is 0.0012 m, not 0.0012000000000000001
    if isinstance(value, Section):
        return describe_fields(value)
    if isinstance(value, tuple):
        return " = ".join(map(str, value))  # a parameter
    return str(value)


def moment_and_drag_lines(scene: Scene) -> list[str]:
    """Return lines that derive moment and drags from magnets and liquids; empty if the scene gives both."""
    return [*_moment_lines(scene), *_drag_lines(scene), *_piston_lines(scene)]


def _moment_lines(scene: Scene) -> Iterator[str]:
    grains = scene.grains
    named = (grains.grade, grains.moment, grains.coating, grains.permeability, grains.temperature)
    if all(value is None for value in named):
        return
    for specy, magnet in zip(grains.species, grains.magnets_in_species(), strict=True):
        remanence = grains.remanence if specy.remanence is None else specy.remanence
        source = "" if grains.moment is None else f", from a moment of {grains.moment:.5g} A m^2"
        if grains.grade is not None and not source:
            grade = find_grade(grains.grade)
            source = f"; {grade.name} has {grade.lowest:g} to {grade.highest:g} T"
        yield f"magnet of {specy.name!r}"
        yield f"  remanence {remanence:.5g} T at {REFERENCE_TEMPERATURE:g} °C{source}"
        if grains.temperature is not None:
            words = f"{100.0 * REMANENCE_SLOPE:+.2g} %/K"
            yield f"  at {grains.temperature:g} °C, by {words}: {magnet.remanence:.5g} T"
        if grains.coating is not None:
            size = f"{1e3 * magnet.diameter:.5g} x {1e3 * magnet.thickness:.5g} mm"
            yield f"  core of {size} below {1e6 * grains.coating:g} um of coating"
        if grains.permeability is not None:
            own = 1.0 / (1.0 + magnet.demagnetisation)
            yield f"  own field at a permeability of {grains.permeability:g}: {own:.5g}"
        if magnet.neighbours:
            ratio = 1.0 / (1.0 + magnet.neighbours / (1.0 + magnet.demagnetisation))
            yield f"  field of neighbours at {1e3 * (grains.spacing or 0.0):.4g} mm: {ratio:.5g}"
        yield f"  moment {magnet.moment:.5g} A m^2"


def _drag_lines(scene: Scene) -> Iterator[str]:
    drag, grains = scene.effects.drag, scene.grains
    if drag is None or drag.viscosity is None:
        return
    yield "drag of a disc"
    yield f"  viscosity {drag.viscosity:.5g} Pa s{_liquid_text(drag.liquid, grains.liquid_temperature)}"
    if drag.is_from_liquid:
        first, second = drag.liquid_film_thicknesses(grains, scene.cell)
        yield f"  films of {1e3 * first:.4g} and {1e3 * second:.4g} mm on its faces"
    if drag.packing is not None:
        factor = drag.counter_flow_drag_factor(grains, scene.cell)
        yield f"  flow back between discs that fill {drag.packing:.4g} of the area: {factor:.5g}"
    yield f"  coefficient {drag.coefficient:.5g} kg/s"


def _piston_lines(scene: Scene) -> Iterator[str]:
    piston, drag = scene.piston, scene.effects.drag
    if piston is None or not piston.has_parts:
        return
    viscosity = None if drag is None else drag.viscosity
    yield "drag of the piston"
    if piston.blade is not None and viscosity is not None:
        blade = piston.blade.drag_coefficient(scene.cell.width, scene.cell.separation, viscosity)
        yield f"  blade {blade:.5g} kg/s"
    if piston.guide is not None:
        temperature = scene.grains.liquid_temperature
        words = _liquid_text(piston.guide.liquid, temperature)
        yield f"  guide {piston.guide.drag_coefficient(temperature, viscosity):.5g} kg/s{words}"
    yield f"  in all {piston.drag:.5g} kg/s"


def _liquid_text(liquid: str | None, celsius: float) -> str:
    if liquid is None:
        return ""
    return f", {liquid} at {celsius:g} °C, ± {100.0 * find_liquid(liquid, celsius).uncertainty:.2g} %"
