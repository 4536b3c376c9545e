"""Elastic moduli in two dimensions: of the bed, and of the hexagonal crystal of dipoles at rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.observables.forces import SILENT, relative_magnetic_moments
from granular.observables.frame import check_vectors, is_present
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.scene.scene import Scene


BULK_OF_PRESSURE = 5.0 / 2.0
"""Bulk modulus over pressure of grains with an energy of r^-3: p ~ rho^2.5, and B = rho dp/drho."""

SHEAR_OF_PRESSURE = 1.0 / 4.0
"""Shear modulus over pressure of an isotropic arrangement of them that shears affinely."""


class Moduli(NamedTuple):
    """Pressure and moduli of a layer."""

    pressure: float  # in two dimensions [N/m]
    bulk: float  # rho dp/drho [N/m]
    shear: float  # of a shear at constant area under this pressure [N/m]

    @property
    def young_modulus(self) -> float:
        """Young's modulus in two dimensions, 4 B mu/(B + mu) [N/m]."""
        return 4.0 * self.bulk * self.shear / (self.bulk + self.shear)


def hexagonal_lattice_sum(power: float = 3.0) -> float:
    """Sum of r^-power over the hexagonal lattice of spacing 1; 11.0342 for r^-3."""
    from scipy.special import zeta

    # 6 zeta(s) L(s), with L of the character mod 3 (Borwein et al., Lattice Sums Then and Now, 2013, 1.4).
    s = 0.5 * power
    beyond = (zeta(s, 1.0 / 3.0) - zeta(s, 2.0 / 3.0)) / 3.0**s
    return float(6.0 * zeta(s) * beyond)


def dipole_pair_strength(moment: float) -> float:
    """Strength C = mu0 m^2/(4 pi) of the energy C/r^3 of two dipoles at a right angle to their plane.

    (Jackson, Classical Electrodynamics, 1999, 5.6 and 5.7.)

    Parameters
    ----------
    moment : float
        Magnetic moment m of each [A m^2]; its sign does not count.

    Returns
    -------
    float
        Strength C [J m^3], 0 or more.
    """
    from granular.parts.magnets import MAGNETIC_CONSTANT

    return MAGNETIC_CONSTANT * moment**2 / (4.0 * math.pi)


def crystal_moduli(density: float, strength: float) -> Moduli:
    """Pressure and moduli of the hexagonal crystal of dipoles at rest, by its lattice sum.

    With S = `hexagonal_lattice_sum` and the spacing a, a^2 = 2/(sqrt(3) rho),

        p = (3/4) rho C S/a^3,   B = (5/2) p,   mu = p/4,

    so that p ~ rho^2.5. In units of C (pi rho)^(3/2)/a^2 these moduli are 3.458 and 0.3458, and
    Young's modulus is 1.257: multiplied by Gamma they are the limit of the crystals of Zahn et al.,
    Phys. Rev. Lett. 90, 155506 (2003), and von Gruenberg et al., ibid. 93, 255703 (2004), at low
    temperature.

    Parameters
    ----------
    density : float
        Grains an area rho [1/m^2], above 0.
    strength : float
        C of the energy C/r^3 of a pair [J m^3], above 0; see `dipole_pair_strength`.

    Returns
    -------
    Moduli
        Pressure and moduli [N/m].

    Raises
    ------
    InputError
        If one of them is not above 0, or not finite.
    """
    _check_positive("density", density)
    _check_positive("strength", strength)
    pressure = 0.75 * density * strength * hexagonal_lattice_sum() / lattice_spacing(density) ** 3
    return Moduli(pressure, BULK_OF_PRESSURE * pressure, SHEAR_OF_PRESSURE * pressure)


def lattice_spacing(density: float) -> float:
    """Spacing of the hexagonal lattice of a density, sqrt(2/(sqrt(3) rho)) [m]; density [1/m^2]."""
    _check_positive("density", density)
    return math.sqrt(2.0 / (math.sqrt(3.0) * density))


def interaction_parameter(density: float, strength: float, temperature: float) -> float:
    """Interaction parameter Gamma = C (pi rho)^(3/2)/(k_B T), energy of neighbours over the temperature.

    Parameters
    ----------
    density : float
        Grains an area rho [1/m^2], above 0.
    strength : float
        C of the energy C/r^3 of a pair [J m^3], above 0; see `dipole_pair_strength`.
    temperature : float
        Boltzmann's constant times the temperature, k_B T [J], above 0.

    Returns
    -------
    float
        Gamma, without unit, as in Zahn et al., Phys. Rev. Lett. 90, 155506 (2003).

    Raises
    ------
    InputError
        If one of them is not above 0, or not finite.
    """
    _check_positive("density", density)
    _check_positive("strength", strength)
    _check_positive("temperature", temperature)
    return strength * (math.pi * density) ** 1.5 / temperature


def melting_theory_modulus(moduli: Moduli, density: float, temperature: float) -> float:
    """Modulus K = Y a^2/(k_B T) of the theory of melting; where it has fallen to 16 pi dislocations unbind.

    Y is `Moduli.young_modulus` and a the spacing of the hexagonal lattice (Nelson and Halperin, Phys. Rev.
    B 19, 2457, 1979).

    Parameters
    ----------
    moduli : Moduli
        Moduli of the crystal [N/m], with a bulk and shear modulus whose sum is above 0.
    density : float
        Grains an area [1/m^2], above 0.
    temperature : float
        Boltzmann's constant times the temperature, k_B T [J], above 0.

    Returns
    -------
    float
        K, without unit.

    Raises
    ------
    InputError
        If density, temperature or the sum of bulk and shear modulus is not above 0, or not finite.
    """
    _check_positive("temperature", temperature)
    _check_positive("bulk + shear modulus", moduli.bulk + moduli.shear)
    return moduli.young_modulus * lattice_spacing(density) ** 2 / temperature


def _check_positive(name: str, value: float) -> None:
    if not 0.0 < value < math.inf:
        raise InputError(f"{name} {value:g} is not above 0; give a positive number")


REACH = 6.0
"""Default of how far partners count, in mean spacings: farther ones are a continuum."""

STRAINS = (np.diag([1.0, 1.0]), np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]]))
"""Swelling, and the two shears at constant area."""

_POINTS = 64
_ROOMY = 4.0
"""Spacing in an arrangement that any grains fit into [largest diameter]."""
_FAR_AWAY = 1e3
"""Distance of absent grains [reach]: dipoles there act 1e-15 times as stiffly as a neighbour."""


class BedModuli(NamedTuple):
    """Moduli of the inner part of a bed."""

    affine: Moduli  # every grain moves with the strain
    relaxed: Moduli  # inner grains move to rest again, the others stay strained
    density: float  # inner grains over the area of their cells [1/m^2]
    grains: int  # inner grains


def bed_moduli(scene: Scene, positions: np.ndarray, reach: float = REACH) -> BedModuli:
    """Pressure, bulk and shear modulus of the inner part of a bed, as if it went on without end.

    Every pair has the second derivative of its energy by differences of the simulation's forces, as the
    matrices of small motions, whatever its law. Inner grains are those with an interior cell that stand
    ``reach`` mean spacings or more inside of the box of the outermost centres. The sums over their partners
    pass smoothly into a continuum of dipoles of the mean density at that distance; other forces end there.
    Affine moduli are those under small strains that all grains follow, mu as a mean over directions; of
    dipoles B = 5 p/2 and mu = p/4 for any arrangement. In a crystal nothing else happens; in a bed without
    its order grains also move against the strain, which the relaxed moduli know: mu and B are less by

        (1/(4 A)) df . H^-1 df,

    with df the forces that an affine strain leaves on the inner grains, diag(1, -1) and its turn by
    45 degrees (their mean) for mu and diag(1, 1) for B, H the matrix of second
    derivatives of the energy and A the area (Maloney and Lemaitre, Phys. Rev. E 74, 016118, 2006).
    The bed should be at rest. Images of a periodic cell do not count.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to. Forces between grains count, walls and weight do not.
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    reach : float
        Distance up to which partners count, in mean spacings (the root of the mean cell area), above 1.

    Returns
    -------
    BedModuli
        Pressure and moduli [N/m], affine and relaxed, with the density [1/m^2] and number of inner grains.

    Raises
    ------
    InputError
        If the shape is not that of the scene's grains, ``reach`` is not above 1, no force acts between
        grains, or no grain stands so far inside.
    """
    positions = check_vectors(positions)
    if len(positions) != scene.grains.count:
        raise InputError(f"{len(positions)} positions for {scene.grains.count} grains; give all")
    if not reach > 1.0:
        raise InputError(f"reach {reach:g} is not above 1 mean spacing; give more, such as 6")
    inner, area, length = _interior_grains_and_reach(positions, reach)
    density = len(inner) / area
    slope, bend, forces, matrix = _strained_pair_sums(scene, positions, inner, length)
    if not matrix.any():
        raise InputError("no force acts between grains; add one, such as [effects] dipole = true")
    beyond = _dipole_energy_beyond(scene, positions, inner, length, density)
    slope, bend = slope - 3.0 * beyond, bend + 12.0 * beyond
    affine = Moduli(-0.5 * slope / area, 0.25 * (bend - slope) / area, (0.125 * bend + 0.375 * slope) / area)
    # At rest again, d2E/ds2 is less by f.K^-1.f. A strain s of each kind is an area or shear strain of 2 s,
    # hence 1/4. Grains without a neighbour have no stiffness, and no force.
    stiff = np.flatnonzero(matrix.diagonal())
    forces, matrix = forces[stiff], matrix[np.ix_(stiff, stiff)]
    lost = 0.25 / area * np.einsum("ik,ik->k", forces, np.linalg.solve(matrix, forces))
    relaxed = Moduli(affine.pressure, affine.bulk - lost[0], affine.shear - 0.5 * (lost[1] + lost[2]))
    return BedModuli(affine, relaxed, density, len(inner))


def first_species_moment(scene: Scene) -> float:
    """Magnetic moment of a grain of the first species, by the natural units of the scene [A m^2]."""
    from granular.schema.natural_units import Scales

    scales = Scales.from_grains(scene.grains)
    return scales.current * scales.length**2


def _interior_grains_and_reach(positions: np.ndarray, reach: float) -> tuple[np.ndarray, float, float]:
    """Inner grains, the area of their cells [m^2] and the reach [m]."""
    cells = voronoi_cells(positions)
    inside = positions[cells.interior]
    if not len(inside):
        raise InputError("no grain has an interior cell; give a larger bed")
    length = reach * math.sqrt(float(cells.area[cells.interior].mean()))
    low, high = np.nanmin(positions, axis=0), np.nanmax(positions, axis=0)
    depth = np.minimum(positions - low, high - positions).min(axis=1)
    inner = np.flatnonzero(cells.interior & (depth >= length))
    if not len(inner):
        raise InputError(
            f"no grain stands {1e3 * length:.3g} mm inside of the bed's outermost centres; take a "
            f"reach below {reach:g} or a larger bed"
        )
    return inner, float(cells.area[inner].sum()), length


def _cutoff_weight(r: np.ndarray, reach: float) -> np.ndarray:
    """Smooth weight from 1 to 0 at the reach: shells of a lattice enter and leave without a jump."""
    along = np.clip(2.0 * r / reach - 1.0, 0.0, 1.0)
    with np.errstate(divide="ignore", over="ignore"):
        rise, fall = (np.where(part > 0.0, np.exp(-1.0 / part), 0.0) for part in (along, 1.0 - along))
    return np.asarray(fall / (rise + fall))


def _tail_integral(reach: float) -> float:
    """Integral of (1 - weight) r^-3 over the plane [1/m]."""
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    r = reach * (0.75 + 0.25 * nodes)
    ramp = 0.25 * reach * float(weights @ ((1.0 - _cutoff_weight(r, reach)) / r**2))
    return 2.0 * math.pi * (ramp + 1.0 / reach)


def _dipole_energy_beyond(
    scene: Scene, positions: np.ndarray, inner: np.ndarray, reach: float, density: float
) -> float:
    """Energy of the inner grains with a continuum of dipoles beyond the reach [m]; density [1/m^2]; [J]."""
    if scene.effects.dipole is None:
        return 0.0
    moments = relative_magnetic_moments(scene)
    strength = dipole_pair_strength(first_species_moment(scene))
    mean = float(moments[is_present(positions)].mean())
    return 0.5 * strength * density * mean * float(moments[inner].sum()) * _tail_integral(reach)


def _strained_pair_sums(
    scene: Scene, positions: np.ndarray, inner: np.ndarray, reach: float
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Sum r U' and r^2 U'' [J]; also forces after each strain [N] and their matrix [N/m]."""
    here, n = is_present(positions), len(positions)
    # Absent grains stand too far away to act.
    far = np.nanmax(np.abs(positions)) + _FAR_AWAY * reach * np.arange(1.0, n + 1.0)
    bed = BedForces(_pairs_alone(scene))
    at = bed.coordinates(np.where(here[:, None], positions, far[:, None]), None)
    count = len(inner)
    position = np.full(n, -1)
    position[inner] = np.arange(count)
    matrix = np.zeros((count, 2, count, 2))
    forces = np.zeros((count, 2, len(STRAINS)))
    slope = bend = 0.0
    for k, i in enumerate(inner):
        branch = positions[i] - positions
        r = np.linalg.norm(branch, axis=1)
        near = here & (r < reach) & (r > 0.0)
        columns = [bed.stiffness_times(at, np.eye(1, bed.size, i + axis * n)[0]) for axis in (0, 1)]
        blocks = -np.stack(columns, axis=1).reshape(2, n, 2).transpose(1, 0, 2)
        branch, r, others = branch[near], r[near], np.flatnonzero(near)
        blocks = _cutoff_weight(r, reach)[:, None, None] * blocks[near]
        # The second derivative of U(r) is U'' along the branch, and U'/r across it.
        across = np.stack([-branch[:, 1], branch[:, 0]], axis=1)
        slope += 0.5 * float(np.einsum("ja,jab,jb->", across, blocks, across))
        bend += 0.5 * float(np.einsum("ja,jab,jb->", branch, blocks, branch))
        matrix[k, :, k, :] += blocks.sum(axis=0)
        known = position[others] >= 0
        matrix[k, :, position[others[known]], :] -= blocks[known]
        for mode, strain in enumerate(STRAINS):
            forces[k, :, mode] = np.einsum("jab,jb->a", blocks, branch @ strain)
    size = 2 * count
    return slope, bend, forces.reshape(size, len(STRAINS)), matrix.reshape(size, size)


def _pairs_alone(scene: Scene) -> Scene:
    """Return a scene with the forces between grains alone, of all pairs."""
    others = {
        f"effects.{effect.key}": None for effect in scene.effects.acting if effect.key in (*SILENT, "walls")
    }
    side = _ROOMY * math.sqrt(scene.grains.count) * float(scene.grains.diameters().max())
    return scene.replace(
        **others,
        **{
            "piston": None,
            "cell": {"width": side},
            "arrangement": {"height": side},
            "pairs": {"method": "direct"},
            "output.record": None,
            "protocol": [{"kind": "hold", "name": "rest", "duration": 1.0}],
        },
    )
