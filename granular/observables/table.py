"""Observables of a run as a table: a row a frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from granular.observables.of_frames import Observable
from granular.shared.errors import InputError
from granular.shared.messages import quoted

if TYPE_CHECKING:
    import pandas

    from granular.run.trajectory import Trajectory


def observed_table(run: Trajectory, observables: Sequence[Observable]) -> pandas.DataFrame:
    """Time [s] and observables of every frame; each column's name holds its unit.

    Raises
    ------
    InputError
        If an observable cannot be computed, or has a value a grain.
    """
    import pandas

    columns = {"time [s]": run.dataset["frame_time"].values}
    for one in observables:
        found = one(run)
        if found.dims != ("frame",):
            raise InputError(
                f"observable {quoted(one.name)} has a value a grain, which no table of frames "
                "holds; take granular.observables.with_observables in Python"
            )
        columns[f"{one.name} [{one.unit}]"] = found.values
    return pandas.DataFrame(columns)
