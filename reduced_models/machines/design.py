"""The bed, piston and drag that leave least of a host's vibration, by the identified law."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from granular.effects.excitation import Excitation
from granular.effects.host import Host
from granular.response.linear_system import hanging_mass_stiffness, linear_response, tuned_mass
from granular.scene.loading import load_scene
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from reduced_models.falls.theory import FEWEST
from reduced_models.machines.response import RANGE, CoupledSystem, solve_response

if TYPE_CHECKING:
    from collections.abc import Iterator

HELPS = 0.9
"""Least fraction of the peak that a damper must leave away, as 1 minus this, to be one."""
_COARSE = np.linspace(0.6, 1.3, 15)
"""Frequencies over the host's that a candidate is tried at."""
_DRAGS = (0.05, 0.1, 0.2, 0.3, 0.45, 0.65, 0.9)
_FRACTIONS = (0.6, 0.8, 1.0)
"""Of the greatest mass, in the piston."""
_COUNTS = (276, 368, 460, 552, 736)
_FILLED = 0.55
"""Most of the cell's area below the piston at rest that grains may take."""


@dataclasses.dataclass(frozen=True, eq=False)
class DamperDesign:
    """A damper for a host.

    Attributes
    ----------
    scene : Scene
        To be simulated.
    peak, alone, ideal : float
        Greatest displacement of the host [m] by the law, without a damper, and with Den Hartog's
        tuned mass of the same weight.
    stroke : float
        Of the piston over the cell at the peak [m].
    mass : float
        Of piston and grains [kg].
    helps : bool
        Whether the peak is less than 0.9 of that without a damper, at a stroke that the law was
        held against.
    verdict : str
    """

    scene: Scene
    peak: float
    alone: float
    ideal: float
    stroke: float
    mass: float
    helps: bool
    verdict: str

    def __str__(self) -> str:
        return self.verdict


def design_for(host: Host, excitation: Excitation, *, limit: float) -> DamperDesign:
    """Damper of the packaged kind of at most so much mass that makes the peak least.

    Grains of 6 mm in a cell of 60 D; their number, the piston's mass and the drag are searched. The
    law has no memory of how a real bed scatters from start to start: simulate the scene.

    Parameters
    ----------
    host : Host
        Of one body, which is to carry the cell.
    excitation : Excitation
        A sine of a force; its frequency may be any.
    limit : float
        Greatest mass of piston and grains [kg].

    Returns
    -------
    DamperDesign
        The damper, and the peak [m] with and without it.

    Raises
    ------
    InputError
        If the host is another, the force is none, or the limit leaves no mass for a piston.
    """
    if len(host.bodies) != 1 or host.bodies[0].stiffness <= 0.0:
        raise InputError("a damper is designed for a host of one body on a spring; give such a one")
    if excitation.kind != "sine" or not excitation.force:
        raise InputError("a damper is designed for a sine of a force; give excitation.force in N")
    (body,) = host.bodies
    own = math.sqrt(body.stiffness / body.mass) / math.tau
    frequencies = [float(own * ratio) for ratio in _COARSE]
    tried = [
        (solve_response(CoupledSystem.of(scene), frequencies, excitation.force), scene)
        for scene in _candidate_dampers(host, excitation, limit)
    ]
    if not tried:
        raise InputError(
            f"limit = {limit:g} kg leaves no piston on a bed of {FEWEST} grains or more; give more"
        )
    _, best = min(tried, key=lambda pair: pair[0].peak)
    fine = [float(own * ratio) for ratio in np.linspace(0.6, 1.4, 81)]
    response = solve_response(CoupledSystem.of(best), fine, excitation.force)
    assert best.piston is not None
    mass = (best.piston.mass or 0.0) + float(best.grains.masses().sum())
    alone_host = Host(bodies=host.bodies, excitation=excitation)
    dense = own * np.linspace(0.6, 1.4, 801)
    alone = float(np.abs(linear_response(alone_host, dense)[:, -1]).max())
    tuned = hanging_mass_stiffness(dense, mass, *tuned_mass(host, mass))
    ideal = float(np.abs(linear_response(alone_host, dense, tuned)[:, -1]).max())
    stroke = float(response.stroke[int(response.displacement.argmax())])
    diameters = stroke / best.grains.species[0].diameter
    helps = response.peak < HELPS * alone and diameters >= RANGE[0]
    return DamperDesign(
        best, response.peak, alone, ideal, stroke, mass, helps,
        _verdict_text(best, response.peak, alone, ideal, diameters),
    )  # fmt: skip


def _candidate_dampers(host: Host, excitation: Excitation, limit: float) -> Iterator[Scene]:
    start = load_scene("machine").replace(
        **{"effects.host": Host(bodies=host.bodies, excitation=excitation).to_plain()}
    )
    for count in _COUNTS:
        bed = float(start.replace(**{"grains.count": 1}).grains.masses().sum()) * count
        for fraction, drag in itertools.product(_FRACTIONS, _DRAGS):
            mass = fraction * (limit - bed)
            if not mass > 0.5:
                continue
            diameter = start.grains.species[0].diameter
            height = 16.0 * diameter * max(count / 368.0, 1.0)
            scene = start.replace(**{
                "grains.count": count, "piston.mass": mass, "effects.drag.coefficient": drag,
                "piston.height": height, "arrangement.height": height - diameter,
            })  # fmt: skip
            try:
                law = CoupledSystem.of(scene)
            except InputError:  # the law is not known for so much drag
                continue
            filled = count * math.pi / 4.0 * diameter**2 / (law.rest * scene.cell.width)
            if law.rest < height and filled < _FILLED:
                yield scene


def _verdict_text(scene: Scene, peak: float, alone: float, ideal: float, stroke: float) -> str:
    drag = scene.effects.drag
    assert scene.piston is not None
    what = (
        f"{scene.grains.count} grains, a piston of {scene.piston.mass:.3g} kg and a drag of "
        f"{0.0 if drag is None else drag.coefficient:.2g} kg/s"
    )
    figures = (
        f"{1e3 * peak:.3g} mm at the peak, {1e3 * alone:.3g} mm without, {1e3 * ideal:.3g} mm with "
        f"an ideal tuned mass of the same weight; the piston swings {stroke:.2g} D"
    )
    if not peak < HELPS * alone:
        still = stroke < RANGE[0]
        how = "hardly moves, and damps little" if still else "leaves most of the vibration"
        return f"no: the best bed, {what}, {how}: {figures}"
    if RANGE[0] <= stroke <= RANGE[1]:
        return f"{what}: {figures}"
    beyond = "less" if stroke < RANGE[0] else "more"
    return f"{what}: {figures}, {beyond} than the law was held against: simulate it"
