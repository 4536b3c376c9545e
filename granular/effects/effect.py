"""Interface of an effect: one file that holds all that the scene, the loop and the run need.

An effect is a section of the scene: its fields are its parameters, with units and limits. Once a
run it makes its *law*: a named tuple of numbers in natural units, and of arrays with one value for
each grain, which follow a grain that leaves. (Arrays that are something else stand in a tuple of
their own within the law.) The law's class has kernels as static methods, the *hooks* of the loop.
What is not there costs nothing; ``law, workspace, index`` come before the others' arguments.

An effect is of one of three kinds, or of two, and subclasses what it is:

- a force, `ForceEffect`: it has an energy, and is minus its gradient;
- a flow, `DissipativeEffect`: it takes energy, and is solved exactly;
- a frame, `MovingFrameEffect`: it acts on everything, the piston too.

``workspace(size, count)``, where the law has it, makes the scratch arrays that the loop hands
over as ``workspace``; its field ``persistent``, if it has one, is part of the run's state.

Where a grain, a pair or a wall's distance is all that counts, the loops over grains need not be
written: a class with the functions of one of them, decorated with
`granular.effects.custom.effect` as a user's own, becomes an effect of this form, and so does a
formula. `granular.effects.magnetic_gradient` is written so. The file's own test aside, nothing else has to
be touched but the table `EFFECTS`.

A flow: it takes energy, and is solved exactly. `granular.effects.eddy_drag` is a short one.

Its velocities after a duration are exact at fixed positions: as a force it would cost the second
order. What it takes is entered in ``state.ledger[LOSSES + index]``. Hooks of its law, behind
``law, workspace, index``:

``damp_velocities(..., dt, bed, opens_step) -> int``
    Velocities after ``dt`` under this effect alone; forward behind the kick that opens a step,
    backward before the one that closes it.
``kick(..., dt, bed, opens_step) -> int``
    Velocities after ``dt`` under all forces, instead of the plain kick, for what must be solved
    together with them; the last effect that has one gives it, and must take along what others do.

A force: it has an energy, and is minus its gradient. `granular.effects.gravity` is a short one.

Hooks of its law, behind ``law, workspace, index``:

``add_forces(..., bed, time) -> int``
    Add the forces on the grains; how many grains are where they cannot be.
``measure_energy_and_stiffness(..., bed, time, stiffness, energies) -> int``
    Enter the energy at ``energies[index]``; add to ``stiffness`` a bound of each grain's stiffness
    over its mass, which the automatic step follows.
``record_external_work(..., dt, bed, time) -> int``
    Enter in ``state.ledger[WORK]`` what a force that depends on time does.
``squared_head_on_impact_frequency(..., speed, constants) -> float``
    Greatest stiffness over mass that a grain of this speed meets.

A frame: it acts on everything, the piston too. `granular.effects.shaking` is a short one.

A host moves grains and piston by their forces, so the loop itself moves it: `granular.engine.bodies`.
Hooks of its law, behind ``law, workspace, index``, next to those of a force that it may have:

``upward_acceleration(..., time) -> float``
    Upward acceleration of all that has a mass.
``drift(..., dt, bed) -> int``
    Positions after ``dt``, instead of the plain drift, and velocities that change in its middle, as
    a heat bath wants it; for Störmer-Verlet's coefficients alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from granular.schema.apparatus import Grains, Piston
from granular.schema.cell import Cell
from granular.schema.natural_units import Scales
from granular.schema.sections import Section
from granular.shared.array_types import Float, Int
from granular.shared.registry import Registry


class RecordedVariable(NamedTuple):
    """A variable of the run that an effect brings.

    Attributes
    ----------
    name, unit, meaning : str
    scale : str
        The natural unit it is in, an attribute of `Scales`.
    """

    name: str
    unit: str
    meaning: str
    scale: str


@dataclasses.dataclass(frozen=True, eq=False)
class EffectContext:
    """Context in which an effect makes its law.

    Attributes
    ----------
    grains : Grains
    cell : Cell
    scales : Scales
    species : int (n,)
        Species of each grain.
    effects : mapping of str to Effect
        All effects that act, by their keys.
    indices : mapping of str to int
        Index of each effect in the tuple of laws.
    piston : Piston or None
    cut_off : float or None
        Distance at which all pairs end [D]; None: they do not.
    """

    grains: Grains
    cell: Cell
    scales: Scales
    species: Int[np.ndarray, "n"]
    effects: Mapping[str, Any]
    indices: Mapping[str, int]
    piston: Piston | None = None
    cut_off: float | None = None

    @property
    def periods(self) -> tuple[float, float] | None:
        """Sides of a periodic cell [D]; None of a closed one."""
        sides, length = self.cell.periods, self.scales.length
        return None if sides is None else (sides[0] / length, sides[1] / length)


class Effect(Section):
    """Base of the effects.

    Attributes
    ----------
    key : str
        Name of the effect in a scene.
    rank : int
        The loop takes effects in the order of their ranks, and of their names: 0 for what acts on
        each grain alone, 1 for pairs, 2 for walls.
    dry : bool
        Whether it stops grains at a threshold, and cannot be undone backward in time.
    damps : bool
        Whether it takes energy wherever grains move.
    drifts : bool
        Whether it has a ``drift``.
    periodic : bool
        Whether it is the same at a grain and at all images of it, and meets the nearest images of
        other grains: it can act in a periodic cell.
    takes_along : tuple of str or None
        Of an effect with a ``kick``: those of the others with a ``kick`` that are solved with it.
    energy_record, loss_record : RecordedVariable or None
        Records of its energy and its loss; those of the same name are added up.
    grain_records : tuple of RecordedVariable
        Records with a value for each grain.
    example : plain data
        Parameters as a scene may have them, for the reference and for the test of all effects.
    """

    key: ClassVar[str] = ""
    rank: ClassVar[int] = 0
    dry: ClassVar[bool] = False
    damps: ClassVar[bool] = False
    drifts: ClassVar[bool] = False
    periodic: ClassVar[bool] = False
    takes_along: ClassVar[tuple[str, ...] | None] = None
    energy_record: ClassVar[RecordedVariable | None] = None
    loss_record: ClassVar[RecordedVariable | None] = None
    grain_records: ClassVar[tuple[RecordedVariable, ...]] = ()
    example: ClassVar[Any] = True

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """The effects that it is made of, each with a law."""
        return (self,)

    @property
    def extra_records(self) -> tuple[RecordedVariable, ...]:
        """Series that the effect records, besides its energy and its loss."""
        return ()

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digests of a user's functions and texts in it, for the run's settings."""
        return ()

    @property
    def dissipates(self) -> bool:
        """True where it, or an effect that it is made of, takes energy."""
        return any(part.damps or part.dry for part in self.component_effects)

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Make the law that the compiled loop takes, in natural units.

        Parameters
        ----------
        context : EffectContext
            Grains, cell, natural units and effects of the scene.

        Returns
        -------
        named tuple or None
            None for what is no law of its own.

        Raises
        ------
        NotImplementedError
            In the base class.
        """
        raise NotImplementedError

    def resolve_parts(self, grains: Grains, cell: Cell) -> Effect:
        """Return the effect with the numbers that follow from the parts of grains and cell."""
        return self

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that the effect fits grains, cell, piston and the other effects.

        Parameters
        ----------
        grains : Grains
            Grains of the scene.
        cell : Cell
            Cell of the scene.
        piston : Piston or None
            Piston of the scene; None where there is none.
        others : Mapping[str, Effect]
            All effects that act, by their keys.

        Raises
        ------
        FieldError
            If it does not; with the path of the key from the scene.
        """

    def normal_load_weights(self, context: EffectContext) -> Float[np.ndarray, "m"] | None:
        """Weights of the grains in the sums over 1/r^3 that the pass over pairs also makes.

        Parameters
        ----------
        context : EffectContext
            Grains, cell, natural units and effects of the scene.

        Returns
        -------
        float64 (m,) or None
            Weights, in units of D^3 F*; None where the effect needs no such sums.
        """
        return None

    def grain_record_values(self, law: Any, state: Any) -> dict[str, np.ndarray]:
        """Values of the effect's `grain_records` at the present moment.

        Parameters
        ----------
        law : object
            Law that the effect made.
        state : object
            State of the run.

        Returns
        -------
        dict of str to float64 (m,)
            Values by their names, in natural units.
        """
        return {}

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Angular frequency of a drive, which a step is to resolve.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [1/tau]; 0 without a drive.
        """
        return 0.0


def energy_variable(name: str, meaning: str) -> RecordedVariable:
    """Make the record of an energy."""
    return RecordedVariable(name, "J", meaning, "energy")


class DissipativeEffect(Effect):
    """Base of the effects that take energy."""

    def decay_rate(self, scales: Scales) -> float:
        """Rate of a linear decay of the velocities, which a step is to resolve up to a limit.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [1/tau]; 0 where the effect has none.
        """
        return 0.0


class ForceEffect(Effect):
    """Base of the effects that have an energy."""

    def downward_acceleration(self, scales: Scales) -> float:
        """Downward acceleration that never changes, which can make grains faster.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [D/tau^2]; 0 where the effect has none.
        """
        return 0.0


class MovingFrameEffect(Effect):
    """Base of the effects that carry grains and piston together."""

    def greatest_imparted_speed(self, scales: Scales) -> float:
        """Greatest speed that the effect lends to all grains.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            [D/tau]; 0 where it lends none.
        """
        return 0.0


EFFECTS = Registry[type[Effect]](
    "effect",
    "granular.effects",
    {
        "bath": "granular.effects.langevin_bath:Bath",
        "contact": "granular.effects.contact:Contact",
        "dipole": "granular.effects.dipole:Dipole",
        "drag": "granular.effects.drag:Drag",
        "eddy": "granular.effects.eddy_drag:Eddy",
        "field": "granular.effects.formula:ForceFields",
        "friction": "granular.effects.friction:Friction",
        "gradient": "granular.effects.magnetic_gradient:Gradient",
        "gravity": "granular.effects.gravity:Gravity",
        "host": "granular.effects.host_structure:Host",
        "pair_law": "granular.effects.formula:PairLaws",
        "shaking": "granular.effects.shaking:Shaking",
        "wall_friction": "granular.effects.wall_friction:WallFriction",
        "walls": "granular.effects.walls:Walls",
    },
    lambda key, made: isinstance(made, type) and issubclass(made, Effect) and made.key == key,
    "an effect of that key",
    from_files=True,
)
"""Effects by their keys."""

WALL_LAWS = Registry[type[Section]](
    "law of a wall",
    "granular.wall_laws",
    {"formula": "granular.effects.formula:WallFormula"},
    lambda key, made: (
        issubclass(made, Section) and getattr(getattr(made, "definition", None), "key", key) == key
    ),
    "a law of that name made by granular.wall_law",
    from_files=True,
)
"""Laws of walls, but for those that `granular.effects.walls` has itself."""
