"""Fit laws to one fall, and judge them on others."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError
from reduced_models.falls.data import FallRow, Falls
from reduced_models.fitting.fitting import fit, law_of
from reduced_models.fitting.options import STARTS
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from granular.scene.scene import Scene

FALL_LAWS = ("elastoplastic-bed", "power-law-spring", "van-der-pol-like", "linear")
SAME = 1e-3
"""Heights of two starts, over the drop, that are the same."""


def judged_falls(
    record: PistonRecord,
    unseen: Mapping[str, PistonRecord],
    laws: Sequence[str | Law] = FALL_LAWS,
    *,
    rest: float | None = None,
    scene: Scene | None = None,
    starts: int = STARTS,
) -> Falls:
    """Fit laws to one fall from rest, and predict others from their first heights alone.

    Parameters
    ----------
    record : PistonRecord
        A fall, from the moment the piston is let go.
    unseen : mapping of str to PistonRecord
        Other falls, by what they differ in.
    laws : sequence of str or Law
        To fit.
    rest : float, optional
        Level where the piston comes to rest [m]; the mean of the record's last tenth if not given.
    scene : Scene, optional
        What fell; fits of ``elastoplastic-bed`` begin at what it says of the law.
    starts : int
        Random starts of each fit.

    Raises
    ------
    InputError
        If there is no unseen fall, no law, no law that can be fitted, or a record begins below the
        level of rest.
    """
    if not unseen or not laws:
        raise InputError("give at least one unseen fall and one law")
    level = float(record.height[-max(1, len(record) // 10) :].mean()) if rest is None else rest
    for label, one in {"the fall": record, **unseen}.items():
        if not one.height[0] > level:
            raise InputError(
                f"{label} begins at {one.height[0]:g} m, not above the level of rest, {level:g} m; "
                "give a fall"
            )
    rows = [
        _row(law_of(law, record), record, tuple(unseen.values()), level, scene, starts)
        for law in laws
    ]
    if all(row.model is None for row in rows):
        raise InputError(f"no law could be fitted; {rows[0].name}: {rows[0].failure}")
    rows.sort(key=lambda row: (row.model is None, row.median))
    drop = float(record.height[0]) - level
    alike = [one for one in unseen.values() if abs(one.height[0] - record.height[0]) <= SAME * drop]
    scatter = tuple(_rms(one, record.time, record.height) / drop for one in alike)
    return Falls(record, level, tuple(unseen), tuple(unseen.values()), tuple(rows), scatter)


def _row(
    law: Law, record: PistonRecord, unseen: Sequence[PistonRecord], level: float,
    scene: Scene | None, starts: int,
) -> FallRow:  # fmt: skip
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the model keeps its notes
            model = fit(
                record, law, holdout=0.0, starts=starts, start=_start(law, scene),
                initial={"height": float(record.height[0]), "velocity": 0.0},
                map="fitted",
            )  # fmt: skip
    except GranularError as cause:
        return FallRow(law.name, None, failure=str(cause))
    return FallRow(law.name, model, tuple(fall_error(model, one, level) for one in unseen))


def _start(law: Law, scene: Scene | None) -> dict[str, float] | None:
    """What a scene says of the law of its fall."""
    if scene is None or law.name != "elastoplastic-bed":
        return None
    from reduced_models.falls.theory import parameters_of

    try:
        return parameters_of(scene)
    except InputError:
        return None


def fall_error(model: ReducedModel, fall: PistonRecord, level: float) -> float:
    """Rms error of a fall that a law predicts from the first height alone, over the drop.

    Infinite where the law diverges.
    """
    first = float(fall.height[0])
    try:
        motion = model.simulate(fall.time, z0=first, v0=0.0)
    except InputError:
        return math.inf
    return _rms(fall, motion.time, motion.height) / (first - level)


def _rms(record: PistonRecord, time: np.ndarray, height: np.ndarray) -> float:
    """Of the difference of a record from heights at other times, over their common span [m]."""
    end = min(record.time[-1] - record.time[0], time[-1] - time[0])
    since = record.time - record.time[0]
    common = since <= end
    other = np.interp(since[common], time - time[0], height)
    return float(np.sqrt(np.mean((record.height[common] - other) ** 2)))
