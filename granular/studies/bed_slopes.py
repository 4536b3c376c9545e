"""Slopes of a damper's results with respect to its parameters, averaged over random packings of the bed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.linear import Slopes, piston_roots, slopes
from granular.linear.bed_forces import check_free_piston
from granular.linear.equilibrium import (
    COARSE_REST,
    equilibrium,
    equilibrium_from,
    scene_changes_to_end_at_rest,
)
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from granular.shared.files import toolkit_cache_folder
from granular.studies.cases import keep_measure_name
from granular.studies.sweep import sweep

__all__ = ["SlopesOverBeds", "slopes_over_beds"]


class SlopesOverBeds(NamedTuple):
    """Results of small motions about several settled beds of a scene, and the slopes of these results.

    Attributes
    ----------
    seeds : tuple of int
        Random seeds of the beds' initial arrangements.
    keys : tuple of str
        Keys of the scene's numbers.
    figures : float64 (b, 3)
        Equilibrium height [m], natural frequency [Hz] and damping ratio of each bed.
    values : float64 (b, k, 3)
        Slopes of each bed: d ln (equilibrium height, frequency or damping ratio) / d ln (value of a key).
    """

    seeds: tuple[int, ...]
    keys: tuple[str, ...]
    figures: Float[np.ndarray, "b 3"]
    values: Float[np.ndarray, "b k 3"]

    @property
    def mean(self) -> Slopes:
        """Slopes averaged over the beds."""
        return Slopes(self.keys, self.values.mean(axis=0))

    @property
    def deviation(self) -> Float[np.ndarray, "k 3"]:
        """Standard deviation of the slopes over the beds."""
        return np.asarray(self.values.std(axis=0, ddof=1))

    @property
    def standard_error(self) -> Float[np.ndarray, "k 3"]:
        """Standard error of the mean slopes."""
        return np.asarray(self.deviation / np.sqrt(len(self.seeds)))

    def to_plain(self) -> dict[str, Any]:
        """Return seeds, results in SI, and the mean, deviation and error of each slope, as plain data.

        Returns
        -------
        dict of str to Any
            Results of each bed, and mean, deviation and error of the slopes for each key.
        """
        parts = {"mean": self.mean.values, "deviation": self.deviation, "error": self.standard_error}
        return {"seeds": list(self.seeds), "figures": self.figures.tolist()} | {
            name: dict(zip(self.keys, values.tolist(), strict=True)) for name, values in parts.items()
        }


def slopes_over_beds(
    scene: Scene,
    beds: int = 4,
    keys: Sequence[str] | None = None,
    *,
    out: str | Path | None = None,
    progress: bool = True,
) -> SlopesOverBeds:
    """Differentiate equilibrium height, frequency and damping ratio of several settled beds.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston; its beds use ``arrangement.seed`` and the seeds after it.
    beds : int
        Number of beds, 2 or more. They are settled in parallel on all processors.
    keys : sequence of str, optional
        Dotted keys of the scene's numbers; all keys known to `granular.linear.small_motions` if not given.
    out : str or Path, optional
        Directory in which the settled beds are stored, so that a second call can use them. If not given: a
        folder of the toolkit in the user's cache.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    SlopesOverBeds
        Results and slopes of each bed, and mean and standard deviation of the slopes.

    Raises
    ------
    InputError
        If the scene has no free piston or cannot settle, a bed has no equilibrium or no mode of the piston, a
        key does not belong to a number of the scene, or there are fewer than 2 beds.
    """
    check_free_piston(scene)
    if beds < 2:
        raise InputError(f"beds = {beds} gives no standard deviation; use 2 or more beds")
    figures, values, seeds = [], [], []
    for state in settled_beds(scene, beds, out=out, progress=progress):
        rest = equilibrium_from(*state)
        root = piston_roots(rest)[0]
        by_numbers = slopes(rest, keys, root)
        figures.append([rest.piston_height, root.frequency, root.damping_ratio])
        values.append(by_numbers.values)
        seeds.append(rest.scene.arrangement.seed)
    return SlopesOverBeds(tuple(seeds), by_numbers.keys, np.array(figures), np.array(values))


def settled_beds(
    scene: Scene, beds: int, *, out: str | Path | None = None, progress: bool = True
) -> list[tuple[Scene, Float[np.ndarray, "n 2"], Float[np.ndarray, "p"]]]:
    """Settle several beds; return the scene of each, with its positions and heights [m] at equilibrium."""
    first, folder = scene.arrangement.seed, toolkit_cache_folder()
    seeds = range(first, first + beds)
    settling = scene.replace(**scene_changes_to_end_at_rest(scene, COARSE_REST))
    # Warnings concern the fall, which does not affect the equilibrium.
    with warnings.catch_warnings(action="ignore"):
        study = sweep(
            settling,
            {"arrangement.seed": seeds},
            measure=equilibrium_state,
            out=out or (None if folder is None else folder / "beds"),
            progress=progress,
            title="beds",
        )
    result = []
    for seed, outcome in zip(seeds, study.outcomes, strict=True):
        if outcome.error is not None:
            raise InputError(f"the bed of arrangement.seed = {seed} has no equilibrium: {outcome.error}")
        state = outcome.figures
        started = scene.replace(**{"arrangement.seed": seed})
        result.append((started, np.array(state["positions"]), np.array(state["height"])))
    return result


@keep_measure_name("granular.studies.bed_slopes:equilibrium_state#2")
def equilibrium_state(run: Trajectory) -> Mapping[str, Any]:
    """Find positions and heights [m] at the equilibrium closest to the end of a run."""
    rest = equilibrium(run)
    return {"positions": rest.positions.tolist(), "height": rest.heights.tolist()}
