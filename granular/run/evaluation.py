"""`evaluate`: forces and energies of grains at given positions, without time stepping."""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.engine.forces import compute_forces_and_energies, force_components_with_far_field
from granular.engine.run_errors import report_arithmetic_errors_as
from granular.engine.state import allocate_measurement_scratch_arrays, make_initial_state
from granular.kernel_data.state import HEIGHT, State
from granular.methods import METHODS
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import SceneInNaturalUnits, scene_in_natural_units
from granular.schema.cell import PISTON, Heights
from granular.shared.errors import InputError, quote


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """Forces and energies of an arrangement, in SI.

    Attributes
    ----------
    force : float64 (n, 2)
        Force on each grain [N] due to magnets, weight, contacts, and custom effects that define an energy;
        without friction and drag.
    piston_force : float
        Force of the grains on the piston, positive upwards [N]; 0 if grains pass through the piston.
    wall_forces : dict of str to float
        Force of the grains on each side of the cell, positive outwards [N]; 0 for a side without a wall.
    potential_energy : float
        Energy of pairs, walls, contacts, weight and custom effects [J].
    kinetic_energy : float
        Kinetic energy of the grains [J].
    normal_load : float64 (n,)
        Normal force of each grain on the glass plates [N]; zero without dry friction.
    """

    force: np.ndarray
    piston_force: float
    wall_forces: dict[str, float]
    potential_energy: float
    kinetic_energy: float
    normal_load: np.ndarray


def evaluate(
    scene: Scene, positions: np.ndarray, velocities: np.ndarray | None = None, piston_height: Heights = None
) -> Evaluation:
    """Return the forces and energies of one arrangement of the scene's grains.

    Parameters
    ----------
    scene : Scene
        Scene whose effects are evaluated.
    positions, velocities : float (n, 2)
        Positions [m] and velocities [m/s] of the n grains of the scene; velocities default to zero.
    piston_height : float or float (1 + p,), optional
        Height of the piston [m]; default: the height in the scene. The height has no effect if the piston is
        not a wall. The heights of p further pistons may follow; their default is 0.

    Returns
    -------
    Evaluation
        Forces [N], energies [J] and normal loads [N].

    Raises
    ------
    InputError
        If a shape does not fit, a value is not finite, or a grain is behind a wall, above the piston or
        at the position of another grain.

    Examples
    --------
    >>> import numpy as np
    >>> from granular import evaluate, load_scene
    >>> scene = load_scene("bed").replace(**{"grains.count": 2})
    >>> positions = np.array([[0.170, 0.06], [0.182, 0.06]])  # [m]
    >>> print(evaluate(scene, positions, piston_height=0.12).force[:, 0].round(3))  # [N]
    [-0.111  0.111]
    """
    system = scene_in_natural_units(scene)
    scales, constants = system.scales, system.constants
    coordinates = _validate_grain_vectors("positions", positions, constants.grains)
    speed = _validate_grain_vectors("velocities", velocities, constants.grains)
    if piston_height is None:
        piston_height = 0.0 if scene.piston is None else scene.piston.height
    host = scene.effects.host
    further = 0 if host is None else len(host.pistons)
    try:
        heights = np.atleast_1d(np.asarray(piston_height, dtype=np.float64)) / scales.length
    except (TypeError, ValueError):
        heights = np.array([np.nan])
    if heights.shape not in ((1,), (1 + further,)) or not np.isfinite(heights).all():
        others = f", or {1 + further} heights, the piston first, then further pistons" if further else ""
        raise InputError(f"piston_height = {quote(piston_height)} is not a height; give one in m{others}")
    start = (coordinates / scales.length, speed / scales.velocity, float(heights[0]))
    state = make_initial_state(*start, constants.acting, METHODS["stormer-verlet"])
    if len(heights) > 1:
        state.bodies[-further:, HEIGHT] = heights[1:]
    measurement, energies = allocate_measurement_scratch_arrays(state), np.zeros(len(constants.acting.laws))
    with report_arithmetic_errors_as(_misplaced_positions_error):
        outside, potential, kinetic = compute_forces_and_energies(state, constants, measurement, energies)
    force = np.stack(force_components_with_far_field(state), axis=1)[: constants.grains]
    if outside or not np.isfinite(force).all():
        raise _misplaced_positions_error()
    potential += float(energies[::-1].sum())
    wall_forces, lines = (state.wall_forces * scales.force).tolist(), scene.cell.lines
    lifts = [-s.normal[1] * f for s, f in zip(lines, wall_forces, strict=True) if s.body == PISTON]
    return Evaluation(
        force=force * scales.force,
        piston_force=sum(lifts),
        wall_forces=dict(zip((line.name for line in lines), wall_forces, strict=True)),
        potential_energy=float(potential * scales.energy),
        kinetic_energy=float(kinetic * scales.energy),
        normal_load=_normal_loads(state, system) * scales.force,
    )


def _misplaced_positions_error() -> InputError:
    return InputError(
        "a grain is behind a wall, above the piston or at the position of another grain; move the grain"
    )


def _normal_loads(state: State, system: SceneInNaturalUnits) -> np.ndarray:
    grains = system.constants.grains
    for effect, law in zip(system.effects, system.constants.acting.laws, strict=True):
        values = effect.grain_record_values(law, state)
        if "normal_load" in values:
            return values["normal_load"][:grains]
    return np.zeros(grains)


def _validate_grain_vectors(name: str, values: np.ndarray | None, count: int) -> np.ndarray:
    if values is None:
        return np.zeros((count, 2))
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} are not numbers; give an array of shape ({count}, 2)") from None
    if array.shape != (count, 2):
        raise InputError(f"{name} has the shape {array.shape}; the scene needs ({count}, 2)")
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds a value that is not finite; give finite numbers")
    return array
