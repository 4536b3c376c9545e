"""Host structure: bodies on springs and dashpots that carry the cell, and further pistons in the cell.

The bodies of a machine form a vertical chain from the base upwards, each on a spring and a dashpot. The last
body carries the cell or the piston; all forces on the carried part act on this body. Displacements X are
measured from static equilibrium with the damper mounted, in which the springs carry all weights. Further
pistons move in the cell; one of them may be the bottom of the cell. Springs can join any two bodies, or a
body and the base. `granular.engine.bodies` has the equations.

In the compiled loop, the array of bodies has the cell in row `CELL`, the piston in row `PISTON`, and all
others in later rows. The height of the cell is its displacement relative to the base; the other bodies are
described in the frame of the cell, like the grains. A link is a spring with a dashpot, or a stop, between two
bodies or between a body and the base.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from granular.compiled import Array, compiled
from granular.effects.effect import (
    Effect,
    EffectContext,
    ForceEffect,
    GrainsAndPistonEffect,
    RecordedVariable,
    recorded_energy_variable,
)
from granular.effects.excitation import ExcitationLaw, HostExcitation
from granular.kernel_data.state import CELL, HEIGHT, LOSSES, PISTON, SPEED, Bed, State
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
    text_field,
)
from granular.shared.array_types import Float, Int
from granular.shared.errors import unknown_word_message


class BodyProperties(NamedTuple):
    """Properties of each body; for the cell only ``masses`` and ``start`` are used."""

    masses: Float[np.ndarray, "b"]  # [m]; for the cell, including all that is fixed to it
    weights: Float[np.ndarray, "b"]  # not carried by springs [F*]
    rates: Float[np.ndarray, "b"]  # decay rates by drag in the guide [1/tau]
    frictions: Float[np.ndarray, "b"]  # Coulomb friction in the guide [F*]
    start: Float[np.ndarray, "b"]  # height from which displacements are measured [D]


class BodyLinks(NamedTuple):
    """Springs, dashpots and stops."""

    signs: Float[np.ndarray, "l b"]  # sign of each body's height in the distance of the ends; cell first
    stiffness: Float[np.ndarray, "l"]  # [F*/D]
    damping: Float[np.ndarray, "l"]  # [F* tau/D]
    preload: Float[np.ndarray, "l"]  # force that pushes the ends apart at the start [F*]
    gap: Float[np.ndarray, "l"]  # approach at which a stop engages [D]; -inf for a spring


class RecordedBodies(NamedTuple):
    """Bodies whose motion is recorded."""

    rows: Int[np.ndarray, "k"]
    over_base: Float[np.ndarray, "k"]  # 1: displacement relative to the base; 0: height in the cell


class BodyKickScratch(NamedTuple):
    """Scratch arrays of a kick."""

    forces: Float[np.ndarray, "b"]  # on each body in the cell, without inertial forces [F*]
    drags: Float[np.ndarray, "b"]  # mean forces of dashpots [F*]
    guides: Float[np.ndarray, "b"]  # mean forces of guides [F*]
    changes: Float[np.ndarray, "b"]  # changes of speed, without guides [D/tau]
    matrix: Float[np.ndarray, "b b"]  # [m]
    before: Float[np.ndarray, "b"]  # speeds before the kick [D/tau]
    speeds: Float[np.ndarray, "2 m"]  # velocities x, y of the grains before a kick [D/tau]
    push: Float[np.ndarray, "m"]  # vertical forces on the grains, without inertial forces [F*]
    ledger: Float[np.ndarray, "k"]


class BodiesAndLinksLaw(NamedTuple):
    """Bodies and links in natural units, for the compiled loop."""

    moves_cell: bool  # whether the cell moves; otherwise it is fixed to the base
    has_dashpots: bool  # whether a link has a dashpot
    rows: BodyProperties
    links: BodyLinks
    chain_length: int  # number of links of the machine, which come first
    recorded: RecordedBodies
    drive: ExcitationLaw
    is_driven: bool  # whether bodies or base are excited
    excited: int  # row of the body on which the force acts
    bed_mass: float  # [m]
    recoil: float  # velocity lost by the cell per velocity that the drive gives to the piston
    pass_count: int  # repetitions of a kick until the reactions of dissipative forces are known
    entry: int  # ledger index of the loss to dashpots and further guides
    law_count: int  # number of laws, including this one

    def workspace(self, size: int, count: int) -> BodyKickScratch:
        """Make the scratch arrays of the kicks."""
        bodies = len(self.rows.masses)
        forces, drags, guides, changes, before = np.zeros((5, bodies))
        return BodyKickScratch(
            forces=forces,
            drags=drags,
            guides=guides,
            changes=changes,
            matrix=np.zeros((bodies, bodies)),
            before=before,
            speeds=np.zeros((2, size)),
            push=np.zeros(size),
            ledger=np.zeros(LOSSES + self.law_count),
        )

    @staticmethod
    @compiled
    def measure_energy_and_stiffness(
        law: BodiesAndLinksLaw,
        workspace: BodyKickScratch,
        index: int,
        bed: Bed,
        time: float,
        stiffness: Float[Array, "m"],
        energies: Float[Array, "laws"],
    ) -> int:
        """Store the energy of bodies and links, and the kinetic energy due to the cell's motion [F* D]."""
        bodies, masses = bed.state.bodies, law.rows.masses
        total = 0.0
        for link in range(law.links.stiffness.size):
            total += _link_energy(law, bed.state, link)
        for b in range(PISTON + 1, masses.size):
            total += 0.5 * masses[b] * bodies[b, SPEED] * bodies[b, SPEED]
            total += law.rows.weights[b] * bodies[b, HEIGHT]
        if law.moves_cell:
            frame = bodies[CELL, SPEED]
            total += 0.5 * (
                masses[CELL] + law.bed_mass
            ) * frame * frame + frame * vertical_momentum_of_grains(bed)
            for b in range(PISTON, masses.size):
                total += masses[b] * frame * (0.5 * frame + bodies[b, SPEED])
        energies[index] = total
        return 0


@compiled
def _link_stretch(law: BodiesAndLinksLaw, state: State, link: int) -> float:
    """Increase of the distance between the ends of a link since the start [D]."""
    signs, bodies = law.links.signs, state.bodies
    total = signs[link, CELL] * bodies[CELL, HEIGHT]
    for b in range(PISTON, bodies.shape[0]):
        total += signs[link, b] * (bodies[b, HEIGHT] - law.rows.start[b])
    return total


@compiled
def link_force(law: BodiesAndLinksLaw, state: State, link: int) -> float:
    """Repulsive force of a spring or a stop between its ends [F*]."""
    links, stretch = law.links, _link_stretch(law, state, link)
    if links.gap[link] >= 0.0:
        return links.stiffness[link] * max(-stretch - links.gap[link], 0.0)
    return links.preload[link] - links.stiffness[link] * stretch


@compiled
def _link_energy(law: BodiesAndLinksLaw, state: State, link: int) -> float:
    links, stretch = law.links, _link_stretch(law, state, link)
    if links.gap[link] >= 0.0:
        stretch = max(-stretch - links.gap[link], 0.0)
        return 0.5 * links.stiffness[link] * stretch * stretch
    return (0.5 * links.stiffness[link] * stretch - links.preload[link]) * stretch


@compiled
def vertical_momentum_of_grains(bed: Bed) -> float:
    """Vertical momentum of the grains in the frame of the cell [m D/tau]."""
    state, constants = bed.state, bed.constants
    total = 0.0
    for i in range(constants.grains):
        total += value_or_one(constants.masses, i) * state.vy[i]
    return total


RESOLVED = 4.0
"""Steps per period of the host, divided by steps per period of the bed's stiffest mode. The ratio is above 1,
since most of the energy is in the host."""


class HostBody(Section):
    """A body of the host, connected to the previous body or the base by a spring and a dashpot.

    Attributes
    ----------
    mass : float
        Mass of the body [kg].
    stiffness : float
        Stiffness of the spring [N/m].
    damping : float
        Coefficient of the dashpot [kg/s].
    """

    mass: float = quantity("kg", above=0.0)
    stiffness: float = quantity("N/m", default=0.0, least=0.0)
    damping: float = quantity("kg/s", default=0.0, least=0.0)


class FurtherPiston(Section):
    """A further piston, which moves vertically in a guide of the cell; the height is 0 at the start.

    Attributes
    ----------
    name : str
        Name for springs and records.
    mass : float
        Mass of the piston [kg].
    side : str or None
        Name of the side of the cell that moves with this piston, such as ``"bottom"``.
    drag : float
        Viscous drag in its guide [kg/s].
    friction : float
        Force of Coulomb friction in its guide [N].
    """

    name: str = text_field()
    mass: float = quantity("kg", above=0.0)
    side: str | None = text_field(default=None, optional=True)
    drag: float = quantity("kg/s", default=0.0, least=0.0)
    friction: float = quantity("N", default=0.0, least=0.0)


class Spring(Section):
    """A spring and a dashpot, or a stop, between two bodies or between a body and the base.

    Attributes
    ----------
    upper, lower : str
        The bodies at the upper and lower end: ``"base"``, ``"cell"``, ``"piston"``, the name of a further
        piston, or ``"body_0"``, ``"body_1"`` ... for the host's bodies below the last one.
    stiffness : float
        Stiffness of the spring [N/m].
    damping : float
        Coefficient of the dashpot [kg/s].
    preload : float
        Repulsive force at the start [N].
    gap : float or None
        Distance by which the ends must approach to touch [m]. A spring with a gap is a stop: it acts only in
        contact, and only repels.
    """

    upper: str = text_field()
    lower: str = text_field(default="base")
    stiffness: float = quantity("N/m", default=0.0, least=0.0)
    damping: float = quantity("kg/s", default=0.0, least=0.0)
    preload: float = quantity("N", default=0.0)
    gap: float | None = quantity("m", default=None, least=0.0, optional=True)

    def validate(self) -> None:
        """Check that a stop has neither preload nor damping, because these act at any distance."""
        if self.gap is not None and (self.preload or self.damping):
            raise FieldError("a stop (with a gap) has no preload or damping; remove them, or the gap", "gap")
        if self.upper == self.lower:
            raise FieldError("equals upper; join two different bodies, or a body and the base", "lower")

    def repulsive_force_at_stretch(self, stretch: float) -> float:
        """Repulsive force between the ends [N]; stretch since the start [m]."""
        if self.gap is not None:
            return self.stiffness * max(-stretch - self.gap, 0.0)
        return self.preload - self.stiffness * stretch


@dataclasses.dataclass(frozen=True)
class SceneBodies:
    """All bodies of a scene, in SI; the first two are the cell and the piston."""

    names: tuple[str, ...]
    masses: Float[np.ndarray, "b"]  # [kg]; meaningless for a cell on the base
    springs: tuple[Spring, ...]  # springs of the chain first
    chain: tuple[str, ...]  # names of the machine's bodies, from the base upwards
    carrying_mass: float  # mass of the machine's last body [kg]
    pistons: tuple[FurtherPiston, ...]

    def row_of_body(self, name: str) -> int:
        """Index of a body, by name."""
        return self.names.index(name)

    @property
    def recorded_displacements(self) -> list[tuple[str, str, int, bool]]:
        """Name, meaning and row of each recorded displacement, and True if it is relative to the base."""
        result = [("host", "the last body", self.row_of_body(name), True) for name in self.chain[-1:]]
        result += [(name, name.replace("_", " "), self.row_of_body(name), True) for name in self.chain[:-1]]
        return result + [
            (other.name, other.name, self.row_of_body(other.name), False) for other in self.pistons
        ]

    def body_properties_in_natural_units(
        self, piston: Piston | None, weight: float, gravity: float, scales: Scales
    ) -> BodyProperties:
        """Return the properties of the bodies; weight on the piston [F*], gravity [D/tau^2]."""
        count = len(self.names)
        weights, drags, frictions, start = np.zeros((4, count))
        weights[PISTON] = weight
        if piston is not None:
            drags[PISTON], frictions[PISTON], start[PISTON] = piston.drag, piston.friction, piston.height
        for other in self.pistons:
            row = self.row_of_body(other.name)
            weights[row] = other.mass / scales.mass * gravity
            drags[row], frictions[row] = other.drag, other.friction
        rates = np.divide(drags * scales.time, self.masses, out=np.zeros(count), where=drags > 0.0)
        return BodyProperties(
            self.masses / scales.mass, weights, rates, frictions / scales.force, start / scales.length
        )

    def links_in_natural_units(self, scales: Scales) -> BodyLinks:
        """Springs, dashpots and stops."""
        stiffness = scales.force / scales.length
        springs = self.springs
        gaps = [-math.inf if spring.gap is None else spring.gap / scales.length for spring in springs]
        signs = np.zeros((len(springs), len(self.names)))
        for k, spring in enumerate(springs):
            for name, sign in ((spring.upper, 1.0), (spring.lower, -1.0)):
                # All bodies except the base also move with the cell.
                signs[k, CELL] += sign * (name != "base")
                if name not in ("base", "cell"):
                    signs[k, self.row_of_body(name)] += sign
        return BodyLinks(
            signs=signs,
            stiffness=np.array([spring.stiffness for spring in springs]) / stiffness,
            damping=np.array([spring.damping for spring in springs]) / (stiffness * scales.time),
            preload=np.array([spring.preload for spring in springs]) / scales.force,
            gap=np.array(gaps),
        )


class Host(GrainsAndPistonEffect):
    """Primary structure that carries the damper, with excitation, further pistons and springs.

    Attributes
    ----------
    mount : str
        ``"cell"``: the last body carries the cell, and the piston is free. ``"piston"``: the last body
        carries the piston; the cell is free and rests upside down on the bed, which rests on the piston.
        Heights are then measured downwards from the closed end of the cell, and ``piston.mass`` is added to
        the body. ``"base"``: the cell is fixed to the base, and the piston is the load to be isolated.
    bodies : tuple of HostBody
        From the base upwards; none with ``mount = "base"``.
    cell_mass : float or None
        Mass of the free cell [kg], with ``mount = "piston"``.
    excitation : HostExcitation or None
    excited : int or None
        Index, from 0, of the body on which the force acts; if not given, the last body.
    pistons : tuple of FurtherPiston
    springs : tuple of Spring
    """

    key = "host"
    rank = 3
    unwritten_defaults = ("pistons", "springs")
    example: ClassVar[Any] = {
        "bodies": [{"mass": "1 kg", "stiffness": "400 N/m", "damping": "0.2 kg/s"}],
        "excitation": {"kind": "sine", "force": "0.1 N", "frequency": "3 Hz"},
    }
    energy_record = recorded_energy_variable(
        "host_energy",
        "energy of bodies and springs, and the kinetic energy of grains and piston due to the motion of "
        "the cell",
    )
    loss_record = recorded_energy_variable(
        "host_loss", "energy lost to dashpots and the guides of further pistons"
    )

    mount: str = choice_field("cell", "piston", "base", default="cell")
    bodies: tuple[HostBody, ...] = section_list_field(HostBody, default=())
    cell_mass: float | None = quantity("kg", above=0.0, default=None, optional=True)
    excitation: HostExcitation | None = nested_section_field(HostExcitation, default=None, optional=True)
    excited: int | None = integer_field(default=None, optional=True)
    pistons: tuple[FurtherPiston, ...] = section_list_field(FurtherPiston, default=())
    springs: tuple[Spring, ...] = section_list_field(Spring, default=())

    @property
    def moves_cell(self) -> bool:
        """True if the cell moves relative to the base."""
        return self.mount != "base"

    def body_rows_by_side(self) -> dict[str, int]:
        """Row of the further piston with which a side moves, by the side's name."""
        return {
            other.side: self.scene_bodies(None).row_of_body(other.name)
            for other in self.pistons
            if other.side
        }

    @property
    def damps(self) -> bool:  # type: ignore[override]  # depends on the dashpots
        """True if a body has a dashpot, or a further piston has a guide with drag or friction."""
        resists = any(other.drag > 0.0 or other.friction > 0.0 for other in self.pistons)
        return resists or any(spring.damping > 0.0 for spring in self.scene_bodies(None).springs)

    @property
    def dry(self) -> bool:  # type: ignore[override]  # depends on the guides
        """True if a further piston has dry friction."""
        return any(other.friction > 0.0 for other in self.pistons)

    @property
    def extra_records(self) -> tuple[RecordedVariable, ...]:
        """Displacements and velocities of bodies, and the excitation."""
        result = []
        for name, words, _, _ in self.scene_bodies(None).recorded_displacements:
            result += [
                RecordedVariable(f"{name}_displacement", "m", f"displacement of {words}", "length"),
                RecordedVariable(f"{name}_velocity", "m/s", f"velocity of {words}", "velocity"),
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
        """Check that bodies, mount, cell mass and excitation are consistent and springs join known bodies."""
        if (self.mount == "base") == bool(self.bodies):
            raise FieldError(
                "a cell on the base has no bodies; remove them, or give another mount"
                if self.bodies
                else "a cell that is not on the base needs bodies; give one or more",
                "bodies",
            )
        if (self.mount == "piston") != (self.cell_mass is not None):
            raise FieldError(
                "is required for mount = 'piston' and allowed only then; add it, or remove it", "cell_mass"
            )
        if self.mount == "base" and self.excitation is not None and not self.excitation.is_base_motion:
            raise FieldError(
                "a force cannot act on the base; give an acceleration or a displacement", "excitation"
            )
        if self.excited is not None and not self.excited < len(self.bodies):
            raise FieldError(
                f"{self.excited} is not the index of a body; there are {len(self.bodies)} bodies, with "
                "indices from 0",
                "excited",
            )
        if self.mount == "piston" and self.pistons:
            raise FieldError("with mount = 'piston' the cell has no further pistons; remove them", "pistons")
        known = self.scene_bodies(None).names
        for index, other in enumerate(self.pistons):
            if known.count(other.name) > 1 or other.name in ("base", "host"):
                raise FieldError(
                    "is already the name of another body; give another name", "pistons", str(index), "name"
                )
        for index, spring in enumerate(self.springs):
            for key in ("upper", "lower"):
                end = getattr(spring, key)
                if end not in (*known, "base"):
                    words = unknown_word_message(end, (*known, "base"), "body")
                    raise FieldError(words, "springs", str(index), key)

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that no other effect moves the cell, and that a piston on a host or a spring has a mass."""
        if "shaking" in others:
            raise FieldError(
                "effects.shaking already moves the cell; remove it, and give the host a base motion instead",
                "effects",
                self.key,
            )
        if "bath" in others:
            raise FieldError(
                "cannot act together with 'bath', which ignores the motion of a host; remove one of them",
                "effects",
                self.key,
            )
        sides = [line.name for line in cell.lines if line.body == CELL]
        for index, other in enumerate(self.pistons):
            path = ("effects", self.key, "pistons", str(index), "side")
            if other.side is not None and other.side not in sides:
                raise FieldError(unknown_word_message(other.side, tuple(sides), "side of the cell"), *path)
            if other.side is not None and [further.side for further in self.pistons].count(other.side) > 1:
                raise FieldError("already moves with another piston; choose another side", *path)
            line = next((line for line in cell.lines if line.name == other.side), None)
            if line is not None and not line.is_level:
                _refuse_forces_along_moving_side(line.name, others, *path)
        walls: Any = others.get("walls")
        if walls is not None and walls.has_gap:
            raise FieldError("cannot carry a cell with gaps; close them", "effects", self.key)
        holds_piston = any("piston" in (spring.upper, spring.lower) for spring in self.springs)
        if (self.mount == "piston" or holds_piston) and (piston is None or piston.mass is None):
            raise FieldError("is missing; a piston on a host or spring needs a mass", "piston", "mass")

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Highest angular frequency of the host or of the excitation, times `RESOLVED` [1/tau]."""
        drive = 0.0 if self.excitation is None else self.excitation.highest_frequency()
        masses = [body.mass for body in self.bodies]
        stiffness = [body.stiffness for body in self.bodies] + [0.0]
        # Row sums of the chain's stiffness matrix over the masses bound its squared frequencies (Gershgorin).
        rows = [2.0 * (stiffness[k] + stiffness[k + 1]) / mass for k, mass in enumerate(masses)]
        return RESOLVED * max(math.tau * drive, math.sqrt(max(rows, default=0.0))) * scales.time

    def plain_host_without_machine(self) -> dict[str, Any] | None:
        """Return plain data of the host with only its further pistons and springs; None if it has neither."""
        cell = ("base", "cell", "piston", *(other.name for other in self.pistons))
        springs = [spring for spring in self.springs if {spring.upper, spring.lower} <= {*cell}]
        if not (self.pistons or springs):
            return None
        return Host(mount="base", pistons=self.pistons, springs=tuple(springs)).to_plain()

    def cell_weight_on_piston(self, grains: Grains, scales: Scales, gravity: float) -> float | None:
        """Weight [F*] of a free cell and its grains on the piston; None if the cell is not free."""
        if self.cell_mass is None:
            return None
        return (self.cell_mass + float(grains.masses().sum())) / scales.mass * gravity

    def moving_piston_mass(self, mass: float) -> float:
        """Return the mass [kg] that moves with the piston, including a body that carries the piston."""
        return mass + self.bodies[-1].mass if self.mount == "piston" else mass

    def scene_bodies(self, piston: Piston | None) -> SceneBodies:
        """Table of all bodies and springs."""
        own = 0.0 if piston is None or piston.mass is None else piston.mass
        below = tuple(f"body_{k}" for k in range(len(self.bodies) - 1))
        chain = (*below, self.mount) if self.bodies else ()
        carrying = self.bodies[-1].mass if self.bodies else 0.0
        carrier = carrying if self.mount == "cell" else self.cell_mass or 1.0
        masses = [carrier, self.moving_piston_mass(own)]
        masses += [body.mass for body in self.bodies[:-1]] + [other.mass for other in self.pistons]
        springs = tuple(
            Spring(upper=upper, lower=lower, stiffness=body.stiffness, damping=body.damping)
            for upper, lower, body in zip(chain, ("base", *below), self.bodies, strict=False)
        )
        names = ("cell", "piston", *below, *(other.name for other in self.pistons))
        return SceneBodies(names, np.array(masses), (*springs, *self.springs), chain, carrying, self.pistons)

    def make_kernel_law(self, context: EffectContext) -> BodiesAndLinksLaw:
        """Make the law for the compiled loop, in natural units."""
        scales, piston, table = context.scales, context.piston, self.scene_bodies(context.piston)
        acting = [part for effect in context.effects.values() for part in effect.component_effects]
        gravity = sum(part.downward_acceleration(scales) for part in acting if isinstance(part, ForceEffect))
        weight = self.cell_weight_on_piston(context.grains, scales, gravity)
        if weight is None:
            weight = float(table.masses[PISTON]) / scales.mass * gravity
        rows, links = (
            table.body_properties_in_natural_units(piston, weight, gravity, scales),
            table.links_in_natural_units(scales),
        )
        carrier, moving = float(rows.masses[CELL]), float(rows.masses[PISTON])
        rubs, has_dashpots = bool(rows.rates.any() or rows.frictions.any()), bool(links.damping.any())
        # Dissipative forces in the cell react on it.
        inside = rubs or any(effect.dissipates for effect in context.effects.values() if effect is not self)
        reacts = self.moves_cell and (has_dashpots or inside)
        recorded = table.recorded_displacements
        over = np.array([float(over) for *_, over in recorded])
        excited = len(table.chain) - 1 if self.excited is None else self.excited
        return BodiesAndLinksLaw(
            moves_cell=self.moves_cell,
            has_dashpots=has_dashpots,
            rows=rows,
            links=links,
            chain_length=len(table.chain),
            recorded=RecordedBodies(np.array([row for _, _, row, _ in recorded], np.int64), over),
            drive=(self.excitation or HostExcitation(force=0.0, frequency=1.0)).make_kernel_law(scales),
            is_driven=self.excitation is not None,
            excited=table.row_of_body(table.chain[excited]) if table.chain else CELL,
            bed_mass=float(context.grains.masses().sum()) / scales.mass,
            recoil=moving / (carrier + moving) if self.moves_cell else 0.0,
            pass_count=3 if reacts or (has_dashpots and rubs) else 1,
            entry=LOSSES + context.indices[self.key],
            law_count=1 + max(context.indices.values()),
        )


def _refuse_forces_along_moving_side(side: str, others: Mapping[str, Effect], *path: str) -> None:
    """Reject tangential forces on an inclined side of a further piston: its force balance omits them."""
    walls: Any = others.get("walls")
    wall = None if walls is None else walls.wall_of(side)
    if wall is not None and (wall.own is not None or wall.law in ("slab", "discs")):
        raise FieldError(
            f"is not level, and its wall {wall.law!r} exerts a tangential force; use 'infinite' or "
            "'experimental', or a level side",
            *path,
        )
    if "wall_friction" in others:
        raise FieldError(
            "is not level, so friction at this side is not supported; remove effects.wall_friction", *path
        )
