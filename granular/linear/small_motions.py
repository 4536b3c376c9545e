"""Small motions of a bed in one result, including the derivatives with respect to every value of its scene.

Slopes need no simulation. If a parameter p changes, the equilibrium moves by dq/dp = K^-1 dF/dp, and a root s
with shape u changes by

    ds/dp = -(d/dp) (u^T (K + s C + s^2 M) u) / (u^T (C + 2 s M) u).

Here d/dp includes the change of the equilibrium q(p), but not of u, because the root is stationary with
respect to u. Both derivatives are finite differences.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.linear.bed_forces import BedForces, scene_with_scaled_value
from granular.linear.equilibrium import Equilibrium, coordinates_to_pin_in_periodic_cell, equilibrium
from granular.linear.pencil import multiply_complex_vector
from granular.linear.roots import (
    NormalModes,
    Root,
    coordinate_index_of_free_piston,
    dynamic_stiffness,
    dynamic_stiffness_derivative_times,
    normal_modes,
    piston_roots,
)
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import dimensionless_groups, dimensionless_groups_text
from granular.schema.sections import find_value
from granular.shared.array_types import Float
from granular.shared.blocks import Block, Printout, Table, Text
from granular.shared.errors import InputError
from granular.shared.html_pages import ResultShownAsBlocks

CHANGE, SHIFT = 3e-4, 5e-4
"""Changes of parameters in finite differences. `CHANGE` is relative; for a force ~ r^-5 the relative error of
the derivative is 20 `CHANGE`^2 = 2e-6. `SHIFT` [D] limits the change of a side of the cell, because walls
then move towards the grains."""

IN_CONTACT = 0.1
"""In contact, the relative change of a diameter is limited to this fraction of the displacement [D] in finite
differences of contact forces."""

_PARTS = ("grains", "cell", "piston", "effects")
_WITHOUT_SLOPES = ("piston.height", "grains.seed", "grains.count", "grains.temperature")
"""Keys without slopes: initial conditions, counts, and temperatures in degrees Celsius, for which a relative
change has no meaning."""
_NAMED = {"grains.grade": "grains.remanence", "effects.drag.liquid": "effects.drag.viscosity"}
"""Keys that choose a material, each with the key of the material's value."""


class Slopes(NamedTuple):
    """Logarithmic slopes of a damper's results with respect to the values of its scene.

    Attributes
    ----------
    keys : tuple of str
        Keys of the scene's numbers.
    values : float64 (k, 3)
        Slopes d ln(result)/d ln(number) of equilibrium height, natural frequency and damping ratio.
    """

    keys: tuple[str, ...]
    values: Float[np.ndarray, "k 3"]

    def of(self, key: str) -> Float[np.ndarray, "3"]:
        """Return the slopes of equilibrium height, frequency and damping ratio with respect to one value.

        Parameters
        ----------
        key : str
            Dotted key of the value.

        Returns
        -------
        float64 (3,)
            Logarithmic slopes.

        Raises
        ------
        InputError
            If the scene has no such value.
        """
        if key not in self.keys:
            raise InputError(
                f"{key!r} is not the key of a number with slopes; choose one of {', '.join(self.keys)}"
            )
        return np.asarray(self.values[self.keys.index(key)])


def slopes(rest: Equilibrium, keys: Sequence[str] | None = None, root: Root | None = None) -> Slopes:
    """Differentiate equilibrium height, natural frequency and damping ratio of a damper.

    Parameters
    ----------
    rest : Equilibrium
        Equilibrium of a bed with a free piston.
    keys : sequence of str, optional
        Dotted keys of the scene's values; if not given, all values of grains, cell, piston and effects that
        are not 0.
    root : Root, optional
        Root whose frequency and damping ratio are differentiated; the piston's first root if not given.

    Returns
    -------
    Slopes
        Derivatives d ln(result)/d ln(number) of equilibrium height, natural frequency and damping ratio.

    Raises
    ------
    InputError
        If the bed has no free piston, or a key is not a number of the scene.
    """
    piston, pencil = coordinate_index_of_free_piston(rest), rest.pencil
    root = root or piston_roots(rest)[0]
    keys = tuple(keys_of_nonzero_numbers(rest.scene)) if keys is None else tuple(keys)
    at = pencil.at
    changes = [_relative_difference_step(rest, key) for key in keys]
    changed = [
        [_bed_with_scaled_value(rest, key, 1.0 + sign * change) for sign in (1.0, -1.0)]
        for key, change in zip(keys, changes, strict=True)
    ]
    pushes = [
        (up.forces(at) - down.forces(at)) / (2.0 * change)
        for (up, down), change in zip(changed, changes, strict=True)
    ]
    moves = pencil.solve(0.0, np.stack(pushes, axis=1), coordinates_to_pin_in_periodic_cell(pencil.bed))
    stiffness = complex(root.shape @ dynamic_stiffness_derivative_times(pencil, root.s, root.shape))
    values = np.empty((len(keys), 3))
    for k, (up, down) in enumerate(changed):
        move, change = moves[:, k], changes[k]
        along = _dynamic_stiffness_quadratic_form(
            up, at + change * move, root
        ) - _dynamic_stiffness_quadratic_form(down, at - change * move, root)
        relative = -along / (2.0 * change) / stiffness / root.s
        # d ln |s| = Re(ds/s); zeta = -cos(arg s), so d zeta = sin(arg s) d arg s. Without damping the slope
        # of the damping ratio is zero.
        ratio = root.damping_ratio
        damping = relative.imag * np.sin(np.angle(root.s)) / ratio if ratio > 0.0 else 0.0
        values[k] = move[piston] / at[piston], relative.real, damping
    return Slopes(keys, values)


def keys_of_nonzero_numbers(scene: Scene) -> list[str]:
    """List the dotted keys of all nonzero values on which forces, masses or resistance may depend."""
    plain = scene.to_plain()
    keys = [key for part in _PARTS for key in _keys_of_nonzero_numbers(plain.get(part), part)]
    keys += [number for name, number in _NAMED.items() if find_value(scene, name) and number not in keys]
    return [key for key in keys if key not in _WITHOUT_SLOPES]


def _keys_of_nonzero_numbers(plain: Any, path: str) -> list[str]:
    if isinstance(plain, Mapping):
        return [
            key for name, part in plain.items() for key in _keys_of_nonzero_numbers(part, f"{path}.{name}")
        ]
    if isinstance(plain, list):
        return [
            key
            for index, part in enumerate(plain)
            for key in _keys_of_nonzero_numbers(part, f"{path}.{index}")
        ]
    # Touching magnets of a row do not allow a smaller pitch. Moving a single corner of a polygon would
    # separate it from its neighbours.
    counts = isinstance(plain, float) and plain != 0.0 and not path.endswith((".share", ".pitch"))
    return [path] if counts and ".excitation." not in path and not path.startswith("cell.sides.") else []


def _relative_difference_step(rest: Equilibrium, key: str) -> float:
    """Return the relative step for a finite difference with respect to a value of the scene."""
    scene = rest.scene
    if scene.effects.contact is not None and key.endswith(".diameter"):
        return min(CHANGE, IN_CONTACT * rest.pencil.bed.finite_difference_displacement(rest.pencil.at))
    if not key.startswith("cell."):
        return CHANGE
    side = float(getattr(scene.cell, key.removeprefix("cell.")))
    return min(CHANGE, SHIFT * scene.grains.species[0].diameter / side)


def _bed_with_scaled_value(rest: Equilibrium, key: str, factor: float) -> BedForces:
    bed = BedForces(scene_with_scaled_value(rest.scene, key, factor))
    bed.coordinates(rest.positions, rest.heights)
    return bed


def _dynamic_stiffness_quadratic_form(bed: BedForces, at: Float[np.ndarray, "q"], root: Root) -> complex:
    """Evaluate u^T (K + s C + s^2 M) u for a changed bed at the equilibrium of the changed bed."""
    shape, s = root.shape, root.s
    total = s * s * (bed.mass_matrix() @ shape)
    total = total + multiply_complex_vector(functools.partial(bed.stiffness_times, at), shape)
    return complex(
        shape @ (total + s * multiply_complex_vector(functools.partial(bed.damping_matrix_times, at), shape))
    )


DRY_FRICTION = (
    "dry friction is not included in the equilibrium: it can hold the bed at any height within "
    "(friction force)/(stiffness) of this equilibrium"
)
NOT_FLOWS = ("bath", "host")
"""Effects without damping in the simulation loop; their energy losses are computed separately."""

NO_SLOPE = 1e-6
"""A value counts as having no effect if its slopes are below this limit; rounding causes slopes of 1e-9."""


@dataclasses.dataclass(frozen=True, eq=False)
class SmallMotions(ResultShownAsBlocks):
    """Small motions of a bed under a free piston.

    Attributes
    ----------
    rest : Equilibrium
        Equilibrium.
    roots : tuple of Root
        Roots of the piston's motion, the root with the largest residue first.
    modes : NormalModes
        Undamped normal modes.
    participation : float64 (k,)
        Fraction that each mode contributes to the piston's motion after a push; the fractions add up to 1.
    stiffness : float
        Static stiffness: force on the piston divided by its displacement [N/m].
    dynamic_stiffness : complex
        Storage and loss stiffness of the bed at the first root's frequency [N/m]; NaN if a machine carries
        the bed.
    moving_mass : float
        Mass of the oscillator whose spring is ``stiffness`` and whose root is the first root, minus the
        piston's mass [kg]; NaN if a machine carries the bed.
    damping : float
        Dashpot of the same oscillator [N s/m]; NaN if a machine carries the bed.
    loss_shares : dict of str to float
        Fraction that each effect contributes to the energy dissipated by the motion of the first root.
    slopes : Slopes
        Logarithmic slopes of equilibrium height, frequency and damping ratio.
    deviation : float64 (k, 3) or None
        Standard deviation of the slopes over several beds if ``slopes`` are means over these beds, otherwise
        None.
    """

    rest: Equilibrium
    roots: tuple[Root, ...]
    modes: NormalModes
    participation: Float[np.ndarray, "k"]
    stiffness: float
    dynamic_stiffness: complex
    moving_mass: float
    damping: float
    loss_shares: dict[str, float]
    slopes: Slopes
    deviation: Float[np.ndarray, "k 3"] | None = None

    def to_plain(self) -> dict[str, Any]:
        """Return equilibrium, roots and slopes as plain data, in SI.

        Returns
        -------
        dict of str to Any
            Values by name, without the modes, which `granular.linear.normal_modes` gives.
        """
        roots = [
            {name: getattr(root, name) for name in ("frequency", "damping_ratio", "mass_fraction")}
            | {"s": [root.s.real, root.s.imag]}
            for root in self.roots
        ]
        return {
            "scene": self.rest.scene.name,
            "groups": dimensionless_groups(self.rest.scene),
            "equilibrium_height": self.rest.piston_height,
            "residual": self.rest.residual,
            "lowest_stiffness": self.rest.lowest_stiffness.tolist(),
            "is_stable": self.rest.is_stable,
            "dry_friction": self.rest.frictionless,
            "roots": roots,
            "stiffness": self.stiffness,
            "storage_stiffness": self.dynamic_stiffness.real,
            "loss_stiffness": self.dynamic_stiffness.imag,
            "moving_mass": self.moving_mass,
            "damping": self.damping,
            "loss_shares": self.loss_shares,
            "slopes": dict(zip(self.slopes.keys, self.slopes.values.tolist(), strict=True)),
        }

    def blocks(self) -> list[Block]:
        """Results as text, and the table of slopes.

        Returns
        -------
        list of Block
            Blocks of `granular.shared.blocks`, for a terminal, a page and a notebook.
        """
        slopes = Table(("d ln / d ln", "z0", "f0", "zeta"), slope_table_rows(self))
        notes = [Text(f"note: {DRY_FRICTION}")] if self.rest.frictionless else []
        return [Printout(self.figures_text), slopes, *notes]

    @property
    def figures_text(self) -> str:
        """Describe equilibrium, roots, stiffness, mass and damping in lines of text."""
        rest, scene, at_root = self.rest, self.rest.scene, self.dynamic_stiffness
        assert rest.piston_height is not None
        stable = "stable" if rest.is_stable else "NOT STABLE"
        lowest = ", ".join(f"{value:.4g}" for value in rest.lowest_stiffness[:3])
        lines = [
            f"{scene.name}: {scene.grains.count} magnets, small motions about the equilibrium",
            f"  equilibrium    z0    {1e3 * rest.piston_height:.7g} mm     residual {rest.residual:.1g} N",
            f"  stability            {stable:14}  lowest eigenvalues {lowest} N/m",
        ]
        lines += [
            f"  root {k}         f0    {root.frequency:.7g} Hz     zeta {100.0 * root.damping_ratio:.5g} %, "
            f"fraction {root.mass_fraction:.4f}"
            for k, root in enumerate(self.roots, 1)
        ]
        lines.append(f"  stiffness      k     {self.stiffness:.6g} N/m")
        if not math.isnan(self.moving_mass):
            lines[-1] += f"     storage {at_root.real:.5g}, loss {at_root.imag:.4g} N/m at f0"
            lines.append(
                f"  moving mass    m     {self.moving_mass:.4g} kg      damping c {self.damping:.5g} N s/m"
            )
        losses = ", ".join(f"{name} {100.0 * part:.4g} %" for name, part in self.loss_shares.items())
        if losses:
            lines.append(f"  loss                 {losses}")
        if groups := dimensionless_groups_text(scene):
            lines.append(f"  groups               {groups}")
        return "\n".join(lines)


def slope_table_rows(motions: SmallMotions) -> list[tuple[str, ...]]:
    """Return the rows of the table of slopes; values without an effect are omitted."""
    values = motions.slopes.values
    texts = np.char.mod("%+.4f", values)
    if motions.deviation is not None:
        texts = np.char.add(texts, np.char.mod(" ± %.4f", motions.deviation))
    rows = zip(motions.slopes.keys, np.abs(values).max(axis=1), texts.tolist(), strict=True)
    return [(key, *text) for key, largest, text in rows if largest > NO_SLOPE]


def small_motions(source: Scene | Trajectory | Equilibrium | str | Path) -> SmallMotions:
    """Find equilibrium, roots, modes, losses and slopes of a bed under a free piston.

    Parameters
    ----------
    source : Scene, Trajectory, Equilibrium, str or Path
        Equilibrium of a bed, or any source accepted by `granular.equilibrium`.

    Returns
    -------
    SmallMotions
        Equilibrium, roots, modes and slopes; ``print`` shows them.

    Raises
    ------
    InputError
        If the bed has no free piston, or no equilibrium.

    Examples
    --------
    >>> from granular import damper
    >>> from granular.linear import small_motions
    >>> found = small_motions(damper(count=48, drop=24.0))
    >>> found.loss_shares
    {'drag': 1.0}
    """
    rest = source if isinstance(source, Equilibrium) else equilibrium(source)
    piston = coordinate_index_of_free_piston(rest)
    roots, modes = piston_roots(rest), normal_modes(rest)
    stiffness = float(dynamic_stiffness(rest, np.zeros(1))[0].real)
    frequency, alone = roots[0].frequency, rest.pencil.bed.machine is None
    mass = float(rest.pencil.mass[piston, piston]) if alone else math.nan
    total = stiffness / abs(roots[0].s) ** 2
    return SmallMotions(
        rest,
        roots,
        modes,
        modes.shapes[piston] ** 2 * rest.pencil.effective_mass_at(piston),
        stiffness,
        complex(dynamic_stiffness(rest, np.array([frequency]))[0]) + (2.0 * np.pi * frequency) ** 2 * mass
        if alone
        else complex(math.nan, math.nan),
        total - mass,
        -2.0 * roots[0].s.real * total + 0.0 if alone else math.nan,
        loss_fraction_by_effect(rest, roots[0]),
        slopes(rest, root=roots[0]),
    )


def loss_fraction_by_effect(rest: Equilibrium, root: Root) -> dict[str, float]:
    """Find the fraction that each effect contributes to the energy dissipated by the motion of a root."""
    pencil, scene, shape = rest.pencil, rest.scene, root.shape
    bed = pencil.bed
    flows = [
        effect.key
        for effect in bed.scene.effects.acting
        if effect.key not in NOT_FLOWS and any(part.loss_record for part in effect.component_effects)
    ]
    grains = np.abs(shape[: 2 * bed.grains]) ** 2
    losses = {"bath": bed.bath_rate * float(grains @ bed.masses()[: 2 * bed.grains])}
    if scene.piston is not None and bed.piston is not None:
        losses["piston"] = scene.piston.drag * abs(shape[bed.piston]) ** 2
        if scene.piston.has_parts:  # their drag remains if the liquid is removed
            fixed = {"piston.blade": None, "piston.guide": None, "piston.drag": scene.piston.drag}
            scene = scene.replace(**fixed)
    if bed.machine is not None:
        resistances = bed.machine.damping_matrix(bed.size, bed.piston)
        losses["host"] = float(np.real(shape.conj() @ resistances @ shape))
    total = float(np.real(shape.conj() @ pencil.damping_times(shape)))
    # The last flow gets the remainder, so that a scene with one flow needs no further bed or kernel.
    known_losses = sum(losses.values())
    for key in flows[:-1]:
        single_flow = BedForces(
            scene.replace(**{f"effects.{other}": None for other in flows if other != key})
        )
        product = multiply_complex_vector(
            functools.partial(single_flow.damping_matrix_times, pencil.at), shape
        )
        losses[key] = float(np.real(shape.conj() @ product)) - known_losses
    if flows:
        losses[flows[-1]] = total - sum(losses.values())
    return {name: float(value / total) for name, value in losses.items() if abs(value) > 1e-9 * abs(total)}
