"""The law of a fall from its scene alone, without a simulation.

A crystal of N equal dipoles, with moments normal to its plane, lies in a cell of width W below a piston of
mass M at height z. The crystal has the pressure p = 1.6674 (F*/D) rho^(5/2). Here rho = N D^2/(W z) is its
density, D the grain diameter and F* the force scale of the dipoles. The pressure is minus the derivative of
the hexagonal lattice sum with respect to the area. For a random mixture, the square of the mean moment
replaces the square of a grain's moment. The piston's weight M g = p W then gives the equilibrium height

    r = (N D^2/W) (1.6674 F* W/(D M g))^(2/5).

Discs at short distances repel more strongly than dipoles. The pressure of a lattice of discs gives the
equilibrium height. There the pressure grows as density^n with n > 5/2. The power of the law is therefore
larger by n - 5/2, and its modulus by the factor (n/2 - 1)/(1/4), the ratio of the shear moduli of the two
lattices.

Grains are less dense at walls: r is larger by a fraction that decreases as N^(-1/2). Grains that
follow the piston affinely have the velocity z' y/z at height y; all grains together have the drag of
N/3 grains at the piston's speed. With the drag coefficient gamma of a grain, lam = N gamma/(6 M).

The piston also moves a third of the grains' mass N m, and drag delays the bed. The bed acts as a column with
diffusion, whose stiffness relative to the static stiffness is f(s) = sqrt(s) coth sqrt(s) with s = i x and
x = omega N gamma r/(5/2 M g). To the next order, f = 1 + (s/3)/(1 + s/15). The imaginary part of f is the
affine drag. The real part grows with omega^2, as if a negative mass were added. The mass added to the piston,
relative to M, is

    mu = (N m/3 - k x^2/45/omega^2/(1 + (x/15)^2))/M,    k = 5/2 M g/r,

so that weight and lam hold for a piston of mass (1 + mu) M. A bed that rearranges lags more than
the column: x/15 and x^2/45 are multiplied by a factor LATE.

Shear modulus and strength are not derived from theory. A falling bed is not a perfect crystal either: a
weight 5 % above g and a power slightly below 5/2 fit falls better. Seven numbers were fitted to 120 falls by
least squares: modulus, strength, weight, power, LATE, and the constants BULK and WALLS for the lower density
at walls. The beds were like the packaged damper, with 276 and 552 grains (two packings each) and 1104 grains.
Pistons of 5, 7.5 and 10 kg fell from 17, 20, 24 and 28 D, masses and heights times sqrt(N/368), with drags of
0.1 and 0.2 kg/s.

A bed between rows of discs is softer: the power is smaller by 0.172, and the modulus is multiplied by 0.785
and the strength by 0.892. With these three numbers the rms error of the law for falls of discs is 1.0 to
2.1 % of the drop; without them it is 4.7 to 7.4 %. The numbers were fitted to five falls from 20 and 24 D
onto 276 and 368 grains, with pistons of 5 and 7.5 kg. For two other falls, one onto 552 grains and one from
18 D, the errors are 1.9 and 3.1 %. Rows of discs do not change the equilibrium height by more than its
spread of 1.5 % between beds.

The hexagonal lattice of a scene's grains under pressure, dipoles or discs, is computed by closed sums. By the
virial theorem, N grains of a lattice of density rho that repel with F(r) have the pressure
p = (rho/4) sum r F(r) over the lattice points. For dipoles r F ~ r^-3 and the sum is
`hexagonal_lattice_sum` with exponent 3: p = 1.6674 rho^2.5. For discs, the next term of r F at long distances
is 7.5 b r^-5 (with b from `granular.pairs.disc_law`), which also has a closed sum. The remainder of r F
decreases as r^-7 and is summed over points within `SHELLS` spacings. In a random mixture, r F is averaged
over the species, with their fractions as weights.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import warnings
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, quote
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.linearization import NoOscillationReason, small_oscillation
from reduced_models.models.at_rest import AtRest
from reduced_models.models.fitted_law import FittedLaw

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

    from granular.pairs.disc_law import Disc
    from granular.scene.scene import Scene
    from granular.schema.apparatus import Grains


__all__ = ["lattice_pressure"]

# Exponent of the density in the lattice's pressure for dipoles: a grain's energy scales as r^-3 ~ rho^(3/2),
# and the pressure is rho^2 times its derivative.
POWER = 2.5
PRESSURE = 1.6674
"""Pressure of the hexagonal lattice of dipoles [F*/D] at rho = 1: see the module docstring."""
SHELLS = 8.0
"""Number of shells of lattice points summed; the remainder is 1e-6 of the pressure."""
_LEAST = 1e-9
"""Pressure below which discs are far enough apart to act as dipoles [F*/D]."""
# The table extends down to e^-12 of the density of touching discs, at which discs act as dipoles.
_THINNEST = 3.5


class PressedLattice(NamedTuple):
    """Hexagonal lattice under pressure: its density rho, and the exponent n in pressure ~ rho^n."""

    density: float  # [1/D^2]
    power: float  # d ln p/d ln rho

    @property
    def relative_shear_modulus(self) -> float:
        """Ratio of shear modulus to pressure, divided by this ratio for dipoles."""
        # Central forces in an isotropic lattice: B = 2 mu + 2 p and B = power p, hence mu/p = power/2 - 1,
        # which is 1/4 for dipoles.
        return (self.power - 2.0) / (POWER - 2.0)


def lattice_under_pressure(grains: Grains, pressure: float) -> PressedLattice:
    """Compute the hexagonal lattice of grains (density in 1/D^2) in equilibrium with a pressure [F*/D]."""
    # The virial's lattice sum is solved for the density: for dipoles p = 1.6674 rho^(5/2) times the squared
    # mean moment, for discs by Brent's method.
    if grains.magnets == "dipoles" or pressure < _LEAST:
        moment = float(np.array(grains.species_fractions()) @ grains.moment_ratios())
        return PressedLattice((pressure / (PRESSURE * moment**2)) ** (1.0 / POWER), POWER)
    from scipy.optimize import brentq

    touching = touching_lattice_density(grains)
    logarithm = _log_pressure_spline(_discs_with_moment_fractions(grains), touching)
    greatest = math.exp(logarithm(0.0))
    if not pressure < greatest:
        raise InputError(
            f"the pressure of the piston is {pressure / greatest:.3g} times the pressure at which these "
            "discs touch; the law of a fall is known only for magnets that do not touch: use a smaller "
            "piston.mass or stronger magnets"
        )
    root = brentq(lambda x: logarithm(x) - math.log(pressure), 0.0, _THINNEST, xtol=1e-9)
    return PressedLattice(touching * math.exp(-(root**2)), -0.5 * float(logarithm(root, 1)) / root)


def touching_lattice_density(grains: Grains) -> float:
    """Density [1/D^2] of the hexagonal lattice in which grains of the mean diameter touch."""
    diameter = float(np.array(grains.species_fractions()) @ np.sqrt(grains.face_area_ratios()))
    return 1.0 / (math.sqrt(0.75) * diameter**2)


def lattice_pressure(grains: Grains, density: float) -> float:
    """Compute the pressure of the hexagonal lattice of grains, by a lattice sum.

    For dipoles it is 1.6674 (F*/D) rho^(5/2) times the square of their mean moment; for the derivation see
    "The laws, derived" in the documentation.

    Parameters
    ----------
    grains : Grains
        Dipoles or discs; a mixture is random.
    density : float
        Number of grains per area, rho [1/D^2].

    Returns
    -------
    float
        Pressure, force per length [F*/D].
    """
    if grains.magnets == "dipoles":
        moment = float(np.array(grains.species_fractions()) @ grains.moment_ratios())
        return PRESSURE * moment**2 * density**POWER
    return _lattice_pressure_of_discs(_discs_with_moment_fractions(grains), density)


def _discs_with_moment_fractions(grains: Grains) -> tuple[tuple[Disc, float], ...]:
    """Return a disc of each species, with the contribution of the species to the mean moment of a grain."""
    from granular.effects.dipole import discs_unless_dipoles

    weights = np.array(grains.species_fractions()) * grains.moment_ratios()
    return tuple(zip(discs_unless_dipoles(grains, grains.species[0].diameter), weights.tolist(), strict=True))


def _lattice_pressure_of_discs(discs: tuple[tuple[Disc, float], ...], density: float) -> float:
    from granular.observables.moduli import hexagonal_lattice_sum

    spacing = math.sqrt(2.0 / (math.sqrt(3.0) * density))
    third, fifth = hexagonal_lattice_sum(3.0) / spacing**3, hexagonal_lattice_sum(5.0) / spacing**5
    total = 0.0
    for (first, weight), (second, other) in itertools.product(discs, repeat=2):
        shift, rest = _disc_shift_and_short_range_sum(first, second, spacing)
        total += weight * other * (3.0 * third + 7.5 * shift * fifth + rest)
    return density / 16.0 * total


@functools.cache
def _log_pressure_spline(discs: tuple[tuple[Disc, float], ...], touching: float) -> CubicSpline:
    """Return a spline of ln(pressure) as a function of x, with density = touching * exp(-x^2)."""
    # The pressure is singular in the density at contact, but smooth in x.
    from scipy.interpolate import CubicSpline

    x = np.linspace(0.0, _THINNEST, 80)
    pressures = [_lattice_pressure_of_discs(discs, touching * math.exp(-value * value)) for value in x]
    return CubicSpline(x, np.log(pressures))


def _disc_shift_and_short_range_sum(first: Disc, second: Disc, spacing: float) -> tuple[float, float]:
    """Return the shift b of two discs, and the lattice sum of r F(r) - (3 r^-3 + 7.5 b r^-5)."""
    # Below contact the force is extrapolated linearly, as in a run.
    from granular.pairs.disc_law import (
        contact_distance,
        disc_energy_and_force,
        force_slope_at_contact,
        pair_squared_distance_shift,
    )

    r, counts = _lattice_distances_and_counts()
    r = spacing * r
    shift, contact = pair_squared_distance_shift(first, second), contact_distance(first, second)
    force = disc_energy_and_force(np.maximum(r, contact), first, second)[1]
    if r[0] < contact:
        force += np.minimum(r - contact, 0.0) * force_slope_at_contact(first, second)
    return shift, float(counts @ (r * force - 3.0 * r**-3 - 7.5 * shift * r**-5))


@functools.cache
def _lattice_distances_and_counts() -> tuple[np.ndarray, np.ndarray]:
    """Return distances of lattice points (spacing 1) from one point, and the number at each distance."""
    i, j = np.mgrid[-10:11, -10:11]
    squares = i * i + i * j + j * j
    distances, counts = np.unique(squares[(squares > 0) & (squares <= SHELLS**2)], return_counts=True)
    return np.sqrt(distances), counts.astype(float)


LAW = LAWS["elastoplastic-bed"]
RUBBING = dataclasses.replace(
    LAW,
    name="elastoplastic-bed with friction of the piston",
    equation=LAW.equation.replace("2*lam*z'", "2*lam*z' + friction*tanh(1000*z')"),
    positive=(*LAW.positive, "friction"),
    units={**LAW.units, "friction": "m/s^2"},
    resolution=4,
)
"""Law of a fall with dry friction of the piston; the friction is fully developed above a few mm/s."""
# Ratio of equilibrium heights of bed and lattice, BULK + WALLS/sqrt(N), from the falls in the docstring.
BULK, WALLS = 0.9567, 0.7838
WEIGHT, FALL_POWER, MODULUS, STRENGTH = 1.046, 2.355, 0.3655, 0.04085
"""Parameters of the law for falling beds: weight divided by g, power, modulus and strength."""
ROWS = (-0.172, 0.785, 0.892)
"""Change of the power, and factors of modulus and strength, for beds between rows of discs (see module)."""
# Ratio of the lag of a falling bed to the lag of a column, from the same falls; its grains rearrange.
LATE = 5.19
FEWEST = 250
"""Minimum number of grains for which the law was tested; for larger beds, modulus and strength do not depend
on the number."""
LATEST = 0.9
"""Maximum of LATE x/15 (see module) in comparisons with falls: drag 1 kg/s, 7.5 kg, 368 grains."""
_SHAPED = {"dipole", "walls", "gravity", "drag", "contact"}


class OutsideRangeWarning(UserWarning):
    """Warning that a law is used outside the range in which it was tested."""


class PredictedLaw(FittedLaw):
    """A law with parameters predicted from a scene; see `FittedLaw` for attributes and methods."""


def predict(scene: Scene) -> PredictedLaw:
    """Predict the law of a scene's fall from the scene alone, without a simulation or a fit.

    The law is ``elastoplastic-bed``: the pressure of a hexagonal lattice and a shear stress that yields.
    The pressure is proportional to height^(-2.5) for dipoles and depends more steeply on the height for
    discs. For the derivation see "The laws, derived" in the documentation.

    The law predicts effects of changed parts only approximately. For the packaged damper with frequency f,
    remanence B and piston mass M, the law gives d ln f/d ln B = -0.40 and d ln f/d ln M = +0.20. The settled
    bed has -0.23 and +0.11. Exact slopes need a settled bed:
    ``granular.linear.slopes(granular.equilibrium(scene))``.

    Motions from other heights are given by ``predict(scene).simulate(times, z0=0.15, v0=0.0)``.

    Parameters
    ----------
    scene : Scene
        Scene of a bed below a falling piston.

    Returns
    -------
    PredictedLaw
        Law with its parameters (``lam`` [1/s], ``weight`` [m/s^2], ``rest`` [m]; ``power``,
        ``modulus`` and ``strength`` without unit), the initial height [m] at rest, and the small
        oscillations, ``at_rest`` (None without oscillations, for example if overdamped). With friction
        of the piston the law has one more parameter, ``friction`` [m/s^2], and no small oscillations.

    Raises
    ------
    InputError
        If the scene has no piston with a mass under gravity, or no dipoles or discs; if it has effects
        other than dipoles or discs, walls, gravity, drag and contact; if a side is open, has a gap or a
        custom law; if a cut-off omits pairs; or if the piston presses discs into contact at equilibrium.

    Warns
    -----
    OutsideRangeWarning
        With fewer than 250 grains, rows of discs that do not touch, or a drag per piston mass above the
        range compared with falls: the law is then an extrapolation.

    Examples
    --------
    >>> from granular import damper
    >>> from reduced_models import predict
    >>> law = predict(damper())  # nothing is run or fitted
    >>> round(law.at_rest.height, 4), round(law.at_rest.damping_ratio, 3)  # [m]
    (0.0587, 0.037)
    """
    piston, law, at_rest = scene.piston, LAW, None
    friction = 0.0 if piston is None or piston.mass is None else piston.friction
    smooth = scene.replace(**{"piston.friction": 0.0}) if friction else scene
    values = predict_bed_parameters(smooth, refuse_outside_range=False)
    assert piston is not None
    if friction:  # a piston with static friction has no small oscillations
        law, values["friction"] = RUBBING, friction / predicted_moving_mass(scene, values)
    else:
        swing = small_oscillation(LAW, [values[name] for name in LAW.parameters], values["rest"])
        if not isinstance(swing, NoOscillationReason):
            at_rest = AtRest(swing.z, swing.period, swing.damping_ratio, {})
    provenance = {"from": f"the scene {scene.name}"}
    return PredictedLaw(law, values, (piston.height, 0.0), at_rest, provenance=provenance)


def predicted_moving_mass(scene: Scene, values: Mapping[str, float]) -> float:
    """Return the moving mass [kg] of a predicted law, the ratio of force to acceleration."""
    mass, gravity = piston_mass_and_gravity(scene)
    return WEIGHT * mass * gravity / values["weight"]


def piston_mass_and_gravity(scene: Scene) -> tuple[float, float]:
    """Return the mass of a falling piston [kg], and the gravitational acceleration [m/s^2]."""
    piston, gravity = scene.piston, scene.effects.gravity
    assert piston is not None
    assert piston.mass is not None
    assert gravity is not None
    return piston.mass, gravity.acceleration


def affine_drag_coefficient(scene: Scene) -> float:
    """Return the drag coefficient [kg/s] of the piston and of the grains that follow it affinely."""
    grains, drag, piston = scene.grains, scene.effects.drag, scene.piston
    faces = float(grains.face_area_ratios()[grains.species_indices()].sum())
    own = 0.0 if piston is None else piston.drag
    return (0.0 if drag is None else drag.coefficient) * faces / 3.0 + own


def predict_bed_parameters(scene: Scene, *, refuse_outside_range: bool = True) -> dict[str, float]:
    """Predict lam [1/s], weight [m/s^2], rest [m], power, modulus and strength of ``elastoplastic-bed``."""
    # Derived in the module docstring; the numbers for walls, lag and bed were fitted to 120 simulated falls.
    piston, grains = scene.piston, scene.grains
    effects = scene.effects
    gravity = effects.gravity.acceleration if effects.gravity is not None else 0.0
    if piston is None or piston.mass is None or not gravity > 0.0:
        raise InputError(
            f"the scene {quote(scene.name)} has no piston with a mass under gravity, so nothing "
            "falls; set piston.mass and effects.gravity"
        )
    others = sorted({effect.key for effect in effects.acting} - _SHAPED)
    if others or piston.friction or effects.dipole is None:
        obstacles = ", ".join(others) or "friction of the piston, or no dipoles"
        raise InputError(
            f"the scene {quote(scene.name)} has {obstacles}, but the law of a fall is known only for dipoles "
            "or discs, walls, gravity, drag and contact; fit a law to a simulated fall or, for the effect of "
            "friction, use the command modes"
        )
    if unknown := ", ".join(_keys_excluded_by_law(scene)):
        raise InputError(
            f"the scene {quote(scene.name)} has {unknown}, but the law of a fall is known only for cells "
            "with four walls, the package's wall laws and repulsion of all pairs: simulate the scene instead"
        )
    scales, width = Scales.from_grains(grains), scene.cell.width
    drag = 0.0 if effects.drag is None else effects.drag.coefficient
    weight = piston.mass * gravity
    lattice = lattice_under_piston_weight(scene)
    packed = grains.count * scales.length**2 / (width * lattice.density)
    rest = (BULK + WALLS / math.sqrt(grains.count)) ** (POWER / lattice.power) * packed
    resistance = grains.count * float(np.array(grains.species_fractions()) @ grains.face_area_ratios()) * drag
    inertia = float(grains.masses().sum()) / 3.0
    softer, *factors = ROWS if has_walls_of_touching_discs(scene) else (0.0, 1.0, 1.0)
    modulus = factors[0] * MODULUS * lattice.relative_shear_modulus
    stiffness = lattice.power * weight / rest
    # LATE x/15 must be small: otherwise the negative mass of small oscillations does not apply to a fall.
    late = LATE / 15.0 * resistance / stiffness * math.sqrt((lattice.power + modulus) * gravity / rest)
    missing = LATE * resistance**2 / (45.0 * stiffness * (1.0 + late**2))
    outside = _outside_range_text(scene, late)
    if outside and refuse_outside_range:
        raise InputError(f"{outside}, or fit the law to a simulated fall")
    if outside:
        words = f"{outside}, or simulate the scene"
        warnings.warn(words, OutsideRangeWarning, stacklevel=3)
    moved = piston.mass + inertia - missing
    return {
        "lam": max((resistance / 3.0 + piston.drag) / (2.0 * moved), 1e-6),  # lam must be above 0
        "weight": WEIGHT * weight / moved,
        "rest": rest,
        "power": FALL_POWER + lattice.power - POWER + softer,
        "modulus": modulus,
        "strength": factors[1] * STRENGTH,
    }


def _keys_excluded_by_law(scene: Scene) -> Iterator[str]:
    """Yield keys with values that the law does not cover: missing or custom walls, omitted pairs."""
    if scene.cell.is_polygon:
        yield "cell.sides, and no cell.width"
    walls = scene.effects.walls
    for line in scene.cell.lines:
        key, wall = f"effects.walls.{line.name}", None if walls is None else walls.wall_of(line.name)
        if wall is None:
            yield f"{key} = 'none'"
        elif wall.own is not None:
            yield f"{key}.law = {wall.law!r}"
        elif wall.has_gap:
            yield f"{key}.gap_start = {wall.gap_start:g} m"
    if scene.pair_method in ("cut-off", "verlet-list"):
        yield f"pairs.method = {scene.pair_method!r}"


def lattice_under_piston_weight(scene: Scene) -> PressedLattice:
    """Return the lattice of a scene's grains in equilibrium with the weight of its piston."""
    weight, scales = math.prod(piston_mass_and_gravity(scene)), Scales.from_grains(scene.grains)
    return lattice_under_pressure(scene.grains, weight * scales.length / (scales.force * scene.cell.width))


def has_walls_of_touching_discs(scene: Scene) -> bool:
    """Return whether grains are discs between rows of discs that touch."""
    walls, touching = scene.effects.walls, 1.01 * scene.grains.species[0].diameter
    return (
        scene.grains.magnets == "cylinders"
        and walls is not None
        and all(wall.law == "discs" and (wall.pitch or 0.0) < touching for _, wall in walls.sides_with_walls)
    )


def _outside_range_text(scene: Scene, late: float) -> str:
    """Return the reason why a scene's fall is outside the tested range of the law; empty if it is inside."""
    if scene.grains.count < FEWEST:
        return (
            f"the bed has {scene.grains.count} grains, but the law was tested only for {FEWEST} and more: "
            "give more grains.count"
        )
    walls = () if scene.effects.walls is None else scene.effects.walls.sides_with_walls
    if any(side.law == "discs" for _, side in walls) and not has_walls_of_touching_discs(scene):
        return (
            f"the walls of {quote(scene.name)} are rows of discs, but the law was tested only for rows of "
            "touching discs on all sides of a bed of discs: give another law for effects.walls"
        )
    if late > LATEST:
        return (
            f"the bed of {quote(scene.name)} lags too far behind its piston: the drag of all grains, "
            f"relative to the piston's weight, is {late / LATEST:.3g} times the limit (1 kg/s for each "
            "of 368 grains under 7.5 kg); reduce effects.drag.coefficient or increase piston.mass"
        )
    return ""


class ValidShakingRange(NamedTuple):
    """Range in which ``annealing-bed`` may replace a shaken bed, and its errors there."""

    # For the packaged damper, settled after a fall, then pushed by F sin(2 pi f t) for six cycles or two
    # seconds, whichever is longer; the response is half the range of the last three cycles. At 3 D the law
    # gives 0.94 to 1.16 of it for 368 grains, but for 736 grains 0.79 at 5 Hz and 0.60 at 8 Hz, so the range
    # ends at 1.5 D.

    amplitudes: tuple[float, float]  # amplitudes of the piston about equilibrium [m]
    frequencies: tuple[float, float]  # [Hz]
    response_error: float  # maximum relative error of a driven piston's amplitude
    loss_error: float  # maximum relative error of the work per cycle of a sinusoidal stroke


AMPLITUDES, FREQUENCIES = (0.5, 1.5), (1.0, 8.0)
"""Amplitudes [D] for 368 grains, and frequencies [Hz], at which the law may replace the bed."""
RESPONSE_ERROR = 0.13
"""Maximum relative error of a driven piston's response (tests/reduced_models/falls/test_both_worlds.py)."""
LOSS_ERROR = 0.13
"""Maximum relative error of the energy loss in sinusoidal strokes of 0.5 to 3 D, for 368 and 736 grains."""


def valid_shaking_range(scene: Scene) -> ValidShakingRange:
    """Return the range in which ``annealing-bed`` may replace the bed of a scene.

    The range is 1 to 8 Hz in frequency and 0.5 to 1.5 D sqrt(N/368) in amplitude. Here D is the diameter of
    the first species, and N the number of grains. Smaller amplitudes were not tested. The bounds come from
    simulated responses of the packaged damper with 368 grains: see `ValidShakingRange`.

    Parameters
    ----------
    scene : Scene
        Scene of a bed below a falling piston.

    Returns
    -------
    ValidShakingRange
        Bounds of frequency [Hz] and amplitude [m], and the maximum relative errors of response and
        loss within them.

    Raises
    ------
    InputError
        If the scene has no piston with a mass under gravity, or no dipoles or discs; if the piston has
        friction or presses discs into contact; if there are effects other than dipoles or discs,
        walls, gravity, drag and contact, or walls or a cut-off that `predict` refuses; if there are
        fewer than 250 grains, or rows of discs that do not touch; or if the drag per piston mass is
        above the range compared with falls.
    """
    predict_bed_parameters(scene)  # raises an error outside the tested range
    grains = scene.grains
    unit = math.sqrt(grains.count / 368) * grains.species[0].diameter
    least, greatest = AMPLITUDES
    return ValidShakingRange((least * unit, greatest * unit), FREQUENCIES, RESPONSE_ERROR, LOSS_ERROR)
