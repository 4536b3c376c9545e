"""The scene: an immutable, validated description of a bed, its piston and its protocol."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from granular.effects.effect import EFFECTS, Effect
from granular.pairs.pair_sum_settings import PairSumSettings
from granular.protocol import KINDS, Stage
from granular.scene.arrangement import GRID, Arrangement, initial_positions_and_velocities
from granular.schema.apparatus import Grains, Output, Piston
from granular.schema.cell import PISTON, Cell, piston_wall_key
from granular.schema.field_kinds import FieldError, NestedSectionKind, SectionListKind, add_key_to_errors
from granular.schema.sections import Section, nested_section_field, section_field, text_field
from granular.schema.units import si_value
from granular.shared.blocks import Printout
from granular.shared.citations import module_docstring_of
from granular.shared.errors import InputError, quote, unknown_word_message
from granular.shared.files import digest, write_text

if TYPE_CHECKING:
    from granular.effects.dipole import Dipole
    from granular.effects.drag import Drag
    from granular.effects.friction import Friction
    from granular.effects.host_structure import Host
    from granular.effects.shaking import Shaking
    from granular.effects.walls import Walls


class Effects(Section):
    """Active effects, each an attribute with the effect's name. Inactive effects take no computing time."""

    _given: Mapping[str, Effect]

    if TYPE_CHECKING:
        dipole: Dipole | None
        drag: Drag | None
        walls: Walls | None
        friction: Friction | None
        shaking: Shaking | None
        host: Host | None

    def __init__(self, **given: Any) -> None:
        object.__setattr__(self, "_given", _read_effects(given, None))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in EFFECTS:
            raise AttributeError(f"effect {name!r} does not exist")
        return self._given.get(name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Effects) and self._given == other._given

    def __hash__(self) -> int:
        return hash(tuple(sorted(self._given)))

    def __repr__(self) -> str:
        return f"Effects({', '.join(f'{name}={effect!r}' for name, effect in self._given.items())})"

    @property
    def acting(self) -> tuple[Effect, ...]:
        """Effects that act, sorted by name."""
        return tuple(self._given.values())

    @property
    def in_loop_order(self) -> tuple[Effect, ...]:
        """Active effects except the dipole forces, in the order in which the loop applies them."""
        parts = [part for item in self.acting if item.key != "dipole" for part in item.component_effects]
        return tuple(sorted(parts, key=lambda effect: (effect.rank, effect.key)))

    @classmethod
    def key_names(cls) -> tuple[str, ...]:
        """Names of all available effects."""
        return tuple(sorted(EFFECTS))

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Read the effects from a table of their keys; diameter [m]."""
        if plain is True:
            plain = {}
        if not isinstance(plain, Mapping):
            raise FieldError(
                f"{quote(plain)} is not a table; give a table with the keys {', '.join(cls.key_names())}"
            )
        self = object.__new__(cls)
        object.__setattr__(self, "_given", _read_effects(plain, diameter))
        return self

    def to_plain(self) -> dict[str, Any]:
        """Convert the effects to a table, which `from_plain` converts back."""
        return {name: effect.to_plain() for name, effect in self._given.items()}


def _read_effects(plain: Mapping[str, Any], diameter: float | None) -> dict[str, Effect]:
    result = {}
    for name in sorted(plain):
        with add_key_to_errors(errors=InputError):
            effect = EFFECTS.find(name)
        with add_key_to_errors(name):
            section = NestedSectionKind(True, section=effect).read_value(plain[name], diameter)
        if section is not None:
            result[name] = section
    return result


_REPLACED_KEYS = {
    "arrangement.positions": GRID,
    "grains.grade": ("remanence", "moment", "permeability"),
    "grains.remanence": ("moment",),
    "grains.moment": ("remanence",),
    "effects.drag.coefficient": ("offset", "packing"),
    "effects.drag.liquid": ("coefficient", "viscosity"),
    "effects.drag.viscosity": ("coefficient", "liquid"),
    "piston.drag": ("blade", "guide"),
    "piston.blade": ("drag",),
    "piston.guide": ("drag",),
}
"""For each key, other keys of the same section that are removed when the key is given."""


class Scene(Section):
    """A complete description of a run, in SI. The classes of the attributes document keys and units.

    Attributes
    ----------
    name : str
        Name for titles and messages.
    grains : Grains
        Species, number of grains and mixing.
    cell : Cell
        Width and sides of the cell.
    piston : Piston or None
        Piston above the bed, or None.
    effects : Effects
        Active forces, dissipation and moving frames.
    pairs : PairSumSettings
        Method of the sum over pairs.
    arrangement : Arrangement
        Initial positions and velocities.
    protocol : tuple of Stage
        Stages of the piston's motion.
    output : Output
        Recorded quantities and intervals.

    Raises
    ------
    SceneError
        If a value is invalid (`FieldError`), or parts of the scene are inconsistent; see `validate`.
    """

    name: str = text_field(default="scene")
    grains: Grains = nested_section_field(Grains)
    cell: Cell = nested_section_field(Cell)
    piston: Piston | None = nested_section_field(Piston, default=None, optional=True)
    effects: Effects = nested_section_field(Effects, default=Effects())
    pairs: PairSumSettings = nested_section_field(PairSumSettings, default=PairSumSettings())
    arrangement: Arrangement = nested_section_field(Arrangement, default=Arrangement())
    protocol: tuple[Stage, ...] = section_field(SectionListKind(kinds=KINDS), default=())
    output: Output = nested_section_field(Output, default=Output())

    @property
    def literature(self) -> tuple[str, ...]:
        """References for the effects, a tuple of str; see `granular.cite`."""
        parts = [part for effect in self.effects.acting for part in (effect, *effect.component_effects)]
        return tuple(module_docstring_of(type(part)) for part in parts)

    def validate(self) -> None:
        """Check that the parts of the scene are consistent; called when a scene is made.

        Raises
        ------
        FieldError
            If two parts are inconsistent; the error has the path of a key, and is a `SceneError`.
        SceneError
            If grains overlap each other or a wall at the start, or do not fit.
        """
        self._set_values_derived_from_parts()
        self._check_piston()
        acting = {effect.key: effect for effect in self.effects.acting}
        for effect in acting.values():
            effect.check_compatibility(self.grains, self.cell, self.piston, acting)
        self._check_joint_kicks()
        self._check_periodic_cell()
        if self.output.record is not None:
            names = tuple(stage.name for stage in self.protocol)
            if self.output.record not in names:
                raise FieldError(unknown_word_message(self.output.record, names, "stage"), "output", "record")
        positions, count = self.arrangement.positions, self.grains.count
        if positions is not None and len(positions) != count:
            raise FieldError(
                f"holds {len(positions)} pairs for grains.count = {count}; give one pair per grain",
                "arrangement",
                "positions",
            )
        self._check_pair_method()
        self.initial_positions_and_velocities()

    def _set_values_derived_from_parts(self) -> None:
        """Compute wall laws and drag coefficients from the parts of the scene, such as a liquid."""
        resolved = (effect.resolve_parts(self.grains, self.cell) for effect in self.effects.acting)
        object.__setattr__(self, "effects", Effects(**{effect.key: effect for effect in resolved}))
        if self.piston is not None:
            viscosity = None if self.effects.drag is None else self.effects.drag.viscosity
            piston = self.piston.resolve_parts(self.grains, self.cell, viscosity)
            object.__setattr__(self, "piston", piston)

    def _check_joint_kicks(self) -> None:
        """Check that effects whose ``kick`` replaces the standard update of velocities can act together."""
        kicks = [effect for effect in self.effects.in_loop_order if effect.solved_together_with is not None]
        for other in kicks[:-1]:
            if other.key not in (kicks[-1].solved_together_with or ()):
                raise FieldError(
                    f"cannot act together with {other.key!r}; remove one of them", "effects", kicks[-1].key
                )

    def initial_positions_and_velocities(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the initial positions [m] and velocities [m/s] of the grains, each (n, 2).

        Positions and velocities depend on arrangement, grains, cell and piston, and have been checked.

        Returns
        -------
        tuple of arrays
            Positions [m] and velocities [m/s], float64 (n, 2) each, x before y; n may be 0.
        """
        touching = self.effects.contact is not None
        return initial_positions_and_velocities(
            self.arrangement, self.grains, self.cell, self.piston, overlapping=touching
        )

    @property
    def pair_method(self) -> str:
        """Name of the method for pair sums; for ``"auto"``, the selected method."""
        return self.pairs.resolve_method(
            self.grains.count, closed=self.has_closed_walls, shorter_side=self._shorter_side_over_diameter
        )

    @property
    def _shorter_side_over_diameter(self) -> float | None:
        """Ratio of a periodic cell's shorter side to the first species' diameter."""
        if self.cell.periods is None:
            return None
        return min(self.cell.periods) / self.grains.species[0].diameter

    @property
    def has_closed_walls(self) -> bool:
        """True if walls close the cell on all sides, without a gap."""
        walls = self.effects.walls
        if walls is None or walls.has_gap or len(walls.sides_with_walls) < len(self.cell.lines):
            return False
        height = 0.0 if self.piston is None else self.piston.height
        names = [line.name for line in self.cell.lines]
        return not self.cell.is_polygon or not self.cell.gap_vectors(names, height)

    @property
    def has_piston_wall(self) -> bool:
        """True if a side that moves with the piston is a wall for the grains."""
        walls = self.effects.walls
        return walls is not None and any(
            line.body == PISTON and walls.wall_of(line.name) is not None for line in self.cell.lines
        )

    def _check_pair_method(self) -> None:
        if self.grains.magnets == "cylinders" and self.pairs.method == "verlet-list":
            raise FieldError(
                "de Paula's list supports only dipoles; use 'direct' or magnets = 'dipoles'",
                "pairs",
                "method",
            )
        if self.cell.periods is not None:
            return
        if self.pairs.method == "direct" and self.pairs.cut_off is not None:
            raise FieldError("'direct' has no cut-off in a closed cell; remove this key", "pairs", "cut_off")
        if self.pairs.method == "mesh" and not self.has_closed_walls:
            raise FieldError(
                "'mesh' needs a closed cell; give four walls without a gap, or use 'direct'",
                "pairs",
                "method",
            )

    def _check_periodic_cell(self) -> None:
        """Check that a periodic cell has no walls or piston, and that all effects support periodic images."""
        shorter_period = self._shorter_side_over_diameter
        if shorter_period is None:
            return
        if self.piston is not None:
            raise FieldError("a cell with periodic sides cannot have a piston; remove the piston", "piston")
        for effect in self.effects.acting:
            if not effect.periodic:
                raise FieldError("cannot act in a cell with periodic sides; remove it", "effects", effect.key)
        with add_key_to_errors("pairs"):
            self.pairs.check_periodic_cell(self.grains.count, shorter_period, self.grains.species[0].diameter)

    def greatest_height(self) -> float:
        """Return the maximum height [m] of piston and grains that can be known before the run.

        The maximum is over the initial grains and piston, jumps of the piston and prescribed final heights.

        Returns
        -------
        float
            Height [m]; 0 without piston and grains.
        """
        height = self.piston.height if self.piston is not None else 0.0
        highest = [height, float(self.initial_positions_and_velocities()[0][:, 1].max(initial=0.0))]
        for stage in self.protocol:
            height += stage.initial_jump(height)
            highest.append(height)
            if (final := stage.prescribed_final_height()) is not None:
                height = final
            highest.append(height)
        return max(highest)

    def _check_piston(self) -> None:
        if self.piston is None and self.has_piston_wall:
            side = next(line.name for line in self.cell.lines if line.body == PISTON)
            raise FieldError(
                "the scene has no piston; add one, or set this wall to 'none'", "effects", "walls", side
            )
        if self.piston is not None:
            self.cell.check_convex(self.piston.height)
        for stage in self.protocol:
            if stage.needs_piston and self.piston is None:
                raise FieldError(f"is missing, but stage {stage.name!r} moves the piston; add it", "piston")
            if stage.needs_piston_mass and (self.piston is None or self.piston.mass is None):
                raise FieldError(
                    f"is missing, but the piston moves freely in stage {stage.name!r}; give the mass",
                    "piston",
                    "mass",
                )
            if (
                not self.has_piston_wall
                and self.grains.count
                and (stage.needs_piston_mass or stage.ends_at_force)
            ):
                raise FieldError(
                    f"the grains exert no force on the piston; add {piston_wall_key(self.cell.lines)}",
                    "protocol",
                    stage.name,
                )

    def replace(self, **changes: Any) -> Scene:
        """Return a new scene with some values changed.

        Parameters
        ----------
        **changes
            Dotted keys, given as ``**{"grains.count": 92, "piston.mass": "7.5 kg"}``. Numbers are in SI;
            strings have a unit, such as "3 mm" or "30 D" (diameters of the first species). Items of lists are
            given by index or ``name``. None removes an optional part. Some keys remove the keys that they
            replace: ``arrangement.positions`` removes the grid, ``grains.grade`` the remanence, and
            ``effects.drag.liquid`` the coefficient.

        Returns
        -------
        Scene
            The changed scene; this scene is unchanged.

        Raises
        ------
        SceneError
            For an unknown key or an invalid value (`FieldError`), or grains that overlap at the start.

        Examples
        --------
        >>> from granular import load_scene
        >>> scene = load_scene("bed").replace(**{"grains.count": 92, "cell.width": "30 D"})
        >>> scene.grains.count, scene.cell.width
        (92, 0.18)
        """
        plain = self.to_plain()
        walls = self.effects.walls
        for side in () if walls is None else walls.unnamed:
            if f"effects.walls.{side}.pitch" not in changes:
                del plain["effects"]["walls"][side]
        for key, others in _REPLACED_KEYS.items():
            if any(f"{change}.".startswith(f"{key}.") for change in changes):
                section = plain
                for name in key.split(".")[:-1]:
                    section = section.get(name, {})
                for name in others:
                    section.pop(name, None)
        for key, value in changes.items():
            _set_nested_key(plain, key.split("."), copy.deepcopy(value))
        return Scene.from_plain(plain)

    @classmethod
    def from_plain(cls, plain: Any, diameter: float | None = None) -> Self:
        """Make a scene from plain data; the unit D is the diameter of the first species.

        Parameters
        ----------
        plain : mapping of str
            Plain data, as from `to_plain`: numbers in SI, or strings with a unit.
        diameter : float, optional
            Length of the unit D [m]; default: the diameter of the first species.

        Returns
        -------
        Scene
            The validated scene.

        Raises
        ------
        FieldError
            For an unknown key or a missing or invalid value; the error has the path of the key, and is a
            `SceneError`.
        SceneError
            If grains overlap each other or a wall at the start.
        """
        return super().from_plain(plain, diameter or _first_species_diameter(plain))

    def __repr__(self) -> str:
        pairs = zip(self.grains.species, self.grains.species_counts(), strict=True)
        grains = " + ".join(f"{count} of {1e3 * specy.diameter:.6g} mm" for specy, count in pairs)
        piston = ""
        if self.piston is not None:
            mass = "" if self.piston.mass is None else f", {self.piston.mass:.6g} kg"
            piston = f", piston at {1e3 * self.piston.height:.6g} mm{mass}"
        if self.cell.height is not None:
            piston = f", {1e3 * self.cell.height:.6g} mm high, periodic"
        effects = ", ".join(effect.key for effect in self.effects.acting)
        return (
            f"Scene {self.name!r}: {grains}, cell {1e3 * self.cell.width:.6g} mm wide{piston}\n"
            f"  effects: {effects or 'none'}\n"
            f"  stages: {', '.join(stage.name for stage in self.protocol)}"
        )

    def _repr_html_(self) -> str:
        from granular.shared.html_pages import blocks_html

        return blocks_html([Printout(self.to_toml())])

    def _repr_latex_(self) -> str:
        from granular.shared.blocks import latex_lines

        return latex_lines(repr(self))

    def to_toml(self) -> str:
        """Return the scene as the text of a TOML file that `load_scene` can read.

        Returns
        -------
        str
            Text of the file, with numbers in SI units.
        """
        import tomli_w

        return tomli_w.dumps(self.to_plain())

    def save(self, path: str | Path) -> None:
        """Write the scene to a TOML file.

        Parameters
        ----------
        path : str or Path
            TOML file to write; an existing file is replaced.

        Raises
        ------
        InputError
            If the file cannot be written; an existing file is kept.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> from granular import load_scene
        >>> path = Path(tempfile.mkdtemp()) / "my-bed.toml"
        >>> load_scene("bed").save(path)
        >>> load_scene(path).grains.count
        368
        """
        write_text(Path(path), self.to_toml())

    def digest(self) -> str:
        """Return a digest of the scene's content: equal scenes have equal digests.

        Returns
        -------
        str
            First 16 hexadecimal digits of the SHA-256 of its plain data.
        """
        return digest(self.to_plain(), 16)  # 64 bits: chance of a collision among a million scenes 3e-8


def _first_species_diameter(plain: Mapping[str, Any]) -> float | None:
    try:
        diameter = plain["grains"]["species"][0]["diameter"]
        return si_value(diameter, "m") if isinstance(diameter, str) else float(diameter)
    except (KeyError, IndexError, TypeError, ValueError):
        return None  # the check of the field reports the error


def _set_nested_key(plain: Any, path: list[str], value: Any) -> None:
    for depth, key in enumerate(path):
        last = depth == len(path) - 1
        if isinstance(plain, list):
            names = [str(item.get("name")) if isinstance(item, dict) else "" for item in plain]
            if key not in names and not (key.isdecimal() and int(key) < len(plain)):
                raise FieldError(unknown_word_message(key, tuple(names), "item"), *path[:depth], key)
            position: Any = names.index(key) if key in names else int(key)
        else:
            position = key
            if not last and plain.get(key) in (None, "none", True):
                plain[key] = {}
        if last:
            plain[position] = value
        else:
            plain = plain[position]
            if not isinstance(plain, dict | list):
                raise FieldError(f"has no parts; remove '.{path[depth + 1]}'", *path[: depth + 1])


DOUBTFUL, COARSE_DOUBTFUL = 1e-4, 1e-2
"""Errors of the energy balance, relative to the energy turnover, above which a run is reported as degraded.
The second value applies to scenes with de Paula's friction or list of pairs
(`granular.engine.state.COARSE_FACTOR`)."""


def dry_friction_parts(scene: Scene) -> tuple[str, ...]:
    """List the parts of the bed and of a free piston that have dry friction."""
    names = [effect.key for effect in scene.effects.in_loop_order if effect.dry]
    piston = scene.piston
    if piston is not None and piston.mass is not None and piston.friction > 0.0:
        names.append("piston.friction")
    return tuple(names)


def dissipative_parts(scene: Scene) -> tuple[str, ...]:
    """List the dissipative parts of the bed and of a free piston."""
    names = [effect.key for effect in scene.effects.in_loop_order if effect.dissipates]
    piston = scene.piston
    if piston is not None and piston.mass is not None:
        names += [f"piston.{name}" for name in ("drag", "friction") if getattr(piston, name) > 0.0]
    return tuple(names)


def has_depaula_friction_or_pair_list(scene: Scene) -> bool:
    """Return True if a scene has de Paula's regularized friction or uses de Paula's list of pairs."""
    friction = scene.effects.friction
    return friction is not None and (friction.scheme == "regularised" or scene.pair_method == "verlet-list")


def degraded_energy_residual_limit(scene: Scene) -> float:
    """Relative error of the energy balance above which a run of the scene is reported as degraded."""
    return COARSE_DOUBTFUL if has_depaula_friction_or_pair_list(scene) else DOUBTFUL
