"""Slopes of rest, frequency and damping ratio with every number of a scene, without a run.

For a parameter p, the equilibrium moves by dq/dp = K^-1 dF/dp, and a root s, whose motion is u, by

    ds/dp = -(d/dp) (u^T (K + s C + s^2 M) u) / (u^T (C + 2 s M) u)

along p and q(p), as the root is stationary against changes of u. Both derivatives are differences.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces, scaled_parameter
from granular.linear.equilibrium import Equilibrium, held_shifts
from granular.linear.pencil import of_parts
from granular.linear.roots import Root, piston_roots, require_free_piston, slope_times
from granular.scene.scene import Scene
from granular.schema.sections import find_value
from granular.shared.array_types import Float
from granular.shared.errors import InputError

CHANGE, SHIFT = 3e-4, 5e-4
"""Relative change of a parameter: the square of it times the cube of a power, 20 of r^-5, is 1e-5; and the
largest change of a side of the cell, whose wall comes so much nearer to the grains [D]."""

IN_CONTACT = 0.1
"""Relative change of a diameter in contact over the displacement in a difference of forces."""

_PARTS = ("grains", "cell", "piston", "effects")
_WITHOUT_SLOPES = ("piston.height", "grains.seed", "grains.count", "grains.temperature")
"""Numbers of the start, counts, and degrees Celsius, whose zero is a convention."""
_NAMED = {"grains.grade": "grains.remanence", "effects.drag.liquid": "effects.drag.viscosity"}
"""Keys that name a material, and the number that follows."""


class Slopes(NamedTuple):
    """Logarithmic slopes of a damper's figures with its numbers.

    Attributes
    ----------
    keys : tuple of str
        Keys of the scene's numbers.
    values : float64 (k, 3)
        d ln (rest, frequency, damping ratio) / d ln (number).
    """

    keys: tuple[str, ...]
    values: Float[np.ndarray, "k 3"]

    def of(self, key: str) -> Float[np.ndarray, "3"]:
        """Return the slopes of rest, frequency and damping ratio with one number.

        Parameters
        ----------
        key : str
            Dotted key of the number.

        Returns
        -------
        float64 (3,)
            Logarithmic slopes.

        Raises
        ------
        InputError
            If the scene has no such number.
        """
        if key not in self.keys:
            raise InputError(
                f"{key!r} is no number of the scene that counts; there are {', '.join(self.keys)}"
            )
        return np.asarray(self.values[self.keys.index(key)])


def slopes(rest: Equilibrium, keys: Sequence[str] | None = None, root: Root | None = None) -> Slopes:
    """Differentiate equilibrium height, natural frequency and damping ratio of a damper.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.
    keys : sequence of str, optional
        Dotted keys of the scene's numbers; without, all numbers of grains, cell, piston and effects that are
        not 0.
    root : Root, optional
        Root whose frequency and damping ratio are meant; the piston's first one if not given.

    Returns
    -------
    Slopes
        Derivatives d ln (rest, frequency, damping ratio) / d ln (number).

    Raises
    ------
    InputError
        If the bed has no free piston, or a key is no number of the scene.
    """
    piston, pencil = require_free_piston(rest), rest.pencil
    root = root or piston_roots(rest)[0]
    keys = tuple(number_keys(rest.scene)) if keys is None else tuple(keys)
    at = pencil.at
    changes = [_relative_change(rest, key) for key in keys]
    changed = [
        [_changed_bed(rest, key, 1.0 + sign * change) for sign in (1.0, -1.0)]
        for key, change in zip(keys, changes, strict=True)
    ]
    pushes = [
        (up.forces(at) - down.forces(at)) / (2.0 * change)
        for (up, down), change in zip(changed, changes, strict=True)
    ]
    moves = pencil.solve(0.0, np.stack(pushes, axis=1), held_shifts(pencil.bed))
    stiffness = complex(root.shape @ slope_times(pencil, root.s, root.shape))
    values = np.empty((len(keys), 3))
    for k, (up, down) in enumerate(changed):
        move, change = moves[:, k], changes[k]
        along = _work(up, at + change * move, root) - _work(down, at - change * move, root)
        relative = -along / (2.0 * change) / stiffness / root.s
        # d ln |s| = Re(ds/s); zeta = -cos(arg s), so d zeta = sin(arg s) d arg s.
        # Without damping there is none to change.
        ratio = root.damping_ratio
        damping = relative.imag * np.sin(np.angle(root.s)) / ratio if ratio > 0.0 else 0.0
        values[k] = move[piston] / at[piston], relative.real, damping
    return Slopes(keys, values)


def number_keys(scene: Scene) -> list[str]:
    """Dotted keys of all numbers that may enter forces, masses or resistance, but for zeros."""
    plain = scene.to_plain()
    keys = [key for part in _PARTS for key in _number_keys(plain.get(part), part)]
    keys += [number for name, number in _NAMED.items() if find_value(scene, name) and number not in keys]
    return [key for key in keys if key not in _WITHOUT_SLOPES]


def _number_keys(plain: Any, path: str) -> list[str]:
    if isinstance(plain, Mapping):
        return [key for name, part in plain.items() for key in _number_keys(part, f"{path}.{name}")]
    if isinstance(plain, list):
        return [key for index, part in enumerate(plain) for key in _number_keys(part, f"{path}.{index}")]
    # Magnets of a row that touch leave no room for a smaller pitch.
    # One corner of a polygon alone would leave its neighbours behind.
    counts = isinstance(plain, float) and plain != 0.0 and not path.endswith((".share", ".pitch"))
    return [path] if counts and ".excitation." not in path and not path.startswith("cell.sides.") else []


def _relative_change(rest: Equilibrium, key: str) -> float:
    """Relative change of a number: grains in contact overlap by much less than their diameter."""
    scene = rest.scene
    if scene.effects.contact is not None and key.endswith(".diameter"):
        return min(CHANGE, IN_CONTACT * rest.pencil.bed.displacement_at(rest.pencil.at))
    if not key.startswith("cell."):
        return CHANGE
    side = float(getattr(scene.cell, key.removeprefix("cell.")))
    return min(CHANGE, SHIFT * scene.grains.species[0].diameter / side)


def _changed_bed(rest: Equilibrium, key: str, factor: float) -> BedForces:
    bed = BedForces(scaled_parameter(rest.scene, key, factor))
    bed.coordinates(rest.positions, rest.heights)
    return bed


def _work(bed: BedForces, at: Float[np.ndarray, "q"], root: Root) -> complex:
    """u^T (K + s C + s^2 M) u of a changed bed at its own equilibrium."""
    shape, s = root.shape, root.s
    total = s * s * (bed.mass_matrix() @ shape)
    total = total + of_parts(functools.partial(bed.stiffness_times, at), shape)
    return complex(shape @ (total + s * of_parts(functools.partial(bed.resistance_times, at), shape)))
