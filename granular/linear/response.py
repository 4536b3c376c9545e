"""Answer of a bed to small harmonic motion and to a release, by its matrices."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from granular.linear.equilibrium import Equilibrium
from granular.linear.roots import require_free_piston
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from jaxtyping import Complex, Float


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
    answers = [_harmonic_answer(rest, frequency, force)[piston] for frequency in frequencies]
    return 1.0 / np.array(answers)


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
    result = []
    for frequency in frequencies:
        inertia = (2.0 * math.pi * frequency) ** 2 * (rest.pencil.mass @ uplift)
        moved = _harmonic_answer(rest, frequency, inertia)
        result.append(1.0 + moved[piston] + frame @ moved)
    return np.array(result)


def _harmonic_answer(rest: Equilibrium, frequency: float, force: np.ndarray) -> Complex[np.ndarray, "q"]:
    s = 2j * math.pi * float(frequency)
    return rest.pencil.solve(s, force.astype(complex)[:, None])[:, 0]


def free_motion(
    rest: Equilibrium, displacement: Float[np.ndarray, "q"], times: Float[np.ndarray, "t"]
) -> Float[np.ndarray, "t"]:
    """Return the piston's displacement after a release from rest, as the sum over all roots.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston, and of at most `granular.linear.pencil.DENSE` coordinates.
    displacement : float (q,)
        Displacements at the release of all coordinates, see `granular.linear.bed_forces` [m].
    times : float (t,)
        Times since the release [s].

    Returns
    -------
    float64 (t,)
        Displacements of the piston [m].

    Raises
    ------
    InputError
        If the bed is too large, or has no free piston.
    """
    pencil, piston = rest.pencil, require_free_piston(rest)
    if not pencil.has_all_modes:
        raise InputError(f"a bed of {pencil.bed.grains} grains has too many roots to sum; simulate it")
    size = pencil.bed.size
    inverse_mass = np.linalg.inv(pencil.mass.toarray())
    rates = np.block(
        [
            [np.zeros((size, size)), np.eye(size)],
            [-inverse_mass @ pencil.full_stiffness, -inverse_mass @ pencil.full_damping],
        ]
    )
    roots, shapes = np.linalg.eig(rates)
    amplitudes = np.linalg.solve(shapes, np.concatenate([displacement, np.zeros(size)]).astype(complex))
    return np.real(np.exp(np.outer(times, roots)) @ (shapes[piston] * amplitudes))
