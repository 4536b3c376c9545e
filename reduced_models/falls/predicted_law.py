"""The law of a fall from its scene alone, before anything has fallen.

A crystal of N equal dipoles with their moments normal to it, in a cell of width W below a piston at
the height z, has the pressure p = 1.6674 (F*/D) rho^(5/2), rho = N D^2/(W z) (lattice sum of the
hexagonal crystal, minus its derivative by the area; a mixture at random has the square of its mean
moment in place of that of one grain). The piston's weight M g = p W then gives the height of rest

    r = (N D^2/W) (1.6674 F* W/(D M g))^(2/5).

Discs repel more where they are near: the pressure of their lattice (`lattice`) gives their height
of rest, and grows there with a power n of the density above 5/2. The law's power is greater by
n - 5/2 then, and its modulus in the ratio of the shear moduli of both lattices, (n/2 - 1)/(1/4).

Walls hold the grains next to them less densely: r is greater by a fraction that falls with
N^(-1/2). Grains that follow the piston affinely have the velocity z' y/z at the height y; their
drag is that of a third of them at the piston's speed, so lam = N gamma/(6 M).

The piston also moves part of their mass, N m/3, and against drag a bed follows late: it is a column
that diffuses, with the stiffness f(s) = sqrt(s) coth sqrt(s) over that at rest, s = i x, x = omega
N gamma r/(5/2 M g). To the next order f = 1 + (s/3)/(1 + s/15): affine drag, and a stiffness that
grows with omega^2 as if mass were missing,

    mu = (N m/3 - k x^2/45/omega^2/(1 + (x/15)^2))/M,    k = 5/2 M g/r,

so that weight and lam are those of a piston of the mass (1 + mu) M. A bed that rearranges follows
later than a column does: x/15 and x^2/45 grow by a factor LATE.

Shear modulus and strength have no theory here. A bed that falls is no perfect crystal either: a
weight 5 % above g and a power somewhat below 5/2 follow falls better. These four numbers, LATE and
the two of the walls' share were fitted together, by least squares, to 120 falls of beds of 276, 552
(two starts each) and 1104 grains of the packaged damper's kind: pistons of 5, 7.5 and 10 kg, drags
of 0.1 and 0.2 kg/s, heights of 17, 20, 24 and 28 D (masses and heights times sqrt(N/368)).

Between rows of discs a bed is softer: with the power less by 0.172, the modulus 0.785 and the strength 0.892
times as large the law follows falls of discs to 1.0 to 2.1 % of the drop (rms), without to 4.7 to
7.4 %. These three were fitted to five falls from 20 and 24 D, of 276 and 368 grains under 5 and
7.5 kg; two others, of 552 grains and from 18 D, are followed to 1.9 and 3.1 %. The height at rest,
which scatters by 1.5 % from bed to bed, is the same within that.

The hexagonal lattice of a scene's grains under pressure, dipoles or discs, by closed sums.

N grains of a lattice of the density rho that repel with F(r) have, by the virial, the pressure
p = (rho/4) sum r F(r) over the places of the lattice. For dipoles r F ~ r^-3 and the sum is
`hexagonal_lattice_sum` of 3: p = 1.6674 rho^2.5. Discs have b r^-5 more far away (`granular.pairs.disc_law`),
again a closed sum, and what is left falls with r^-7: it is added over the places within `SHELLS`
spacings. A mixture is taken at random: each place holds each species by its fraction.
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
from reduced_models.laws.linearization import NoOscillation, small_oscillation
from reduced_models.models.at_rest import AtRest
from reduced_models.models.fitted_law import FittedLaw

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

    from granular.pairs.disc_law import Disc
    from granular.scene.scene import Scene
    from granular.schema.apparatus import Grains


__all__ = ["lattice_pressure"]

# Of the lattice's pressure, by the density, for dipoles: a grain's energy goes with r^-3 ~ rho^(3/2), and the
# pressure is rho^2 times its derivative.
POWER = 2.5
PRESSURE = 1.6674
"""Pressure of the hexagonal lattice of dipoles [F*/D] at rho = 1: see the module's first lines."""
SHELLS = 8.0
"""The rest beyond is 1e-6 of the pressure."""
_LEAST = 1e-9
"""Pressure below which discs are so far apart that they are dipoles [F*/D]."""
# Root of the logarithm of the density of touching discs over the thinnest in the table, e^-12 of it: dipoles.
_THINNEST = 3.5


class PressedLattice(NamedTuple):
    """A lattice under a pressure."""

    density: float  # [1/D^2]
    power: float  # d ln p/d ln rho

    @property
    def relative_shear_modulus(self) -> float:
        """Shear modulus over that of dipoles, both over the pressure, without unit."""
        # Central forces have B = 2 mu + 2 p in an isotropic lattice, and B = power p: mu/p = power/2 - 1, 1/4
        # for dipoles.
        return (self.power - 2.0) / (POWER - 2.0)


def lattice_under_pressure(grains: Grains, pressure: float) -> PressedLattice:
    """Compute the hexagonal lattice of grains that a pressure holds [1/D^2]; pressure [F*/D]."""
    # The virial's lattice sum solved for the density: p = 1.6674 rho^(5/2) times the squared mean moment for
    # dipoles, by Brent's method for discs.
    if grains.magnets == "dipoles" or pressure < _LEAST:
        moment = float(np.array(grains.species_fractions()) @ grains.moment_ratios())
        return PressedLattice((pressure / (PRESSURE * moment**2)) ** (1.0 / POWER), POWER)
    from scipy.optimize import brentq

    touching = touching_lattice_density(grains)
    logarithm = _tabulated_pressure(_discs_with_moment_fractions(grains), touching)
    greatest = math.exp(logarithm(0.0))
    if not pressure < greatest:
        raise InputError(
            f"the piston presses with {pressure / greatest:.3g} times what lets these discs touch; the "
            "law of a fall is known for magnets that repel: give less piston.mass, or stronger ones"
        )
    root = brentq(lambda x: logarithm(x) - math.log(pressure), 0.0, _THINNEST, xtol=1e-9)
    return PressedLattice(touching * math.exp(-(root**2)), -0.5 * float(logarithm(root, 1)) / root)


def touching_lattice_density(grains: Grains) -> float:
    """Density of the hexagonal lattice in which grains of the mean diameter touch [1/D^2]."""
    diameter = float(np.array(grains.species_fractions()) @ np.sqrt(grains.face_area_ratios()))
    return 1.0 / (math.sqrt(0.75) * diameter**2)


def lattice_pressure(grains: Grains, density: float) -> float:
    """Compute the pressure of the hexagonal lattice of grains, by a lattice sum.

    That of dipoles is 1.6674 (F*/D) rho^(5/2) times the square of their mean moment; its derivation
    is "The laws, derived" in the documentation.

    Parameters
    ----------
    grains : Grains
        Dipoles or discs; a mixture at random.
    density : float
        Number of grains an area, rho [1/D^2].

    Returns
    -------
    float
        Pressure, a force a length [F*/D].
    """
    if grains.magnets == "dipoles":
        moment = float(np.array(grains.species_fractions()) @ grains.moment_ratios())
        return PRESSURE * moment**2 * density**POWER
    return _disc_pressure(_discs_with_moment_fractions(grains), density)


def _discs_with_moment_fractions(grains: Grains) -> tuple[tuple[Disc, float], ...]:
    """Discs of each species, and what its moments have of a grain's mean moment."""
    from granular.effects.dipole import discs_unless_dipoles

    weights = np.array(grains.species_fractions()) * grains.moment_ratios()
    return tuple(zip(discs_unless_dipoles(grains, grains.species[0].diameter), weights.tolist(), strict=True))


def _disc_pressure(discs: tuple[tuple[Disc, float], ...], density: float) -> float:
    from granular.observables.moduli import hexagonal_lattice_sum

    spacing = math.sqrt(2.0 / (math.sqrt(3.0) * density))
    third, fifth = hexagonal_lattice_sum(3.0) / spacing**3, hexagonal_lattice_sum(5.0) / spacing**5
    total = 0.0
    for (first, weight), (second, other) in itertools.product(discs, repeat=2):
        shift, rest = _short_range_sum(first, second, spacing)
        total += weight * other * (3.0 * third + 7.5 * shift * fifth + rest)
    return density / 16.0 * total


@functools.cache
def _tabulated_pressure(discs: tuple[tuple[Disc, float], ...], touching: float) -> CubicSpline:
    """Logarithm of the pressure at the density touching exp(-x^2), by x."""
    # By x the pressure is smooth up to contact, where it is singular in the density.
    from scipy.interpolate import CubicSpline

    x = np.linspace(0.0, _THINNEST, 80)
    pressures = [_disc_pressure(discs, touching * math.exp(-value * value)) for value in x]
    return CubicSpline(x, np.log(pressures))


def _short_range_sum(first: Disc, second: Disc, spacing: float) -> tuple[float, float]:
    """Shift b of two discs, and the sum of r F(r) less 3 r^-3 + 7.5 b r^-5, over that scale of dipoles."""
    # Below contact the force continues with its slope, as in a run.
    from granular.pairs.disc_law import (
        contact_distance,
        disc_energy_and_force,
        force_slope_at_contact,
        pair_squared_distance_shift,
    )

    r, counts = _lattice_distances()
    r = spacing * r
    shift, contact = pair_squared_distance_shift(first, second), contact_distance(first, second)
    force = disc_energy_and_force(np.maximum(r, contact), first, second)[1]
    if r[0] < contact:
        force += np.minimum(r - contact, 0.0) * force_slope_at_contact(first, second)
    return shift, float(counts @ (r * force - 3.0 * r**-3 - 7.5 * shift * r**-5))


@functools.cache
def _lattice_distances() -> tuple[np.ndarray, np.ndarray]:
    """Distances of the points of a lattice of spacing 1 from one of them, and the number at each."""
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
"""Friction of the piston, over the mass that moves, is full from some mm/s on."""
# Height of rest over that of the lattice, BULK + WALLS/sqrt(N), by the falls of the module's first lines.
BULK, WALLS = 0.9567, 0.7838
WEIGHT, FALL_POWER, MODULUS, STRENGTH = 1.046, 2.355, 0.3655, 0.04085
"""Weight over g, and the law's other numbers, of beds that fall."""
ROWS = (-0.172, 0.785, 0.892)
"""Change of the power, and factors of modulus and strength, between rows of discs (first lines)."""
# Factor by which a bed that falls follows later than a column, by the same falls: grains rearrange.
LATE = 5.19
FEWEST = 250
"""Grains from which on modulus and strength are alike from bed to bed."""
LATEST = 0.9
"""Greatest LATE x/15 that was compared with falls: 1 kg/s of drag with 7.5 kg on 368 grains."""
_SHAPED = {"dipole", "walls", "gravity", "drag", "contact"}


class OutsideRangeWarning(UserWarning):
    """A law is used where nothing was measured."""


class PredictedLaw(FittedLaw):
    """A law whose numbers follow from a scene; `FittedLaw` tells of attributes and methods."""


def predict(scene: Scene) -> PredictedLaw:
    """Predict the law of a scene's fall from the scene alone: nothing is run, and nothing fitted.

    The law is ``elastoplastic-bed``: the pressure of a triangular lattice, which goes as the height
    to the power -2.5 for dipoles and grows faster for discs, and a shear stress that yields; its
    derivation is "The laws, derived" in the documentation.

    The law knows only roughly what a change of a part does: of the packaged damper it has
    d ln f/d ln B = -0.40 and d ln f/d ln M = +0.20, the settled bed -0.23 and +0.11 (B remanence, M mass).
    Exact slopes need a settled bed: ``granular.linear.slopes(granular.equilibrium(scene))``.

    Its motions from other heights: ``predict(scene).simulate(times, z0=0.15, v0=0.0)``.

    Parameters
    ----------
    scene : Scene
        Scene of a bed below a falling piston.

    Returns
    -------
    PredictedLaw
        Law with its parameters (``lam`` [1/s], ``weight`` [m/s^2], ``rest`` [m]; ``power``,
        ``modulus`` and ``strength`` without unit), the initial height [m] at rest, and the small
        swing, ``at_rest``: None where there is none, as with overdamping. With friction of the
        piston the law has one more parameter, ``friction`` [m/s^2], and no small swing.

    Raises
    ------
    InputError
        If the scene has no piston with a mass under gravity, no dipoles or discs, or effects other
        than dipoles or discs, walls, gravity, drag and contact; if a side is open, has a gap or
        has a law of one's own; if a cut-off leaves pairs out; or if its piston presses discs
        together at rest.

    Warns
    -----
    OutsideRangeWarning
        With fewer than 250 grains, rows of discs that do not touch, or more drag over the piston's
        mass than was compared with falls: the law is what is expected there.

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
    if friction:  # a piston that sticks has no small swing
        law, values["friction"] = RUBBING, friction / accelerated_mass(scene, values)
    else:
        swing = small_oscillation(LAW, [values[name] for name in LAW.parameters], values["rest"])
        if not isinstance(swing, NoOscillation):
            at_rest = AtRest(swing.z, swing.period, swing.damping_ratio, {})
    provenance = {"from": f"the scene {scene.name}"}
    return PredictedLaw(law, values, (piston.height, 0.0), at_rest, provenance=provenance)


def accelerated_mass(scene: Scene, values: Mapping[str, float]) -> float:
    """Mass that the accelerations of a predicted law belong to [kg]."""
    mass, gravity = mass_and_gravity(scene)
    return WEIGHT * mass * gravity / values["weight"]


def mass_and_gravity(scene: Scene) -> tuple[float, float]:
    """Mass of a piston that falls [kg], and the acceleration by gravity [m/s^2]."""
    piston, gravity = scene.piston, scene.effects.gravity
    assert piston is not None
    assert piston.mass is not None
    assert gravity is not None
    return piston.mass, gravity.acceleration


def affine_drag(scene: Scene) -> float:
    """Drag of the piston and of grains that follow it affinely, over its velocity [kg/s]."""
    grains, drag, piston = scene.grains, scene.effects.drag, scene.piston
    faces = float(grains.face_area_ratios()[grains.species_indices()].sum())
    own = 0.0 if piston is None else piston.drag
    return (0.0 if drag is None else drag.coefficient) * faces / 3.0 + own


def predict_bed_parameters(scene: Scene, *, refuse_outside_range: bool = True) -> dict[str, float]:
    """Predict lam [1/s], weight [m/s^2], rest [m], power, modulus and strength of ``elastoplastic-bed``."""
    # Derived in the module's first lines; walls, lateness and the bed's numbers were fitted to 120 simulated
    # falls.
    piston, grains = scene.piston, scene.grains
    effects = scene.effects
    gravity = effects.gravity.acceleration if effects.gravity is not None else 0.0
    if piston is None or piston.mass is None or not gravity > 0.0:
        raise InputError(
            f"the scene {quote(scene.name)} has no piston with a mass under gravity, so nothing "
            "falls; give it piston.mass and effects.gravity"
        )
    others = sorted({effect.key for effect in effects.acting} - _SHAPED)
    if others or piston.friction or effects.dipole is None:
        what = ", ".join(others) or "friction of the piston, or no dipoles"
        raise InputError(
            f"the scene {quote(scene.name)} has {what}; the law of a fall is known for dipoles or discs, "
            "walls, gravity, drag and contact: fit it to a fall instead (friction: the command modes)"
        )
    if unknown := ", ".join(_unknown_keys(scene)):
        raise InputError(
            f"the scene {quote(scene.name)} has {unknown}; the law of a fall is known where four walls of "
            "the package's laws hold the grains and all pairs repel: simulate the scene instead"
        )
    scales, width = Scales.from_grains(grains), scene.cell.width
    drag = 0.0 if effects.drag is None else effects.drag.coefficient
    weight = piston.mass * gravity
    lattice = lattice_at_rest(scene)
    packed = grains.count * scales.length**2 / (width * lattice.density)
    rest = (BULK + WALLS / math.sqrt(grains.count)) ** (POWER / lattice.power) * packed
    resistance = grains.count * float(np.array(grains.species_fractions()) @ grains.face_area_ratios()) * drag
    inertia = float(grains.masses().sum()) / 3.0
    softer, *factors = ROWS if has_rows(scene) else (0.0, 1.0, 1.0)
    modulus = factors[0] * MODULUS * lattice.relative_shear_modulus
    stiffness = lattice.power * weight / rest
    # LATE x/15: if it is not small, the missing mass of a small motion is not a fall's.
    late = LATE / 15.0 * resistance / stiffness * math.sqrt((lattice.power + modulus) * gravity / rest)
    missing = LATE * resistance**2 / (45.0 * stiffness * (1.0 + late**2))
    outside = _outside_range_text(scene, late)
    if outside and refuse_outside_range:
        raise InputError(f"{outside}, or fit the law to a fall instead")
    if outside:
        words = f"{outside}; what the law says there was compared with nothing: simulate the scene"
        warnings.warn(words, OutsideRangeWarning, stacklevel=3)
    moved = piston.mass + inertia - missing
    return {
        "lam": max((resistance / 3.0 + piston.drag) / (2.0 * moved), 1e-6),  # it has none below
        "weight": WEIGHT * weight / moved,
        "rest": rest,
        "power": FALL_POWER + lattice.power - POWER + softer,
        "modulus": modulus,
        "strength": factors[1] * STRENGTH,
    }


def _unknown_keys(scene: Scene) -> Iterator[str]:
    """Yield keys, with their values, by which a bed leaves its cell or its pairs do not carry the piston."""
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


def lattice_at_rest(scene: Scene) -> PressedLattice:
    """Lattice of a scene's grains under the weight of its piston."""
    weight, scales = math.prod(mass_and_gravity(scene)), Scales.from_grains(scene.grains)
    return lattice_under_pressure(scene.grains, weight * scales.length / (scales.force * scene.cell.width))


def has_rows(scene: Scene) -> bool:
    """Return whether grains are discs between rows of discs that touch."""
    walls, touching = scene.effects.walls, 1.01 * scene.grains.species[0].diameter
    return (
        scene.grains.magnets == "cylinders"
        and walls is not None
        and all(wall.law == "discs" and (wall.pitch or 0.0) < touching for _, wall in walls.present_walls)
    )


def _outside_range_text(scene: Scene, late: float) -> str:
    """Why the law was not compared with such a fall; empty where it was."""
    if scene.grains.count < FEWEST:
        return (
            f"{scene.grains.count} grains; what is known of the law holds from {FEWEST} on: give "
            "more grains.count"
        )
    walls = () if scene.effects.walls is None else scene.effects.walls.present_walls
    if any(side.law == "discs" for _, side in walls) and not has_rows(scene):
        return (
            f"the walls of {quote(scene.name)} are rows of discs, of which the law knows those that touch, "
            "on all sides of a bed of discs; give another law for effects.walls"
        )
    if late > LATEST:
        return (
            f"the bed of {quote(scene.name)} follows its piston too late (drag of all grains over "
            f"the piston's weight: {late / LATEST:.3g} times the limit, that of 1 kg/s with 7.5 kg "
            "on 368 grains); give less effects.drag.coefficient or more piston.mass"
        )
    return ""


class ValidShakingRange(NamedTuple):
    """The range in which ``annealing-bed`` may stand in for a shaken bed, and its errors there."""

    # Of the packaged damper, fallen to rest, then pushed by F sin(2 pi f t) for six cycles or two seconds,
    # the longer: the response is half the range of the last three. At 3 D the law gives 0.94 to 1.16 of it
    # for 368 grains, but for 736 grains 0.79 at 5 Hz and 0.60 at 8 Hz, so the range ends at 1.5 D.

    amplitudes: tuple[float, float]  # of the piston about its level of rest [m]
    frequencies: tuple[float, float]  # [Hz]
    response_error: float  # relative, of a pushed piston's amplitude, at worst
    loss_error: float  # relative, of the work in a cycle of a prescribed sine, at worst


AMPLITUDES, FREQUENCIES = (0.5, 1.5), (1.0, 8.0)
"""[D] of 368 grains, and [Hz], where a law may stand in for the bed."""
RESPONSE_ERROR = 0.13
"""Greatest of pushed pistons in this range (tests/reduced_models/falls/test_both_worlds.py)."""
LOSS_ERROR = 0.13
"""Greatest of prescribed sines of 0.5 to 3 D, of 368 and 736 grains."""


def valid_shaking_range(scene: Scene) -> ValidShakingRange:
    """Return the range in which ``annealing-bed`` may stand in for the bed of a scene.

    Frequencies are 1 to 8 Hz, and amplitudes 0.5 to 1.5 D sqrt(N/368), D the diameter of the first
    species and N the number of grains. Smaller ones were not measured. The bounds are those of
    simulated responses of the packaged damper, of 368 grains: see `ValidShakingRange`.

    Parameters
    ----------
    scene : Scene
        Scene of a bed below a falling piston.

    Returns
    -------
    ValidShakingRange
        Bounds of frequency [Hz] and amplitude [m], and the relative errors of response and loss
        within them, at worst.

    Raises
    ------
    InputError
        If the scene has no piston with a mass under gravity, no dipoles or discs, friction of the
        piston, effects other than dipoles or discs, walls, gravity, drag and contact, walls or a
        cut-off that `predict` refuses, discs that its piston presses together, fewer than 250
        grains, rows of discs that do not touch, or more drag over the piston's mass than was
        compared with falls.
    """
    predict_bed_parameters(scene)  # refuses what is not known
    grains = scene.grains
    unit = math.sqrt(grains.count / 368) * grains.species[0].diameter
    least, greatest = AMPLITUDES
    return ValidShakingRange((least * unit, greatest * unit), FREQUENCIES, RESPONSE_ERROR, LOSS_ERROR)
