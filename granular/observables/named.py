"""Observables by name: those of the package, a user's own, or of an installed distribution."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from granular.observables.bond_order import psi6
from granular.observables.distance import least_piston_distance, mean_pair_distance
from granular.observables.forces import compressive_forces
from granular.observables.grain_stress import grain_pressures
from granular.observables.of_frames import Frame, Observable, observable
from granular.observables.packing import packing_fraction
from granular.observables.temperature import kinetic_temperature
from granular.schema.sections import unknown
from granular.shared.errors import InputError
from granular.shared.messages import quoted
from granular.shared.registry import load_entry_point

GROUP = "granular.observables"
"""Entry points by which an installed distribution offers observables."""


@observable("m", "mean distance of two grains")
def mean_distance(frame: Frame) -> float:
    return mean_pair_distance(frame.positions)


@observable("m", "distance of the piston from the grain next to it")
def piston_distance(frame: Frame) -> float:
    return least_piston_distance(frame.positions, frame.piston_height)


@observable("1", "packing fraction below the piston, or of a periodic cell")
def packing(frame: Frame) -> float:
    here = np.isfinite(frame.positions).all(axis=1)
    height = frame.scene.cell.height or frame.piston_height
    return float(packing_fraction(frame.diameters[here], frame.scene.cell.width, height))


@observable("1", "mean of |psi_6| over the grains")
def hexatic_order(frame: Frame) -> float:
    return psi6(frame.positions)


@observable("J", "kinetic temperature of the bed")
def temperature(frame: Frame) -> float:
    return kinetic_temperature(frame.velocities, frame.masses)


@observable("N", "compressive force on the grain")
def compressive_force(frame: Frame) -> np.ndarray:
    return compressive_forces(frame.scene, frame.positions, frame.piston_height)


@observable("N/m", "pressure of the grain")
def grain_pressure(frame: Frame) -> np.ndarray:
    return grain_pressures(frame.scene, frame.positions, frame.piston_height)


OBSERVABLES = {
    one.name: one
    for one in (
        mean_distance, piston_distance, packing, hexatic_order, temperature, compressive_force,
        grain_pressure,
    )
}  # fmt: skip


def observable_named(name: str, own: Mapping[str, Observable] | None = None) -> Observable:
    """The observable of that name.

    Parameters
    ----------
    name : str
    own : mapping of str to Observable, optional
        The user's own by their names; see `granular.own.import_own`.

    Raises
    ------
    InputError
        If there is none, or the distribution's cannot be loaded.

    Examples
    --------
    >>> from granular.observables import observable_named
    >>> observable_named("mean_distance").unit
    'm'
    """
    every = {**OBSERVABLES, **(own or {})}
    if name in every:
        return every[name]
    found = load_entry_point(GROUP, name, "observable")
    if isinstance(found, Observable):
        return found
    if found is not None:
        raise InputError(f"observable {quoted(name)} is no granular Observable")
    raise InputError(
        f"{unknown(name, tuple(every), 'observable')}; one of your own comes by --import FILE, or "
        f"by an installed entry point of the group {GROUP!r}"
    )
