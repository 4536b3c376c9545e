"""A machine that shakes, and carries the cell: bodies on springs and dashpots.

The bodies stand one above another on a base, each on a spring and a dashpot, and move up and down.
The last of them carries the cell, or the piston, and feels all forces of what it carries. Their
displacements X are counted from where all is at rest, with the damper aboard: the springs hold all
weights, and move the more slowly for them. See `granular.engine.host_motion` for the equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.effect import Effect, EffectContext, RecordedVariable, energy_variable
from granular.effects.excitation import Excitation, ExcitationLaw
from granular.effects.moving_frame_effect import MovingFrameEffect
from granular.kernel_data.state import LOSSES, SPEED, Bed, State
from granular.pairs.grain_arrays import value_or_one
from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.schema.sections import (
    Section,
    choice_field,
    integer_field,
    nested_section_field,
    quantity,
    section_list_field,
)

if TYPE_CHECKING:
    from jaxtyping import Float

RESOLVED = 4.0
"""Steps in a host's period over those in the bed's stiffest one: most of the energy is the host's."""

CELL, PISTON_MOUNT, FIXED = range(3)
"""The load of the chain's last body: the cell; the piston; nothing, for the cell is the base."""

PUSH, PULL, CARRIED = range(3)
"""Entries of what holds for the present kick: the frame's acceleration A [D/tau^2], the force
of the chain on the piston [F*], and the velocity in the frame of a last body that it drives [D/tau]."""

_MOUNTS = {"cell": CELL, "piston": PISTON_MOUNT, "base": FIXED}


class HostBody(Section):
    """A body of the chain, on a spring and a dashpot that stand on the one before, or the base.

    Attributes
    ----------
    mass : float
        [kg]
    stiffness : float
        [N/m]
    damping : float
        Coefficient of the dashpot [kg/s].
    """

    mass: float = quantity("kg", above=0.0)
    stiffness: float = quantity("N/m", default=0.0, least=0.0)
    damping: float = quantity("kg/s", default=0.0, least=0.0)


class Host(MovingFrameEffect):
    """Primary structure that carries the damper, and its excitation.

    Attributes
    ----------
    mount : str
        ``"cell"``: the last body carries the cell, and the piston is free. ``"piston"``: it carries
        the piston, the cell stands on it upside down, with the bed between, and is free: heights
        are counted downwards from its end, and ``piston.mass`` adds to the body. ``"base"``: the
        cell stands on the base itself, and the piston is the load that is to be left in peace.
    bodies : tuple of HostBody
        From the base upwards; none with ``mount = "base"``.
    cell_mass : float or None
        Mass of the free cell [kg], with ``mount = "piston"``.
    excitation : Excitation or None
    excited : int or None
        Index of the body that the force acts on, from 0; the last one if not given.
    """

    key = "host"
    rank = 3
    takes_along: ClassVar[tuple[str, ...] | None] = None
    example: ClassVar[Any] = {
        "bodies": [{"mass": "1 kg", "stiffness": "400 N/m", "damping": "0.2 kg/s"}],
        "excitation": {"kind": "sine", "force": "0.1 N", "frequency": "3 Hz"},
    }
    energy_record = energy_variable(
        "host_energy", "energy of the host, and what its motion adds to that of grains and piston"
    )
    loss_record = energy_variable("host_loss", "energy lost to the host's dashpots")

    mount: str = choice_field("cell", "piston", "base", default="cell")
    bodies: tuple[HostBody, ...] = section_list_field(HostBody)
    cell_mass: float | None = quantity("kg", above=0.0, default=None, optional=True)
    excitation: Excitation | None = nested_section_field(Excitation, default=None, optional=True)
    excited: int | None = integer_field(default=None, optional=True)

    @property
    def damps(self) -> bool:  # type: ignore[override]  # of these dashpots
        """True where a body has a dashpot."""
        return any(body.damping > 0.0 for body in self.bodies)

    @property
    def extra_records(self) -> tuple[RecordedVariable, ...]:
        """Displacement and velocity of the last body; displacements of the others; the drive."""
        result = []
        if self.bodies:
            result += [
                RecordedVariable("host_displacement", "m", "displacement of the last body", "length"),
                RecordedVariable("host_velocity", "m/s", "velocity of the last body", "velocity"),
            ]
        result += [
            RecordedVariable(f"body_{k}_displacement", "m", f"displacement of body {k}", "length")
            for k in range(len(self.bodies) - 1)
        ]
        drive = self.excitation
        if drive is not None and drive.is_base_motion:
            result.append(
                RecordedVariable("base_acceleration", "m/s^2", "acceleration of the base", "acceleration")
            )
        elif drive is not None:
            result.append(RecordedVariable("host_force", "N", "force on the host from outside", "force"))
        return tuple(result)

    def validate(self) -> None:
        """Check that bodies, mount, free cell and excitation fit each other."""
        if (self.mount == "base") == bool(self.bodies):
            raise FieldError(
                "a cell on the base has no bodies" if self.bodies else "give at least one body", "bodies"
            )
        if (self.mount == "piston") != (self.cell_mass is not None):
            raise FieldError("is to be given where the cell is free (mount = 'piston')", "cell_mass")
        if self.mount == "base" and self.excitation is not None and not self.excitation.is_base_motion:
            raise FieldError("a base is moved by an acceleration or a displacement", "excitation")
        if self.excited is not None and not self.excited < len(self.bodies):
            raise FieldError(f"{self.excited} is no body; there are {len(self.bodies)}", "excited")

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that nothing else moves the cell, and that what the mount needs is there."""
        if "shaking" in others:
            raise FieldError(
                "the cell is shaken already; take effects.shaking away, or move the host's base",
                "effects",
                self.key,
            )
        if "bath" in others:
            raise FieldError(
                "cannot act together with 'bath', which takes no notice of what carries the cell; "
                "take one of them away",
                "effects",
                self.key,
            )
        walls: Any = others.get("walls")
        if walls is not None and walls.has_gap:
            raise FieldError("cannot carry a cell with a gap", "effects", self.key)
        if self.mount == "piston" and (piston is None or piston.mass is None):
            raise FieldError("must be given: the host carries the piston", "piston", "mass")

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency of the chain or of its excitation, times `RESOLVED` [1/tau]."""
        drive = 0.0 if self.excitation is None else self.excitation.highest_frequency()
        masses = [body.mass for body in self.bodies]
        stiffness = [body.stiffness for body in self.bodies] + [0.0]
        # Row sums of the chain's stiffness over the masses bound its squared frequencies (Gershgorin).
        rows = [2.0 * (stiffness[k] + stiffness[k + 1]) / mass for k, mass in enumerate(masses)]
        return RESOLVED * max(math.tau * drive, math.sqrt(max(rows, default=0.0))) * scales.time

    def weight_on_piston(self, grains: Grains, scales: Scales, gravity: float) -> float | None:
        """Weight that presses the bed against the piston, where the cell is free [F*]; gravity [D/tau^2]."""
        if self.cell_mass is None:
            return None
        return (self.cell_mass + float(grains.masses().sum())) / scales.mass * gravity

    def moving_piston_mass(self, mass: float) -> float:
        """Mass of what moves as the piston: with the body that carries it, if one does [kg]; mass [kg]."""
        return mass + self.bodies[-1].mass if self.mount == "piston" else mass

    def make_kernel_law(self, context: EffectContext) -> HostLaw:
        """Law in natural units."""
        scales, piston = context.scales, context.piston
        masses = np.array([body.mass for body in self.bodies]) / scales.mass
        force = scales.force / scales.length
        stiffness = np.array([body.stiffness for body in self.bodies]) / force
        damping = np.array([body.damping for body in self.bodies]) / (force * scales.time)
        fraction = np.zeros(len(self.bodies))
        if self.bodies:
            fraction[len(fraction) - 1 if self.excited is None else self.excited] = 1.0
        own = 0.0 if piston is None or piston.mass is None else piston.mass
        piston_mass = self.moving_piston_mass(own) / scales.mass
        frame = masses[-1] if self.mount == "cell" else (self.cell_mass or 1.0) / scales.mass
        drive = self.excitation or Excitation(force=0.0, frequency=1.0)
        return HostLaw(
            mount=_MOUNTS[self.mount],
            chain=HostChain(masses, stiffness, damping, fraction),
            drive=drive.make_kernel_law(scales),
            frame_mass=float(frame),
            piston_mass=piston_mass,
            recoil=0.0 if self.mount == "base" else piston_mass / (float(frame) + piston_mass),
            bed_mass=float(context.grains.masses().sum()) / scales.mass,
            reacts=self.damps or self._bed_dissipates(context),
            entry=LOSSES + context.indices[self.key],
            laws=1 + max(context.indices.values()),
            driven=self.excitation is not None,
        )

    def _bed_dissipates(self, context: EffectContext) -> bool:
        """Return whether anything in the cell dissipates, and so reacts on the frame."""
        piston = context.piston
        rubs = piston is not None and (piston.drag > 0.0 or piston.friction > 0.0)
        inside = [effect for effect in context.effects.values() if effect.key != self.key]
        return rubs or any(effect.dissipates for effect in inside)


class HostChain(NamedTuple):
    """The bodies, from the base upwards."""

    masses: Float[np.ndarray, "n"]  # [m]
    stiffness: Float[np.ndarray, "n"]  # [F*/D]
    damping: Float[np.ndarray, "n"]  # [F* tau/D]
    fraction: Float[np.ndarray, "n"]  # fraction of the outer force on each body


class HostWorkspace(NamedTuple):
    """The motion of the host, and scratch."""

    persistent: Float[np.ndarray, "2 n"]  # displacements [D], velocities [D/tau]; last: the frame
    present: Float[np.ndarray, "3"]  # `PUSH` [D/tau^2], `PULL` [F*], `CARRIED` [D/tau]
    forces: Float[np.ndarray, "n"]  # [F*]
    changes: Float[np.ndarray, "n"]  # [D/tau]
    diagonal: Float[np.ndarray, "n"]  # [m]
    speeds: Float[np.ndarray, "2 m"]  # velocities x, y of the grains before a kick [D/tau]
    push: Float[np.ndarray, "m"]  # vertical forces on the grains, without inertia [F*]
    ledger: Float[np.ndarray, "k"]


class HostLaw(NamedTuple):
    """The host as the kernels take it."""

    mount: int
    chain: HostChain
    drive: ExcitationLaw
    frame_mass: float  # [m], fixed to the frame while the piston is free
    piston_mass: float  # [m], with the body that carries it; 0: none
    recoil: float  # velocity that the cell loses over that which its drive gives the piston
    bed_mass: float  # [m]
    reacts: bool  # something dissipates, on either side of the frame
    entry: int  # index in the ledger of the loss to the dashpots
    laws: int  # number of laws, this one among them
    driven: bool  # something shakes it

    def workspace(self, size: int, count: int) -> HostWorkspace:
        """Make the workspace for the motion of the host, all at rest."""
        bodies = max(len(self.chain.masses), 1)
        return HostWorkspace(
            persistent=np.zeros((2, bodies)),
            present=np.zeros(3),
            forces=np.zeros(bodies),
            changes=np.zeros(bodies),
            diagonal=np.zeros(bodies),
            speeds=np.zeros((2, size)),
            push=np.zeros(size),
            ledger=np.zeros(LOSSES + self.laws),
        )

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: HostLaw,
        workspace: HostWorkspace,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Enter the energy of bodies and springs, and of the frame's motion [F* D]."""
        state = bed.state
        chain, last = law.chain, law.chain.masses.size - 1
        total, below = 0.0, 0.0
        for k in range(last + 1):
            x, speed = workspace.persistent[0, k], workspace.persistent[1, k]
            total += 0.5 * chain.stiffness[k] * (x - below) * (x - below)
            if k < last:
                total += 0.5 * chain.masses[k] * speed * speed
            below = x
        if law.mount != FIXED:
            frame, piston = workspace.persistent[1, last], state.piston[SPEED]
            momentum = bed_momentum(bed)
            total += 0.5 * (law.frame_mass + law.bed_mass) * frame * frame + frame * momentum
            total += law.piston_mass * frame * (0.5 * frame + piston)
        energies[index] = total
        return 0


@compiled(inline=True)
def last_body_velocity(law: HostLaw, workspace: HostWorkspace, state: State) -> float:
    """Velocity of the last body over the base [D/tau]."""
    speed = workspace.persistent[1, law.chain.masses.size - 1]
    return speed + state.piston[SPEED] if law.mount == PISTON_MOUNT else speed


@compiled
def bed_momentum(bed: Bed) -> float:
    """Vertical momentum of the grains in the frame of the cell [m D/tau]."""
    state, constants = bed.state, bed.constants
    total = 0.0
    for i in range(constants.grains):
        total += value_or_one(constants.masses, i) * state.vy[i]
    return total
