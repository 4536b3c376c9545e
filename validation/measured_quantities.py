"""Quantities measured in runs, whose errors a work-precision study (error against time) shows.

The module also reads the numbers printed by de Paula (2025) from ``published.toml``, and computes the
duration of a compression.

>>> from validation.measured_quantities import published_value
>>> alpha = published_value("damper.van_der_pol_like.alpha")
"""

from __future__ import annotations

import dataclasses
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from granular.records.record import PistonRecord
from granular.run.trajectory import Trajectory
from granular.scene.named_scenes import END, LOWEST_START, REFERENCE_COUNT, START
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError, RecordError, unknown_word_message

# These are six half cycles. With fewer logarithms in the fitted line, single turning points would determine
# the damping ratio.
_MINIMUM_CYCLES = 3


@dataclasses.dataclass(frozen=True)
class MeasuredQuantity:
    """A quantity measured in a run."""

    name: str
    unit: str
    measure: Callable[[Trajectory], float | np.ndarray]
    relative: bool = True  # otherwise the error is absolute
    exact: float | None = None  # exact value, if known; 0 for a quantity that is an error
    differs_by_start: bool = False  # as for positions, whose scatter over initial states is meaningless

    def error(self, value: float | np.ndarray, reference: float | np.ndarray) -> float:
        """Return the maximum error of a value against a reference."""
        missed = float(np.abs(np.asarray(value) - np.asarray(reference)).max())
        return missed / float(np.abs(reference).max()) if self.relative else missed


def _ledger_residual(run: Trajectory) -> float:
    return float(run.settings()["ledger_residual"])


def _final_positions(run: Trajectory) -> np.ndarray:
    return np.asarray(run.dataset["position"].values[-1]) / Scales.from_grains(run.scene.grains).length


def _equilibrium_height(run: Trajectory) -> float:
    for stage in run.stages:
        if stage.reason == "rest":
            return stage.height
    raise RecordError(
        "no stage came to rest; give the scene a stage with until = 'rest', and enough time to reach it"
    )


def oscillation_period_and_damping(record: PistonRecord) -> tuple[float, float]:
    """Return the period [s] and the damping ratio of the decaying oscillation in a record."""
    # Turning points need no equilibrium: the period comes from their times, the damping from the logarithm
    # of the distance between them. Both depend on amplitude unless it is small.
    times, heights = _times_and_heights_of_turning_points(record)
    displacements = np.abs(np.diff(heights))
    clear = displacements > 0.02 * displacements.max(
        initial=0.0
    )  # later on, the bed creeps more than it oscillates
    displacements = displacements[: int(np.argmin(clear)) if not clear.all() else len(clear)]
    if len(displacements) < 2 * _MINIMUM_CYCLES:
        raise RecordError(
            f"the record holds {len(displacements) / 2:g} cycles; {_MINIMUM_CYCLES} are needed: record longer"
        )
    half = float(np.polyfit(np.arange(len(displacements) + 1), times[: len(displacements) + 1], 1)[0])
    decrement = -float(np.polyfit(np.arange(len(displacements)), np.log(displacements), 1)[0])
    return 2.0 * half, decrement / float(np.hypot(np.pi, decrement))


def _times_and_heights_of_turning_points(record: PistonRecord) -> tuple[np.ndarray, np.ndarray]:
    # Turning points are vertices of the parabolas through the three nearest samples.
    t, z = record.time, record.height
    slope = np.sign(np.diff(z))
    turns = np.flatnonzero(slope[1:] * slope[:-1] < 0.0) + 1
    step = t[turns + 1] - t[turns]
    rise, bend = 0.5 * (z[turns + 1] - z[turns - 1]), z[turns + 1] - 2.0 * z[turns] + z[turns - 1]
    return t[turns] - step * rise / bend, z[turns] - 0.5 * rise**2 / bend


def _mean_final_force(run: Trajectory) -> float:
    """Return the mean force on the piston over the last tenth of the records, since the force fluctuates."""
    force = run.dataset["piston_force"].values
    return float(force[-max(1, len(force) // 10) :].mean())


def _final_pair_distance(run: Trajectory) -> float:
    from granular.observables import mean_pair_distance

    return float(mean_pair_distance(run.dataset["position"].values[-1]))


QUANTITIES = {
    quantity.name: quantity
    for quantity in (
        MeasuredQuantity("energy", "1", _ledger_residual, relative=False, exact=0.0, differs_by_start=True),
        MeasuredQuantity("positions", "D", _final_positions, relative=False, differs_by_start=True),
        MeasuredQuantity("rest height", "m", _equilibrium_height),
        MeasuredQuantity("period", "s", lambda run: oscillation_period_and_damping(run.piston())[0]),
        MeasuredQuantity("damping ratio", "1", lambda run: oscillation_period_and_damping(run.piston())[1]),
        MeasuredQuantity("piston force", "N", _mean_final_force),
        MeasuredQuantity("mean distance", "m", _final_pair_distance),
    )
}


def quantity_named(name: str | MeasuredQuantity) -> MeasuredQuantity:
    """Return the quantity with a given name; a quantity is returned unchanged."""
    if isinstance(name, MeasuredQuantity):
        return name
    if name not in QUANTITIES:
        raise InputError(unknown_word_message(str(name), tuple(QUANTITIES), "quantity"))
    return QUANTITIES[name]


__all__ = ["compression_duration", "published_value"]

PATH = Path(__file__).parent / "published.toml"

LABELS = ("source", "n", "aspect_ratio", "aspect", "steps")
"""Keys of entries that describe a section of ``published.toml`` and are not results themselves."""

_INDEX = re.compile(r"(.*)\[(\d+)\]")


@cache
def published_values() -> dict[str, dict[str, Any]]:
    """Return all values printed by de Paula (2025), by section and name."""
    return tomllib.loads(PATH.read_text(encoding="utf-8"))


def published_value(key: str) -> Any:
    """Look up a number printed by de Paula (2025).

    Parameters
    ----------
    key : str
        Path of a value in ``published.toml``, such as ``"damper.van_der_pol_like.alpha"`` or
        ``"section.name[2]"``.

    Returns
    -------
    Any
        Number, text or list, in the unit of the thesis.

    Raises
    ------
    InputError
        If the key does not exist.

    Examples
    --------
    >>> from validation.measured_quantities import published_value
    >>> published_value("damper.rest_height")
    10.53
    """
    match = _INDEX.fullmatch(key)
    name, position = (match[1], int(match[2])) if match else (key, None)
    result: Any = published_values()
    try:
        for part in name.split("."):
            result = result[part]
        return result if position is None else result[position]
    except (KeyError, IndexError, TypeError):
        raise InputError(f"{key!r} is not a published value; see {PATH.name}") from None


def keys_of_published_values() -> Iterator[str]:
    """Return the keys of all published values except labels."""
    for section, entries in published_values().items():
        for name, value in entries.items():
            if name not in LABELS:
                yield from _keys_of_values_below(f"{section}.{name}", value)


def _keys_of_values_below(key: str, value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _keys_of_values_below(f"{key}.{name}", item)
    elif isinstance(value, list):
        yield from (f"{key}[{index}]" for index in range(len(value)))
    else:
        yield key


def compression_duration(count: int, speed: float) -> float:
    """Compute the duration of the compression of a bed of equal 6 mm grains.

    The piston's heights before and after the compression are from de Paula (2025, Table 2.1 and section 3.4).

    Parameters
    ----------
    count : int
        Number of grains, 1 or more.
    speed : float
        Speed of the piston [m/s], above 0.

    Returns
    -------
    float
        Duration [s].
    """
    size = math.sqrt(count / REFERENCE_COUNT)
    return (max(START * size, LOWEST_START) - END * size) * 0.006 / speed
