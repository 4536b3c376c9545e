"""The matrices of small motions about a state, and the solution of (K + s C + s^2 M) u = f.

Products of a matrix with a vector are finite differences of the forces, and the equations are solved by GMRES
(Saad and Schultz 1986, doi:10.1137/0907058). The preconditioner is the factorised matrix of near pairs. A
single finite difference gives many columns of this matrix, because distant grains can be displaced together
(Curtis, Powell and Reid 1974, doi:10.1093/imamat/13.1.117). Beds of up to `DENSE` coordinates have full
matrices, computed column by column, which give all modes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.shared.array_types import Float, Shaped
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

DENSE = 4000
"""Maximum number of coordinates for full matrices; the three matrices then take 400 MB of memory, and the
stiffness of dipoles takes 30 s to compute."""

NEIGHBOURS = 18
"""Number of neighbours in the matrix of near pairs: three shells of a triangular lattice."""

CYCLE, MAXIMUM_CYCLES = 100, 3
"""GMRES runs at most `MAXIMUM_CYCLES` cycles of at most `CYCLE` steps. Settled beds of 368 to 1,472 dipoles
take one cycle of about 35 steps."""

PRECISION, NOISE = 1e-10, 3e-11
"""Residuals below which GMRES ends. `PRECISION` is relative to the right-hand side. `NOISE` is relative to
(largest stiffness) x (largest displacement). In this unit, finite differences of the forces of 1,472 dipoles
have an error of 7e-12."""

STALLED = 1e-5
"""If a further cycle of GMRES does not halve the residual, the solution is accepted if the residual, relative
to the right-hand side, is below this limit. For 5,888 dipoles on a mesh, rounding causes a residual of 2e-8;
the error of a root is the square of the residual. For grains in hard contact, the error of the products
(1e-6) differs from product to product. Small beds are then solved with full matrices instead."""


@dataclasses.dataclass(frozen=True, eq=False)
class Pencil:
    """Stiffness K, damping C and mass M of small motions about a state."""

    bed: BedForces
    at: Float[np.ndarray, "q"]  # [m]
    stiffness: csc_matrix  # (q, q), near pairs only [N/m]
    damping: csc_matrix  # (q, q), near pairs only [N s/m]
    mass: csc_matrix  # (q, q) [kg]
    damping_is_diagonal: bool  # except for a machine's bodies; then the matrix is complete

    @property
    def has_all_modes(self) -> bool:
        """True if the bed is small enough for full matrices."""
        return self.bed.size <= DENSE

    @functools.cached_property
    def full_stiffness(self) -> Float[np.ndarray, "q q"]:
        """Stiffness K of all pairs [N/m]."""
        return _full_matrix_from_products(self.stiffness_times, self.bed.size)

    @functools.cached_property
    def full_damping(self) -> Float[np.ndarray, "q q"]:
        """Damping C of all pairs [N s/m]."""
        return _full_matrix_from_products(self.damping_times, self.bed.size)

    def dynamic_stiffness_times(self, s: complex, u: Shaped[np.ndarray, "q"]) -> Shaped[np.ndarray, "q"]:
        """Return (K + s C + s^2 M) u."""
        result = self.stiffness_times(u) + s * s * (self.mass @ u)
        return np.asarray(result if s == 0.0 else result + s * self.damping_times(u))

    def stiffness_times(self, u: Shaped[np.ndarray, "q"]) -> Shaped[np.ndarray, "q"]:
        """Return K u."""
        return multiply_complex_vector(functools.partial(self.bed.stiffness_times, self.at), u)

    def damping_times(self, u: Shaped[np.ndarray, "q"]) -> Shaped[np.ndarray, "q"]:
        """Return C u."""
        if self.damping_is_diagonal:
            return np.asarray(self.damping @ u)
        return multiply_complex_vector(functools.partial(self.bed.damping_matrix_times, self.at), u)

    def solve(
        self, s: complex, right: Shaped[np.ndarray, "q k"], held: tuple[int, ...] = ()
    ) -> Shaped[np.ndarray, "q k"]:
        """Solve (K + s C + s^2 M) u = right with u = 0 at the held coordinates."""
        from scipy.sparse.linalg import LinearOperator, gmres

        free = np.delete(np.arange(self.bed.size), list(held))
        result = np.zeros(right.shape, np.result_type(right, s))
        near = (self.stiffness + s * self.damping + s * s * self.mass)[free][:, free]
        largest = float(np.abs(near.diagonal()).max())

        def product(u: np.ndarray) -> np.ndarray:
            extended = np.zeros(self.bed.size, u.dtype)
            extended[free] = u
            return self.dynamic_stiffness_times(s, extended)[free]

        operator = LinearOperator(near.shape, product, dtype=result.dtype)
        conditioner = LinearOperator(near.shape, _triangular_factors(near).solve, dtype=result.dtype)
        for k in range(right.shape[1]):
            column, u = right[free, k].astype(result.dtype), None
            size = float(np.linalg.norm(column))
            before = np.inf
            for _ in range(MAXIMUM_CYCLES):
                u, _ = gmres(operator, column, u, rtol=PRECISION, restart=CYCLE, maxiter=1, M=conditioner)
                noise = NOISE * largest * float(np.abs(u).max())
                left = float(np.linalg.norm(column - product(u)))
                if left <= max(PRECISION * size, noise) or left > 0.5 * before:
                    break
                before = left
            if left > max(PRECISION * size, noise) and self.has_all_modes:
                full = self.full_stiffness + s * self.full_damping + s * s * self.mass
                u = np.linalg.solve(np.asarray(full)[np.ix_(free, free)], column)
            elif left > max(STALLED * size, noise):
                raise InputError(
                    "the equations of small motions could not be solved; start from a settled bed"
                )
            result[free, k] = u
        return result

    def effective_mass_at(self, coordinate: int) -> float:
        """Return the force on a coordinate divided by its initial acceleration [kg]; all others are free."""
        from scipy.sparse.linalg import spsolve

        unit = np.zeros(self.bed.size)
        unit[coordinate] = 1.0
        return 1.0 / float(spsolve(self.mass, unit)[coordinate])

    def is_stable(self, held: tuple[int, ...]) -> bool:
        """Return whether the stiffness with some coordinates held is positive definite."""
        if not self.has_all_modes:
            return bool(self.lowest_eigenvalues_and_modes(1, held)[0][0] > 0.0)
        free = np.delete(np.arange(self.bed.size), list(held))
        with contextlib.suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(self.full_stiffness[free][:, free])
            return True
        return False

    def lowest_eigenvalues_and_modes(
        self, count: int, held: tuple[int, ...] = ()
    ) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "q k"]]:
        """Find the lowest eigenvalues [N/m] and eigenvectors of the stiffness, with some coordinates held."""
        free = np.delete(np.arange(self.bed.size), list(held))
        count = min(count, len(free))
        vectors = np.zeros((self.bed.size, count))
        if self.has_all_modes:
            from scipy.linalg import eigh

            values, vectors[free] = eigh(self.full_stiffness[free][:, free], subset_by_index=[0, count - 1])
            return values, vectors
        from scipy.sparse.linalg import LinearOperator, eigsh

        def apply_to_free_coordinates(
            function: Callable[[np.ndarray], np.ndarray], u: np.ndarray
        ) -> np.ndarray:
            extended = np.zeros(self.bed.size)
            extended[free] = u.ravel()
            return function(extended)[free]

        shape = (len(free), len(free))
        solve = functools.partial(
            apply_to_free_coordinates, lambda u: self.solve(0.0, u[:, None], held)[:, 0]
        )
        inverse = LinearOperator(shape, solve, dtype=float)
        product = LinearOperator(
            shape, functools.partial(apply_to_free_coordinates, self.stiffness_times), dtype=float
        )
        values, vectors[free] = eigsh(product, count, sigma=0.0, OPinv=inverse, tol=1e-6)
        order = np.argsort(values)
        return values[order], vectors[:, order]


def make_pencil(bed: BedForces, at: Float[np.ndarray, "q"]) -> Pencil:
    """Compute the matrices of small motions about the coordinates ``at`` [m]."""
    assemble = functools.partial(_near_matrix_from_products, *_column_groups_and_near_pattern(bed, at))
    stiffness_times = functools.partial(bed.stiffness_times, at)
    stiffness = _correct_diagonal_for_far_pairs(
        assemble(stiffness_times, bed.size), stiffness_times, bed.grains
    )
    diagonal = _damping_matrix_if_diagonal(bed, at)
    damping = diagonal
    if damping is None:
        damping = assemble(functools.partial(bed.damping_matrix_times, at), bed.size)
    return Pencil(bed, at, stiffness, damping, bed.mass_matrix(), diagonal is not None)


def _triangular_factors(matrix: csc_matrix) -> Any:
    """Factorise a matrix with a symmetric pattern of nonzero entries into triangular matrices."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    symmetric = {"SymmetricMode": True}
    try:
        return splu(csc_matrix(matrix), "MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options=symmetric)
    except RuntimeError:
        raise InputError(
            "a coordinate has no stiffness: a grain has no neighbours, or a body has no spring"
        ) from None


def multiply_complex_vector(
    product: Callable[[np.ndarray], np.ndarray], u: Shaped[np.ndarray, "q"]
) -> np.ndarray:
    """Product of a real matrix with a real or complex vector."""
    return product(u.real) + 1j * product(u.imag) if np.iscomplexobj(u) else product(u)


def _damping_matrix_if_diagonal(bed: BedForces, at: Float[np.ndarray, "q"]) -> csc_matrix | None:
    """Return the damping matrix if it is diagonal except for the machine's bodies; otherwise None."""
    from scipy.sparse import block_diag, diags

    trial = np.random.default_rng(0).uniform(0.5, 1.0, bed.size)
    trial[bed.pistons :] = 0.0
    unit_velocities = np.where(trial > 0.0, 1.0, 0.0)
    diagonal = bed.damping_matrix_times(at, unit_velocities)
    error = np.abs(bed.damping_matrix_times(at, trial) - trial * diagonal).max()
    if error > 1e-9 * np.abs(diagonal).max(initial=0.0):
        return None
    blocks = [diags(diagonal[: bed.pistons])]
    if bed.machine is not None:
        blocks.append(bed.machine.damping_matrix(bed.size, bed.piston)[bed.pistons :, bed.pistons :])
    return block_diag(blocks, format="csc")


def _full_matrix_from_products(
    product: Callable[[np.ndarray], np.ndarray], size: int
) -> Float[np.ndarray, "q q"]:
    result = np.empty((size, size))
    for column, direction in enumerate(np.eye(size)):
        result[column] = product(direction)
    return 0.5 * (result + result.T)


def _near_matrix_from_products(
    groups: list[np.ndarray], near: csc_matrix, product: Callable[[np.ndarray], np.ndarray], size: int
) -> csc_matrix:
    """Compute the nonzero entries of ``near`` with one matrix-vector product per group of columns."""
    from scipy.sparse import csc_matrix

    values = np.zeros(near.nnz)
    for columns in groups:
        direction = np.zeros(size)
        direction[columns] = 1.0
        response = product(direction)
        for column in columns:
            entries = slice(near.indptr[column], near.indptr[column + 1])
            values[entries] = response[near.indices[entries]]
    result = csc_matrix((values, near.indices, near.indptr), near.shape)
    return csc_matrix(0.5 * (result + result.T))


def _correct_diagonal_for_far_pairs(
    near: csc_matrix, product: Callable[[np.ndarray], np.ndarray], grains: int
) -> csc_matrix:
    """Correct the diagonals of ``near`` so that a uniform shift gives the forces of all pairs."""
    from scipy.sparse import csc_matrix, diags

    # Otherwise long waves, which distant grains follow, would be much too stiff and GMRES slow in large beds.
    x, y = np.zeros((2, near.shape[0]))
    x[:grains], y[grains : 2 * grains] = 1.0, 1.0
    of_x, of_y = product(x) - near @ x, product(y) - near @ y
    own = np.zeros(near.shape[0])
    own[: 2 * grains] = np.concatenate([of_x[:grains], of_y[grains : 2 * grains]])
    cross = np.zeros(near.shape[0] - grains)
    cross[:grains] = 0.5 * (of_x[grains : 2 * grains] + of_y[:grains])
    return csc_matrix(near + diags(own) + diags([cross, cross], [grains, -grains]))


def _column_groups_and_near_pattern(
    bed: BedForces, at: Float[np.ndarray, "q"]
) -> tuple[list[np.ndarray], csc_matrix]:
    """Return groups of columns that have no nonzero row in common, and the sparsity pattern of near pairs."""
    from scipy.sparse import bmat, csc_matrix, identity
    from scipy.spatial import cKDTree

    n, rest = bed.grains, bed.size - 2 * bed.grains
    periods = bed.scene.cell.periods
    points = bed.positions(at)
    tree = cKDTree(points if periods is None else points % periods, boxsize=periods)
    shells = tree.query(tree.data, min(NEIGHBOURS + 1, n))[0].reshape(n, -1)[:, -1]
    reach = float(np.quantile(shells, 0.9))
    pairs = tree.sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    grains = csc_matrix((np.ones(pairs.nnz), (pairs.row, pairs.col)), (n, n))
    grains = grains + identity(n)
    near = bmat([[grains, grains], [grains, grains]])
    if rest:
        full = np.ones((2 * n, rest))
        near = bmat([[near, full], [full.T, np.ones((rest, rest))]])
    colours = _colour_grains_within_reach_differently(tree, 2.0 * reach)
    groups = [np.flatnonzero(colours == k) + axis * n for axis in (0, 1) for k in range(colours.max() + 1)]
    groups += [np.array([column]) for column in range(2 * n, bed.size)]
    return groups, csc_matrix(near)


def _colour_grains_within_reach_differently(tree: Any, reach: float) -> np.ndarray:
    """Colour the grains so that two grains closer than ``reach`` have different colours."""
    near = tree.query_ball_point(tree.data, reach)
    colours = np.full(tree.n, -1)
    for grain, others in enumerate(near):
        taken = set(colours[others].tolist())
        colours[grain] = next(k for k in range(len(others) + 1) if k not in taken)
    return colours
