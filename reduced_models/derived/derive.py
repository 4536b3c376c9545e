"""Derive the piston's law from equilibria and complex roots of its bed, without a fit to a motion.

If the piston is held at a height z, F(z) is the downward force on it, including its weight. Small
oscillations about this state are proportional to exp(s t), with a complex root s. If M is the piston's mass,
the bed's contributions m to the mass and c to the damping follow from (M + m) s^2 + c s + F' = 0, so that

    (M + m(z)) z'' + m'(z)/2 z'^2 + c(z) z' + F(z) = 0

has the exact root at equilibrium, and loses energy only through c. The range of heights ends at an
instability: when the lowest eigenvalue of the bed's stiffness becomes zero, grains rearrange and the
force jumps.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import (
    RELAXED,
    Equilibrium,
    coordinates_to_pin_in_periodic_cell,
    equilibrium,
    find_equilibrium_pencil,
    relax_until_forces_reduced,
)
from granular.linear.pencil import Pencil
from granular.linear.roots import (
    MASS_FRACTION,
    Root,
    coordinate_index_of_free_piston,
    modal_coordinate,
    piston_roots,
    quasi_static_displacement_shape,
    refine_root,
)
from granular.protocol.stages import Lift
from granular.records.record import PistonRecord
from granular.run.trajectory import Trajectory, piston_heights_in_frames
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from reduced_models.derived.motion_error import CYCLES, MotionError, motion_error
from reduced_models.laws.law import Law
from reduced_models.models.at_rest import AtRest
from reduced_models.models.model import ReducedModel
from reduced_models.models.ports import DERIVED
from reduced_models.models.quantities import Quality, format_percent
from reduced_models.records.backbone import Backbone
from reduced_models.records.sources import open_source

RESOLUTION = 1e-4
"""Shortest step of the piston, in grain diameters D; heights of instabilities have this error."""

_KICK = 1e-2  # displacement along the unstable mode [D], large enough to leave a saddle at the shortest step
_MOVED = 0.25  # fraction of the largest displacement; grains that move farther count as rearranged


class HeldState(NamedTuple):
    """Equilibrium with the piston held, and small oscillations about it: (M + m) s^2 + c s + k = 0."""

    height: float  # [m]
    force: float  # F: downward force on the piston including its weight [N]
    stiffness: float  # k = dF/dz [N/m]
    mass: float  # M + m [kg]
    damping: float  # c [N s/m]
    root: complex  # s [1/s]


class Instability(NamedTuple):
    """A piston height at which the equilibrium with the piston held becomes unstable.

    Attributes
    ----------
    height : float
        Height of the piston [m], with an error of 1e-4 grain diameters.
    grains : tuple of int
        Grains that move by at least a quarter of the largest displacement.
    force_drop : float
        Decrease [N] of the force on the piston, at this height, due to the rearrangement; 0 if the
        rearrangement is gradual.
    """

    height: float
    grains: tuple[int, ...]
    force_drop: float


def held_state_of_root(pencil: Pencil, piston: int, s: complex) -> HeldState:
    """Return the small oscillation about a held equilibrium, using the root closest to s [1/s]."""
    root, shape, height = (
        refine_root(pencil, piston, s),
        quasi_static_displacement_shape(pencil, piston),
        pencil.at[piston],
    )
    if root is None:
        raise InputError(
            f"the piston does not oscillate about a height of {1e3 * height:.4g} mm; reduce the "
            "drag or the reach"
        )
    stiffness, s = float(shape @ pencil.dynamic_stiffness_times(0.0, shape)), root.s
    mass, damping = np.linalg.solve([[(s * s).real, s.real], [(s * s).imag, s.imag]], [-stiffness, 0.0])
    force = -float(pencil.bed.forces(pencil.at)[piston])
    return HeldState(float(height), force, stiffness, float(mass), float(damping), s)


def held_states_and_first_instability(
    pencil: Pencil, piston: int, s: complex, step: float, count: int
) -> tuple[list[HeldState], Instability | None]:
    """Return held states after each of ``count`` steps [m], and any instability that ends the sequence."""
    states: list[HeldState] = []
    start = float(pencil.at[piston])
    for k in range(1, count + 1):
        pencil, reached = _last_equilibrium_and_is_goal_reached(pencil, piston, start + k * step)
        if not reached:
            return states, _rearrangement_beyond_last_height(pencil, piston, float(np.sign(step)))
        states.append(held_state_of_root(pencil, piston, s))
        s = states[-1].root
    return states, None


def _last_equilibrium_and_is_goal_reached(pencil: Pencil, piston: int, goal: float) -> tuple[Pencil, bool]:
    """Follow the equilibrium towards a height [m]; return its matrices, and whether it reached the height."""
    size = goal - pencil.at[piston]
    while (left := goal - pencil.at[piston]) != 0.0:
        height = goal if abs(left) <= abs(size) else float(pencil.at[piston] + size)
        trial = _next_equilibrium(pencil, piston, height)
        if trial is not None:
            pencil = trial
        elif abs(size) <= RESOLUTION * pencil.bed.length:
            return pencil, False
        else:
            size *= 0.5
    return pencil, True


def _next_equilibrium(pencil: Pencil, piston: int, height: float) -> Pencil | None:
    """Return the stable equilibrium at a height [m] on the current branch; None if the branch ends."""
    step, held = height - float(pencil.at[piston]), _held_coordinates(pencil.bed, piston)
    start = pencil.at + step * quasi_static_displacement_shape(pencil, piston)
    start[piston] = height
    try:
        result = find_equilibrium_pencil(pencil.bed, start, held, pencil)
    except InputError:
        return None
    # Another branch differs from the extrapolation by more than the piston's step, the curvature by less.
    if np.abs(result.at - start).max() > abs(step) or not result.is_stable(held):
        return None
    return result


def _held_coordinates(bed: BedForces, piston: int) -> tuple[int, ...]:
    return (piston, *coordinates_to_pin_in_periodic_cell(bed))


def _rearrangement_beyond_last_height(pencil: Pencil, piston: int, direction: float) -> Instability:
    """Find the rearrangement beyond the last height before an instability."""
    bed, held = pencil.bed, _held_coordinates(pencil.bed, piston)
    at, mode = pencil.at.copy(), pencil.lowest_eigenvalues_and_modes(1, held)[1][:, 0]
    at[piston] += direction * RESOLUTION * bed.length
    side = 1.0 if mode @ bed.forces(at) >= 0.0 else -1.0
    kick = side * _KICK * bed.length / float(np.abs(mode).max())
    stiffness = pencil.stiffness.diagonal()
    relaxed = relax_until_forces_reduced(bed, at + kick * mode, held, stiffness, RELAXED)
    moved = np.linalg.norm(bed.positions(relaxed) - bed.positions(pencil.at), axis=1)
    grains = tuple(map(int, np.flatnonzero(moved >= _MOVED * moved.max())))
    relaxed[piston] = pencil.at[piston]
    try:
        after = find_equilibrium_pencil(bed, relaxed, held).at
    except InputError:  # the bed is about to rearrange again
        after = relax_until_forces_reduced(bed, relaxed, held, stiffness, RELAXED)
    drop = float(bed.forces(pencil.at)[piston] - bed.forces(after)[piston])
    return Instability(float(pencil.at[piston]), grains, drop)


RESIDUAL = 1e-5
"""The order of a polynomial is raised until its relative residual is below this value. The residual of the
force includes the force's slope."""

HIGHEST_ORDER = 9

LARGEST_RESIDUAL = 0.01
"""Maximum relative residual of a polynomial; the derived law has an error of the same size."""

# Nodes in a half cycle: the midpoint rule of a smooth periodic function converges faster than any power.
_NODES = 64
_MOST_STEPS = 50


def fit_polynomial_law_values_and_text(
    states: Sequence[HeldState], middle: int, order: int | None
) -> tuple[Law, dict[str, float], str]:
    """Return a law, its parameter values, and a text on the orders and residuals of its polynomials."""
    heights, at = np.array([state.height for state in states]), states[middle]
    distances = np.abs(heights - at.height)
    fits = _fit_force_mass_and_damping(states, at, order)
    worst = max(fits, key=lambda name: fits[name][1])
    if order is None and fits[worst][1] > LARGEST_RESIDUAL:
        for reach in np.unique(distances)[:0:-1]:
            near = [state for state, away in zip(states, distances, strict=True) if away <= reach]
            if (
                max(residual for _, residual in _fit_force_mass_and_damping(near, at, order).values())
                <= LARGEST_RESIDUAL
            ):
                break
        raise InputError(
            f"no polynomial in the height fits the {worst} from {1e3 * heights[0]:.4g} to "
            f"{1e3 * heights[-1]:.4g} mm within {format_percent(LARGEST_RESIDUAL)}, since the bed "
            f"almost rearranges there; use reach = {995.0 * reach:.3g} mm"
        )
    k, m, c = (coefficients / at.mass for coefficients, _ in fits.values())
    values = {f"m{j}": float(m[j]) for j in range(1, len(m))} | {"rest": at.height}
    values |= {f"c{j}": float(c[j]) for j in range(len(c))} | {f"k{j}": float(k[j]) for j in range(1, len(k))}
    inertia = ["1", *(_power_term_text(f"m{j}", j) for j in range(1, len(m)))]
    gradient = [_power_term_text(f"{j}*m{j}/2" if j > 1 else "m1/2", j - 1) for j in range(1, len(m))]
    parts = [f"({' + '.join(inertia)})*z''", f"({' + '.join(gradient)})*z'**2"][: 1 + bool(gradient)]
    parts += [f"({' + '.join(_power_term_text(f'c{j}', j) for j in range(len(c)))})*z'"]
    parts += [_power_term_text(f"k{j}", j) for j in range(1, len(k))]
    units = {
        "rest": "m",
        **{name: _coefficient_unit(name[0], int(name[1:])) for name in values if name != "rest"},
    }
    law = Law(DERIVED, f"{' + '.join(parts)} = 0", units=units, source="equilibria and roots of the bed")
    accuracy = (
        f"{name} of order {len(coefficients) - 1}, residual {format_percent(residual)}"
        for name, (coefficients, residual) in fits.items()
    )
    return law, {name: values[name] for name in law.parameters}, ", ".join(accuracy)


def _fit_force_mass_and_damping(
    states: Sequence[HeldState], at: HeldState, order: int | None
) -> dict[str, tuple[Float[np.ndarray, "p"], float]]:
    """Fit polynomials to force, mass and damping about the state ``at``; return them with residuals."""
    height, force, stiffness, mass, damping, _ = np.array(states).real.T
    x, less = height - at.height, None if order is None else order - 1
    return {
        "force": _fit_polynomial_and_residual(x, force, (0.0, at.stiffness), order, stiffness),
        "mass": _fit_polynomial_and_residual(x, mass, (at.mass,), less),
        "damping": _fit_polynomial_and_residual(x, damping, (at.damping,), less),
    }


def _power_term_text(factor: str, power: int) -> str:
    return factor + ("" if power == 0 else "*(z - rest)" if power == 1 else f"*(z - rest)**{power}")


def _coefficient_unit(kind: str, power: int) -> str:
    """Return the unit of the coefficient of (z - rest)^power in the inertia, damping or force per mass."""
    seconds = {"m": 0, "c": 1, "k": 2}[kind]
    metres = power - (kind == "k")
    below = [f"{unit}^{size}" if size > 1 else unit for unit, size in (("m", metres), ("s", seconds)) if size]
    return f"1/({' '.join(below)})" if len(below) > 1 else f"1/{below[0]}"


def _fit_polynomial_and_residual(
    x: Float[np.ndarray, "n"],
    values: Float[np.ndarray, "n"],
    known: tuple[float, ...],
    order: int | None,
    slopes: Float[np.ndarray, "n"] | None = None,
) -> tuple[Float[np.ndarray, "p"], float]:
    """Fit a polynomial with known lowest coefficients; return its coefficients and relative residual."""
    reach = float(np.abs(x).max())
    u = x / reach
    target = values if slopes is None else np.concatenate([values, reach * slopes])
    lowest, highest = len(known) - 1, min(HIGHEST_ORDER, len(target) // 2)
    for degree in range(lowest, highest + 1) if order is None else [max(order, lowest)]:
        powers = np.arange(degree + 1)
        columns = u[:, None] ** powers
        if slopes is not None:
            columns = np.concatenate([columns, powers * u[:, None] ** np.maximum(powers - 1, 0)])
        coefficients = np.zeros(degree + 1)
        coefficients[: len(known)] = np.array(known) * reach ** powers[: len(known)]
        left = target - columns @ coefficients
        coefficients[len(known) :] = np.linalg.lstsq(columns[:, len(known) :], left, rcond=None)[0]
        # Without drag the damping is zero at all heights.
        largest = float(np.abs(target).max()) or 1.0
        residual = float(np.abs(target - columns @ coefficients).max()) / largest
        if residual <= RESIDUAL:
            break
    return coefficients / reach**powers, residual


def backbone_from_energy_loss(values: Mapping[str, float], amplitudes: Sequence[float]) -> Backbone:
    """Return the backbone [m, rad/s]: frequencies of undamped cycles, and damping from their energy loss."""
    # The lowest coefficients of inertia and force in z - rest are fixed and not parameters.
    laws = tuple(
        np.polynomial.Polynomial([*lowest, *(value for name, value in values.items() if name[0] == kind)])
        for kind, lowest in (("m", [1.0]), ("c", []), ("k", [0.0]))
    )
    frequency, ratio = np.array(
        [_frequency_and_damping_at_amplitude(laws, amplitude) for amplitude in amplitudes]
    ).T
    none = np.zeros(len(frequency))
    return Backbone("energy", np.asarray(amplitudes, dtype=float), frequency, ratio, none, none)


def _frequency_and_damping_at_amplitude(
    laws: tuple[np.polynomial.Polynomial, ...], amplitude: float
) -> tuple[float, float]:
    """Return angular frequency [rad/s] and damping ratio of a cycle with an amplitude [m]."""
    inertia, damping, force = laws
    if not amplitude > 0.0:
        raise InputError(f"amplitude = {amplitude:g} m is not above 0; give a larger amplitude")
    potential, centre = force.integ(), 0.0
    for _ in range(_MOST_STEPS):  # Newton's method for extremes of one energy
        low, high = centre - amplitude, centre + amplitude
        change = (potential(high) - potential(low)) / (force(high) - force(low))
        centre -= change
        if abs(change) < 1e-14 * amplitude:
            break
    low, high = centre - amplitude, centre + amplitude
    # With x = centre + amplitude sin(angle), energy less potential is (high - x)(x - low) times a polynomial.
    quotient = (potential(high) - potential) // np.polynomial.Polynomial([-low * high, low + high, -1.0])
    angles = math.pi * ((np.arange(_NODES) + 0.5) / _NODES - 0.5)
    x = centre + amplitude * np.sin(angles)
    if not (force(high) > 0.0 > force(low) and (quotient(x) > 0.0).all() and (inertia(x) > 0.0).all()):
        raise InputError(
            f"the force is not restoring at an amplitude of {amplitude:g} m; give a smaller amplitude"
        )
    pace = np.sqrt(2.0 * quotient(x) / inertia(x))  # speed / (amplitude cos(angle))
    omega = 1.0 / float((1.0 / pace).mean())
    loss = 2.0 * math.pi * float((damping(x) * pace * np.cos(angles) ** 2).mean())
    return omega, loss / (2.0 * math.pi * omega**2)


REACH = 0.2
"""Default range above and below the equilibrium, in grain diameters D, for a scene without a lift."""

STEP = 0.025
"""Longest step of the piston, in grain diameters D."""

FEWEST_STEPS = 4
"""Minimum number of steps of the piston on each side of the equilibrium."""

FRACTIONS = (1.0, 0.5, 0.1)
"""Printed amplitudes, divided by the distance from the equilibrium to the nearer end of the range."""

REARRANGED = 0.5
"""Displacement of a grain, in diameters D, above which the packing (and thus its roots) counts as changed."""

NAMED = 8
"""Maximum number of printed grains of an instability."""

GRADUAL = 1e-9
"""Fraction of the piston's weight below which a drop of the force counts as rounding error."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class DerivedModel(ReducedModel):
    """A law derived from equilibria and complex roots of a bed; a subclass of `ReducedModel`.

    A saved file contains the law and the print-out, but not the attributes below.

    Attributes
    ----------
    states : tuple of HeldState
        Height [m], force F [N], stiffness dF/dz [N/m], mass M + m [kg], damping c [N s/m] and root [1/s],
        in order of increasing height.
    instabilities : tuple of Instability
        Instabilities at which the range ends, below or above the equilibrium.
    error : MotionError or None
        Error in comparison with a run; None if there is no comparison.
    """

    states: tuple[HeldState, ...] = ()
    instabilities: tuple[Instability, ...] = ()
    error: MotionError | None = None

    def backbone(self, amplitudes: Sequence[float]) -> Backbone:
        """Compute frequency and damping ratio against amplitude from undamped cycles and their energy loss.

        Parameters
        ----------
        amplitudes : sequence of float
            Amplitudes [m], above 0: half the distance between the two extremes of a cycle.

        Returns
        -------
        Backbone
            Angular frequency [rad/s] and damping ratio for each amplitude, arrays (n,).

        Raises
        ------
        InputError
            If an amplitude is not above 0, or the force is not restoring at the extremes of the cycle.
        """
        return backbone_from_energy_loss(self.parameters, amplitudes)


def derive(
    source: Scene | Trajectory | str | Path,
    reach: float | None = None,
    *,
    order: int | None = None,
    against: Trajectory | PistonRecord | str | Path | None = None,
) -> DerivedModel:
    """Derive the law of a piston on its bed from equilibria and complex roots, without a fit.

    The piston is held at heights about its equilibrium, up to the first instability (if any) on each side.
    The law is (M + m) z'' + m'/2 z'^2 + c z' + F = 0, divided by the mass M + m at equilibrium; F, m and c
    are polynomials in the height. The law does not include drives, thermal motion and dry friction.

    Parameters
    ----------
    source : Scene, Trajectory, str or Path
        A run (or its directory) whose last frame is the settled bed, or a scene. The protocol of a scene is
        simulated until the bed first comes to rest.
    reach : float, optional
        Distance from the equilibrium to each end of the range [m]; by default the scene's lift, or
        0.2 D without a lift.
    order : int, optional
        Order of F, from 1 to 9; the order of m and c is lower by one. By default each has the lowest order
        whose relative residual is below 1e-5.
    against : Trajectory, PistonRecord, str or Path, optional
        Free oscillation that is compared with the law over ten cycles from its second extreme; by default
        the oscillation after the release, if the source is a run.

    Returns
    -------
    DerivedModel
        Derived model. If the source is a run with a release, the model's motion starts there, from the run's
        state projected onto the mode of the piston's root. If grains have rearranged, it starts from the
        piston's height and velocity. Without a release, it starts from rest at the top of the range.

    Raises
    ------
    InputError
        If the bed has no free piston, no equilibrium or no oscillation; if the bed is mounted on a machine;
        if ``reach`` is not between 0 and the piston's height; if ``order`` is out of range; if the bed is
        unstable close to equilibrium; or if no polynomial fits mass, damping and force within 1 %.
    RecordError
        If ``against`` has fewer than two extremes.

    Examples
    --------
    >>> from granular import damper
    >>> from reduced_models import derive
    >>> model = derive(damper(count=48, drop=24.0), reach=1e-4)  # [m]
    >>> model.law.name, bool(abs(model.states[-1].force) > 0.0)
    ('derived', True)
    """
    opened = open_source(source) if isinstance(source, str | Path) else source
    if not isinstance(opened, Scene | Trajectory):
        raise InputError(f"a {type(opened).__name__} does not contain a bed; give a scene or a run")
    rest = equilibrium(opened)
    bed, piston = rest.pencil.bed, coordinate_index_of_free_piston(rest)
    if bed.machine is not None:
        raise InputError(
            "the bed is mounted on a machine, whose motion the law does not include; remove effects.host"
        )
    if reach is None:
        lifts = [abs(stage.by) for stage in rest.scene.protocol if isinstance(stage, Lift)]
        reach = lifts[-1] if lifts else REACH * bed.length
    height = float(rest.pencil.at[piston])
    if not 0.0 < reach < height:
        raise InputError(
            f"reach = {reach:g} m is outside the limits; give a number above 0 and below the "
            f"piston's height, {height:.4g} m"
        )
    if order is not None and not 1 <= order <= HIGHEST_ORDER:
        raise InputError(f"order = {order} is outside the limits; give an integer from 1 to {HIGHEST_ORDER}")
    root = piston_roots(rest)[0]
    count = max(FEWEST_STEPS, math.ceil(reach / (STEP * bed.length)))
    below, above = (
        held_states_and_first_instability(rest.pencil, piston, root.s, side * reach / count, count)
        for side in (-1.0, 1.0)
    )
    states = (*reversed(below[0]), held_state_of_root(rest.pencil, piston, root.s), *above[0])
    instabilities = tuple(end for _, end in (below, above) if end is not None)
    if len(states) < 3:
        raise InputError(
            f"the bed is unstable {1e3 * reach / count:.2g} mm from equilibrium; give a smaller reach"
        )
    small = {"height": height, "period": 1.0 / root.frequency, "damping_ratio": root.damping_ratio}
    law, values, accuracy = fit_polynomial_law_values_and_text(states, len(below[0]), order)
    model = DerivedModel(
        law=law,
        parameters=values,
        intervals=_zero_width_intervals(values),
        confidence=0.95,
        initial=(states[-1].height, 0.0),
        at_rest=AtRest(height, small["period"], small["damping_ratio"], _zero_width_intervals(small)),
        quality=Quality(0.0, 0.0, None, (), 0, 0, 0, 0.0),
        domain={"height": (states[0].height, states[-1].height)},
        notes=_derivation_notes(rest, root, instabilities),
        states=states,
        instabilities=instabilities,
    )
    record = _open_comparison_record(against)
    if isinstance(opened, Trajectory) and (release := _release_stage_name(opened)) is not None:
        model = dataclasses.replace(
            model, initial=_projected_start_height_and_velocity(opened, release, rest, root)
        )
        record = record or opened.piston(release)
    if record is not None:
        error = motion_error(model, record)
        quality = dataclasses.replace(
            model.quality, residual=error.rms, relative=error.relative, samples=error.samples
        )
        model = dataclasses.replace(model, error=error, quality=quality)
    low, high = (1e3 * end for end in model.domain["height"])
    ending = "" if instabilities else ", without an instability"
    lines = [
        f"derived from the scene {rest.scene.name}, without a fit to a motion",
        f"piston held at {len(states)} heights, from {low:.5g} to {high:.5g} mm{ending}",
        f"polynomials: {accuracy}; moving mass {states[len(below[0])].mass:.5g} kg",
        f"backbone: {_backbone_text(model)}",
    ]
    if model.error is not None:
        lines.append(
            f"against the run, {CYCLES} cycles from the second extreme: error "
            f"{format_percent(model.error.relative)} of the rms displacement, mean shift "
            f"{1e6 * model.error.mean_shift:.2g} um"
        )
    data = f"equilibria and roots of the scene {rest.scene.name}"
    return dataclasses.replace(model, provenance={"data": data, "record": "\n".join(lines)})


def _open_comparison_record(against: Trajectory | PistonRecord | str | Path | None) -> PistonRecord | None:
    opened = open_source(against) if isinstance(against, str | Path) else against
    if isinstance(opened, Scene):
        raise InputError(
            f"the scene {opened.name} is not simulated yet; simulate it and give the directory of the run"
        )
    return opened.piston() if isinstance(opened, Trajectory) else opened


def _release_stage_name(run: Trajectory) -> str | None:
    """Return the name of the stage after a run's last lift; None if there is none."""
    lifts = [stage.name for stage in run.scene.protocol if isinstance(stage, Lift)]
    names = [stage.name for stage in run.stages]
    behind = names[names.index(lifts[-1]) + 1 :] if lifts and lifts[-1] in names else []
    return behind[0] if behind else None


def _projected_start_height_and_velocity(
    run: Trajectory, stage: str, rest: Equilibrium, root: Root
) -> tuple[float, float]:
    """Project the state at a stage's start on the root's mode; return height [m] and velocity [m/s]."""
    bed, data, start = rest.pencil.bed, run.dataset, run.stage(stage).start
    piston = coordinate_index_of_free_piston(rest)
    frame = int(np.searchsorted(data["frame_time"].values, start + 1e-9, side="right")) - 1
    record = run.piston(stage)
    assert record.velocity is not None
    heights = piston_heights_in_frames(run.scene, data)[frame]
    heights[0] = record.height[0]
    away = bed.coordinates(data["position"].values[frame], heights) - rest.pencil.at
    if np.abs(away).max() > REARRANGED * bed.length:
        return float(record.height[0]), float(record.velocity[0])
    velocity = np.zeros(bed.size)
    velocity[: 2 * bed.grains] = data["velocity"].values[frame].T.ravel()
    velocity[piston] = record.velocity[0]
    part = modal_coordinate(rest.pencil, root, away, velocity)
    return float(rest.pencil.at[piston] + 2.0 * part.real), 2.0 * (part * root.s).real


def _zero_width_intervals(values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return intervals of zero width, for values without an error."""
    return {name: (value, value) for name, value in values.items()}


def _derivation_notes(rest: Equilibrium, root: Root, instabilities: Sequence[Instability]) -> tuple[str, ...]:
    notes = []
    if root.mass_fraction < 1.0 - MASS_FRACTION:
        part = f"{100.0 * root.mass_fraction:.2g} %"
        notes.append(
            f"the law describes {part} of the piston's small motions; the remainder is in other modes"
        )
    for end in instabilities:
        grains = f"{', '.join(map(str, end.grains[:NAMED]))}{' ...' * (len(end.grains) > NAMED)}"
        drops = abs(end.force_drop) > GRADUAL * rest.pencil.bed.weight
        how = f"and the force on the piston drops by {end.force_drop:.3g} N" if drops else "gradually"
        notes.append(
            f"the range ends at {1e3 * end.height:.5g} mm, where the bed's equilibrium becomes unstable: "
            f"grains {grains} rearrange, {how}"
        )
    if rest.pencil.bed.scene is not rest.scene:
        notes.append("the law does not include the scene's drive, heat and dry friction")
    return tuple(notes)


def _backbone_text(model: DerivedModel) -> str:
    assert model.at_rest is not None
    reach = min(abs(end - model.at_rest.height) for end in model.domain["height"])
    curve = model.backbone([fraction * reach for fraction in FRACTIONS])
    return "; ".join(
        f"{frequency / math.tau:.5g} Hz and {100.0 * ratio:.4g} % at {1e3 * amplitude:.3g} mm"
        for amplitude, frequency, ratio in zip(
            curve.amplitude, curve.frequency, curve.damping_ratio, strict=True
        )
    )
