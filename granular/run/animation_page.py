"""A run as a page that moves: the bed, the piston's curve and its phase plane."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.scene.bed_drawing import SidePiece, side_pieces
from granular.scene.scene import Scene
from granular.schema.cell import CELL, PISTON
from granular.shared.errors import InputError
from granular.shared.html_pages import InteractivePage
from granular.shared.plotting import COLOURS

if TYPE_CHECKING:
    import xarray

TEMPLATE = Path(__file__).with_name("view.html")
MOST_VALUES = 1_500_000
"""Numbers of places and velocities that a page holds, four bytes each."""
MOST_RECORDS = 6000
HEIGHT = 640


def run_animation_page(
    scene: Scene, data: xarray.Dataset, stages: Sequence[tuple[str, float]]
) -> InteractivePage:
    """Make an interactive page that shows a run in motion: bed, piston curve and phase plane; stages [s]."""
    frames, grains = data.sizes["frame"], data.sizes["grain"]
    if not frames:
        raise InputError("the run has no frames; run it for longer, or lower output.frames")
    every = max(1, -(-frames * grains * 4 // MOST_VALUES))
    chosen = data.isel(frame=slice(None, None, every))
    top = _height_of_animated_cell(scene, data)
    plain: dict[str, Any] = {
        "width": scene.cell.width,
        "periods": scene.cell.periods,
        "diameters": scene.grains.diameters().tolist(),
        "colours": [COLOURS[k % len(COLOURS)] for k in scene.grains.species_indices()],
        "frames": chosen["frame_time"].values.tolist(),
        "position": _encode_as_base64(scene.cell.wrap_positions(chosen["position"].values)),
        "velocity": _encode_as_base64(chosen["velocity"].values),
        "stages": [{"name": name, "start": start} for name, start in stages],
        "top": top,
        "walls": [_piece_ends(piece) for piece in side_pieces(scene, CELL, top) if piece.walled],
        **_piston_curves(scene, data),
    }
    return InteractivePage.from_template(TEMPLATE, f"scene {scene.name}", plain, HEIGHT)


def _piece_ends(piece: SidePiece) -> list[list[float]]:
    return [list(piece.start), list(piece.end)]


def _piston_curves(scene: Scene, data: xarray.Dataset) -> dict[str, Any]:
    """Time, sides and heights of all pistons, and of the first the velocity; else the kinetic energy."""
    every = max(1, -(-data.sizes["time"] // MOST_RECORDS))
    part = data.isel(time=slice(None, None, every))
    further = () if scene.effects.host is None else scene.effects.host.pistons
    names = ["piston_height", *(f"{other.name}_displacement" for other in further)]
    pistons = [
        ([_piece_ends(piece) for piece in side_pieces(scene, body, 0.0)], part[name].values.tolist())
        for body, name in enumerate(names, PISTON)
        if name in part
    ]
    record: dict[str, Any] = {"time": part["time"].values.tolist(), "pistons": pistons}
    if "piston_height" not in part:
        return record | {"curve": part["kinetic_energy"].values.tolist(), "phase": None}
    height = part["piston_height"].values
    if "piston_velocity" in part:
        velocity = part["piston_velocity"].values
    else:
        velocity = np.gradient(height, part["time"].values) if len(height) > 1 else 0.0 * height
    return record | {"curve": height.tolist(), "phase": velocity.tolist()}


def _height_of_animated_cell(scene: Scene, data: xarray.Dataset) -> float:
    """Height that holds piston and grains [m]."""
    if scene.cell.height is not None:
        return scene.cell.height
    heights = data["position"].values[..., 1]
    top = float(np.nanmax(heights, initial=0.0)) + scene.grains.diameters().max(initial=0.0)
    if "frame_height" in data and scene.piston is not None:
        top = max(top, float(data["frame_height"].values.max()))
    return top


def _encode_as_base64(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
