"""Roots, normal modes and harmonic response of a bed's small motions.

A free motion u exp(s t) satisfies (K + s C + s^2 M) u = 0. With symmetric matrices, the piston's receptance
is

    h(s) = sum over roots of u_z^2 / (u^T (2 s_k M + C) u) / (s - s_k),

in which the factor of 1/(s - s_k) is the residue of the root s_k. The dynamic stiffness at the piston is 1/h.

An integration method changes a root slightly, depending on the time step. During a time T, the exact motion
of a root near equilibrium is multiplied by exp(s T). Several steps of the method over the same time are a
linear map A of coordinates and velocities, and multiply the motion by (y^T A w)/(y^T w). Here w = (u, s u) is
the exact motion and y = (s M u + C u, M u) is the left eigenvector. The error of this factor is of second
order in the error of w.
"""

from __future__ import annotations

import cmath
import dataclasses
import functools
import math

import numpy as np

from granular.kernel_data.state import HEIGHT, SPEED
from granular.linear.bed_forces import BedForces, check_free_piston, directional_derivative
from granular.linear.equilibrium import Equilibrium, coordinates_to_pin_in_periodic_cell
from granular.linear.pencil import Pencil, multiply_complex_vector
from granular.methods.method import Method
from granular.run.engines import NO_STOP_CRITERIA, NO_TICKS, UNDIVIDED
from granular.run.plan import plan
from granular.run.run_state import ARRANGE, RunState
from granular.shared.array_types import Complex, Float, Shaped
from granular.shared.errors import InputError

LOWEST = 40
"""Default number of modes of a bed without full matrices."""

MODE_SHIFT = 1e-3
"""The search for eigenvalues starts at -`MODE_SHIFT` x (largest stiffness of a coordinate)/(largest mass of a
coordinate)."""


@dataclasses.dataclass(frozen=True, eq=False)
class NormalModes:
    """Normal modes of small motions without damping.

    Attributes
    ----------
    squared_angular_frequencies : float64 (k,)
        Squared angular frequencies in increasing order [1/s^2]; negative for unstable modes.
    shapes : float64 (q, k)
        Displacements of all coordinates in each mode, for a modal mass of 1 kg [m].
    frequencies : float64 (k,)
        Frequencies [Hz]; NaN for unstable modes.
    """

    squared_angular_frequencies: Float[np.ndarray, "k"]
    shapes: Float[np.ndarray, "q k"]

    @property
    def frequencies(self) -> Float[np.ndarray, "k"]:
        """Frequencies [Hz]; NaN for unstable modes."""
        squares = self.squared_angular_frequencies
        return np.where(squares >= 0.0, np.sqrt(np.abs(squares)) / (2.0 * math.pi), np.nan)


def normal_modes(rest: Equilibrium, count: int | None = None) -> NormalModes:
    """Find the lowest undamped normal modes of a bed.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed.
    count : int, optional
        Number of modes. If not given, a bed of up to `granular.linear.pencil.DENSE` coordinates gives all
        modes, and a larger bed gives 40.

    Returns
    -------
    NormalModes
        Solutions of K u = omega^2 M u.
    """
    pencil = rest.pencil
    if pencil.has_all_modes:
        from scipy.linalg import eigh

        last = pencil.bed.size if count is None else min(count, pencil.bed.size)
        return NormalModes(*eigh(pencil.full_stiffness, pencil.mass.toarray(), subset_by_index=[0, last - 1]))
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import LinearOperator, eigsh

    shape = (pencil.bed.size, pencil.bed.size)
    undamped = dataclasses.replace(pencil, damping=csc_matrix(shape), damping_is_diagonal=True)
    scale = float(np.abs(pencil.stiffness.diagonal()).max() / pencil.mass.diagonal().max())
    # Below zero, because uniform shifts in a periodic cell have no stiffness.
    sigma = -MODE_SHIFT * scale
    inverse = LinearOperator(shape, lambda u: undamped.solve(math.sqrt(-sigma), u.reshape(-1, 1))[:, 0])
    product = LinearOperator(shape, lambda u: pencil.dynamic_stiffness_times(0.0, u.ravel()))
    return NormalModes(*eigsh(product, count or LOWEST, M=pencil.mass, sigma=sigma, OPinv=inverse, tol=1e-8))


MASS_FRACTION = 0.05
"""Minimum residue of a root that is returned, relative to the largest residue."""

MAXIMUM_ROOTS = 8
"""Number of undamped modes used as starting points for roots."""

SMALLEST_FRACTION = 0.5
"""Minimum sum of the mass fractions of oscillating roots. If the sum is smaller, the piston mainly creeps."""

REAL_TOLERANCE = 1e-6
"""Ratio of Im s to |s| below which a root s is taken as real. A relative rounding error e can turn two nearly
equal real roots into a complex pair with Im s/|s| = sqrt(e)."""

ROUNDED = 1e-9
"""Newton's method ends if a relative step is smaller than this value and larger than half the previous step.
For 23,552 grains on a mesh, rounding causes steps of 5e-11."""

MAXIMUM_STEPS = 30
"""Maximum number of Newton steps to a root; five suffice if they start from the quasi-static root."""


@dataclasses.dataclass(frozen=True, eq=False)
class Root:
    """A damped mode of small motions.

    Attributes
    ----------
    s : complex
        Root [1/s]; the motion is u exp(s t).
    shape : complex (q,)
        Displacement u of each coordinate divided by the displacement of the piston; see
        `granular.linear.bed_forces`.
    residue : complex
        Residue of the piston's receptance [s/kg].
    mass_fraction : float
        Fraction of the piston's initial acceleration after a force step that is due to this root and its
        complex conjugate: 2 Re(s residue) times the piston's effective mass. If a machine carries the bed,
        this mass includes the recoil of the machine. The fractions of all roots add up to 1 if real roots are
        counted with a factor of 1/2.
    frequency : float
        Natural frequency |s|/(2 pi) [Hz].
    damping_ratio : float
        -Re s/|s|.
    """

    s: complex
    shape: Complex[np.ndarray, "q"]
    residue: complex
    mass_fraction: float

    @property
    def frequency(self) -> float:
        """Natural frequency, without damping [Hz]."""
        return abs(self.s) / (2.0 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping over critical damping."""
        return -self.s.real / abs(self.s) + 0.0


def piston_roots(rest: Equilibrium) -> tuple[Root, ...]:
    """Find the roots of the piston's motion, the root with the largest residue first.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.

    Returns
    -------
    tuple of Root
        Roots near the undamped modes in which the piston participates. The residue of each is at least a
        twentieth of the largest residue.

    Raises
    ------
    InputError
        If the bed has no free piston, is unstable, or is damped so strongly that real roots account for at
        least half of the piston's motion.
    """
    pencil, piston = rest.pencil, coordinate_index_of_free_piston(rest)
    if pencil.has_all_modes and not rest.is_stable:
        lowest = rest.lowest_stiffness[0]
        raise InputError(
            f"the equilibrium is not stable: an eigenvalue of the stiffness is {lowest:.3g} N/m; "
            "start from a settled bed"
        )
    first = refine_root(pencil, piston, _quasi_static_root(pencil, piston))
    roots = [] if first is None else [first]
    # The fractions of all roots add up to one: if one is 0.95, no other exceeds a twentieth.
    if pencil.has_all_modes and (first is None or first.mass_fraction < 1.0 - MASS_FRACTION):
        for start in _approximate_mode_roots(rest, piston):
            root = refine_root(pencil, piston, start)
            if root is not None and not any(abs(root.s - other.s) < 1e-6 * abs(root.s) for other in roots):
                roots.append(root)
    fraction = sum(root.mass_fraction for root in roots)
    if not roots or (pencil.has_all_modes and fraction < SMALLEST_FRACTION):
        raise InputError(
            f"the piston mainly creeps: oscillations account for a fraction of {fraction:.2g} of its motion; "
            "reduce the drag"
        )
    roots.sort(key=lambda root: -abs(root.residue))
    return tuple(root for root in roots if abs(root.residue) >= MASS_FRACTION * abs(roots[0].residue))


def coordinate_index_of_free_piston(rest: Equilibrium) -> int:
    """Return the coordinate index of the free piston; raise an error if the bed has none."""
    check_free_piston(rest.scene)
    assert rest.pencil.bed.piston is not None
    return rest.pencil.bed.piston


def refine_root(pencil: Pencil, piston: int, s: complex) -> Root | None:
    """Refine a root [1/s] by Newton's method on the piston's dynamic stiffness; return None if that fails."""
    before = math.inf
    for _ in range(MAXIMUM_STEPS):
        shape = _shape_per_piston_displacement(pencil, piston, s, ())
        value = complex(shape @ pencil.dynamic_stiffness_times(s, shape))
        slope = complex(shape @ dynamic_stiffness_derivative_times(pencil, s, shape))
        change = value / slope
        s -= change
        size = abs(change / s)
        if size < 1e-11 or 0.5 * before < size < ROUNDED:
            mass_fraction = 2.0 * (s / slope).real * pencil.effective_mass_at(piston)
            return Root(s, shape, 1.0 / slope, mass_fraction) if s.imag > REAL_TOLERANCE * abs(s) else None
        before = size
    return None


def dynamic_stiffness_derivative_times(
    pencil: Pencil, s: complex, shape: Complex[np.ndarray, "q"]
) -> Complex[np.ndarray, "q"]:
    """Return (C + 2 s M) u, the derivative of (K + s C + s^2 M) u with respect to s."""
    return pencil.damping_times(shape) + 2.0 * s * (pencil.mass @ shape)


def quasi_static_displacement_shape(pencil: Pencil, piston: int) -> Float[np.ndarray, "q"]:
    """Return the displacements of all coordinates in equilibrium with a piston displaced by 1."""
    return _shape_per_piston_displacement(
        pencil, piston, 0.0, coordinates_to_pin_in_periodic_cell(pencil.bed)
    )


def _shape_per_piston_displacement(
    pencil: Pencil, piston: int, s: complex, held: tuple[int, ...]
) -> Shaped[np.ndarray, "q"]:
    """Return the displacements of all coordinates, relative to a piston that moves as exp(s t); s [1/s]."""
    unit = np.zeros(pencil.bed.size, np.result_type(s))
    unit[piston] = 1.0
    column = -pencil.dynamic_stiffness_times(s, unit)
    column[piston] = 0.0
    return np.asarray(pencil.solve(s, column[:, None], (piston, *held))[:, 0] + unit)


def _quasi_static_root(pencil: Pencil, piston: int) -> complex:
    """Return the root [1/s] of the piston's motion if the grains follow it quasi-statically."""
    shape = quasi_static_displacement_shape(pencil, piston)
    stiffness = float(shape @ pencil.dynamic_stiffness_times(0.0, shape))
    damping = float(shape @ pencil.damping_times(shape))
    return _root_of_oscillator(float(shape @ (pencil.mass @ shape)), damping, stiffness)


def modal_coordinate(
    pencil: Pencil, root: Root, displacement: Float[np.ndarray, "q"], velocity: Float[np.ndarray, "q"]
) -> complex:
    """Return the amplitude a [m] with which a root contributes 2 Re(a exp(s t)) to a motion."""
    # Uses the left eigenvector, which equals the shape because the matrices are symmetric.
    inertia = dynamic_stiffness_derivative_times(pencil, root.s, root.shape)
    weights = inertia - root.s * (pencil.mass @ root.shape)
    state = (pencil.mass @ root.shape) @ velocity + weights @ displacement
    return complex(state / (root.shape @ inertia))


def _root_of_oscillator(mass: float, damping: float, stiffness: float) -> complex:
    return (-damping + cmath.sqrt(damping * damping - 4.0 * mass * stiffness)) / (2.0 * mass)


def _approximate_mode_roots(rest: Equilibrium, piston: int) -> list[complex]:
    """Estimate, from modal damping, the roots [1/s] of the modes in which the piston participates most."""
    pencil, modes = rest.pencil, normal_modes(rest)
    fractions = modes.shapes[piston] ** 2
    chosen = np.argsort(-fractions)[:MAXIMUM_ROOTS]
    starts = []
    for k in chosen[fractions[chosen] >= 0.5 * MASS_FRACTION * fractions.max()]:
        shape = modes.shapes[:, k]
        damping = float(shape @ pencil.damping_times(shape))
        starts.append(_root_of_oscillator(1.0, damping, float(modes.squared_angular_frequencies[k])))
    return starts


def root_of_steps(
    rest: Equilibrium, root: Root, dt: float, method: str | Method = "stormer-verlet"
) -> complex:
    """Find the root of the motion that an integration method computes with a given time step.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed that is not carried by a machine.
    root : Root
        Exact root.
    dt : float
        Time step [s], above 0.
    method : str or Method
        Integration method, as in `granular.simulate`.

    Returns
    -------
    complex
        Root [1/s] of the computed motion, near the exact root.

    Raises
    ------
    InputError
        If a machine carries the bed, the method has variable steps, or it does not support drag.
    """
    bed = rest.pencil.bed
    if bed.machine is not None or bed.bath_rate:
        raise InputError(
            "with a machine or a heat bath, a step depends on more than the state of the bed; "
            "compare two runs with different time steps instead"
        )
    run_plan = plan(bed.scene, dt, method, threads=1)
    if run_plan.method.variable:
        raise InputError(f"{run_plan.method.name!r} varies its time step; use a method with constant steps")
    if run_plan.method.tableau is not None and rest.pencil.damping.max() > 0.0:
        raise InputError(
            f"{run_plan.method.name!r} does not support drag; use 'stormer-verlet', or remove the drag"
        )
    far_field = run_plan.system.constants.acting.far
    steps = (far_field.every or 1) if far_field is not None else 1
    advance = functools.partial(_coordinates_and_velocities_after_steps, RunState(run_plan), bed, dt, steps)
    motion = np.concatenate([root.shape, root.s * root.shape * bed.scales.time])
    start = np.concatenate([rest.pencil.at, np.zeros(bed.size)])
    displacement = bed.finite_difference_displacement(rest.pencil.at) * bed.length
    mapped = multiply_complex_vector(
        lambda w: directional_derivative(advance, start, w, displacement), motion
    )
    left_eigenvector = np.concatenate(
        [
            root.s * (rest.pencil.mass @ root.shape) + rest.pencil.damping_times(root.shape),
            (rest.pencil.mass @ root.shape) / bed.scales.time,
        ]
    )
    multiplier = complex((left_eigenvector @ mapped) / (left_eigenvector @ motion))
    return cmath.log(multiplier) / (steps * dt)


def _coordinates_and_velocities_after_steps(
    run: RunState, bed: BedForces, dt: float, steps: int, start: Float[np.ndarray, "2q"]
) -> Float[np.ndarray, "2q"]:
    """Advance some steps; return coordinates [m] and velocities times the natural unit of time [m]."""
    state, n, length = run.state, bed.grains, bed.length
    q, v = start[: bed.size] / length, start[bed.size :] / length
    state.x[:n], state.y[:n], state.vx[:n], state.vy[:n] = q[:n], q[n : 2 * n], v[:n], v[n : 2 * n]
    if bed.piston is not None:
        state.piston[:] = 0.0
        state.piston[HEIGHT], state.piston[SPEED] = q[bed.piston], v[bed.piston]
    run.motion = run.motion._replace(free=bed.piston is not None)
    run.present_record(ARRANGE)
    h = dt / bed.scales.time
    schedule = UNDIVIDED._replace(length=steps * h, h=h, steps=steps)
    run.call_engine(NO_TICKS._replace(ticks=1), schedule, NO_STOP_CRITERIA)
    piston = () if bed.piston is None else state.piston
    height, speed = piston[HEIGHT : HEIGHT + 1], piston[SPEED : SPEED + 1]
    return length * np.concatenate([state.x[:n], state.y[:n], height, state.vx[:n], state.vy[:n], speed])


def dynamic_stiffness(rest: Equilibrium, frequencies: Float[np.ndarray, "f"]) -> Complex[np.ndarray, "f"]:
    """Dynamic stiffness at the piston: force divided by displacement, at each frequency.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.
    frequencies : float (f,)
        Frequencies [Hz].

    Returns
    -------
    complex128 (f,)
        Storage stiffness (real part) and loss stiffness (imaginary part) of bed and piston, including inertia
        [N/m].

    Raises
    ------
    InputError
        If the bed has no free piston.
    """
    piston = coordinate_index_of_free_piston(rest)
    force = np.zeros(rest.pencil.bed.size)
    force[piston] = 1.0
    return 1.0 / displacements_under_harmonic_force(rest, frequencies, force)[:, piston]


def transmissibility(rest: Equilibrium, frequencies: Float[np.ndarray, "f"]) -> Complex[np.ndarray, "f"]:
    """Transmissibility: absolute displacement of the piston divided by vertical displacement of the base.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston; its cell stands on the base, or on a machine on the base.
    frequencies : float (f,)
        Frequencies [Hz].

    Returns
    -------
    complex128 (f,)
        Modulus and phase of the ratio; 1 at frequency 0.

    Raises
    ------
    InputError
        If the bed has no free piston.
    """
    piston = coordinate_index_of_free_piston(rest)
    frame, uplift = rest.pencil.bed.cell_displacement_coefficients_and_uplift()
    moved = displacements_under_harmonic_force(rest, frequencies, -(rest.pencil.mass @ uplift), 2)
    return 1.0 + moved[:, piston] + moved @ frame


def displacements_under_harmonic_force(
    rest: Equilibrium, frequencies: Float[np.ndarray, "f"], force: Float[np.ndarray, "q"], power: int = 0
) -> Complex[np.ndarray, "f q"]:
    """Return the displacement amplitudes [m] under force amplitudes [N] times (i omega)^power."""
    rates = 2j * math.pi * np.asarray(frequencies, dtype=np.float64)
    return np.array([rest.pencil.solve(s, (s**power * force)[:, None])[:, 0] for s in rates])
