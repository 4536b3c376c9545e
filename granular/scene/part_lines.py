"""Steps from the parts that a scene names to moment and drags, one a line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from granular.parts.grades import REFERENCE_TEMPERATURE, REMANENCE_SLOPE, find_grade
from granular.parts.liquids import find_liquid

if TYPE_CHECKING:
    from granular.scene.scene import Scene


def part_lines(scene: Scene) -> list[str]:
    """Lines of all steps; none where a scene names moment and drags by their numbers."""
    return [*_moment_lines(scene), *_drag_lines(scene), *_piston_lines(scene)]


def _moment_lines(scene: Scene) -> Iterator[str]:
    grains = scene.grains
    named = (grains.grade, grains.moment, grains.coating, grains.permeability, grains.temperature)
    if all(value is None for value in named):
        return
    for specy, magnet in zip(grains.species, grains.magnets_in_species(), strict=True):
        remanence = grains.remanence if specy.remanence is None else specy.remanence
        source = "" if grains.moment is None else f", by a moment of {grains.moment:.5g} A m^2"
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
    yield f"  viscosity {drag.viscosity:.5g} Pa s{_liquid_words(drag.liquid, grains.liquid_temperature)}"
    if drag.follows:
        first, second = drag.films(grains, scene.cell)
        yield f"  films of {1e3 * first:.4g} and {1e3 * second:.4g} mm on its faces"
    if drag.packing is not None:
        factor = drag.packing_factor(grains, scene.cell)
        yield f"  flow back between discs that fill {drag.packing:.4g} of the area: {factor:.5g}"
    yield f"  coefficient {drag.coefficient:.5g} kg/s"


def _piston_lines(scene: Scene) -> Iterator[str]:
    piston, drag = scene.piston, scene.effects.drag
    if piston is None or not piston.has_parts:
        return
    viscosity = None if drag is None else drag.viscosity
    yield "drag of the piston"
    if piston.blade is not None and viscosity is not None:
        blade = piston.blade.drag(scene.cell.width, scene.cell.separation, viscosity)
        yield f"  blade {blade:.5g} kg/s"
    if piston.guide is not None:
        temperature = scene.grains.liquid_temperature
        words = _liquid_words(piston.guide.liquid, temperature)
        yield f"  guide {piston.guide.drag(temperature, viscosity):.5g} kg/s{words}"
    yield f"  in all {piston.drag:.5g} kg/s"


def _liquid_words(liquid: str | None, celsius: float) -> str:
    if liquid is None:
        return ""
    return f", {liquid} at {celsius:g} °C, ± {100.0 * find_liquid(liquid, celsius).uncertainty:.2g} %"
