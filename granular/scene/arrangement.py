"""Initial positions and velocities of the grains, from a randomly perturbed grid or a list."""

from __future__ import annotations

import math

import numpy as np

from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import CELL, PISTON, Cell, SideLine
from granular.schema.field_kinds import FieldError, PointListKind
from granular.schema.sections import Section, integer_field, quantity, section_field
from granular.shared.array_types import Float
from granular.shared.errors import SceneError

Points = tuple[tuple[float, float], ...]
GRID = {"height": None, "jitter": 0.1, "speed": 0.0, "seed": 1}
"""Keys of the grid and their defaults; these keys are not used if positions are given."""
MAX_GRAINS_WITHOUT_TREE = 1000
"""Maximum number of grains for which near pairs are found by comparing all x; else a k-d tree is used."""
_ROUNDING = 1e-9
"""Tolerance for rounding errors, as a fraction of the distance that is checked."""


class Arrangement(Section):
    """The initial positions and velocities of the grains.

    Attributes
    ----------
    height : float or None
        Height up to which the grid fills the cell [m]; default: the piston's height. In a periodic cell the
        grid fills the whole cell, and every other row is shifted by half a spacing. Without jitter this is a
        triangular lattice, if such a lattice fits the cell.
    jitter : float
        Maximum random displacement of each grain along each axis, as a fraction of the grid's spacing.
    speed : float
        Initial speed, in random directions [m/s].
    seed : int
        Seed of the random numbers.
    positions, velocities : pairs of float, or None
        Position [m] and velocity [m/s] of each grain. If positions are given, the keys above are not used;
        velocities default to zero.
    """

    height: float | None = quantity("m", above=0.0, default=None, optional=True)
    jitter: float = quantity("1", default=0.1, least=0.0, below=0.5)
    speed: float = quantity("m/s", default=0.0, least=0.0)
    seed: int = integer_field(default=1)
    positions: Points | None = section_field(PointListKind(True, unit="m"), default=None)
    velocities: Points | None = section_field(PointListKind(True, unit="m/s"), default=None)

    def validate(self) -> None:
        """Check that velocities are given only with positions, and positions without keys of the grid."""
        if self.velocities is not None:
            if self.positions is None:
                raise FieldError(
                    "are given without positions; give positions, or remove the velocities", "velocities"
                )
            if len(self.velocities) != len(self.positions):
                raise FieldError(
                    f"holds {len(self.velocities)} pairs for {len(self.positions)} positions; give one pair "
                    "per position",
                    "velocities",
                )
        for name, default in GRID.items():
            if self.positions is not None and getattr(self, name) != default:
                remedy = "give velocities" if name == "speed" else "remove it"
                raise FieldError(f"applies only to the grid, but positions are given; {remedy}", name)


def initial_positions_and_velocities(
    plan: Arrangement, grains: Grains, cell: Cell, piston: Piston | None, *, overlapping: bool
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Return the initial positions [m] and velocities [m/s] of the grains."""
    count = grains.count
    if plan.positions is not None:
        positions = np.array(plan.positions, dtype=float).reshape(count, 2)
        velocities = np.zeros_like(positions)
        if plan.velocities is not None:
            velocities[:] = np.array(plan.velocities, dtype=float).reshape(count, 2)
    else:
        positions, velocities = _grid_positions_and_velocities(plan, grains, cell, piston)
    check_positions_free_of_overlap(positions, grains, cell, piston, overlapping=overlapping)
    return positions, velocities


def _grid_positions_and_velocities(
    plan: Arrangement, grains: Grains, cell: Cell, piston: Piston | None
) -> tuple[np.ndarray, np.ndarray]:
    count, width = grains.count, cell.width
    periodic = cell.periods is not None
    height = cell.height if periodic else plan.height
    if periodic and plan.height is not None:
        raise SceneError("arrangement.height: a periodic cell is filled completely; remove the key")
    if height is None:
        if piston is None:
            raise SceneError("arrangement.height: is missing, and there is no piston; give the height")
        height = piston.height
    if count == 0:
        return np.zeros((0, 2)), np.zeros((0, 2))
    if cell.is_polygon:
        sites, mesh = _polygon_grid_sites_and_spacing(count, height, cell, piston)
    else:
        # Rows of a triangular lattice are sqrt(3)/2 of a spacing apart; the grid in a closed cell is nearly
        # square.
        flat = math.sqrt(0.75) if periodic else 1.0
        columns = max(1, round(math.sqrt(count * width / height * flat)))
        rows = -(-count // columns)
        # The outermost grains are one spacing from the walls, which repel about as strongly as grains.
        edge = 0 if periodic else 1
        mesh = np.array([width / (columns + edge), height / (rows + edge)])
        sites = np.stack([np.arange(count) % columns, np.arange(count) // columns], axis=1) + edge
        if periodic:
            sites = sites + np.stack([0.25 + 0.5 * (sites[:, 1] % 2), np.full(count, 0.5)], axis=1)
    widest = max(specy.diameter for specy in grains.species)
    distance = mesh.min()
    if periodic:
        distance = min(mesh[0], math.hypot(0.5 * mesh[0], mesh[1]))
    if distance * (1.0 - 2.0 * plan.jitter) < widest:
        raise SceneError(
            f"{count} grains are {distance:.4g} m apart in the grid; with a jitter of {plan.jitter:g}, "
            f"grains of {widest:.4g} m diameter could overlap; use fewer grains, less jitter, or a larger "
            "cell"
        )
    random = np.random.default_rng(plan.seed)
    offset = random.uniform(-plan.jitter, plan.jitter, (count, 2))
    angle = random.uniform(0.0, 2.0 * math.pi, count)
    positions = (sites + offset) * mesh
    velocities = plan.speed * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return positions, velocities


def _polygon_grid_sites_and_spacing(
    count: int, height: float, cell: Cell, piston: Piston | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return sites, lowest first, and spacing [m] of a square grid that fills a polygon up to a height."""
    spacing, lines = math.sqrt(cell.width * height / count), _side_lines_to_keep_clear_of(cell, piston)
    top = 0.0 if piston is None else piston.height
    while True:
        columns = np.arange(-math.floor(0.5 * cell.width / spacing), cell.width / spacing)
        sites = np.array([(x, y) for y in np.arange(1, height / spacing - 0.5) for x in columns + 0.5])
        sites = sites.reshape(-1, 2) + np.array([0.5 * cell.width / spacing, 0.0])
        # As in a rectangle, no grain is closer to a wall than one spacing.
        free = [
            line.distances_from_side(sites * spacing, top) >= (1.0 - _ROUNDING) * spacing for line in lines
        ]
        sites = sites[np.all(free, axis=0)]
        if len(sites) >= count:
            return sites[:count], np.array([spacing, spacing])
        spacing *= 0.99


def check_positions_free_of_overlap(
    positions: Float[np.ndarray, "n 2"],
    grains: Grains,
    cell: Cell,
    piston: Piston | None,
    *,
    overlapping: bool,
) -> None:
    """Check that no grain overlaps a wall, the piston or another grain; positions [m]."""
    radius = grains.diameters() / 2.0
    if cell.periods is None:
        top = 0.0 if piston is None else piston.height
        for line in _side_lines_to_keep_clear_of(cell, piston):
            _check_distance_from_wall(line.distances_from_side(positions, top) - radius, line)
    else:
        positions = cell.wrap_positions(positions)
    if not overlapping:
        _check_overlaps(positions, radius, cell)


def _side_lines_to_keep_clear_of(cell: Cell, piston: Piston | None) -> list[SideLine]:
    return [line for line in cell.lines if line.body == CELL or piston is not None]


def _check_overlaps(positions: np.ndarray, radius: np.ndarray, cell: Cell) -> None:
    pairs = _grain_pairs_within_reach(positions, 2.0 * float(radius.max(initial=0.0)), cell)
    displacement = cell.nearest_image_displacements(positions[pairs[:, 0]] - positions[pairs[:, 1]])
    gap, needed = np.linalg.norm(displacement, axis=1), radius[pairs].sum(axis=1)
    if (gap < needed).any():
        worst = int((needed - gap).argmax())
        i, j = pairs[worst]
        raise SceneError(
            f"grains {i} and {j} overlap: their centres are {gap[worst]:.4g} m apart, but "
            f"{needed[worst]:.4g} m are needed; use fewer grains, a larger cell or less jitter"
        )


def _grain_pairs_within_reach(positions: np.ndarray, reach: float, cell: Cell) -> np.ndarray:
    """Return pairs (k, 2) of grains, including all pairs closer than ``reach`` [m]."""
    if len(positions) <= MAX_GRAINS_WITHOUT_TREE:
        distance = positions[:, None, 0] - positions[:, 0]
        if cell.periods is not None:
            distance -= cell.periods[0] * np.round(distance / cell.periods[0])
        first, second = np.nonzero(np.abs(distance) <= (1.0 + _ROUNDING) * reach)
        return np.stack([first, second], axis=1)[first < second]
    from scipy.spatial import cKDTree  # its import takes longer than the checks of a small bed

    tree = cKDTree(positions, boxsize=cell.periods)
    return np.asarray(tree.query_pairs(reach, output_type="ndarray"))


def _check_distance_from_wall(gap: np.ndarray, line: SideLine) -> None:
    if len(gap) and gap.min() < 0.0:
        grain, remedy = int(gap.argmin()), "move the grain, or enlarge the cell"
        if line.body == PISTON:
            remedy = "raise piston.height or lower arrangement.height"
        raise SceneError(
            f"grain {grain} extends {-gap[grain]:.4g} m into {line.label}, the limit is 0 m; {remedy}"
        )
