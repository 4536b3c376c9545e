"""The bed of a scene as an element between two bodies, from the scene alone.

The bed's force acts on the piston, and against it on the cell. The bed's mass is no part of the
element: grains that follow the piston affinely give the mass matrix that `mass_matrix` returns.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from granular.scene.scene import Scene
from reduced_models.falls.predicted_law import PredictedLaw
from reduced_models.laws.annealing_bed import ANNEALING_BED
from reduced_models.machines.response import ORDER, CoupledSystem
from reduced_models.models.at_rest import AtRest
from reduced_models.models.export import write_code
from reduced_models.models.ports import ForcePort

if TYPE_CHECKING:
    from jaxtyping import Float


def export_bed(scene: Scene, path: str | Path, *, fmi: int = 2) -> str:
    """Write the bed of a scene as an element between two bodies, from the scene alone.

    Its inputs are height [m] and velocity [m/s] of the piston over the cell, its output is the
    force of the bed on the piston [N]. The bed's mass is no part of it.

    Parameters
    ----------
    scene : Scene
        Scene of a piston with a mass on magnets that drag alone damps.
    path : str or Path
        File to write: ``.py``, ``.c`` (with its header), ``.m``, ``.mo`` or ``.fmu``.
    fmi : int
        Version of FMI of an ``.fmu``, 2 or 3.

    Returns
    -------
    str
        Language of the file.

    Raises
    ------
    InputError
        If the law of the bed is not known, the ending is another one, or the file cannot be
        written.

    Examples
    --------
    >>> from granular import load_scene
    >>> from reduced_models.machines import export_bed
    >>> export_bed(load_scene("damper"), "Bed.mo")
    'a Modelica model'
    """
    return write_code(bed_force_port(scene), Path(path), fmi)


def bed_force_port(scene: Scene) -> ForcePort:
    """Return the law of a scene's bed as an element."""
    system = CoupledSystem.from_bed_scene(scene)
    load, swing = system.piston * system.gravity, system.small_swing
    values = {
        "lam": 0.5 * system.drag / system.moving,
        "weight": load / system.moving,
        "rest": system.rest,
        "power": system.power,
        "modulus": system.modulus,
        "strength": system.strength,
    }
    at_rest = AtRest(system.rest, math.tau / swing.omega, swing.lam / swing.omega, {})
    model = PredictedLaw(
        ANNEALING_BED,
        values,
        (system.rest, 0.0),
        at_rest,
        provenance={"data": f"none, from the scene {scene.name}"},
        hidden={"q": ORDER},
    )
    return ForcePort(model, system.moving, load)


def mass_matrix(system: CoupledSystem) -> Float[np.ndarray, "2 2"]:
    """Mass matrix [kg] of host and piston over the cell."""
    # An affine bed moves by 1/2 of the piston's stroke on average, in the mass that couples it with the host.
    swing = system.piston + 0.5 * system.bed
    return np.array([[system.host + system.piston + system.bed, swing], [swing, system.moving]])
