"""Kinetic (granular) temperature of the bed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granular.observables.forces import grain_masses
from granular.observables.frames import frame_array, present, species_names, values_of_grains
from granular.shared.errors import InputError

if TYPE_CHECKING:
    import xarray

    from granular.run.trajectory import Trajectory


def kinetic_temperature(velocities: np.ndarray, masses: np.ndarray) -> float:
    """Mean kinetic energy of the fluctuations per degree of freedom, (1/2) <m |v - V|^2> [J].

    V is the velocity of the centre of mass of the grains given. (Goldhirsch, Annu. Rev. Fluid Mech.
    35, 267, 2003, leaves the mass out; with it, species in equilibrium have one temperature.)

    Parameters
    ----------
    velocities : float (n, 2)
        [m/s]; NaN for absent grains.
    masses : float (n,)
        [kg]

    Returns
    -------
    float
        NaN without grains.

    Raises
    ------
    InputError
        If shapes do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from granular.observables import kinetic_temperature
    >>> kinetic_temperature(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([2.0, 2.0]))
    1.0
    """
    velocities = np.asarray(velocities, dtype=np.float64)
    if velocities.ndim != 2 or velocities.shape[1] != 2:
        raise InputError(f"velocities have the shape {velocities.shape}; (n, 2) is wanted")
    masses = values_of_grains("masses", masses, len(velocities))
    energies = fluctuation_energies(velocities, masses)
    energies = energies[np.isfinite(energies)]
    return float(energies.mean()) if len(energies) else np.nan


def fluctuation_energies(velocities: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """(1/2) m |v - V|^2 of each grain (n,) [J]; NaN for absent grains."""
    here = present(velocities)
    if not here.any():
        return np.full(len(masses), np.nan)
    drift = np.average(velocities[here], axis=0, weights=masses[here])
    return np.asarray(0.5 * masses * ((velocities - drift) ** 2).sum(axis=1))


def temperature_series(run: Trajectory) -> xarray.Dataset:
    """Kinetic temperature of every frame, of the bed and of each species.

    Returns
    -------
    xarray.Dataset
        ``bed`` [J] on ``frame`` and ``by_species`` [J] on (``frame``, ``species_name``); all
        velocities are relative to the centre of mass of the bed.
    """
    import xarray

    masses, names = grain_masses(run), species_names(run)
    owner = run.dataset["species"].values
    velocities = run.dataset["velocity"].values
    energies = np.array([fluctuation_energies(v, masses) for v in velocities])
    energies = energies.reshape(-1, len(masses))
    by_species = np.stack([_mean(energies[:, owner == k]) for k in range(len(names))], axis=1)
    return xarray.Dataset(
        {
            "bed": frame_array(run, _mean(energies), "J", "kinetic temperature"),
            "by_species": frame_array(
                run, by_species, "J", "kinetic temperature of the species",
                ("frame", "species_name"), {"species_name": names},
            ),
        }
    )  # fmt: skip


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean of the finite values of each row; NaN where there are none."""
    known = np.isfinite(values)
    number = known.sum(axis=1)
    total = np.where(known, values, 0.0).sum(axis=1)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)
