"""Answer of a bed to small harmonic motion, by its matrices."""

from __future__ import annotations

import math

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.linear.roots import require_free_piston
from granular.shared.array_types import Complex, Float


def dynamic_stiffness(rest: Equilibrium, frequencies: Float[np.ndarray, "f"]) -> Complex[np.ndarray, "f"]:
    """Force on the piston over its displacement, at each frequency.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.
    frequencies : float (f,)
        Frequencies [Hz].

    Returns
    -------
    complex128 (f,)
        Storage stiffness as the real part, loss stiffness as the imaginary one, both of bed and piston with
        their inertia [N/m].

    Raises
    ------
    InputError
        If the bed has no free piston.
    """
    piston = require_free_piston(rest)
    force = np.zeros(rest.pencil.bed.size)
    force[piston] = 1.0
    return 1.0 / harmonic_answers(rest, frequencies, force)[:, piston]


def transmissibility(rest: Equilibrium, frequencies: Float[np.ndarray, "f"]) -> Complex[np.ndarray, "f"]:
    """Displacement of the piston in the laboratory over that of the base, which moves up and down.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston; its cell stands on the base, or on a machine that does.
    frequencies : float (f,)
        Frequencies [Hz].

    Returns
    -------
    complex128 (f,)
        Modulus and phase of the ratio; 1 at frequency 0.

    Raises
    ------
    InputError
        If the bed has no free piston.
    """
    piston = require_free_piston(rest)
    frame, uplift = rest.pencil.bed.frame_and_uplift()
    moved = harmonic_answers(rest, frequencies, -(rest.pencil.mass @ uplift), 2)
    return 1.0 + moved[:, piston] + moved @ frame


def harmonic_answers(
    rest: Equilibrium, frequencies: Float[np.ndarray, "f"], force: Float[np.ndarray, "q"], power: int = 0
) -> Complex[np.ndarray, "f q"]:
    """Displacements of all coordinates [m] under a force [N] times (i omega)^power; frequencies [Hz]."""
    rates = 2j * math.pi * np.asarray(frequencies, dtype=np.float64)
    return np.array([rest.pencil.solve(s, (s**power * force)[:, None])[:, 0] for s in rates])
