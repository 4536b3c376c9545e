"""Scenes and runs in a few lines: for the command line and for reports."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from granular.run.trajectory import Trajectory
from granular.scene.dimensionless_groups import dimensionless_groups, groups_line
from granular.scene.part_lines import part_lines
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales
from granular.schema.section_text import describe_fields

_SHOWN = 1.0
"""Seconds of compiling from which on a run tells of them."""


def packing_fraction(scene: Scene, height: float) -> float:
    """Packing fraction, the grains' area over the cell's below the piston at ``height`` [m] [D, eq. 2.2]."""
    area = float((math.pi / 4.0 * scene.grains.diameters() ** 2).sum())
    return area / (scene.cell.width * height)


def derived_scene_values(scene: Scene) -> dict[str, Any]:
    """Natural units, numbers of grains, packing fraction and groups of a scene, in SI [m, kg, N, s]."""
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
    """Names of the effects that act in a scene [effects]."""
    return tuple(key for key in scene.effects.key_names() if getattr(scene.effects, key))


def custom_code_digests(scene: Scene) -> list[str]:
    """Digests of a user's own functions in a scene, and of what is derived from formulas."""
    parts: list[Any] = [*scene.effects.in_loop_order, *scene.protocol]
    return sorted(digest for part in parts for digest in part.user_code_digests)


def scene_text(scene: Scene) -> str:
    """Text of a scene: grains, natural units, cell, piston, effects and stages.

    Parameters
    ----------
    scene : Scene
        Scene to describe.

    Returns
    -------
    str
        Lines: name; number and diameter [mm] of each species; natural units D [mm], m [g], F* [N] and tau
        [ms]; width of the cell and height of the piston or the periodic cell [mm] and [D], with the
        piston's mass [kg] and the packing fraction [D, eq. 2.2]; dimensionless groups of a damper; effects
        with their values; the steps from parts that are named to moment [A m^2] and drags [kg/s]; stages
        with their values.

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
        mixed = "" if len(counts) == 1 else f", a fraction of {fraction:.4g}"
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
    if groups := groups_line(scene):
        lines.append(f"  groups: {groups}")
    lines.append(f"  effects: {', '.join(active_effect_names(scene)) or 'none'}")
    lines += [
        f"    {effect.key}: {said}" for effect in scene.effects.acting if (said := describe_fields(effect))
    ]
    lines += [f"  {line}" for line in part_lines(scene)]
    for stage in scene.protocol:
        said = describe_fields(stage, without=("name",))
        lines.append(f"  stage {stage.name!r}: {type(stage).__name__.lower()}, {said}")
    return "\n".join(lines)


def run_statistics(run: Trajectory) -> dict[str, Any]:
    """Last values, stages, step counts, residual and timings of a run, in SI."""
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
    """Text of a run: its stages, steps, wall time and energy ledger.

    Parameters
    ----------
    run : Trajectory
        Finished run, or one that was cut off.

    Returns
    -------
    str
        Lines: times [s] of each stage, why it ended, and the piston's height there [mm] and [D]; steps,
        method, time step, wall time [s] and the ledger's residual over the energy turned over; the run
        directory where there is one.
    """
    figures, scales = run_statistics(run), Scales.from_grains(run.scene.grains)
    lines = []
    for stage in run.stages:
        height = ""
        if run.scene.piston is not None:
            height = f", piston at {1e3 * stage.height:.4f} mm ({stage.height / scales.length:.4f} D)"
        lines.append(f"{stage.name}: {stage.start:.4g} to {stage.end:.4g} s ({stage.reason}){height}")
    compiled = run.settings().get("compile_seconds", 0.0)
    more = f" and {compiled:.2g} s of compiling" if compiled >= _SHOWN else ""
    lines.append(
        f"{figures['steps']} steps ({run.method.name}, dt {figures['dt']}) in "
        f"{figures['seconds']:.3g} s{more}; ledger closed to {figures['ledger_residual']:.1e} of "
        "the energy turned over"
    )
    if run.path is not None:
        lines.append(f"written to {run.path}")
    return "\n".join(lines)
