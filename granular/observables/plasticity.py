"""Plastic events, and the plastic strain due to the motion of dislocations.

Plastic events are sudden drops of a force or an energy while a bed is driven.

A dislocation with the Burgers vector b (convention FS/RH, as in `granular.observables.defects`)
that moves by d changes the mean plastic distortion of the area A around it by

    d beta_ij = b_i (z x d)_j / A

where z is the unit vector out of the plane (Orowan, Proc. Phys. Soc. 52, 8, 1940; Kroener 1958). Glide shears
the area, and climb changes its size. Summed over all dislocations, A d beta_ij is the change of sum b_i (z x
r)_j. A pair of dislocations with opposite Burgers vectors that appears or vanishes at a finite separation
therefore contributes as if one of them had moved by this separation.

The plastic strain of the bed is the strain imposed by the piston minus the elastic strain of the bonds
between neighbours. With the texture M = <r r> over the bonds, the elastic strain is (1/2) log M (Graner,
Dollet, Raufaste and Marmottant, Eur. Phys. J. E 25, 349, 2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.observables.defect_tracks import (
    DefectEvent,
    DefectTrack,
    burgers_conserving_fraction,
    detect_defects_in_frames,
    find_defect_events,
    link_defect_tracks,
)
from granular.observables.defects import CORE, FrameDefects, lattice_to_plane
from granular.observables.frame import checked_frames, checked_series
from granular.observables.voronoi import VoronoiCells, voronoi_cells
from granular.shared.array_types import Bool, Float, Int
from granular.shared.errors import InputError


class PlasticEvents(NamedTuple):
    """Drops of a quantity, in chronological order."""

    begin: Int[np.ndarray, "k"]  # sample at the top of each drop
    end: Int[np.ndarray, "k"]  # sample at the bottom of each drop
    size: Float[np.ndarray, "k"]  # size of each drop, in units of the quantity
    time: Float[np.ndarray, "k"]  # time at the top of each drop [s]


class DropStatistics(NamedTuple):
    """Statistics of the sizes of drops."""

    exponent: float  # tau of a density ~ size^-tau above the smallest size
    error: float  # standard error of tau
    events: int
    mean: float  # mean size, in units of the drops


def plastic_events(time: np.ndarray, values: np.ndarray, smallest_drop: float) -> PlasticEvents:
    """Find plastic events: monotonic drops of a quantity by at least ``smallest_drop``.

    Parameters
    ----------
    time : float (n,)
        Times of the samples [s], increasing.
    values : float (n,)
        Finite values in any units, such as the piston's force under compression,
        ``run.dataset["piston_force"]``.
    smallest_drop : float
        Size of the smallest drop that counts as an event, in units of the values; above 0 and larger than the
        noise.

    Returns
    -------
    PlasticEvents
        For each of k events: sample indices at the top (k,) and the bottom (k,), drop (k,) in units of the
        values, and time (k,) [s] at the top. k may be 0.

    Raises
    ------
    InputError
        If the shapes differ or are not (n,), a value is not finite, or ``smallest_drop`` is not above 0.
    """
    times, series = checked_series("time and values", time, values)
    if not np.isfinite(series).all():
        raise InputError("a value is not finite; remove such samples")
    if not smallest_drop > 0.0:
        raise InputError(
            f"smallest_drop = {smallest_drop:g}; the smallest drop that counts as an event must be above 0"
        )
    falls = np.concatenate([[False], np.diff(series) < 0.0, [False]])
    edges = np.flatnonzero(np.diff(falls.astype(np.int8)))
    begin, end = edges[::2], edges[1::2]
    size = series[begin] - series[end]
    chosen = size >= smallest_drop
    return PlasticEvents(begin[chosen], end[chosen], size[chosen], times[begin[chosen]])


def drop_statistics(sizes: np.ndarray, smallest_drop: float) -> DropStatistics:
    """Maximum-likelihood exponent of a power law of drop sizes, and the mean drop.

    The density of sizes is assumed proportional to size^-tau. For k drops, tau = 1 + k/sum
    log(size/smallest_drop), with the standard error (tau - 1)/sqrt(k) (Clauset, Shalizi and Newman, SIAM
    Review 51, 661, 2009). The power law itself is not tested.

    Parameters
    ----------
    sizes : float (k,)
        Sizes of the drops, finite, in any unit.
    smallest_drop : float
        Smallest drop that counts, above 0, in the same unit.

    Returns
    -------
    DropStatistics
        Exponent tau and its standard error, dimensionless; both are NaN for fewer than two drops, or if all
        drops equal ``smallest_drop``. Also the number of drops and the mean drop, NaN without drops, in the
        same unit as the drops.

    Raises
    ------
    InputError
        If the shape is not (k,), ``smallest_drop`` is not above 0, or a drop is below ``smallest_drop`` or
        not finite.
    """
    drops = np.asarray(sizes, dtype=np.float64)
    if drops.ndim != 1 or not np.isfinite(drops).all():
        raise InputError(
            f"drops have the shape {drops.shape} or are not finite; pass finite values of the shape (k,)"
        )
    if not smallest_drop > 0.0 or (drops < smallest_drop).any():
        raise InputError(
            f"smallest_drop = {smallest_drop:g} must be above 0 and not larger than any drop; lower it, or "
            "remove the drops below it"
        )
    count = len(drops)
    logs = float(np.log(drops / smallest_drop).sum())
    if count < 2 or logs == 0.0:
        return DropStatistics(np.nan, np.nan, count, float(drops.mean()) if count else np.nan)
    exponent = 1.0 + count / logs
    return DropStatistics(exponent, (exponent - 1.0) / float(np.sqrt(count)), count, float(drops.mean()))


class DislocationSlip(NamedTuple):
    """Plastic distortion by dislocations since the first frame."""

    moves: Float[np.ndarray, "f 2 2"]  # due to displacements relative to the surrounding grains
    events: Float[np.ndarray, "f 2 2"]  # due to births, annihilations and reactions that conserve b
    rim: Float[
        np.ndarray, "f 2 2"
    ]  # due to paths between the edge and the points at which defects enter or leave
    defects: tuple[FrameDefects, ...]
    tracks: tuple[DefectTrack, ...]
    conserved: float  # fraction of events away from the rim that conserve the Burgers vectors

    @property
    def total(self) -> np.ndarray:
        """Total plastic distortion ``moves + events + rim``, float64 (f, 2, 2), dimensionless."""
        return self.moves + self.events + self.rim


def axial_strain_difference(strain: Float[np.ndarray, "f 2 2"]) -> Float[np.ndarray, "f"]:
    """Return yy minus xx of strain tensors; a piston changes only yy if the width is constant."""
    return np.asarray(strain[:, 1, 1] - strain[:, 0, 0])


def areal_strain(strain: Float[np.ndarray, "f 2 2"]) -> Float[np.ndarray, "f"]:
    """Trace of strain tensors; the trace of a plastic strain is nonzero only if dislocations climb."""
    return np.asarray(strain[:, 0, 0] + strain[:, 1, 1])


def plastic_distortion(frames: np.ndarray) -> DislocationSlip:
    """Plastic distortion due to dislocations in frames of the same grains.

    A dislocation with the Burgers vector b that moves by d changes the mean distortion of an area A by b_i (z
    x d)_j/A, where z is the normal to the plane (Orowan, Proc. Phys. Soc. 52, 8, 1940).

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.

    Returns
    -------
    DislocationSlip
        Dimensionless distortions (f, 2, 2) since the first frame due to motion, events and the rim, each
        separately; also the defects and their tracks. A frame is valid if at least one grain and all its
        neighbours have interior cells; from the first invalid frame on, the distortion is NaN.

    Raises
    ------
    InputError
        If the shape is wrong, there are no frames, or a frame has no interior cells.
    """
    frames = checked_frames(frames, minimum_count=1)
    defects = detect_defects_in_frames(frames)
    tracks = link_defect_tracks(defects)
    spacing = float(np.mean([entry.spacing for entry in defects]))
    events = find_defect_events(tracks, frames, spacing)
    cells = [voronoi_cells(entry) for entry in frames]
    area = np.array([entry.area[mask_of_grains_with_interior_neighbours(entry)].sum() for entry in cells])
    moves, jumps, rim = np.zeros((3, len(frames), 2, 2))
    for entry in tracks:
        _add_slip_of_track(moves, entry, frames, spacing)
    for event in events:
        if not event.missing.any():
            jumps[event.frame] += _slip_of_event(event, tracks)
        elif event.kind in ("entry", "leaving"):
            known = frames[event.frame][mask_of_grains_with_interior_neighbours(cells[event.frame])]
            box = np.stack([known.min(axis=0), known.max(axis=0)])
            burgers = lattice_to_plane(event.missing, defects[event.frame].angle, spacing)
            rim[event.frame] += _slip_of_event(event, tracks)
            rim[event.frame] += slip_area_tensor(
                burgers, -glide_displacement_to_edge(event.position, burgers, box)
            )
    return DislocationSlip(
        np.cumsum(moves / area[:, None, None], axis=0),
        np.cumsum(jumps / area[:, None, None], axis=0),
        np.cumsum(rim / area[:, None, None], axis=0),
        tuple(defects),
        tuple(tracks),
        burgers_conserving_fraction(events),
    )


def slip_area_tensor(
    burgers: Float[np.ndarray, "2"], displacement: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "2 2"]:
    """Plastic distortion times area [m^2], b_i (z x d)_j, for a dislocation that moves by d (Orowan 1940)."""
    return np.outer(burgers, [-displacement[1], displacement[0]])


def glide_displacement_to_edge(
    position: Float[np.ndarray, "2"], burgers: Float[np.ndarray, "2"], box: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "2"]:
    """Shortest displacement [m], parallel to the Burgers vector, from a position to an edge of the box."""
    if (position <= box[0]).any() or (position >= box[1]).any():
        return np.zeros(2)
    along = burgers / np.linalg.norm(burgers)
    with np.errstate(divide="ignore"):
        displacements = ((box - position) / along).ravel()
    return np.asarray(along * displacements[np.argmin(np.abs(displacements))])


def _add_slip_of_track(moves: np.ndarray, track: DefectTrack, frames: np.ndarray, spacing: float) -> None:
    for k in range(1, len(track.frames)):
        before, after = track.frames[k - 1], track.frames[k]
        position = track.positions[k - 1]
        # Relative to the surrounding grains: a defect that is carried along by the bed does not slip.
        near = np.linalg.norm(frames[before] - position, axis=1) < CORE * spacing
        carried = np.nanmean(frames[after, near] - frames[before, near], axis=0)
        moves[after] += slip_area_tensor(track.burgers, track.positions[k] - position - carried)


def _slip_of_event(event: DefectEvent, tracks: Sequence[DefectTrack]) -> np.ndarray:
    """Sum `slip_area_tensor` over moves from ended tracks to the event, and from the event to new tracks."""
    total = np.zeros((2, 2))
    for track in (tracks[point] for point in event.ended):
        total += slip_area_tensor(track.burgers, event.position - track.positions[-1])
    for track in (tracks[point] for point in event.started):
        total += slip_area_tensor(track.burgers, track.positions[0] - event.position)
    return total


def elastic_strain(frames: np.ndarray) -> np.ndarray:
    """Elastic strain (1/2) log M of the bonds in the inner part of a bed, relative to the first frame.

    M = <r r> is the texture, averaged over bonds r between Voronoi neighbours (Graner, Dollet, Raufaste and
    Marmottant, Eur. Phys. J. E 25, 349, 2008). A bond is included if the cell of one of its grains and the
    cells of all neighbours of this grain are interior.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions of the grains in each frame [m]; NaN for absent grains.

    Returns
    -------
    float64 (f, 2, 2)
        Strain of each frame, dimensionless; NaN for a frame without such bonds, and for all frames if the
        first frame has no such bond.

    Raises
    ------
    InputError
        If the shape is wrong, or there are no frames.
    """
    array = checked_frames(frames, minimum_count=1)
    result = np.array([_logarithm_of_texture_tensor(frame, voronoi_cells(frame)) for frame in array])
    return np.asarray(result - result[0])


def _logarithm_of_texture_tensor(positions: np.ndarray, cells: VoronoiCells) -> np.ndarray:
    bonds = cells.neighbours[mask_of_grains_with_interior_neighbours(cells)[cells.neighbours].any(axis=1)]
    if not len(bonds):
        return np.full((2, 2), np.nan)
    arm = positions[bonds[:, 1]] - positions[bonds[:, 0]]
    values, vectors = np.linalg.eigh(arm.T @ arm / len(arm))
    return np.asarray((vectors * (0.5 * np.log(values))) @ vectors.T)


def mask_of_grains_with_interior_neighbours(cells: VoronoiCells) -> Bool[np.ndarray, "n"]:
    """Return a mask of the grains whose cell and all neighbours' cells are interior."""
    result = cells.interior.copy()
    result[cells.neighbours[~cells.interior[cells.neighbours].all(axis=1)].ravel()] = False
    return result
