"""Slow cycles of compression and expansion of annealed beds."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from granular.observables.plasticity import (
    DislocationSlip,
    areal_strain,
    axial_strain_difference,
    elastic_strain,
    plastic_distortion,
)
from granular.run.trajectory import Trajectory
from granular.scene.named_scenes import load_scene
from granular.scene.scene import Scene
from granular.shared.files import digest
from reduced_models.laws.annealing_bed import MODULUS, STIFFENING

Row = dict[str, Any]

SIZES = {184: 8, 368: 8}
"""Number of random starts by number of grains."""

DRAG = 0.1
"""Drag of a grain [kg/s], as in the packaged bed; about half the critical damping of its fastest mode."""

STROKE = 0.3
"""Fraction of its height by which the piston moves down and up again."""

CYCLE = 20.0
"""Duration of the cycle [s]."""

FRAMES, SHOWN = 0.004, 50
"""Interval between frames [s]; and between frames in a row, in frames."""

ANNEAL, COOL = 15.0, 3.0
"""Durations [s] of the bath below melting, and of drag only before the cycle."""

WARM = 0.07
"""Temperature of the annealing over the energy of a pair at the mean spacing; a crystal melts near
0.100."""

_UNIT = 5.68e-4


def annealing_scene(count: int, seed: int) -> Scene:
    """Return a bed with the packing of full compression in a heat bath below melting."""
    changes: dict[str, Any] = {
        "effects.drag": None,
        "effects.bath": {"temperature": WARM * _UNIT, "rate": 5.0, "seed": seed},
        "protocol": [{"name": "anneal", "kind": "hold", "duration": ANNEAL}],
        "output.frames": ANNEAL,
        "output.scalars": 0.05,
    }
    return _uncompressed_bed_scene(count, seed).replace(**changes)


def cycle_scene(count: int, seed: int, annealed: Trajectory) -> Scene:
    """Return the annealed bed, cooled by its drag, then compressed and decompressed."""
    places = annealed.dataset["position"].values[-1]
    height = _full_compression_height_in_diameters(count)
    half = 0.5 * CYCLE
    changes: dict[str, Any] = {
        "effects.drag.coefficient": DRAG,
        "arrangement": {"positions": places.tolist()},
        "protocol": [
            {"name": "cool", "kind": "hold", "duration": COOL},
            {
                "name": "compress",
                "kind": "move",
                "to": _length_text_in_diameters(height * (1.0 - STROKE)),
                "duration": half,
            },
            {"name": "expand", "kind": "move", "to": _length_text_in_diameters(height), "duration": half},
        ],
        "output.frames": FRAMES,
        "output.scalars": FRAMES,
    }
    return _uncompressed_bed_scene(count, seed).replace(**changes)


def _uncompressed_bed_scene(count: int, seed: int) -> Scene:
    height = _full_compression_height_in_diameters(count)
    return load_scene("bed").replace(
        **{
            "name": f"cycle-{count}-{seed}",
            "grains.count": count,
            "cell.width": _length_text_in_diameters(60.0 * math.sqrt(count / 368)),
            "piston.height": _length_text_in_diameters(height),
            "arrangement.height": _length_text_in_diameters(height - 1.0),
            "arrangement.seed": seed,
        }
    )


def _full_compression_height_in_diameters(count: int) -> float:
    return 20.0 * math.sqrt(count / 368)


def _length_text_in_diameters(number: float) -> str:
    return f"{number!r} D"


def time_height_and_stress_ratio(run: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time [s], height of the piston [m], and w = (p_y - p_x)/(p_y + p_x) from the wall forces."""
    data = run.dataset
    height = data["piston_height"].values
    down = 0.5 * (data["piston_force"].values + data["bottom_force"].values)
    sideways = 0.5 * (data["left_force"].values + data["right_force"].values)
    first, second = down / run.scene.cell.width, sideways / height
    return data["time"].values, height, (first - second) / (first + second)


def plastic_strain_by_annealing_law(height: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Return the plastic strain since the first sample by the law `annealing-bed` of an ordered bed.

    With w' = -(modulus/z)(z' + plastic flow) and w measured at the walls it is the strain log z plus w over
    the modulus.
    """
    stiff = MODULUS * (1.0 + STIFFENING)
    return np.asarray(np.log(height / height[0]) + (stress - stress[0]) / stiff)


def key_of_cycle_row(case: tuple[int, int]) -> str:
    """Return the key of the row of a number of grains and a seed."""
    setting = annealing_scene(*case).to_plain(), STROKE, CYCLE, COOL, FRAMES, DRAG
    return f"{case[0]}-{case[1]}-{digest(setting, 8)}"


def simulate_and_measure_cycle(case: tuple[int, int]) -> Row:
    """Return strains over one cycle of a number of grains and a seed, at every `SHOWN`-th frame.

    Returns
    -------
    dict
        ``time`` [s]; ``driven``, ``plastic`` (of the bed by its bonds), ``law``, ``moves``,
        ``events`` and ``rim`` as yy less xx; ``climb``, the area change by dislocations; and
        ``conserved``, ``tracks``.
    """
    from granular.run.simulation import simulate

    count, seed = case
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # as of `temperature.simulate_and_measure_bed`
        annealed = simulate(annealing_scene(count, seed), progress=False)
        run = simulate(cycle_scene(count, seed, annealed), progress=False)
    time, height, stress = time_height_and_stress_ratio(run)
    frame_times = run.dataset["frame_time"].values
    first = int(np.searchsorted(frame_times, COOL - 0.5 * FRAMES))
    frames = run.dataset["position"].values[first:]
    slip = plastic_distortion(frames)
    shown = np.arange(0, len(frames), SHOWN)
    at = np.searchsorted(time, frame_times[first + shown] - 0.5 * FRAMES)
    driven = np.log(height[at] / height[at[0]])
    series = {
        "time": frame_times[first + shown] - frame_times[first],
        "driven": driven,
        "plastic": driven - axial_strain_difference(elastic_strain(frames[shown])),
        "law": plastic_strain_by_annealing_law(height[at], stress[at]),
        **_dislocation_strain_by_part(slip, shown),
    }
    plain = {name: np.round(values, 5).tolist() for name, values in series.items()}
    return {
        "grains": count,
        "seed": seed,
        "conserved": slip.conserved,
        "tracks": len(slip.tracks),
        "climb": round(float(areal_strain(slip.total)[-1]), 5),
        **plain,
    }


def _dislocation_strain_by_part(slip: DislocationSlip, shown: np.ndarray) -> dict[str, np.ndarray]:
    parts = {"moves": slip.moves, "events": slip.events, "rim": slip.rim}
    return {name: axial_strain_difference(values)[shown] for name, values in parts.items()}
