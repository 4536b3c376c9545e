"""All that is known of a bed's small motions, in one result."""

from __future__ import annotations

import dataclasses
import functools
import math
from pathlib import Path
from typing import Any

import numpy as np

from granular.linear.bed_forces import BedForces
from granular.linear.equilibrium import Equilibrium, equilibrium
from granular.linear.modes import NormalModes, normal_modes
from granular.linear.pencil import of_parts
from granular.linear.response import dynamic_stiffness
from granular.linear.roots import Root, piston_roots, require_free_piston
from granular.linear.slopes import Slopes, slopes
from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.scene.scene_in_natural_units import dimensionless_groups, groups_line
from granular.shared.array_types import Float
from granular.shared.blocks import Block, Printout, Table, Text
from granular.shared.html_pages import Shown

DRY_FRICTION = (
    "dry friction is not in the equilibrium: it holds the bed anywhere within its force over the stiffness"
)
NOT_FLOWS = ("bath", "host")
"""Effects whose resistance is added to that of the loop's kick."""

NO_SLOPE = 1e-6
"""Slope below which a number has no part in the forces: rounding leaves 1e-9 (see `slopes.CHANGE`)."""


@dataclasses.dataclass(frozen=True, eq=False)
class SmallMotions(Shown):
    """Small motions of a bed under a free piston.

    Attributes
    ----------
    rest : Equilibrium
        Equilibrium.
    roots : tuple of Root
        Roots that the piston moves by, the one of the largest residue first.
    modes : NormalModes
        Modes without damping.
    participation : float64 (k,)
        Share of each mode in the piston's motion after a push; over all modes they add up to 1.
    stiffness : float
        Force on the piston over its displacement, held still [N/m].
    dynamic_stiffness : complex
        Storage and loss stiffness of the bed at the first root's frequency [N/m]; NaN on a machine.
    moving_mass : float
        Mass that moves along: with it, the piston on ``stiffness`` has the first root [kg]; NaN on a machine.
    damping : float
        Dashpot of that oscillator [N s/m]; NaN on a machine.
    loss_shares : dict of str to float
        Share of each effect in the energy that the first root loses.
    slopes : Slopes
        Logarithmic slopes of equilibrium height, frequency and damping ratio.
    deviation : float64 (k, 3) or None
        Standard deviation of the slopes from bed to bed, if they are means over beds.
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
        """Return the figures as plain data, in SI.

        Returns
        -------
        dict of str to Any
            Figures by name; the modes are left to `granular.linear.normal_modes`.
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
        """Figures, and the table of slopes.

        Returns
        -------
        list of Block
            Blocks of `granular.shared.blocks`, for a terminal, a page and a notebook.
        """
        slopes = Table(("d ln / d ln", "z0", "f0", "zeta"), slope_rows(self))
        notes = [Text(f"note: {DRY_FRICTION}")] if self.rest.frictionless else []
        return [Printout(self.figures_text), slopes, *notes]

    @property
    def figures_text(self) -> str:
        """Equilibrium, roots, stiffness, mass and damping in lines."""
        rest, scene, at_root = self.rest, self.rest.scene, self.dynamic_stiffness
        assert rest.piston_height is not None
        stable = "stable" if rest.is_stable else "NOT STABLE"
        lowest = ", ".join(f"{value:.4g}" for value in rest.lowest_stiffness[:3])
        lines = [
            f"{scene.name}: {scene.grains.count} magnets, small motions about the equilibrium",
            f"  equilibrium    z0    {1e3 * rest.piston_height:.7g} mm     forces left {rest.residual:.1g} N",
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
                f"  moves along    m     {self.moving_mass:.4g} kg      damping c {self.damping:.5g} N s/m"
            )
        losses = ", ".join(f"{name} {100.0 * part:.4g} %" for name, part in self.loss_shares.items())
        if losses:
            lines.append(f"  loss                 {losses}")
        if groups := groups_line(scene):
            lines.append(f"  groups               {groups}")
        return "\n".join(lines)


def slope_rows(motions: SmallMotions) -> list[tuple[str, ...]]:
    """Rows of the table of slopes, without numbers that change nothing."""
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
        Equilibrium of a bed, or what `granular.equilibrium` takes.

    Returns
    -------
    SmallMotions
        Figures, roots, modes and slopes; ``print`` shows them.

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
    piston = require_free_piston(rest)
    roots, modes = piston_roots(rest), normal_modes(rest)
    stiffness = float(dynamic_stiffness(rest, np.zeros(1))[0].real)
    frequency, alone = roots[0].frequency, rest.pencil.bed.machine is None
    mass = float(rest.pencil.mass[piston, piston]) if alone else math.nan
    total = stiffness / abs(roots[0].s) ** 2
    return SmallMotions(
        rest,
        roots,
        modes,
        modes.shapes[piston] ** 2 * rest.pencil.mass_at(piston),
        stiffness,
        complex(dynamic_stiffness(rest, np.array([frequency]))[0]) + (2.0 * np.pi * frequency) ** 2 * mass
        if alone
        else complex(math.nan, math.nan),
        total - mass,
        -2.0 * roots[0].s.real * total + 0.0 if alone else math.nan,
        loss_shares(rest, roots[0]),
        slopes(rest, root=roots[0]),
    )


def loss_shares(rest: Equilibrium, root: Root) -> dict[str, float]:
    """Find the share of each effect in the energy that a root loses."""
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
        if scene.piston.has_parts:  # their drag stays where the liquid is taken away
            fixed = {"piston.blade": None, "piston.guide": None, "piston.drag": scene.piston.drag}
            scene = scene.replace(**fixed)
    if bed.machine is not None:
        resistances = bed.machine.resistances(bed.size, bed.piston)
        losses["host"] = float(np.real(shape.conj() @ resistances @ shape))
    total = float(np.real(shape.conj() @ pencil.damping_times(shape)))
    # The last flow has the remainder, so a scene of one flow needs no other bed, and no other kernel.
    outside = sum(losses.values())
    for key in flows[:-1]:
        alone = BedForces(scene.replace(**{f"effects.{other}": None for other in flows if other != key}))
        lost = of_parts(functools.partial(alone.resistance_times, pencil.at), shape)
        losses[key] = float(np.real(shape.conj() @ lost)) - outside
    if flows:
        losses[flows[-1]] = total - sum(losses.values())
    return {name: float(value / total) for name, value in losses.items() if abs(value) > 1e-9 * abs(total)}
