"""Defects of a run in motion: tracks, speeds and events as a dataset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.observables.bond_order import global_psi6
from granular.observables.defect_clusters import KINDS, Defects, found_defects
from granular.observables.defect_tracks import (
    MEMORY,
    REACH,
    DefectEvent,
    DefectTrack,
    found_events,
    lasting_tracks,
    linked_tracks,
    motion_of_track,
)
from granular.observables.defects import in_space
from granular.observables.frames import chosen_frames
from granular.observables.voronoi import voronoi_cells
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory

LEAST = 3
"""Default of the frames in which a defect is seen at least."""


def defects_of_frames(frames: np.ndarray) -> list[Defects]:
    """`found_defects` of every frame; the direction of the lattice is followed in time.

    Parameters
    ----------
    frames : float (f, n, 2)
        Positions [m]; NaN for absent grains.

    Raises
    ------
    InputError
        If the shape is another one, or a frame has no interior cells.
    """
    array = np.asarray(frames, dtype=np.float64)
    if array.ndim != 3 or array.shape[2] != 2:
        raise InputError(f"positions of frames have the shape {array.shape}; (f, n, 2) is wanted")
    found: list[Defects] = []
    for one in array:
        cells = voronoi_cells(one)
        angle = float(np.angle(global_psi6(one, cells))) / 6.0
        if found:
            # The bond order knows it up to 60 degrees: the nearest of these is the same lattice.
            turn = np.pi / 3.0
            angle += turn * round((found[-1].angle - angle) / turn)
        found.append(found_defects(one, angle, cells))
    return found


def tracked_defects(
    run: Trajectory,
    start: float = 0.0,
    stop: float = np.inf,
    reach: float = REACH,
    memory: int = MEMORY,
    least: int = LEAST,
) -> xarray.Dataset:
    """Tracks of the defects over the frames with start <= time <= stop [s].

    Frames should follow each other so closely that a defect goes less than ``reach`` spacings in
    between. Defects are those of `found_defects`: a bed of one crystal, or of parts turned by less
    than 25 degrees.

    Parameters
    ----------
    run : Trajectory
    start, stop : float
        [s]
    reach : float
        Farthest way from frame to frame, in spacings.
    memory : int
        Frames that a defect may be out of sight.
    least : int
        Frames in which a track was seen at least; shorter ones are left out.

    Returns
    -------
    xarray.Dataset
        On ``track``: ``kind``, ``begin`` and ``end`` [s], ``burgers`` [m], ``velocity``, ``speed``,
        ``glide`` and ``climb`` [m/s], ``born`` and ``ended`` (kinds of the events; empty where the
        frames begin or end); on (``frame``, ``track``, ``axis``): ``position`` [m]; on ``event``:
        ``event_kind``, ``event_time`` [s], ``event_position`` and ``event_burgers`` [m], what came
        from the rim; on (``frame``, ``defect``): ``count``; on ``frame``: ``total_burgers`` [m].
        The attribute ``conserved`` is the share of events away from the rim whose Burgers vectors
        add up; NaN without events.

    Raises
    ------
    InputError
        If there are no such frames, a frame has no interior cells, or an option is not possible.
    """
    if least < 1:
        raise InputError(f"least {least}; take 1 frame or more")
    chosen = chosen_frames(run, start, stop)
    frames = run.scene.cell.inside(run.dataset["position"].values[chosen])
    times = run.dataset["frame_time"].values[chosen]
    found = defects_of_frames(frames)
    tracks = lasting_tracks(linked_tracks(found, reach, memory), least)
    boxes = np.stack([np.nanmin(frames, axis=1), np.nanmax(frames, axis=1)], axis=1)
    spacing = float(np.mean([one.spacing for one in found]))
    events = found_events(tracks, boxes, spacing)
    return _dataset(found, tracks, events, times, spacing)


def _dataset(
    found: Sequence[Defects], tracks: Sequence[DefectTrack], events: Sequence[DefectEvent],
    times: np.ndarray, spacing: float,
) -> xarray.Dataset:  # fmt: skip
    import xarray

    moves = [motion_of_track(one, times) for one in tracks]
    paths = np.full((len(times), len(tracks), 2), np.nan)
    for place, one in enumerate(tracks):
        paths[one.frames, place] = one.positions
    of_tracks: dict[str, tuple[Any, str, str]] = {
        "begin": ([times[one.frames[0]] for one in tracks], "s", "first seen"),
        "end": ([times[one.frames[-1]] for one in tracks], "s", "last seen"),
        "speed": ([one.speed for one in moves], "m/s", "speed"),
        "glide": ([one.glide for one in moves], "m/s", "velocity along the Burgers vector"),
        "climb": ([one.climb for one in moves], "m/s", "velocity across the Burgers vector"),
    }
    data: dict[str, Any] = {
        name: ("track", np.array(values, dtype=float), {"units": unit, "long_name": meaning})
        for name, (values, unit, meaning) in of_tracks.items()
    }
    flat = ("track", "axis")
    data["kind"] = ("track", _words(one.kind for one in tracks))
    data["burgers"] = (flat, _pairs(one.burgers for one in tracks), {"units": "m"})
    data["velocity"] = (flat, _pairs(one.velocity for one in moves), {"units": "m/s"})
    data["position"] = (("frame", "track", "axis"), paths, {"units": "m"})
    data["born"] = ("track", _words(_event_kinds(events, len(tracks), begun=True)))
    data["ended"] = ("track", _words(_event_kinds(events, len(tracks), begun=False)))
    angle = found[0].angle
    missing = _pairs(in_space(one.missing, angle, spacing) for one in events)
    data["event_kind"] = ("event", _words(one.kind for one in events))
    data["event_time"] = ("event", np.array([times[one.frame] for one in events], dtype=float),
                          {"units": "s"})  # fmt: skip
    data["event_position"] = (("event", "axis"), _pairs(one.position for one in events),
                              {"units": "m"})  # fmt: skip
    data["event_burgers"] = (("event", "axis"), missing, {"units": "m"})
    counts = [[one.kinds.count(kind) for kind in KINDS] for one in found]
    data["count"] = (("frame", "defect"), np.array(counts), {"units": "1"})
    total = _pairs(one.burgers.sum(axis=0) for one in found)
    data["total_burgers"] = (("frame", "axis"), total, {"units": "m"})
    inside = [not one.missing.any() for one in events if one.kind not in ("entry", "leaving")]
    return xarray.Dataset(
        data,
        coords={"frame_time": ("frame", times, {"units": "s"}), "defect": list(KINDS),
                "axis": ["x", "y"]},
        attrs={"conserved": float(np.mean(inside)) if inside else np.nan, "spacing": spacing},
    )  # fmt: skip


def _words(values: Any) -> np.ndarray:
    return np.array(list(values), dtype=str)


def _pairs(values: Any) -> np.ndarray:
    return np.array(list(values), dtype=float).reshape(-1, 2)


def _event_kinds(events: Sequence[DefectEvent], count: int, *, begun: bool) -> list[str]:
    kinds = [""] * count
    for one in events:
        for place in one.begun if begun else one.ended:
            kinds[place] = one.kind
    return kinds
