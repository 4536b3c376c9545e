"""Link the defects of successive frames into tracks, and find their births, annihilations and reactions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.observables.bond_order import global_psi6
from granular.observables.defects import (
    BOUNDARY,
    DISLOCATION,
    KINDS,
    PAIR,
    FrameDefects,
    detect_defects,
    lattice_to_plane,
)
from granular.observables.frame import checked_frames, labelled_columns, select_frame_indices
from granular.observables.voronoi import voronoi_cells
from granular.shared.array_types import Float, Int
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory

REACH = 2.5
"""Default maximum displacement of a defect from one frame to the next, in lattice spacings."""

MEMORY = 2
"""Default maximum number of successive frames in which a defect may remain undetected."""

# Two tracks may each end up to one maximum displacement away from their event.
MEETING = 2.0 * REACH
"""Maximum distance, in lattice spacings, between ends and beginnings of tracks that belong to one event. A
defect can enter or leave through the rim only within this distance of the rim."""

SAME_TIME = 2
"""Maximum number of frames between ends and beginnings of tracks that belong to one event."""

MINIMUM_FRAMES = 3
"""Default minimum number of detections of a track; shorter tracks are omitted."""


class DefectTrack(NamedTuple):
    """The path of a defect."""

    kind: str
    lattice: Int[np.ndarray, "2"]  # Burgers vector in lattice coordinates
    frames: Int[np.ndarray, "k"]  # frames in which it was detected
    positions: Float[np.ndarray, "k 2"]  # position in each of these frames [m]
    burgers: Float[np.ndarray, "2"]  # Burgers vector, mean over the frames [m]


class DefectEvent(NamedTuple):
    """Event in which defect tracks end or begin at nearly the same position and time."""

    kind: str  # birth, annihilation, reaction, entry or leaving
    frame: int  # first frame after the event
    position: Float[np.ndarray, "2"]  # mean position of the ends and beginnings [m]
    ended: tuple[int, ...]  # indices of tracks
    started: tuple[int, ...]  # indices of tracks
    missing: Int[np.ndarray, "2"]  # Burgers vectors of started minus ended tracks: zero away from the rim


def link_defect_tracks(
    frames: Sequence[FrameDefects], reach: float = REACH, memory: int = MEMORY
) -> list[DefectTrack]:
    """Link the defects of successive frames into tracks."""
    if not reach > 0.0 or memory < 0:
        raise InputError(f"reach = {reach:g}, memory = {memory}; reach must be above 0, and memory 0 or more")
    # The detections of each track: frame number and index of the defect in that frame.
    open_tracks: list[list[tuple[int, int]]] = []
    closed: list[list[tuple[int, int]]] = []
    for number, defects in enumerate(frames):
        closed += [detections for detections in open_tracks if number - detections[-1][0] > memory + 1]
        open_tracks = [detections for detections in open_tracks if number - detections[-1][0] <= memory + 1]
        # Bound pairs are created and annihilated thermally: they have no tracks.
        known_indices = [k for k, kind in enumerate(defects.kinds) if kind != PAIR]
        taken = _assign_defects_to_tracks(
            [detections[-1] for detections in open_tracks], frames, known_indices, number, reach
        )
        for k in known_indices:
            if k in taken:
                open_tracks[taken[k]].append((number, k))
            else:
                open_tracks.append([(number, k)])
    tracks = []
    for detections in sorted(closed + open_tracks, key=lambda detections: detections[0][0]):
        first, k = frames[detections[0][0]], detections[0][1]
        positions = np.array([frames[number].positions[index] for number, index in detections])
        burgers = np.mean([frames[number].burgers[index] for number, index in detections], axis=0)
        numbers = np.array([number for number, _ in detections])
        tracks.append(DefectTrack(first.kinds[k], first.lattice[k], numbers, positions, burgers))
    return tracks


def _assign_defects_to_tracks(
    ends: list[tuple[int, int]],
    frames: Sequence[FrameDefects],
    known_indices: list[int],
    number: int,
    reach: float,
) -> dict[int, int]:
    """Match the defects of a frame to the tracks that they continue, by each track's last detection."""
    from scipy.optimize import linear_sum_assignment

    defects = frames[number]
    if not ends or not known_indices:
        return {}
    squared_reach = (reach * defects.spacing) ** 2
    # Leaving a track and a defect unlinked costs as much as the largest allowed displacement.
    costs = np.full((len(ends), len(known_indices)), 2.0 * squared_reach)
    for row, (last_frame, index) in enumerate(ends):
        for column, k in enumerate(known_indices):
            squared_displacement = _squared_displacement_between_detections(
                frames[last_frame], index, defects, k
            )
            # The squared displacement of a random walk grows with the number of frames without detection.
            if squared_displacement <= squared_reach * (number - last_frame):
                # Kept below 2: after a gap a link would otherwise cost more than no link.
                costs[row, column] = min(squared_displacement, 1.9 * squared_reach)
    # Minimum sum of squared displacements (Crocker and Grier, J. Colloid Interface Sci. 179, 298, 1996).
    rows, columns = linear_sum_assignment(costs)
    return {
        known_indices[column]: row
        for row, column in zip(rows, columns, strict=True)
        if costs[row, column] < 2.0 * squared_reach
    }


def _squared_displacement_between_detections(
    before: FrameDefects, index: int, after: FrameDefects, k: int
) -> float:
    """Return the squared displacement (of a boundary: along b); infinite if the defects differ."""
    kind, burgers = before.kinds[index], before.burgers[index]
    if kind != after.kinds[k]:
        return math.inf
    # The Burgers vector of a boundary may change.
    if kind == DISLOCATION and (before.lattice[index] != after.lattice[k]).any():
        return math.inf
    displacement = after.positions[k] - before.positions[index]
    if kind == BOUNDARY:
        return float((displacement @ burgers) ** 2 / (burgers @ burgers))
    return float(displacement @ displacement)


def find_defect_events(
    tracks: Sequence[DefectTrack], frames: Float[np.ndarray, "f n 2"], spacing: float
) -> list[DefectEvent]:
    """Find the events (births, annihilations, reactions) at which tracks begin or end; all lengths in m."""
    ends_and_starts = [
        (int(end.frames[-1]) + 1, end.positions[-1], index, -1)
        for index, end in enumerate(tracks)
        if end.frames[-1] + 1 < len(frames)
    ]
    ends_and_starts += [
        (int(end.frames[0]), end.positions[0], index, 1)
        for index, end in enumerate(tracks)
        if end.frames[0] > 0
    ]
    ends_and_starts.sort(key=lambda end: end[0])
    boxes = np.stack([np.nanmin(frames, axis=1), np.nanmax(frames, axis=1)], axis=1)
    events = []
    while ends_and_starts:
        event_ends = [ends_and_starts.pop(0)]
        growing = True
        while growing:
            growing = False
            for k, end in enumerate(ends_and_starts):
                if any(_track_ends_meet(end, other, spacing) for other in event_ends):
                    event_ends.append(ends_and_starts.pop(k))
                    growing = True
                    break
        events.append(_make_defect_event(event_ends, tracks, boxes, spacing))
    return events


TrackEnd = tuple[int, np.ndarray, int, int]


def _track_ends_meet(first: TrackEnd, other: TrackEnd, spacing: float) -> bool:
    near = float(np.linalg.norm(first[1] - other[1])) < MEETING * spacing
    return near and abs(first[0] - other[0]) <= SAME_TIME and first[2] != other[2]


def _make_defect_event(
    event_ends: list[TrackEnd], tracks: Sequence[DefectTrack], boxes: np.ndarray, spacing: float
) -> DefectEvent:
    ended = tuple(position for _, _, position, sign in event_ends if sign < 0)
    started = tuple(position for _, _, position, sign in event_ends if sign > 0)
    # Only the rim adds or removes Burgers vectors; elsewhere a nonzero sum means a missed defect.
    missing = np.sum([sign * tracks[position].lattice for _, _, position, sign in event_ends], axis=0)
    positions = np.array([event[1] for event in event_ends])
    low, high = boxes[[event[0] for event in event_ends]].transpose(1, 0, 2)
    depth = float(np.minimum(positions - low, high - positions).min())
    if depth < MEETING * spacing and missing.any():
        kind = "entry" if not ended else "leaving"
    else:
        kind = "reaction" if ended and started else "annihilation" if ended else "birth"
    return DefectEvent(
        kind, max(event[0] for event in event_ends), positions.mean(axis=0), ended, started, missing
    )


class DefectVelocity(NamedTuple):
    """Velocity of a defect: slope of the least-squares line through its path."""

    velocity: Float[np.ndarray, "2"]  # velocity along x and y [m/s]
    speed: float  # [m/s]
    glide: float  # along the Burgers vector [m/s]; NaN without one
    climb: float  # along the Burgers vector turned by +90 degrees [m/s]; NaN without one


def fit_velocity_of_track(track: DefectTrack, times: Float[np.ndarray, "f"]) -> DefectVelocity:
    """Fit the velocity [m/s] of a defect by a least-squares line through its path; ``times`` are in s."""
    if len(track.frames) < 2:
        return DefectVelocity(np.full(2, np.nan), math.nan, math.nan, math.nan)
    detection_times = np.asarray(times)[track.frames]
    velocity = np.polyfit(detection_times - detection_times.mean(), track.positions, 1)[0]
    size = float(np.linalg.norm(track.burgers))
    glide = climb = math.nan
    if size > 0.0:
        direction = track.burgers / size
        glide = float(velocity @ direction)
        climb = float(velocity @ [-direction[1], direction[0]])
    return DefectVelocity(velocity, float(np.linalg.norm(velocity)), glide, climb)


def detect_defects_in_frames(frames: Float[np.ndarray, "f n 2"]) -> list[FrameDefects]:
    """Detect the defects in every frame of positions [m]; the lattice angle is unwrapped over the frames."""
    array = checked_frames(frames, minimum_count=1)
    defects: list[FrameDefects] = []
    for frame in array:
        cells = voronoi_cells(frame)
        if not cells.interior.any():
            raise InputError("a frame has 0 grains with an interior Voronoi cell; use a larger bed")
        angle = float(np.angle(global_psi6(frame, cells))) / 6.0
        if defects:
            # The bond order gives the direction modulo 60 degrees. The value nearest to the previous
            # direction is taken.
            turn = np.pi / 3.0
            angle += turn * round((defects[-1].angle - angle) / turn)
        defects.append(detect_defects(frame, angle, cells))
    return defects


def track_defects(
    run: Trajectory,
    start: float = 0.0,
    stop: float = np.inf,
    reach: float = REACH,
    memory: int = MEMORY,
    minimum_frames: int = MINIMUM_FRAMES,
) -> xarray.Dataset:
    """Track the defects over the frames with start <= time <= stop.

    Defects are detected by `detect_defects`, which requires that the lattice direction in every part of the
    bed differs from the mean direction by less than 25 degrees. Defects of the same kind and Burgers vector
    are linked from frame to frame as in Crocker and Grier, J. Colloid Interface Sci. 179, 298 (1996), by
    `link_defect_tracks`; events are found by `find_defect_events`. Frames should be so close in time that a
    defect moves less than ``reach`` spacings between them.

    Parameters
    ----------
    run : Trajectory
        Finished or interrupted run.
    start, stop : float
        First and last time of the frames [s].
    reach : float
        Maximum displacement from frame to frame, above 0, in lattice spacings.
    memory : int
        Maximum number of frames in which a defect may go undetected, 0 or more.
    minimum_frames : int
        Minimum number of detections of a track, 1 or more; shorter tracks are omitted.

    Returns
    -------
    xarray.Dataset
        Variables by their dimensions:

        - ``track``: ``kind``; ``begin`` and ``end`` [s]; ``speed``, ``glide`` and ``climb`` [m/s];
          ``born`` and ``ended``, the kinds of the events at both ends; ``born`` is empty for tracks that
          begin in the first frame, and ``ended`` for tracks that end in the last frame.
        - (``track``, ``axis``): ``burgers`` [m] and ``velocity`` [m/s].
        - (``frame``, ``track``, ``axis``): ``position`` [m], NaN in frames without detection.
        - ``event``: ``event_kind`` and ``event_time`` [s].
        - (``event``, ``axis``): ``event_position`` [m] and ``event_burgers`` [m], the Burgers vector gained
          from the rim.
        - (``frame``, ``defect``): ``count`` of each kind of defect.
        - (``frame``, ``axis``): ``total_burgers`` [m].

        Velocities are NaN for a defect detected only once. Glide and climb are also NaN without a Burgers
        vector. The attribute ``conserved`` is the fraction of events away from the rim that conserve the sum
        of Burgers vectors, NaN without such events. The attribute ``spacing`` is the mean lattice spacing
        [m].

    Raises
    ------
    InputError
        If no frame lies in the range, a frame has no interior cells, ``reach`` is not above 0, ``memory`` is
        below 0 or ``minimum_frames`` below 1.
    """
    if minimum_frames < 1:
        raise InputError(f"minimum_frames = {minimum_frames}; 1 frame or more is needed")
    chosen = select_frame_indices(run, start, stop)
    frames = run.scene.cell.wrap_positions(run.dataset["position"].values[chosen])
    times = run.dataset["frame_time"].values[chosen]
    defects = detect_defects_in_frames(frames)
    tracks = [
        entry for entry in link_defect_tracks(defects, reach, memory) if len(entry.frames) >= minimum_frames
    ]
    spacing = float(np.mean([entry.spacing for entry in defects]))
    events = find_defect_events(tracks, frames, spacing)
    return _defect_dataset(defects, tracks, events, times, spacing)


def _defect_dataset(
    defects: Sequence[FrameDefects],
    tracks: Sequence[DefectTrack],
    events: Sequence[DefectEvent],
    times: np.ndarray,
    spacing: float,
) -> xarray.Dataset:
    import xarray

    motions = [fit_velocity_of_track(entry, times) for entry in tracks]
    paths = np.full((len(times), len(tracks), 2), np.nan)
    for point, entry in enumerate(tracks):
        paths[entry.frames, point] = entry.positions
    tracks_data = {
        "begin": ([times[entry.frames[0]] for entry in tracks], "s", "first detected"),
        "end": ([times[entry.frames[-1]] for entry in tracks], "s", "last detected"),
        "speed": ([entry.speed for entry in motions], "m/s", "speed"),
        "glide": ([entry.glide for entry in motions], "m/s", "velocity along the Burgers vector"),
        "climb": ([entry.climb for entry in motions], "m/s", "velocity perpendicular to the Burgers vector"),
    }
    angle = defects[0].angle
    missing = (lattice_to_plane(entry.missing, angle, spacing) for entry in events)
    counts = [[entry.kinds.count(kind) for kind in KINDS] for entry in defects]
    data = labelled_columns("track", tracks_data) | {
        "kind": _text_variable("track", (entry.kind for entry in tracks)),
        "burgers": _vector_variable("track", (entry.burgers for entry in tracks), "m"),
        "velocity": _vector_variable("track", (entry.velocity for entry in motions), "m/s"),
        "position": (("frame", "track", "axis"), paths, {"units": "m"}),
        "born": _text_variable("track", _event_kind_by_track(events, len(tracks), started=True)),
        "ended": _text_variable("track", _event_kind_by_track(events, len(tracks), started=False)),
        "event_kind": _text_variable("event", (entry.kind for entry in events)),
        "event_time": ("event", times[[entry.frame for entry in events]], {"units": "s"}),
        "event_position": _vector_variable("event", (entry.position for entry in events), "m"),
        "event_burgers": _vector_variable("event", missing, "m"),
        "count": (("frame", "defect"), np.array(counts), {"units": "1"}),
        "total_burgers": _vector_variable("frame", (entry.burgers.sum(axis=0) for entry in defects), "m"),
    }
    return xarray.Dataset(
        data,
        coords={"frame_time": ("frame", times, {"units": "s"}), "defect": list(KINDS), "axis": ["x", "y"]},
        attrs={"conserved": burgers_conserving_fraction(events), "spacing": spacing},
    )


def burgers_conserving_fraction(events: Sequence[DefectEvent]) -> float:
    """Fraction of the events away from the rim that conserve the Burgers vector; NaN without such events."""
    conserved = [not event.missing.any() for event in events if event.kind not in ("entry", "leaving")]
    return float(np.mean(conserved)) if conserved else np.nan


def _text_variable(dim: str, values: Iterable[str]) -> tuple[str, np.ndarray]:
    return dim, np.array(list(values), dtype=str)


def _vector_variable(dim: str, values: Iterable[np.ndarray], unit: str) -> tuple[Any, ...]:
    return (dim, "axis"), np.array(list(values), dtype=float).reshape(-1, 2), {"units": unit}


def _event_kind_by_track(events: Sequence[DefectEvent], count: int, *, started: bool) -> list[str]:
    kinds = [""] * count
    for event in events:
        for position in event.started if started else event.ended:
            kinds[position] = event.kind
    return kinds
