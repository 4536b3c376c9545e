"""Dampers of five sizes: with equal groups, and of the same magnets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from granular import damper
from granular.linear import piston_roots
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.scene.dimensionless_groups import dimensionless_groups, lattice_rest, rescale
from granular.studies.bed_slopes import settled_beds
from research.campaign import Plain

FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Widths over that of the settled bed."""
MASSES = (1.0, 0.85, 0.7, 0.6, 0.5)
"""Masses of its piston over the first one."""
COUNTS = (48, 92, 184, 368, 736)


def rescaled(out: str | Path) -> Iterator[Plain]:
    """Figures of one bed in five widths, under a piston of several masses."""
    scene, positions, height = settled_beds(damper(count=92), 1, out=out, progress=False)[0]
    assert height is not None
    for mass in MASSES:
        loaded = scene.replace(**{"piston.mass": damper(count=92).piston.mass * mass})
        rest = equilibrium_from(loaded, positions, height)
        positions, height = rest.positions, rest.piston_height or height
        for factor in FACTORS:
            other = rescale(loaded, factor * loaded.cell.width)
            yield figures(equilibrium_from(other, factor * positions, factor * height))


def of_same_magnets(out: str | Path) -> Iterator[Plain]:
    """Figures of five dampers of the packaged magnets, widths and pistons as the root of N."""
    for count in COUNTS:
        yield figures(equilibrium_from(*settled_beds(damper(count=count), 1, out=out, progress=False)[0]))


def figures(rest: Equilibrium) -> Plain:
    """Width [m], kappa, rest/W, f sqrt(W/g), zeta, and the rest over that of a lattice."""
    scene, root, height = rest.scene, piston_roots(rest)[0], rest.piston_height or math.nan
    width, kappa, count = scene.cell.width, dimensionless_groups(scene)["kappa"], scene.grains.count
    return {
        "width": width,
        "count": count,
        "kappa": kappa,
        "rest": height / width,
        "frequency": root.frequency * math.sqrt(width / 9.8),
        "zeta": root.damping_ratio,
        "over lattice": height / lattice_rest(count, width, kappa),
    }
