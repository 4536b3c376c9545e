"""Base classes of effects, and the functions that an effect provides for the scene, the loop and the run.

An effect is a section of the scene; its fields are its parameters, with units and limits. At the start of a
run the effect makes its *law*: a named tuple of numbers in natural units and of arrays with one value per
grain. When a grain leaves, its entries are removed from these arrays. (Arrays of any other length belong in a
nested tuple within the law.) The static methods of the law's class are compiled *hooks*, which the loop calls
at fixed points of a time step. Hooks that are not defined take no computing time. The first arguments of
every hook are ``law, workspace, index``.

An effect subclasses one or two of three base classes:

- a force, `ForceEffect`: minus the gradient of an energy;
- dissipation, `DissipativeEffect`: removes energy, and is solved exactly;
- a moving frame, `GrainsAndPistonEffect`: acts on all bodies, including the piston.

A law may have a method ``workspace(size, count)``, which makes the scratch arrays that the loop passes as
``workspace``. A field ``persistent`` of the workspace is part of the run's state.

If an effect depends only on one grain, one pair or the distance from a wall, no loops over grains need to be
written: the effect can be a class with functions of one grain, decorated with
`granular.effects.custom.effect`, or a formula. `granular.effects.magnetic_gradient` is an example. Apart from
its file and its test, a new built-in effect needs only an entry in the table `EFFECTS`.

**Dissipation.** `granular.effects.eddy_drag` is a short example.

The velocities after a time step are exact at fixed positions. If dissipation were treated as a force, the
integrator would no longer be of second order. The lost energy is added to ``state.ledger[LOSSES + index]``.
Hooks, with the arguments that follow ``law, workspace, index``:

``damp_velocities(..., dt, bed, opens_step) -> int``
    Set the velocities after ``dt`` under this effect alone. The effects act in forward order after the kick
    that opens a step, and in reverse order before the kick that closes it.
``kick(..., dt, bed, opens_step) -> int``
    Set the velocities after ``dt`` under all forces, in place of the plain kick, for effects that must be
    solved together with the forces. If several effects have this hook, only the last one is called, and it
    must include the others.

**Forces.** `granular.effects.gravity` is a short example.

Hooks, with the arguments that follow ``law, workspace, index``:

``add_forces(..., bed, time) -> int``
    Add the forces on the grains; return the number of grains at impossible positions.
``measure_energy_and_stiffness(..., bed, time, stiffness, energies) -> int``
    Set ``energies[index]`` to the energy; add to ``stiffness`` an upper bound of each grain's ratio of
    stiffness to mass, which determines the automatic time step.
``record_external_work(..., dt, bed, time) -> int``
    Add the work of a time-dependent force to ``state.ledger[WORK]``.
``squared_head_on_impact_frequency(..., speed, constants) -> float``
    Maximum ratio of stiffness to mass in a head-on impact at this speed.

**Moving frames.** `granular.effects.shaking` is a short example.

The motion of a host, the structure that carries the damper, depends on the forces of grains and piston. The
loop itself therefore moves the host (`granular.engine.bodies`). Hooks in addition to the hooks of a force,
with the arguments that follow ``law, workspace, index``:

``upward_acceleration(..., time) -> float``
    Upward inertial acceleration of all grains and the piston.
``drift(..., dt, bed) -> int``
    Set the positions after ``dt``, in place of the plain drift, if velocities change halfway through the
    drift, as in a heat bath. Requires the Störmer-Verlet method.
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
    """A variable that an effect adds to the recorded time series of a run.

    Attributes
    ----------
    name, unit, meaning : str
    scale : str
        Natural unit of the values, given by the name of an attribute of `Scales`.
    """

    name: str
    unit: str
    meaning: str
    scale: str


@dataclasses.dataclass(frozen=True, eq=False)
class EffectContext:
    """Scene data from which an effect makes its law.

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
        Cut-off distance of all pair sums [D]; None: no cut-off.
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
        """Side lengths of a periodic cell [D]; None if the cell is not periodic."""
        sides, length = self.cell.periods, self.scales.length
        return None if sides is None else (sides[0] / length, sides[1] / length)


class Effect(Section):
    """Base class of effects.

    Attributes
    ----------
    key : str
        Name of the effect in a scene.
    rank : int
        Order in which the loop applies effects: 0 for single grains, 1 for pairs, 2 for walls; effects of
        equal rank are applied in alphabetical order.
    dry : bool
        True if the effect has dry friction, which stops grains and is therefore not reversible in time.
    damps : bool
        True if the effect dissipates energy whenever grains move.
    drifts : bool
        True if the law has a hook ``drift``.
    periodic : bool
        True if the effect can act in a periodic cell: it is the same for a grain and all its images, and
        uses the nearest images of other grains.
    solved_together_with : tuple of str or None
        For an effect with the hook ``kick``: keys of other effects with this hook that are included in the
        kick.
    energy_record, loss_record : RecordedVariable or None
        Recorded variables for the energy and the lost energy; variables with the same name are summed.
    grain_records : tuple of RecordedVariable
        Recorded variables with one value per grain.
    example : plain data
        Example parameters as in a scene, for the reference and for the test of all effects.
    """

    key: ClassVar[str] = ""
    rank: ClassVar[int] = 0
    dry: ClassVar[bool] = False
    damps: ClassVar[bool] = False
    drifts: ClassVar[bool] = False
    periodic: ClassVar[bool] = False
    solved_together_with: ClassVar[tuple[str, ...] | None] = None
    energy_record: ClassVar[RecordedVariable | None] = None
    loss_record: ClassVar[RecordedVariable | None] = None
    grain_records: ClassVar[tuple[RecordedVariable, ...]] = ()
    example: ClassVar[Any] = True

    @property
    def component_effects(self) -> tuple[Effect, ...]:
        """Effects of which this effect consists, each with a law."""
        return (self,)

    @property
    def extra_records(self) -> tuple[RecordedVariable, ...]:
        """Series that the effect records in addition to its energy and loss."""
        return ()

    @property
    def user_code_digests(self) -> tuple[str, ...]:
        """Digests (hashes) of the user's functions and formulas in the effect, which identify a run."""
        return ()

    @property
    def dissipates(self) -> bool:
        """True if the effect, or one of its components, dissipates energy."""
        return any(part.damps or part.dry for part in self.component_effects)

    def make_kernel_law(self, context: EffectContext) -> Any:
        """Make the law for the compiled loop, in natural units.

        Parameters
        ----------
        context : EffectContext
            Grains, cell, natural units and effects of the scene.

        Returns
        -------
        named tuple or None
            Law; None if the effect has no law in the loop.

        Raises
        ------
        NotImplementedError
            In the base class.
        """
        raise NotImplementedError

    def resolve_parts(self, grains: Grains, cell: Cell) -> Effect:
        """Return the effect with the values that follow from grains and cell."""
        return self

    def check_compatibility(
        self, grains: Grains, cell: Cell, piston: Piston | None, others: Mapping[str, Effect]
    ) -> None:
        """Check that the effect is compatible with grains, cell, piston and the other effects.

        Parameters
        ----------
        grains : Grains
            Grains of the scene.
        cell : Cell
            Cell of the scene.
        piston : Piston or None
            Piston of the scene; None without a piston.
        others : Mapping[str, Effect]
            All effects that act, by their keys.

        Raises
        ------
        FieldError
            If the effect is not compatible; the error has the path of the key in the scene.
        """

    def normal_load_weights(self, context: EffectContext) -> Float[np.ndarray, "m"] | None:
        """Weights of the grains in the sums of 1/r^3 that are computed together with the pair forces.

        Parameters
        ----------
        context : EffectContext
            Grains, cell, natural units and effects of the scene.

        Returns
        -------
        float64 (m,) or None
            Weights, in units of D^3 F*; None if the effect needs no such sums.
        """
        return None

    def grain_record_values(self, law: Any, state: Any) -> dict[str, np.ndarray]:
        """Return the current values of the effect's `grain_records`.

        Parameters
        ----------
        law : object
            Law made by the effect.
        state : object
            State of the run.

        Returns
        -------
        dict of str to float64 (m,)
            Values by their names, in natural units.
        """
        return {}

    def drive_angular_frequency(self, scales: Scales) -> float:
        """Angular frequency of a drive, which the time step must resolve.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            Angular frequency [1/tau]; 0 without a drive.
        """
        return 0.0


def recorded_energy_variable(name: str, meaning: str) -> RecordedVariable:
    """Make the record of an energy."""
    return RecordedVariable(name, "J", meaning, "energy")


class DissipativeEffect(Effect):
    """Base class of dissipative effects."""

    def decay_rate(self, scales: Scales) -> float:
        """Linear decay rate of the velocities; the time step resolves rates up to a limit.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            Decay rate [1/tau]; 0 if the effect has no linear decay.
        """
        return 0.0


class ForceEffect(Effect):
    """Base class of effects with an energy."""

    def downward_acceleration(self, scales: Scales) -> float:
        """Constant downward acceleration of the grains.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            Acceleration [D/tau^2]; 0 if the effect has none.
        """
        return 0.0


class GrainsAndPistonEffect(Effect):
    """Base class of effects that move grains and piston together."""

    def maximum_imparted_speed(self, scales: Scales) -> float:
        """Maximum speed that the effect gives to the grains.

        Parameters
        ----------
        scales : Scales
            Natural units of the scene, in SI.

        Returns
        -------
        float
            Speed [D/tau]; 0 if the effect gives none.
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
    "an effect with this key",
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
    "a law with this name, made by granular.wall_law",
    from_files=True,
)
"""Wall laws in addition to the built-in laws of `granular.effects.walls`."""
