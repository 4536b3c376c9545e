"""The scene: a frozen, validated, plain description of a bed, its piston and what happens."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from granular.effects.contact import Contact
from granular.effects.dipole import Dipole
from granular.effects.drag import Drag
from granular.effects.friction import Friction
from granular.effects.gravity import Gravity
from granular.effects.shaking import Shaking
from granular.effects.walls import Walls
from granular.pairs.section import Pairs
from granular.protocol import KINDS, Stage
from granular.scene.arrangement import Arrangement, initial_motion
from granular.scene.schema import (
    FieldError,
    Many,
    Section,
    choice,
    declare,
    many,
    one,
    quantity,
    text,
    unknown,
    whole,
)
from granular.scene.units import si_value
from granular.shared.errors import SceneError

SCENES = Path(__file__).parents[1] / "scenes"


class Species(Section):
    """One kind of grain: a flat cylinder magnetised along its axis.

    Attributes
    ----------
    name : str
    diameter : float
        [m]
    share : float
        Fraction of the grains; the shares of a bed add up to 1.
    """

    name: str = text(default="grain")
    diameter: float = quantity("m", above=0.0)
    share: float = quantity("1", default=1.0, least=0.0, most=1.0)


class Grains(Section):
    """The grains, all of one material and thickness. Defaults as in [D, Table 2.1].

    Attributes
    ----------
    count : int
    species : tuple of Species
        The first one sets the natural units.
    thickness : float
        [m]
    density : float
        [kg/m^3]
    remanence : float
        Residual magnetisation Br [T].
    mixing : str
        How the species follow each other in the initial grid, row by row: ``"interspersed"``,
        each evenly, in the numbers that their shares give; or ``"every-kth"``, the source's rule
        for two species [D, 4.2.2]: every k-th grain is of the second one, k = floor(1/R) for its
        share R up to 1/2, or every k-th is of the first one, k = floor(1/(1 - R)), above. It makes
        other shares than it is given (1/2 for every R in (1/3, 1/2]); see `shares`.
    """

    count: int = whole(most=10**8)
    species: tuple[Species, ...] = many(Species, least=1)
    thickness: float = quantity("m", default=0.003, above=0.0)
    density: float = quantity("kg/m^3", default=7368.0, above=0.0)
    remanence: float = quantity("T", default=1.3, above=0.0)
    mixing: str = choice("interspersed", "every-kth", default="interspersed")

    def validate(self) -> None:
        total = sum(one.share for one in self.species)
        if abs(total - 1.0) > 1e-9:
            raise FieldError(f"the shares add up to {total:g}; they must add up to 1", "species")
        if self.mixing == "every-kth" and len(self.species) != 2:
            raise FieldError(
                f"'every-kth' mixes 2 species, not {len(self.species)}; take 'interspersed'",
                "mixing",
            )

    def counts(self) -> tuple[int, ...]:
        """How many grains each species has."""
        return tuple(np.bincount(self.assignment(), minlength=len(self.species)).tolist())

    def shares(self) -> tuple[float, ...]:
        """The share of each species that the mixing rule really makes."""
        return tuple(number / max(self.count, 1) for number in self.counts())

    def assignment(self) -> np.ndarray:
        """Species index of each grain (n,)."""
        if self.mixing == "every-kth":
            return _every_kth(self.count, self.species[1].share)
        counts = self._rounded_counts()
        places = [(np.arange(number) + 0.5) / max(number, 1) for number in counts]
        owner = np.repeat(np.arange(len(counts)), counts)
        return owner[np.argsort(np.concatenate(places), kind="stable")]

    def _rounded_counts(self) -> tuple[int, ...]:
        """Shares of ``count``, by largest remainder."""
        exact = [self.count * one.share for one in self.species]
        counts = [int(number + 1e-9) for number in exact]
        order = sorted(range(len(exact)), key=lambda k: counts[k] - exact[k])
        for k in order[: self.count - sum(counts)]:
            counts[k] += 1
        return tuple(counts)

    def diameters(self) -> np.ndarray:
        """Diameter of each grain (n,) [m]."""
        return np.array([one.diameter for one in self.species])[self.assignment()]


def _every_kth(count: int, share: float) -> np.ndarray:
    """Grain numbers count from 1; the quotients are exact, where floating point makes 19 of 20."""
    rare = Fraction(repr(share)).limit_denominator(10**6)
    common, found = 0, 1
    if rare > Fraction(1, 2):
        rare, common, found = 1 - rare, 1, 0
    species = np.full(count, common)
    if rare > 0:
        every = int(1 / rare)
        species[every - 1 :: every] = found
    return species


class Cell(Section):
    """The Hele-Shaw cell.

    Attributes
    ----------
    width : float
        Distance of the side walls [m].
    separation : float
        Distance E of the glass plates [m].
    """

    width: float = quantity("m", above=0.0)
    separation: float = quantity("m", default=0.0031, above=0.0)


class Piston(Section):
    """The piston, the cell's top wall.

    Attributes
    ----------
    height : float
        At the start [m].
    mass : float or None
        [kg]; needed where a stage lets it move freely.
    drag : float
        Viscous drag of the free piston [kg/s].
    friction : float
        Coulomb friction of the free piston [N].
    """

    height: float = quantity("m", above=0.0)
    mass: float | None = quantity("kg", above=0.0, default=None, optional=True)
    drag: float = quantity("kg/s", default=0.0, least=0.0)
    friction: float = quantity("N", default=0.0, least=0.0)


class Effects(Section):
    """The effects that act. What is left out costs nothing.

    Attributes
    ----------
    dipole : Dipole or None
    walls : Walls or None
    gravity : Gravity or None
    drag : Drag or None
    friction : Friction or None
    contact : Contact or None
    shaking : Shaking or None
    """

    dipole: Dipole | None = one(Dipole, default=None, optional=True)
    walls: Walls | None = one(Walls, default=None, optional=True)
    gravity: Gravity | None = one(Gravity, default=None, optional=True)
    drag: Drag | None = one(Drag, default=None, optional=True)
    friction: Friction | None = one(Friction, default=None, optional=True)
    contact: Contact | None = one(Contact, default=None, optional=True)
    shaking: Shaking | None = one(Shaking, default=None, optional=True)


class Output(Section):
    """What a run records, and how often.

    Attributes
    ----------
    scalars : float
        From record to record of piston, wall forces and energies [s].
    frames : float
        From frame to frame of the grains' positions, velocities and forces [s].
    record : str or None
        The stage whose piston motion is the record to identify; all of the run if not given.
    """

    scalars: float = quantity("s", default=0.001, above=0.0)
    frames: float = quantity("s", default=0.1, above=0.0)
    record: str | None = text(default=None, optional=True)

    @property
    def frames_every(self) -> int:
        """Records from frame to frame."""
        return round(self.frames / self.scalars)

    def validate(self) -> None:
        ratio = self.frames / self.scalars
        if ratio < 0.5 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            near = max(1, round(ratio)) * self.scalars
            raise FieldError(
                f"{self.frames:g} s is no whole multiple of scalars = {self.scalars:g} s; "
                f"give {near:g} s",
                "frames",
            )


class Scene(Section):
    """A complete description of a run. See the attributes' classes for their keys."""

    name: str = text(default="scene")
    grains: Grains = one(Grains)
    cell: Cell = one(Cell)
    piston: Piston | None = one(Piston, default=None, optional=True)
    effects: Effects = one(Effects, default=Effects())
    pairs: Pairs = one(Pairs, default=Pairs())
    arrangement: Arrangement = one(Arrangement, default=Arrangement())
    protocol: tuple[Stage, ...] = declare(Many(kinds=KINDS), default=())
    output: Output = one(Output, default=Output())

    def validate(self) -> None:
        self._check_piston()
        self._check_walls()
        if self.effects.friction is not None:
            self.effects.friction.factors(self.grains, self.cell)
        if self.output.record is not None:
            names = tuple(stage.name for stage in self.protocol)
            if self.output.record not in names:
                raise FieldError(unknown(self.output.record, names, "stage"), "output", "record")
        positions = self.arrangement.positions
        if positions is not None and len(positions) != self.grains.count:
            raise FieldError(
                f"holds {len(positions)} pairs for grains.count = {self.grains.count}",
                "arrangement",
                "positions",
            )
        self._check_pairs()
        initial_motion(self)

    @property
    def pair_method(self) -> str:
        """How pairs are summed, where it is left to choose."""
        return self.pairs.chosen(self.grains.count, closed=self._closed)

    @property
    def _closed(self) -> bool:
        walls = self.effects.walls
        return walls is not None and not walls.has_gap and None not in walls.sides

    def _check_pairs(self) -> None:
        if self.pairs.method == "mesh" and not self._closed:
            raise FieldError(
                "the mesh of 'mesh' covers a closed cell; give all four walls and no gap, or take "
                "'direct'",
                "pairs",
                "method",
            )

    def greatest_height(self) -> float:
        """Greatest height of piston and grains that is known before the run [m]."""
        height = self.piston.height if self.piston is not None else 0.0
        highest = [height, float(initial_motion(self)[0][:, 1].max(initial=0.0))]
        for stage in self.protocol:
            height += stage.jump(height)
            final = stage.final_height()
            highest.append(height)
            if final is not None:
                height = final
                highest.append(height)
        return max(highest)

    def _check_walls(self) -> None:
        walls, piston = self.effects.walls, self.piston
        if walls is not None:
            try:
                walls.check_size(self.cell.width, None if piston is None else piston.height)
            except FieldError as error:
                raise error.within("effects", "walls") from None
        top = walls is not None and walls.top is not None
        for place, stage in enumerate(self.protocol):
            if not top and self.grains.count and (stage.needs_mass or stage.limits_force):
                raise FieldError(
                    "the piston must be a wall that grains push (effects.walls.top)",
                    "protocol",
                    stage.name or str(place),
                )

    def _check_piston(self) -> None:
        walls = self.effects.walls
        if self.piston is None and walls is not None and walls.top is not None:
            raise FieldError(
                "there is no piston; give [piston] a height or set it to 'none'",
                "effects",
                "walls",
                "top",
            )
        for stage in self.protocol:
            if stage.needs_piston and self.piston is None:
                raise FieldError(f"must be given: stage {stage.name!r} moves the piston", "piston")
            if stage.needs_mass and (self.piston is None or self.piston.mass is None):
                raise FieldError(
                    f"must be given: stage {stage.name!r} lets the piston move freely",
                    "piston",
                    "mass",
                )

    def replace(self, **changes: Any) -> Scene:
        """A new scene with some values changed.

        Parameters
        ----------
        **changes
            Dotted keys, given as ``**{"grains.count": 92, "piston.mass": "7.5 kg"}``. An item of a
            list is named by its index or its ``name``. None takes an optional part away.

        Raises
        ------
        SceneError
            For an unknown key or an unfit value.
        """
        plain = self.plain()
        for key, value in changes.items():
            _put(plain, key.split("."), value)
        return Scene.from_plain(plain)

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Scene:
        """A scene from plain data; the unit D means the diameter of the first species."""
        return cls.build(plain, _first_diameter(plain))

    def to_toml(self) -> str:
        """The scene as a TOML file's text; `load_scene` reads an equal scene from it."""
        import tomli_w

        return tomli_w.dumps(self.plain())

    def save(self, path: str | Path) -> None:
        """Write the scene to a TOML file."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")

    def digest(self) -> str:
        """A digest of the scene's content: equal scenes have equal digests."""
        return plain_digest(self.plain())


def plain_digest(plain: Mapping[str, Any]) -> str:
    """The digest of a scene from its plain data."""
    text = json.dumps(plain, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _first_diameter(plain: Mapping[str, Any]) -> float | None:
    try:
        diameter = plain["grains"]["species"][0]["diameter"]
    except (KeyError, IndexError, TypeError):
        return None
    try:
        return si_value(diameter, "m") if isinstance(diameter, str) else float(diameter)
    except (SceneError, TypeError, ValueError):
        return None  # the field's own check names what is wrong


def _put(plain: Any, path: list[str], value: Any) -> None:
    for depth, key in enumerate(path):
        last = depth == len(path) - 1
        if isinstance(plain, list):
            names = [str(item.get("name")) for item in plain]
            if key not in names and not (key.isdecimal() and int(key) < len(plain)):
                raise FieldError(unknown(key, tuple(names), "item"), *path[:depth], key)
            place: Any = names.index(key) if key in names else int(key)
        else:
            place = key
            if not last and plain.get(key) in (None, "none", True):
                plain[key] = {}
        if last:
            plain[place] = value
        else:
            plain = plain[place]
            if not isinstance(plain, dict | list):
                raise FieldError(f"has no parts; remove '.{path[depth + 1]}'", *path[: depth + 1])


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False


def scene_names() -> tuple[str, ...]:
    """Names of the packaged scenes."""
    return tuple(sorted(path.stem for path in SCENES.glob("*.toml")))


def load_scene(source: str | Path) -> Scene:
    """A packaged scene by its name, or a scene from a TOML file.

    Raises
    ------
    SceneError
        If there is no such scene, the file is not TOML, or the scene is not valid.
    """
    path = Path(source)
    if str(source) in scene_names():
        path = SCENES / f"{source}.toml"
    elif not _is_file(path):
        if path.suffix:
            raise SceneError(f"there is no scene file {str(source)!r}; check the path")
        raise SceneError(unknown(str(source), scene_names(), "scene"))
    try:
        plain = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path}: not a TOML file: {error}") from None
    try:
        return Scene.from_plain(plain)
    except SceneError as error:
        raise SceneError(f"{path.name}: {error}") from None
