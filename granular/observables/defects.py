"""Defects of the hexagonal order: disclinations, dislocations and their Burgers vectors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from granular.observables.bond_order import global_psi6, local_psi6
from granular.observables.voronoi import VoronoiCells, checked_positions_and_cells, circumcentres
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

NEAREST_NEIGHBOURS = np.array([[1, 0], [0, 1], [-1, 1], [-1, 0], [0, -1], [1, -1]])
"""Nearest neighbours in the lattice, counter-clockwise from a1."""


def nearest_lattice_vector_of_bonds(arms: Float[np.ndarray, "k 2"], angle: float) -> Int[np.ndarray, "k 2"]:
    """Nearest-neighbour lattice vector closest in direction to each bond [m]; ``angle`` is in rad."""
    # Only one of an arm and its opposite is classified, so that both get exactly opposite vectors.
    back = (arms[:, 1] < 0.0) | ((arms[:, 1] == 0.0) & (arms[:, 0] < 0.0))
    x, y = np.where(back[:, None], -arms, arms).T
    index = np.round((np.arctan2(y, x) - angle) / (np.pi / 3.0)).astype(int) % 6
    return np.where(back[:, None], -NEAREST_NEIGHBOURS[index], NEAREST_NEIGHBOURS[index])


def lattice_to_plane(vectors: np.ndarray, angle: float, spacing: float) -> Float[np.ndarray, "... 2"]:
    """Convert vectors (..., 2) from lattice coordinates to the plane [m]; ``angle`` is in rad."""
    turned = angle + np.pi / 3.0
    basis = np.array([[np.cos(angle), np.sin(angle)], [np.cos(turned), np.sin(turned)]])
    return np.asarray(spacing * (np.asarray(vectors) @ basis))


def lattice_norm_squared(vectors: Int[np.ndarray, "... 2"]) -> Int[np.ndarray, "..."]:
    """Squared length m^2 + m n + n^2 of vectors of the hexagonal lattice."""
    m, n = np.moveaxis(np.asarray(vectors), -1, 0)
    return np.asarray(m * m + m * n + n * n)


def edges_of_triangles(triangles: Int[np.ndarray, "t 3"]) -> Int[np.ndarray, "t 3 2"]:
    """List the three edges of each triangle as pairs of corners."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)


def burgers_vectors(
    triangles: Int[np.ndarray, "t 3"], positions: Float[np.ndarray, "n 2"], angle: float
) -> Int[np.ndarray, "t 2"]:
    """Burgers vector of each counter-clockwise triangle in lattice coordinates; ``angle`` is in rad."""
    edges = edges_of_triangles(triangles).reshape(-1, 2)
    bonds = nearest_lattice_vector_of_bonds(positions[edges[:, 1]] - positions[edges[:, 0]], angle)
    # Integral of du over the circuit, where u is the displacement from the perfect lattice (FS/RH, Hirth and
    # Lothe 1982). The Burgers vector of a region is the sum over its triangles.
    return np.asarray(-bonds.reshape(-1, 3, 2).sum(axis=1))


def excess_grain_count(
    triangles: Int[np.ndarray, "t 3"], positions: Float[np.ndarray, "n 2"], angle: float
) -> float:
    """Return grains minus lattice sites of a region, such as -1 for a vacancy; lattice ``angle`` in rad."""
    edges = edges_of_triangles(triangles).reshape(-1, 2)
    directed_edges = {(int(i), int(j)) for i, j in edges}
    rim = {i: j for i, j in directed_edges if (j, i) not in directed_edges}
    area = 0.0
    while rim:
        start = corner = next(iter(rim))
        position = np.zeros(2)
        while corner in rim:
            next_corner = rim.pop(corner)
            bond = nearest_lattice_vector_of_bonds((positions[next_corner] - positions[corner])[None], angle)[
                0
            ]
            area += 0.5 * float(position[0] * bond[1] - position[1] * bond[0])
            position, corner = position + bond, next_corner
            if corner == start:
                break
    # For t triangles, n grains inside and k on the rim, t = 2 n + k - 2; n lattice sites inside the rim make
    # n + k/2 - 1 lattice cells (Pick's theorem).
    return 0.5 * len(triangles) - area


class Dislocations(NamedTuple):
    """Pairs of a pentagon and a neighbouring heptagon."""

    pairs: Int[np.ndarray, "d 2"]  # the grain with five neighbours, and the one with seven
    positions: Float[np.ndarray, "d 2"]  # midpoint of both [m]
    burgers: Float[np.ndarray, "d 2"]  # Burgers vectors [m]


def disclination_charges(cells: VoronoiCells) -> np.ndarray:
    """Disclination charge of each grain: 6 minus the number of its neighbours.

    (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979.)

    Parameters
    ----------
    cells : VoronoiCells
        Voronoi cells of the grains.

    Returns
    -------
    int64 (n,)
        Charge, such as 1 for a pentagon, 0 for a hexagon and -1 for a heptagon; 0 for grains without an
        interior cell.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.arange(10.0) * 9e-3  # a triangular lattice, 9 mm from grain to grain
    >>> x, y = np.meshgrid(grid, grid * 3**0.5 / 2)
    >>> x[1::2] += 4.5e-3
    >>> places = np.column_stack([x.ravel(), y.ravel()])
    >>> from granular.observables import disclination_charges, voronoi_cells
    >>> int(np.nansum(np.abs(disclination_charges(voronoi_cells(places)))))
    0
    """
    return np.where(cells.interior, 6 - cells.sides, 0)


def dislocations(positions: np.ndarray, cells: VoronoiCells | None = None) -> Dislocations:
    """Find dislocations: as many pairs of neighbouring pentagons and heptagons as possible.

    Only interior cells are paired, and each belongs to at most one pair. In a cluster of defects several
    pairings can reach the maximum number of pairs; one of them is taken.

    The Burgers vector of a pair is

        b = a z x (r7 - r5)/|r7 - r5|,

    which has the direction from the pentagon (at r5) to the heptagon (at r7), turned by +90 degrees; z is the
    normal to the plane. The length a is the spacing of the hexagonal lattice whose cell area is the mean cell
    area of both grains and their neighbours. A circuit around such a pair, mapped onto the perfect lattice,
    always fails to close by one lattice vector perpendicular to r7 - r5. The sign of b is the sign of the
    integral of du over a counter-clockwise circuit, where u is the displacement from the perfect lattice.
    This is the convention FS/RH of Hirth and Lothe (Theory of Dislocations, 1982), with the line direction
    out of the plane. A dislocation with b = +a x has its extra half row, and the pentagon, above.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    Dislocations
        Pairs (d, 2), positions (d, 2) [m] and Burgers vectors (d, 2) [m]; d is 0 without such pairs.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), or ``cells`` has another number of grains.
    """
    positions, cells = checked_positions_and_cells(positions, cells)
    pairs = _match_pentagons_to_heptagons(cells)
    five, seven = positions[pairs[:, 0]], positions[pairs[:, 1]]
    arm = seven - five
    across = np.stack([-arm[:, 1], arm[:, 0]], axis=1) / np.linalg.norm(arm, axis=1)[:, None]
    spacing = np.sqrt(2.0 / np.sqrt(3.0) * _mean_cell_areas_of_pairs(cells, pairs))
    return Dislocations(pairs, 0.5 * (five + seven), spacing[:, None] * across)


def count_defects(cells: VoronoiCells) -> dict[str, float]:
    """Count disclinations (non-hexagonal interior cells), dislocations and unpaired disclinations."""
    number = int(np.count_nonzero(disclination_charges(cells)))
    pairs = len(_match_pentagons_to_heptagons(cells))
    return {"disclinations": number, "dislocations": pairs, "unpaired": number - 2 * pairs}


def _match_pentagons_to_heptagons(cells: VoronoiCells) -> np.ndarray:
    """Find the largest set of disjoint neighbour pairs (pentagon, heptagon), an int array (d, 2)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    charge = disclination_charges(cells)
    directed_pairs = np.concatenate([cells.neighbours, cells.neighbours[:, ::-1]])
    directed_pairs = directed_pairs[
        (charge[directed_pairs[:, 0]] == 1) & (charge[directed_pairs[:, 1]] == -1)
    ]
    if not len(directed_pairs):
        return np.empty((0, 2), dtype=np.intp)
    fives, rows = np.unique(directed_pairs[:, 0], return_inverse=True)
    sevens, columns = np.unique(directed_pairs[:, 1], return_inverse=True)
    # Older releases of SciPy accept only 32-bit indices for matching.
    indices = (rows.astype(np.int32), columns.astype(np.int32))
    graph = csr_array((np.ones(len(directed_pairs), dtype=bool), indices))
    partner = maximum_bipartite_matching(graph, perm_type="column")
    return np.stack([fives[partner >= 0], sevens[partner[partner >= 0]]], axis=1)


def _mean_cell_areas_of_pairs(cells: VoronoiCells, pairs: np.ndarray) -> np.ndarray:
    """Mean area (d,) [m^2] of the interior cells of each pair and of the pair's neighbours."""
    owner = np.full(len(cells.sides), -1)
    owner[pairs.ravel()] = np.repeat(np.arange(len(pairs)), 2)
    directed_pairs = np.concatenate([cells.neighbours, cells.neighbours[:, ::-1]])
    directed_pairs = directed_pairs[(owner[directed_pairs[:, 0]] >= 0) & cells.interior[directed_pairs[:, 1]]]
    # Neighbours of both grains of a pair, and the pair itself, count once.
    chosen = np.unique(np.stack([owner[directed_pairs[:, 0]], directed_pairs[:, 1]], axis=1), axis=0)
    total = np.bincount(chosen[:, 0], cells.area[chosen[:, 1]], minlength=len(pairs))
    return np.asarray(total / np.bincount(chosen[:, 0], minlength=len(pairs)))


DISLOCATION, DISCLINATION, VACANCY, INTERSTITIAL, PAIR, BOUNDARY = KINDS = (
    "dislocation",
    "disclination",
    "vacancy",
    "interstitial",
    "bound pair",
    "grain boundary",
)

# Dislocations at this distance from each other turn the lattice by 1/7 rad, 8 degrees.
BOUNDARY_LINK = 7.0
"""Maximum distance between neighbouring dislocations in a grain boundary, in lattice spacings."""

MINIMUM_BOUNDARY_SIZE = 5
"""Minimum number of dislocations in a grain boundary; their Burgers vectors must not cancel."""


# Includes the shells at 1, sqrt(3) and 2 spacings, but not the next one, at sqrt(7).
CORE = 2.6
"""Radius, in lattice spacings, of the region whose disorder determines a dislocation's position."""

_CENTRINGS = 3


class FrameDefects(NamedTuple):
    """The defects of a frame."""

    kinds: tuple[str, ...]  # of `KINDS`
    positions: Float[np.ndarray, "d 2"]  # position of each defect [m]
    lattice: Int[np.ndarray, "d 2"]  # Burgers vectors in lattice coordinates
    burgers: Float[np.ndarray, "d 2"]  # Burgers vectors in the plane [m]
    charge: Int[np.ndarray, "d"]  # sum of (6 minus the number of neighbours) over the cluster
    sizes: Int[np.ndarray, "d"]  # number of grains without six neighbours
    angle: float  # direction of the lattice [rad]
    spacing: float  # spacing of the lattice with the mean cell area [m]


class _DefectCluster(NamedTuple):
    kind: str
    position: np.ndarray
    lattice: np.ndarray
    charge: int
    size: int


def detect_defects(
    positions: np.ndarray, angle: float | None = None, cells: VoronoiCells | None = None
) -> FrameDefects:
    """Detect defects of the hexagonal order: clusters of adjacent grains that do not have six neighbours.

    Each cluster is classified by the Burgers circuit around it (Hirth and Lothe, Theory of Dislocations,
    1982; see `granular.observables.defects.burgers_vectors`). A cluster with a charge is a disclination; a
    cluster without charge but with a Burgers vector is a dislocation. A cluster with neither is a vacancy if
    the circuit encloses fewer grains than lattice sites, and an interstitial if it encloses more. If the
    numbers are equal, the cluster is a bound pair of dislocations; thermal motion creates and annihilates
    such pairs. A grain boundary consists of `MINIMUM_BOUNDARY_SIZE` or more dislocations, each less than
    `BOUNDARY_LINK` spacings from the next. The magnitude of the sum of their Burgers vectors must be at least
    half the sum of the magnitudes. Clusters at the rim, where cells are not interior, are incomplete and are
    omitted, except grain boundaries.

    Parameters
    ----------
    positions : float (n, 2)
        Positions of the grains [m]; NaN for absent grains.
    angle : float, optional
        Direction of the lattice [rad], modulo 60 degrees; the direction of the mean bond order if not given.
        Every part of the bed should be turned from this direction by less than 25 degrees.
    cells : VoronoiCells, optional
        Voronoi cells of these positions, if already computed.

    Returns
    -------
    FrameDefects
        Kinds (d,), positions (d, 2) [m], Burgers vectors (d, 2) [m] and charges (d,) of the defects; d is 0
        without defects.

    Raises
    ------
    InputError
        If the positions do not have the shape (n, 2), ``cells`` has another number of grains, or no grain has
        an interior cell.
    """
    positions, cells = checked_positions_and_cells(positions, cells)
    if not cells.interior.any():
        raise InputError("0 grains have an interior Voronoi cell; use a larger bed")
    if angle is None:
        angle = float(np.angle(global_psi6(positions, cells))) / 6.0
    area = float(cells.area[cells.interior].mean())
    spacing = math.sqrt(2.0 / math.sqrt(3.0) * area)
    clusters = _join_grain_boundaries(_cluster_defects(positions, cells, angle, spacing), spacing)
    lattice = np.array([cluster.lattice for cluster in clusters], dtype=int).reshape(-1, 2)
    return FrameDefects(
        kinds=tuple(cluster.kind for cluster in clusters),
        positions=np.array([cluster.position for cluster in clusters], dtype=float).reshape(-1, 2),
        lattice=lattice,
        burgers=lattice_to_plane(lattice, angle, spacing),
        charge=np.array([cluster.charge for cluster in clusters], dtype=int),
        sizes=np.array([cluster.size for cluster in clusters], dtype=int),
        angle=angle,
        spacing=spacing,
    )


def _cluster_defects(
    positions: np.ndarray, cells: VoronoiCells, angle: float, spacing: float
) -> list[_DefectCluster]:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    count = len(positions)
    triangles = cells.triangles
    bonds = np.unique(np.sort(edges_of_triangles(triangles).reshape(-1, 2), axis=1), axis=0)
    # Bonds of the triangulation: the circuits need a bond among four grains on one circle too.
    degree = np.bincount(bonds.ravel(), minlength=count)
    defective = cells.interior & (degree != 6)
    defect_bonds = bonds[defective[bonds].all(axis=1)]
    graph = csr_array(
        (np.ones(len(defect_bonds)), (defect_bonds[:, 0], defect_bonds[:, 1])), shape=(count, count)
    )
    _, owner = connected_components(graph, directed=False)
    owner = np.where(defective, owner, -1)
    at_rim = np.zeros(count, dtype=bool)
    at_rim[bonds[~cells.interior[bonds].all(axis=1)].ravel()] = True
    vectors = burgers_vectors(triangles, positions, angle)
    of_triangle = owner[triangles].max(axis=1, initial=-1)
    order = np.abs(local_psi6(positions, cells))
    disorder = np.where(cells.interior & np.isfinite(order), 1.0 - order, 0.0)
    result = []
    for label in np.unique(owner[defective]):
        members = np.flatnonzero(owner == label)
        region = triangles[of_triangle == label]
        lattice = vectors[of_triangle == label].sum(axis=0)
        charge = int((6 - degree[members]).sum())
        kind = DISCLINATION if charge else DISLOCATION
        if not charge and not lattice.any():
            excess = round(excess_grain_count(region, positions, angle))
            kind = VACANCY if excess < 0 else INTERSTITIAL if excess > 0 else PAIR
        if at_rim[members].any():
            # Clusters at the rim are seen only in part. Only the end of a grain boundary has such a long
            # vector; it is kept to be joined to the boundary.
            if kind != BOUNDARY and lattice_norm_squared(lattice) < MINIMUM_BOUNDARY_SIZE**2 / 4:
                continue
            kind = DISLOCATION
        position = positions[members].mean(axis=0)
        if kind == VACANCY:
            position = _vacancy_centre(positions, region)
        elif kind == DISLOCATION:
            position = _dislocation_core_position(positions, disorder, position, spacing)
        result.append(_DefectCluster(kind, position, lattice, charge, len(members)))
    return result


def _dislocation_core_position(
    positions: np.ndarray, disorder: np.ndarray, position: np.ndarray, spacing: float
) -> np.ndarray:
    """Disorder-weighted centre near a point; it moves smoothly, even if the grains of the core change."""
    started = position
    for _ in range(_CENTRINGS):
        relative_distance = np.linalg.norm(positions - position, axis=1) / (CORE * spacing)
        # Weight and slope vanish at the edge, so that grains enter and leave without a jump.
        weight = np.where(relative_distance < 1.0, disorder * (1.0 - relative_distance**2) ** 2, 0.0)
        if not weight.sum() > 0.0:
            return started
        position = np.nansum(weight[:, None] * positions, axis=0) / weight.sum()
    # At larger distances the centre has moved into the disorder of another defect.
    return position if np.linalg.norm(position - started) < spacing else started


def _vacancy_centre(positions: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Centre of the largest circumcircle among the Delaunay triangles of a region."""
    corners = circumcentres(positions, region)
    radii = np.linalg.norm(corners - positions[region[:, 0]], axis=1)
    return np.asarray(corners[np.argmax(radii)])


def _join_grain_boundaries(clusters: list[_DefectCluster], spacing: float) -> list[_DefectCluster]:
    """Merge the dislocations of each grain boundary into one cluster."""
    from scipy.cluster.hierarchy import fcluster, linkage

    with_burgers = [cluster for cluster in clusters if cluster.lattice.any()]
    if (
        sum(math.sqrt(lattice_norm_squared(defect.lattice)) for defect in with_burgers)
        < MINIMUM_BOUNDARY_SIZE / 2
    ):
        return clusters
    result = [cluster for cluster in clusters if not cluster.lattice.any()]
    positions = np.array([defect.position for defect in with_burgers])
    groups = (
        fcluster(linkage(positions, "single"), BOUNDARY_LINK * spacing, "distance")
        if len(with_burgers) > 1
        else np.ones(1, dtype=int)
    )
    for group in np.unique(groups):
        members = [defect for defect, label in zip(with_burgers, groups, strict=True) if label == group]
        result += _merge_grain_boundary(members)
    return result


def _merge_grain_boundary(members: list[_DefectCluster]) -> list[_DefectCluster]:
    lengths = [math.sqrt(lattice_norm_squared(member.lattice)) for member in members]
    total = np.sum([member.lattice for member in members], axis=0)
    # A dislocation consists of two grains without six neighbours.
    dislocations = sum(member.size for member in members) / 2.0
    if dislocations < MINIMUM_BOUNDARY_SIZE or math.sqrt(lattice_norm_squared(total)) < 0.5 * max(
        sum(lengths), MINIMUM_BOUNDARY_SIZE
    ):
        return members
    sizes = np.array([member.size for member in members])
    middle = np.average([member.position for member in members], axis=0, weights=sizes)
    charge = sum(member.charge for member in members)
    return [_DefectCluster(BOUNDARY, middle, total, charge, int(sizes.sum()))]
