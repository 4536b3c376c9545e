"""Two-dimensional elastic moduli of a bed, and of the hexagonal dipole crystal at zero temperature."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.observables.forces import SILENT, relative_magnetic_moments
from granular.observables.frame import checked_vectors, present_grain_mask
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from granular.scene.scene import Scene


BULK_OF_PRESSURE = 5.0 / 2.0
"""Ratio of bulk modulus to pressure for pair energies ~ r^-3: p ~ rho^2.5, and B = rho dp/drho."""

SHEAR_OF_PRESSURE = 1.0 / 4.0
"""Ratio of shear modulus to pressure for pair energies ~ r^-3, in an isotropic arrangement under affine
shear."""


class Moduli(NamedTuple):
    """Pressure and moduli of a layer."""

    pressure: float  # pressure in two dimensions [N/m]
    bulk: float  # bulk modulus rho dp/drho [N/m]
    shear: float  # shear modulus at constant area under this pressure [N/m]

    @property
    def young_modulus(self) -> float:
        """Young's modulus in two dimensions, 4 B mu/(B + mu) [N/m]."""
        return 4.0 * self.bulk * self.shear / (self.bulk + self.shear)


def hexagonal_lattice_sum(power: float = 3.0) -> float:
    """Sum of r^-power over the hexagonal lattice of spacing 1; 11.0342 for r^-3."""
    from scipy.special import zeta

    # 6 zeta(s) L(s), where L is the L-function of the character mod 3 (Borwein et al., Lattice Sums Then and
    # Now, 2013, 1.4).
    s = 0.5 * power
    beyond = (zeta(s, 1.0 / 3.0) - zeta(s, 2.0 / 3.0)) / 3.0**s
    return float(6.0 * zeta(s) * beyond)


def dipole_pair_strength(moment: float) -> float:
    """Strength C = mu0 m^2/(4 pi) in the energy C/r^3 of two dipoles perpendicular to the layer.

    (Jackson, Classical Electrodynamics, 1999, 5.6 and 5.7.)

    Parameters
    ----------
    moment : float
        Magnetic moment m of each dipole [A m^2]; its sign is irrelevant.

    Returns
    -------
    float
        Strength C [J m^3], 0 or more.
    """
    from granular.parts.magnets import MAGNETIC_CONSTANT

    return MAGNETIC_CONSTANT * moment**2 / (4.0 * math.pi)


def crystal_moduli(density: float, strength: float) -> Moduli:
    """Pressure and moduli of the hexagonal dipole crystal at zero temperature, from its lattice sum.

    With S = `hexagonal_lattice_sum` and the spacing a given by a^2 = 2/(sqrt(3) rho),

        p = (3/4) rho C S/a^3,   B = (5/2) p,   mu = p/4,

    so that p ~ rho^2.5. In units of C (pi rho)^(3/2)/a^2, B is 3.458, mu is 0.3458, and Young's modulus is
    1.257. Multiplied by Gamma, these numbers are the low-temperature limit for the crystals of Zahn et al.,
    Phys. Rev. Lett. 90, 155506 (2003), and von Gruenberg et al., ibid. 93, 255703 (2004).

    Parameters
    ----------
    density : float
        Grains per area rho [1/m^2], above 0.
    strength : float
        Strength C of the pair energy C/r^3 [J m^3], above 0; see `dipole_pair_strength`.

    Returns
    -------
    Moduli
        Pressure and moduli [N/m].

    Raises
    ------
    InputError
        If an argument is not above 0, or not finite.
    """
    _check_positive("density", density)
    _check_positive("strength", strength)
    pressure = 0.75 * density * strength * hexagonal_lattice_sum() / lattice_spacing(density) ** 3
    return Moduli(pressure, BULK_OF_PRESSURE * pressure, SHEAR_OF_PRESSURE * pressure)


def lattice_spacing(density: float) -> float:
    """Spacing sqrt(2/(sqrt(3) rho)) [m] of the hexagonal lattice with the density rho [1/m^2]."""
    _check_positive("density", density)
    return math.sqrt(2.0 / (math.sqrt(3.0) * density))


def interaction_parameter(density: float, strength: float, temperature: float) -> float:
    """Interaction parameter Gamma = C (pi rho)^(3/2)/(k_B T): typical pair energy divided by k_B T.

    Parameters
    ----------
    density : float
        Grains per area rho [1/m^2], above 0.
    strength : float
        Strength C of the pair energy C/r^3 [J m^3], above 0; see `dipole_pair_strength`.
    temperature : float
        Boltzmann's constant times the temperature, k_B T [J], above 0.

    Returns
    -------
    float
        Gamma, dimensionless, as in Zahn et al., Phys. Rev. Lett. 90, 155506 (2003).

    Raises
    ------
    InputError
        If an argument is not above 0, or not finite.
    """
    _check_positive("density", density)
    _check_positive("strength", strength)
    _check_positive("temperature", temperature)
    return strength * (math.pi * density) ** 1.5 / temperature


def melting_theory_modulus(moduli: Moduli, density: float, temperature: float) -> float:
    """Modulus K = Y a^2/(k_B T); in the theory of two-dimensional melting, dislocations unbind at K = 16 pi.

    Here Y is `Moduli.young_modulus` and a is the spacing of the hexagonal lattice (Nelson and Halperin, Phys.
    Rev. B 19, 2457, 1979).

    Parameters
    ----------
    moduli : Moduli
        Moduli of the crystal [N/m]; the sum of bulk and shear modulus must be above 0.
    density : float
        Grains per area [1/m^2], above 0.
    temperature : float
        Boltzmann's constant times the temperature, k_B T [J], above 0.

    Returns
    -------
    float
        K, dimensionless.

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
        raise InputError(f"{name} = {value:g} must be above 0")


REACH = 6.0
"""Default distance, in mean spacings, up to which pairs are summed individually."""

STRAINS = (np.diag([1.0, 1.0]), np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]]))
"""Strain tensors of areal expansion and of the two shears at constant area."""

_POINTS = 64
_ROOMY = 4.0
"""Spacing, in units of the largest diameter, at which grains of any size do not touch."""
_FAR_AWAY = 1e3
"""Absent grains are placed at this multiple of the reach; the stiffness of dipoles at this distance is 1e-15
of the stiffness between neighbours."""


class BedModuli(NamedTuple):
    """Moduli of the inner part of a bed."""

    affine: Moduli  # every grain follows the strain
    relaxed: Moduli  # inner grains relax to equilibrium, the others stay strained
    density: float  # number of inner grains divided by the area of their cells [1/m^2]
    grains: int  # number of inner grains


def bed_moduli(scene: Scene, positions: np.ndarray, reach: float = REACH) -> BedModuli:
    """Pressure, bulk and shear modulus of the inner part of a bed, extrapolated to an infinite bed.

    The second derivatives of the pair energy are computed from finite differences of the simulation's forces,
    for any pair law. Inner grains have an interior cell and lie at least ``reach`` mean spacings inside the
    bounding box of the centres. At distances beyond ``reach``, dipoles are represented by a continuum of the
    mean density, with a smooth transition; other forces are cut off. Affine moduli B and mu describe small
    strains that all grains follow, with mu averaged over directions; for dipoles under the pressure p, B = 5
    p/2 and mu = p/4 in any arrangement. In a crystal, affine moduli are exact. In a disordered bed, grains
    also move relative to the affine strain. The relaxed moduli include this motion, which reduces B and mu by

        (1/(4 A)) df . H^-1 df,

    where df are the forces on the inner grains after an affine strain, H is the matrix of second derivatives
    of the energy, and A is the area of the inner cells (Maloney and Lemaitre, Phys. Rev. E 74, 016118, 2006).
    For B the strain is diag(1, 1); mu is the mean over diag(1, -1) and the same strain turned by 45 degrees.
    The bed should be at rest. Images in a periodic cell are ignored.

    Parameters
    ----------
    scene : Scene
        Scene that the grains belong to. Forces between grains are included; walls and weight are ignored.
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    reach : float
        Distance within which pairs are summed, in mean spacings (the square root of the mean cell area),
        above 1.

    Returns
    -------
    BedModuli
        Pressure and moduli [N/m], affine and relaxed; density [1/m^2] and number of inner grains.

    Raises
    ------
    InputError
        If the shape does not match the scene's grains, ``reach`` is not above 1, no force acts between
        grains, or no grain lies ``reach`` mean spacings inside the bed.
    """
    positions = checked_vectors(positions)
    if len(positions) != scene.grains.count:
        raise InputError(
            f"{len(positions)} positions for {scene.grains.count} grains; pass one position for each grain"
        )
    if not reach > 1.0:
        raise InputError(f"reach = {reach:g} must be above 1 mean spacing; use a larger value, such as 6")
    inner, area, length = _interior_grains_area_and_reach(positions, reach)
    density = len(inner) / area
    first_derivative, second_derivative, forces, matrix = _pair_sums_strain_forces_and_stiffness(
        scene, positions, inner, length
    )
    if not matrix.any():
        raise InputError("the scene has no force between grains; add one, such as [effects] dipole = true")
    tail_energy = _dipole_energy_beyond(scene, positions, inner, length, density)
    first_derivative, second_derivative = (
        first_derivative - 3.0 * tail_energy,
        second_derivative + 12.0 * tail_energy,
    )
    affine = Moduli(
        -0.5 * first_derivative / area,
        0.25 * (second_derivative - first_derivative) / area,
        (0.125 * second_derivative + 0.375 * first_derivative) / area,
    )
    # Relaxation reduces d2E/ds2 by f.K^-1.f. A strain s of each kind is an area or shear strain of 2 s, which
    # gives the factor 1/4. Grains without neighbours have neither stiffness nor force.
    with_stiffness = np.flatnonzero(matrix.diagonal())
    forces, matrix = forces[with_stiffness], matrix[np.ix_(with_stiffness, with_stiffness)]
    reduction = 0.25 / area * np.einsum("ik,ik->k", forces, np.linalg.solve(matrix, forces))
    relaxed = Moduli(
        affine.pressure, affine.bulk - reduction[0], affine.shear - 0.5 * (reduction[1] + reduction[2])
    )
    return BedModuli(affine, relaxed, density, len(inner))


def magnetic_moment_of_first_species(scene: Scene) -> float:
    """Magnetic moment of a grain of the first species, from the natural units of the scene [A m^2]."""
    from granular.schema.natural_units import Scales

    scales = Scales.from_grains(scene.grains)
    return scales.current * scales.length**2


def _interior_grains_area_and_reach(positions: np.ndarray, reach: float) -> tuple[np.ndarray, float, float]:
    """Return the indices of the inner grains, the total area of their cells [m^2] and the reach [m]."""
    cells = voronoi_cells(positions)
    inside = positions[cells.interior]
    if not len(inside):
        raise InputError("0 grains have an interior Voronoi cell; use a larger bed")
    length = reach * math.sqrt(float(cells.area[cells.interior].mean()))
    low, high = np.nanmin(positions, axis=0), np.nanmax(positions, axis=0)
    depth = np.minimum(positions - low, high - positions).min(axis=1)
    inner = np.flatnonzero(cells.interior & (depth >= length))
    if not len(inner):
        raise InputError(
            f"0 grains lie {1e3 * length:.3g} mm or more inside the bounding box of the centres; use a "
            f"reach below {reach:g} or a larger bed"
        )
    return inner, float(cells.area[inner].sum()), length


def _smooth_cut_off_weight(r: np.ndarray, reach: float) -> np.ndarray:
    """Weight that decreases smoothly from 1 to 0 at r = reach, to avoid jumps at shells of the lattice."""
    ramp = np.clip(2.0 * r / reach - 1.0, 0.0, 1.0)
    with np.errstate(divide="ignore", over="ignore"):
        rise, fall = (
            np.where(argument > 0.0, np.exp(-1.0 / argument), 0.0) for argument in (ramp, 1.0 - ramp)
        )
    return np.asarray(fall / (rise + fall))


def _integral_outside_cut_off(reach: float) -> float:
    """Integral of (1 - weight) r^-3 over the plane [1/m]."""
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    r = reach * (0.75 + 0.25 * nodes)
    transition = 0.25 * reach * float(weights @ ((1.0 - _smooth_cut_off_weight(r, reach)) / r**2))
    return 2.0 * math.pi * (transition + 1.0 / reach)


def _dipole_energy_beyond(
    scene: Scene, positions: np.ndarray, inner: np.ndarray, reach: float, density: float
) -> float:
    """Energy [J] of inner grains in the field of dipoles beyond the reach [m]; density of grains in 1/m^2."""
    if scene.effects.dipole is None:
        return 0.0
    moments = relative_magnetic_moments(scene)
    strength = dipole_pair_strength(magnetic_moment_of_first_species(scene))
    mean = float(moments[present_grain_mask(positions)].mean())
    return 0.5 * strength * density * mean * float(moments[inner].sum()) * _integral_outside_cut_off(reach)


def _pair_sums_strain_forces_and_stiffness(
    scene: Scene, positions: np.ndarray, inner: np.ndarray, reach: float
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Return sums of r U' and r^2 U'' [J], forces per unit strain [N] and the stiffness matrix [N/m]."""
    present, n = present_grain_mask(positions), len(positions)
    # Absent grains are placed too far away to act.
    far = np.nanmax(np.abs(positions)) + _FAR_AWAY * reach * np.arange(1.0, n + 1.0)
    bed = BedForces(_scene_with_pair_forces_only(scene))
    coordinates = bed.coordinates(np.where(present[:, None], positions, far[:, None]), None)
    count = len(inner)
    position = np.full(n, -1)
    position[inner] = np.arange(count)
    matrix = np.zeros((count, 2, count, 2))
    forces = np.zeros((count, 2, len(STRAINS)))
    first_derivative = second_derivative = 0.0
    for k, i in enumerate(inner):
        branch = positions[i] - positions
        r = np.linalg.norm(branch, axis=1)
        near = present & (r < reach) & (r > 0.0)
        columns = [bed.stiffness_times(coordinates, np.eye(1, bed.size, i + axis * n)[0]) for axis in (0, 1)]
        blocks = -np.stack(columns, axis=1).reshape(2, n, 2).transpose(1, 0, 2)
        branch, r, others = branch[near], r[near], np.flatnonzero(near)
        blocks = _smooth_cut_off_weight(r, reach)[:, None, None] * blocks[near]
        # The second derivative of U(r) is U'' along the branch and U'/r across it.
        across = np.stack([-branch[:, 1], branch[:, 0]], axis=1)
        first_derivative += 0.5 * float(np.einsum("ja,jab,jb->", across, blocks, across))
        second_derivative += 0.5 * float(np.einsum("ja,jab,jb->", branch, blocks, branch))
        matrix[k, :, k, :] += blocks.sum(axis=0)
        known = position[others] >= 0
        matrix[k, :, position[others[known]], :] -= blocks[known]
        for mode, strain in enumerate(STRAINS):
            forces[k, :, mode] = np.einsum("jab,jb->a", blocks, branch @ strain)
    size = 2 * count
    return first_derivative, second_derivative, forces.reshape(size, len(STRAINS)), matrix.reshape(size, size)


def _scene_with_pair_forces_only(scene: Scene) -> Scene:
    """Return a copy of a scene with forces between grains only, summed over all pairs."""
    removed = {
        f"effects.{effect.key}": None for effect in scene.effects.acting if effect.key in (*SILENT, "walls")
    }
    cell_side = _ROOMY * math.sqrt(scene.grains.count) * float(scene.grains.diameters().max())
    return scene.replace(
        **removed,
        **{
            "piston": None,
            "cell": {"width": cell_side},
            "arrangement": {"height": cell_side},
            "pairs": {"method": "direct"},
            "output.record": None,
            "protocol": [{"kind": "hold", "name": "rest", "duration": 1.0}],
        },
    )
