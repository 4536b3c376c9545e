"""Conversion of a scene to natural units, its dimensionless groups, and rescaling of a damper.

Scaling lengths by s, times by s^(1/2), masses by s^2 and currents by s changes neither the acceleration of
gravity nor the magnetic constant, so all equations of a bed are unchanged. Let W be the width of the cell, N
the number of grains, m and m_g the magnetic moment and the mass of a grain, M the piston's mass, and gamma
the drag coefficient of a grain. By dimensional analysis, the rest height divided by W, the frequency f
sqrt(W/g) and the damping ratio zeta of a packing depend on N, kappa = mu0 m^2/(pi M g W^4), N m_g/M and gamma
sqrt(W/g)/M. A small zeta is proportional to the last group. The three quantities also depend on D/W through
the wall laws and, for discs of height h and rows of magnets, on h/D and the ratio of the rows' pitch to W.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from granular.effects.dipole import discs_unless_dipoles
from granular.effects.effect import Effect, EffectContext, ForceEffect
from granular.effects.pair_law import PairLawEffect, tail_charges_of_grains
from granular.effects.walls import sides_in_natural_units
from granular.kernel_data.state import BodyResistance, Constants, EffectLaws
from granular.methods import Method
from granular.pairs.direct_sum import pad_values
from granular.pairs.disc_law import DiscSeries, make_all_pairs_and_near_disc_laws
from granular.pairs.far_field import EXTRAPOLATION_STEPS, MAX_POINTS, SPACINGS, FarFieldSettings
from granular.pairs.grain_arrays import FAR, LOAD_FAR
from granular.pairs.near_law import NearLaw
from granular.pairs.pair_sum_settings import SPLIT_RADIUS
from granular.pairs.stripes import CutOffSettings
from granular.parts.magnets import LATTICE_SUM
from granular.scene.scene import Scene
from granular.schema.field_kinds import PointListKind, QuantityKind, QuantityListKind, TemperatureKind
from granular.schema.natural_units import Scales
from granular.schema.sections import find_field_value_and_kind
from granular.schema.units import unit_size
from granular.shared.array_types import Int
from granular.shared.errors import InputError

FAR_EVERY = 8
"""Number of steps between evaluations of the far field. With the automatic time step, these steps together
take 0.8/omega, where omega is the highest angular frequency. The fastest mode would resonate at
an interval of pi/omega, which is much longer (Biesiadecki and Skeel 1993, doi:10.1006/jcph.1993.1220)."""

HEADROOM = 1.5
"""Ratio of the mesh's height to the maximum height known before the run, above which the piston may rise."""

EXIT = -5.0
"""Grains below this height [D] have left through a gap; the force of wall slabs on them is below 1e-3 F*."""


@dataclasses.dataclass(frozen=True)
class SceneInNaturalUnits:
    """A scene in natural units."""

    scales: Scales
    constants: Constants
    species: Int[np.ndarray, "n"]
    effects: tuple[Effect, ...]
    downward_acceleration: float  # constant acceleration [F*/m]


def scene_in_natural_units(
    scene: Scene, *, threads: int = 1, method: Method | None = None
) -> SceneInNaturalUnits:
    """Convert a scene to the arguments of the compiled loop, in natural units."""
    scales = Scales.from_grains(scene.grains)
    species = scene.grains.species_indices()
    effects = scene.effects.in_loop_order
    indices = {effect.key: index for index, effect in enumerate(effects)}
    named = {effect.key: effect for effect in scene.effects.acting}
    context = EffectContext(scene.grains, scene.cell, scales, species, named, indices, scene.piston)
    laws = [effect for effect in effects if isinstance(effect, PairLawEffect)]
    tails = [tail for law in laws if (tail := law.dipole_tail_coefficients(context)) is not None]
    # Charge of each grain in the sum over all pairs, with tails of custom laws; None: its moment.
    charges = tail_charges_of_grains(tails, context, dipoles=scene.effects.dipole is not None)
    numbers = _relative_masses_and_moments(scene, species, charges)
    acting = _acting_laws(scene, context, numbers, charges, method)
    pulls = (effect.downward_acceleration(scales) for effect in effects if isinstance(effect, ForceEffect))
    gravity = sum(pulls)
    piston_mass, piston_weight, resistance = _piston_mass_weight_and_resistance(scene, scales, gravity)
    walls = scene.effects.walls
    constants = Constants(
        grains=len(species),
        **numbers._asdict(),
        piston_mass=piston_mass,
        piston_weight=piston_weight,
        resistance=resistance,
        exit=EXIT if walls is not None and walls.has_gap else -np.inf,
        acting=acting,
        threaded=None if threads == 1 else True,
    )
    return SceneInNaturalUnits(scales, constants, species, effects, gravity)


class _RelativeMassesAndMoments(NamedTuple):
    """Masses and moments of the grains in units of the first species' values; see `Constants`."""

    masses: np.ndarray | None
    moments: np.ndarray | None
    minimum_mass: float
    minimum_moment: float
    minimum_ratio: float

    @property
    def relative_moments(self) -> np.ndarray | None:
        """Return the moment of each grain relative to the first species; None if all are equal."""
        return self.masses if self.moments is None else self.moments


def _relative_masses_and_moments(
    scene: Scene, species: np.ndarray, charges: np.ndarray | None
) -> _RelativeMassesAndMoments:
    masses = scene.grains.mass_ratios()[species]
    moments = scene.grains.moment_ratios()[species] * scene.grains.moment_spread_factors()
    equal = bool((masses == moments).all())
    several = len(scene.grains.species) > 1 or not equal
    # At a given speed the distance of closest approach grows with q^2/m: the smallest value approaches
    # closest.
    meeting = moments if charges is None or scene.effects.dipole is not None else charges
    weakest = int(np.argmin(meeting * (meeting / masses))) if len(species) else None
    return _RelativeMassesAndMoments(
        masses=pad_values(masses) if several else None,
        moments=None if equal else pad_values(moments),
        minimum_mass=1.0 if weakest is None else float(masses[weakest]),
        minimum_moment=1.0 if weakest is None else float(meeting[weakest]),
        minimum_ratio=float((moments / masses).min(initial=1.0)) if not equal else 1.0,
    )


def _acting_laws(
    scene: Scene,
    context: EffectContext,
    numbers: _RelativeMassesAndMoments,
    charges: np.ndarray | None,
    method: Method | None,
) -> EffectLaws:
    grains, effects, scales = scene.grains, scene.effects.in_loop_order, context.scales
    weights = [result for effect in effects if (result := effect.normal_load_weights(context)) is not None]
    dipole = scene.effects.dipole
    if dipole is None:  # the tail of a custom law tilts no grain
        weights = [0.0 * weight for weight in weights]
    summed = scene.pair_method if dipole is not None or charges is not None else None
    discs = (
        None
        if dipole is None
        else _all_pairs_and_near_disc_laws(scene, context, numbers, loads=bool(weights))
    )
    far = _far_field_settings(scene, context, summed, method)
    if far is not None and discs is not None:
        fifth = discs[0].coefficients
        far = far._replace(inverse_fifth_factor=float(fifth[FAR]), load_fifth_factor=float(fifth[LOAD_FAR]))
    periods = context.periods
    shorter_side = None if periods is None else min(periods)
    radius = scene.pairs.near_pair_radius(summed, scales.length, shorter_side) if far is None else far.radius
    nearest = cut = None
    if summed == "direct" and periods is not None:
        assert radius is not None
        nearest = np.array([*periods, radius])
    elif radius is not None:
        several = len(grains.species) > 1 or grains.spread > 0.0 or charges is not None
        cut = CutOffSettings(radius, several, None if far is None else True, periods)
    listing = scene.pairs.verlet_list_settings(scales.length) if summed == "verlet-list" else None
    ends = radius if listing is None else listing.radius
    context = dataclasses.replace(context, cut_off=ends if far is None else None)
    laws = tuple(effect.make_kernel_law(context) for effect in effects)
    if discs is not None:
        _check_cut_off_covers_disc_correction(discs[1], scales, radius, periods)
    named = {effect.key: law for effect, law in zip(effects, laws, strict=True)}
    return EffectLaws(
        laws=laws,
        host=named.get("host"),
        dipole=None if summed is None else True,
        sides=named["walls"].sides
        if "walls" in named
        else sides_in_natural_units(None, context, scene.cell.lines),
        weight=weights[0] if weights else None,
        cut=cut,
        listing=listing,
        far=far,
        nearest=nearest,
        charges=numbers.relative_moments if charges is None else pad_values(charges),
        series=None if discs is None else discs[0].coefficients,
        shift=None if discs is None else discs[0].shift,
        near=None if discs is None else discs[1],
    )


def _all_pairs_and_near_disc_laws(
    scene: Scene, context: EffectContext, numbers: _RelativeMassesAndMoments, *, loads: bool
) -> tuple[DiscSeries, NearLaw] | None:
    """Return the law of discs as a part for all pairs and a correction for near pairs; None for dipoles."""
    discs, species = discs_unless_dipoles(scene.grains, context.scales.length), context.species
    if not discs:
        return None
    strength = numbers.minimum_moment**2 / numbers.minimum_mass
    return make_all_pairs_and_near_disc_laws(
        discs, species, numbers.relative_moments, strength, context.periods, loads=loads
    )


def _check_cut_off_covers_disc_correction(
    discs: NearLaw, scales: Scales, radius: float | None, periods: tuple[float, float] | None
) -> None:
    """Raise `InputError` if the cut-off is below the reach of the correction for discs."""
    limit = min([np.inf if radius is None else radius, *(0.5 * side for side in periods or ())])
    if limit < discs.reach:
        raise InputError(
            f"grains.magnets = 'cylinders': pairs are cut off at {limit * scales.length:.4g} m, but the "
            f"force of these discs requires {discs.reach * scales.length:.4g} m; use a longer "
            "pairs.cut_off, a larger cell, or 'dipoles'"
        )


def _far_field_settings(
    scene: Scene, context: EffectContext, summed: str | None, method: Method | None
) -> FarFieldSettings | None:
    """Return settings of the far field; None if the pair forces are not split into near and far parts."""
    if summed == "direct" and scene.cell.periods is None:
        every, rubbing = (
            _steps_between_far_field_impulses(scene, method),
            _far_field_extrapolation_steps_under_friction(scene, method),
        )
        if every is None and rubbing is None:
            return None
        return FarFieldSettings(SPLIT_RADIUS, None, every, rubbing)
    length, periods = context.scales.length, context.periods
    radius = scene.pairs.near_pair_radius(summed, length)
    if summed != "mesh" or radius is None:
        return None
    closed = scene.cell.width / length, HEADROOM * scene.greatest_height() / length
    width, height = periods or closed
    points = width * height * (SPACINGS / radius) ** 2
    if points > MAX_POINTS:
        raise InputError(
            f"pairs.method = 'mesh' needs {points:.3g} points for {width:.3g} x {height:.3g} D, but the "
            f"limit is {MAX_POINTS:g}; use 'direct', a smaller cell or a longer pairs.cut_off"
        )
    every, rubbing = (
        _steps_between_far_field_impulses(scene, method),
        _far_field_extrapolation_steps_under_friction(scene, method),
    )
    return FarFieldSettings(radius, (width, height), every, rubbing, periodic=periods is not None)


def _far_field_extrapolation_steps_under_friction(scene: Scene, method: Method | None) -> int | None:
    """Return the number of steps over which the far field is extrapolated during sliding, or None."""
    requested = scene.pairs.far_every
    if scene.effects.friction is None or requested == 1:
        return None
    if requested is None:
        if scene.pair_method == "direct":
            return None
        return EXTRAPOLATION_STEPS if method is not None and method.allows_far_field_impulses else 1
    return requested


def _steps_between_far_field_impulses(scene: Scene, method: Method | None) -> int | None:
    """Return the number of steps between impulses of the far field; None if each step includes it."""
    requested = scene.pairs.far_every
    rubs, hosted = scene.effects.friction is not None, scene.effects.host is not None
    able = method is not None and method.allows_far_field_impulses and (rubs or not hosted)
    if requested is not None and requested > 1 and method is not None and not able:
        reason, alternative = f"{method.name!r} does not support it", " or 'stormer-verlet'"
        if hosted and method.allows_far_field_impulses:
            reason, alternative = "a host needs the whole force on its cell at each step", ""
        raise InputError(f"pairs.far_every = {requested}: {reason}; remove it, or use 1{alternative}")
    if rubs or not able:
        return None
    if requested is None:
        return FAR_EVERY if scene.pair_method == "mesh" else None
    return requested if requested > 1 else None


def _piston_mass_weight_and_resistance(
    scene: Scene, scales: Scales, gravity: float
) -> tuple[float, float, BodyResistance | None]:
    """Return the piston's mass, weight and resistance; infinite mass and zero weight if it is not free."""
    piston, host, weight = scene.piston, scene.effects.host, None
    if piston is None or piston.mass is None:
        return np.inf, 0.0, None
    mass = piston.mass
    if host is not None:
        mass = host.moving_piston_mass(mass)
        weight = host.cell_weight_on_piston(scene.grains, scales, gravity)
    resistance = BodyResistance(piston.drag * scales.time / mass, piston.friction / scales.force)
    mass /= scales.mass
    return mass, mass * gravity if weight is None else weight, resistance if any(resistance) else None


LATTICE_PRESSURE = 0.1875 * LATTICE_SUM * 0.75**0.75
"""Pressure of a triangular lattice of dipoles with rho grains per area, divided by (F*/D) (rho D^2)^2.5:
1.6675. The pressure is 3/2 of the energy per area."""

_EXPONENTS = (1.0, 2.0, 0.5, 1.0)  # of length, mass, time and current


def dimensionless_groups(scene: Scene) -> dict[str, float]:
    """Return the dimensionless groups of a damper, by name; empty without gravity or a piston mass."""
    piston, gravity, effects = scene.piston, getattr(scene.effects, "gravity", None), scene.effects
    if piston is None or not piston.mass or gravity is None or not gravity.acceleration:
        return {}
    scales, width, mass = Scales.from_grains(scene.grains), scene.cell.width, piston.mass
    weight, drag_unit = mass * gravity.acceleration, mass * math.sqrt(gravity.acceleration / width)
    groups: dict[str, float] = {
        "N": scene.grains.count,
        "kappa": scales.force * (scales.length / width) ** 4 / weight,
        "N m/M": float(scene.grains.masses().sum()) / mass,
    }
    if effects.drag is not None:
        groups["gamma sqrt(W/g)/M"] = effects.drag.coefficient / drag_unit
    if piston.drag:
        groups["piston's gamma sqrt(W/g)/M"] = piston.drag / drag_unit
    groups["D/W"] = scales.length / width
    walls = () if effects.walls is None else effects.walls.sides_with_walls
    pitches = {wall.pitch for _, wall in walls if wall.pitch is not None}
    if pitches or scene.grains.magnets == "cylinders":
        thickness = float(scene.grains.species_values("thickness")[0])
        groups["h/D"] = thickness / scales.length
    if len(pitches) == 1:
        groups["pitch/W"] = pitches.pop() / width
    return groups


def dimensionless_groups_text(scene: Scene) -> str:
    """Return the dimensionless groups of a scene as one line of text, which may be empty."""
    return ", ".join(f"{name} {value:.4g}" for name, value in dimensionless_groups(scene).items())


def lattice_rest_height(count: int, width: float, kappa: float) -> float:
    """Rest height N W (1.6675 kappa)^0.4 of a triangular lattice of weightless dipoles [m]; width [m]."""
    return count * width * (LATTICE_PRESSURE * kappa) ** 0.4


def rescale_scene_to_width(scene: Scene, width: float) -> Scene:
    """Return the damper with another width [m] and equal dimensionless groups.

    Remanence, pressures and gravity are unchanged. Drag coefficients computed from a liquid are replaced by
    numbers.
    """
    parts: list[Any] = [*scene.effects.in_loop_order, *scene.protocol]
    if any(part.user_code_digests for part in parts):
        raise InputError(f"scene {scene.name!r} has custom parts, whose scaling is unknown; remove them")
    factor, drag, changes = width / scene.cell.width, scene.effects.drag, dict[str, Any]()
    if drag is not None and drag.viscosity is not None:
        changes["effects.drag"] = {"coefficient": drag.coefficient}
    if scene.piston is not None and scene.piston.has_parts:
        changes["piston.drag"] = scene.piston.drag
    scene = scene.replace(**changes)
    return Scene.from_plain(_scaled_plain_value(scene, "", scene.to_plain(), factor))


def _scaled_plain_value(scene: Scene, key: str, value: Any, factor: float) -> Any:
    """Return the plain value of a key after the lengths of a scene are multiplied by a factor."""
    if isinstance(value, dict):
        return {
            name: _scaled_plain_value(scene, f"{key}.{name}" if key else name, value[name], factor)
            for name in value
        }
    _, kind = (key and find_field_value_and_kind(scene, key)) or (None, None)
    if isinstance(kind, TemperatureKind):
        return value
    if isinstance(kind, QuantityListKind):
        kind = kind.element
    if isinstance(kind, QuantityKind | PointListKind) and not isinstance(value, str):
        powers = unit_size(kind.unit)[1]
        size = factor ** sum(a * b for a, b in zip(_EXPONENTS, powers, strict=True))
        return _multiply_plain_value(value, size)
    if isinstance(value, list):
        return [
            _scaled_plain_value(scene, f"{key}.{index}", item, factor) for index, item in enumerate(value)
        ]
    return value


def _multiply_plain_value(value: Any, size: float) -> Any:
    return (
        [_multiply_plain_value(item, size) for item in value]
        if isinstance(value, list | tuple)
        else value * size
    )
