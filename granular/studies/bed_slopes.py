"""Slopes of a damper over settled beds that differ by their random start."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.linear import Slopes, piston_roots, slopes
from granular.linear.bed_forces import check_free_piston
from granular.linear.equilibrium import COARSE_REST, equilibrium, equilibrium_from, settling_changes
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from granular.shared.files import toolkit_cache_folder
from granular.studies.cases import keep_measure_name
from granular.studies.sweep import sweep

__all__ = ["SlopesOverBeds", "slopes_over_beds"]


class SlopesOverBeds(NamedTuple):
    """Figures of small motions and their slopes, of several settled beds of a scene.

    Attributes
    ----------
    seeds : tuple of int
        Random starts of the beds.
    keys : tuple of str
        Keys of the scene's numbers.
    figures : float64 (b, 3)
        Equilibrium height [m], natural frequency [Hz] and damping ratio of each bed.
    values : float64 (b, k, 3)
        d ln (rest, frequency, damping ratio) / d ln (number) of each bed.
    """

    seeds: tuple[int, ...]
    keys: tuple[str, ...]
    figures: Float[np.ndarray, "b 3"]
    values: Float[np.ndarray, "b k 3"]

    @property
    def mean(self) -> Slopes:
        """Mean slopes over the beds."""
        return Slopes(self.keys, self.values.mean(axis=0))

    @property
    def deviation(self) -> Float[np.ndarray, "k 3"]:
        """Standard deviation of the slopes from bed to bed."""
        return np.asarray(self.values.std(axis=0, ddof=1))

    @property
    def standard_error(self) -> Float[np.ndarray, "k 3"]:
        """Standard error of the mean slopes."""
        return np.asarray(self.deviation / np.sqrt(len(self.seeds)))

    def to_plain(self) -> dict[str, Any]:
        """Return seeds, figures in SI, and mean, deviation and error of each slope, as plain data.

        Returns
        -------
        dict of str to Any
            Figures of each bed; by the keys of the numbers, three slopes each.
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
    """Differentiate equilibrium height, frequency and damping ratio of several settled beds of a scene.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston; its beds start from ``arrangement.seed`` and the seeds after it.
    beds : int
        Number of beds, from 2. They settle on all processors.
    keys : sequence of str, optional
        Dotted keys of the scene's numbers; without, all that `granular.linear.small_motions` finds.
    out : str or Path, optional
        Directory that keeps the settled beds, so that a second call settles none; a folder of the toolkit
        among the user's caches if not given.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    SlopesOverBeds
        Figures and slopes of each bed, with their mean and deviation.

    Raises
    ------
    InputError
        If the scene has no free piston or cannot settle, a bed has no equilibrium or root, a key is no number
        of the scene, or there are fewer than 2 beds.
    """
    check_free_piston(scene)
    if beds < 2:
        raise InputError(f"beds = {beds} have no deviation; give 2 or more")
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
    """Return scene, positions and heights [m] at the equilibrium of each bed of `slopes_over_beds`."""
    first, folder = scene.arrangement.seed, toolkit_cache_folder()
    seeds = range(first, first + beds)
    settling = scene.replace(**settling_changes(scene, COARSE_REST))
    # Doubts are of the fall, which has no part in the equilibrium.
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
    """Positions and heights [m] at the equilibrium next to a run's end."""
    rest = equilibrium(run)
    return {"positions": rest.positions.tolist(), "height": rest.heights.tolist()}
