"""Tolerances of a damper's parts: how much each one moves equilibrium, frequency and damping ratio.

A tolerance is a standard deviation. Each part's number is moved by it to both sides, and the equilibrium and
root of the changed damper are found from those of the settled one; with all parts drawn at once likewise.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.linear import motion_friction, piston_roots
from granular.linear.bed_forces import BedForces, check_free_piston
from granular.linear.equilibrium import Equilibrium, equilibrium_from, find_equilibrium
from granular.linear.roots import Root, refine_root, require_free_piston
from granular.linear.slopes import number_keys
from granular.scene.scene import Scene
from granular.schema.field_kinds import FieldError, QuantityKind, TemperatureKind
from granular.schema.sections import find_field
from granular.shared.errors import InputError
from granular.shared.files import parse_toml
from granular.shared.message_text import quote
from granular.shared.text_tables import align_columns
from granular.studies.bed_slopes import settled_beds

if TYPE_CHECKING:
    from jaxtyping import Float

__all__ = ["Part", "Tolerances", "tolerances", "tolerances_at", "usual_parts"]

FIGURES = ("rest", "f0", "zeta")

STEPS = (1.0, 0.25, 0.0625)
"""Deviations at which differences are taken, a smaller one if the bed would rearrange within it."""

REARRANGED = 0.2
"""Largest displacement of a grain, beside an even strain, from which a bed has rearranged [D]: a grain that
changes its neighbours moves by half a spacing or so."""

CURVED = 0.05
"""Part of a standard deviation that second differences may add before slopes alone are said not to do."""

_FACTOR_OF_LIMITS = 1.0 / math.sqrt(3.0)
"""Standard deviation over the half-width of limits between which nothing is known (JCGM 100:2008, 4.3.7)."""

_RELATIVE = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*%\s*")
_KELVINS = re.compile(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*(?:K|°C)?\s*")
_SECTIONS = ("grains.", "cell.", "piston.", "effects.")
_LAST = {"grains.remanence": 1, "effects.drag.viscosity": 1, "effects.drag.coefficient": 2, "piston.drag": 2}
"""Keys that may follow from others, which they take away: their tolerance comes on top of the others'."""


class Part(NamedTuple):
    """A part's number and its tolerance.

    Attributes
    ----------
    key : str
        Dotted key of the number.
    value : float
        Number in the scene, in SI; temperatures [deg C].
    unit : str
        Its unit.
    deviation : float
        Standard deviation, in that unit.
    relative : bool
        True if the deviation goes with the number.
    one_sided : bool
        True for a 0 that cannot be negative, which only rises.
    """

    key: str
    value: float
    unit: str
    deviation: float
    relative: bool
    one_sided: bool = False

    @property
    def slope_unit(self) -> str:
        """Unit of slopes; none if they are over the relative change: not of 0 and temperatures."""
        return "" if self.value and self.unit != "degC" else f" /{self.unit.replace('degC', 'K')}"

    @property
    def text(self) -> str:
        """Number and tolerance in words."""
        names = {"1": "", "degC": " °C", "m": " mm"}
        size, name = 1e3 if self.unit == "m" else 1.0, names.get(self.unit, f" {self.unit}")
        if self.relative:
            return f"{size * self.value:.5g}{name} ± {100.0 * self.deviation / abs(self.value):.3g} %"
        return f"{size * self.value:.5g} ± {size * self.deviation:.3g}{name}"


@dataclasses.dataclass(frozen=True, eq=False)
class Tolerances:
    """Standard deviations of a damper's figures by the tolerances of its parts.

    The figures are equilibrium height [m], natural frequency [Hz] and damping ratio.

    Attributes
    ----------
    scene : str
        Name of the scene.
    parts : tuple of Part
        Parts and their tolerances.
    figures : float64 (b, 3)
        Figures of each settled bed.
    changes : float64 (b, k, 3)
        Relative change of the figures of each bed by one standard deviation of each part.
    curvatures : float64 (b, k, 3)
        Relative second difference at that distance: mean of both sides less the middle.
    drawn : float64 (d, 3)
        Relative changes of the figures of drawn dampers; of none if slopes alone were asked for.
    rearranged : int
        Number of drawn dampers without an equilibrium near the settled bed: they have changes by slopes.
    amplitude : float or None
        Amplitude of the damping ratio with dry friction [m]; None of small motions without it.
    """

    scene: str
    parts: tuple[Part, ...]
    figures: Float[np.ndarray, "b 3"]
    changes: Float[np.ndarray, "b k 3"]
    curvatures: Float[np.ndarray, "b k 3"]
    drawn: Float[np.ndarray, "d 3"]
    rearranged: int = 0
    amplitude: float | None = None

    @property
    def contributions(self) -> Float[np.ndarray, "k 3"]:
        """Relative standard deviations of the figures by each part alone: rms changes over beds."""
        # A damper's bed is one of them: its variance is the mean of theirs.
        return np.sqrt((self.changes**2).mean(axis=0))

    @property
    def slopes(self) -> Float[np.ndarray, "b k 3"]:
        """Slopes of each bed, d ln figure/d ln number; d ln figure/d number of temperatures and zeros."""
        sizes = [part.deviation / (1.0 if part.slope_unit else abs(part.value)) for part in self.parts]
        return self.changes / np.array(sizes)[:, None]

    @property
    def linear_totals(self) -> Float[np.ndarray, "3"]:
        """Relative standard deviations of the figures: root of the sum of the squared contributions."""
        return np.sqrt((self.contributions**2).sum(axis=0))

    @property
    def totals(self) -> Float[np.ndarray, "3"]:
        """Relative standard deviations of the figures, of the drawn dampers if there are any."""
        return self.linear_totals if len(self.drawn) < 2 else np.asarray(self.drawn.std(axis=0, ddof=1))

    @property
    def spread(self) -> Float[np.ndarray, "3"]:
        """Relative standard deviations of the figures from bed to bed, which no part makes."""
        means = self.figures.mean(axis=0)
        return np.asarray(self.figures.std(axis=0, ddof=1) / np.where(means > 0.0, means, 1.0))

    @property
    def curved(self) -> tuple[str, ...]:
        """Keys of parts whose second difference adds more than a twentieth to a standard deviation."""
        # A change a x + c x^2 with x of the standard normal distribution has the variance a^2 + 2 c^2.
        square = np.maximum(self.linear_totals**2, 1e-30)
        excess = np.sqrt(1.0 + 2.0 * (self.curvatures**2).mean(axis=0) / square) - 1.0
        return tuple(part.key for part, row in zip(self.parts, excess, strict=True) if row.max() > CURVED)

    def largest(self, count: int = 3) -> dict[str, tuple[str, ...]]:
        """Keys of the parts that move each figure most.

        Parameters
        ----------
        count : int
            Number of parts.

        Returns
        -------
        dict of str to tuple of str
            Keys by figure, the largest contribution first.
        """
        order = np.argsort(-self.contributions, axis=0)[:count].T
        return {
            name: tuple(self.parts[k].key for k in column)
            for name, column in zip(FIGURES, order.tolist(), strict=True)
        }

    def to_plain(self) -> dict[str, Any]:
        """Return parts, slopes, contributions and totals as plain data.

        Returns
        -------
        dict of str to Any
            Numbers in SI; contributions and totals relative to the mean figures.
        """
        slopes = np.moveaxis(self.slopes, 1, 0).tolist()
        rows = zip(self.parts, slopes, self.contributions.tolist(), strict=True)
        plain = {"figures": self.figures.mean(axis=0), "totals": self.totals, "by_slopes": self.linear_totals}
        return {name: dict(zip(FIGURES, row.tolist(), strict=True)) for name, row in plain.items()} | {
            "scene": self.scene,
            "figures_of_beds": self.figures.tolist(),
            "parts": {
                part.key: part._asdict() | {"slopes": over_beds, "contributions": own}
                for part, over_beds, own in rows
            },
            "amplitude": self.amplitude,
            "draws": len(self.drawn),
            "rearranged": self.rearranged,
            "curved": list(self.curved),
        }

    @property
    def summary(self) -> str:
        """Totals and the largest causes in one line."""
        (rest, frequency, damping), total = self.figures.mean(axis=0), self.totals
        largest = ", ".join(f"{name} {keys[0]}" for name, keys in self.largest(1).items())
        return (
            f"of the parts: rest ± {1e3 * rest * total[0]:.2g} mm, f0 ± {frequency * total[1]:.2g} Hz, "
            f"zeta ± {100.0 * damping * total[2]:.2g} % (standard deviations; most by {largest})"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Meaning of the table in sentences."""
        notes = [
            "A tolerance is a standard deviation, of all pieces of a part together, as of a batch: scatter "
            "of single magnets about their mean hardly counts (3 % of the moment: 0.02 % of rest and "
            "frequency, 0.3 % of the damping ratio).",
            "Figures are those of small motions, without dry friction."
            if self.amplitude is None
            else f"The damping ratio is with dry friction, at an amplitude of {1e3 * self.amplitude:g} mm.",
        ]
        if self.rearranged:
            notes.append(f"{self.rearranged} drawn dampers pack otherwise: for them the slopes count.")
        if self.curved:
            remedy = "the drawn dampers contain it" if len(self.drawn) > 1 else "draw dampers (--draws 200)"
            keys = ", ".join(self.curved)
            notes.append(f"Slopes alone are not enough for {keys}, whose second difference counts: {remedy}.")
        return tuple(notes)

    def __str__(self) -> str:
        """Table in lines."""
        rest, frequency, damping = self.figures.mean(axis=0)
        return "\n".join(
            [
                f"{self.scene}: tolerances of {len(self.parts)} parts at {len(self.figures)} settled bed(s)",
                f"rest {1e3 * rest:.5g} mm, f0 {frequency:.5g} Hz, zeta {100.0 * damping:.4g} %",
                align_columns(table_rows(self)),
                self.summary,
                *self.notes,
            ]
        )


def table_rows(result: Tolerances) -> list[tuple[str, ...]]:
    """Header and rows of the table, with the sum of all parts."""
    rows = [("part", "tolerance", *(f"slope of {f}" for f in FIGURES), *(f"{f} [± %]" for f in FIGURES))]
    several = len(result.figures) > 1
    slopes, errors = result.slopes.mean(axis=0), result.slopes.std(axis=0, ddof=int(several))
    for part, own, *pair in zip(result.parts, result.contributions, slopes, errors, strict=True):
        cells = [
            f"{slope:+.4f}" + (f" ± {error:.4f}" if several else "") + part.slope_unit
            for slope, error in zip(*pair, strict=True)
        ]
        rows.append((part.key, part.text, *cells, *_percents(own)))
    rows.append(("all parts", "root of the sum of squares", "", "", "", *_percents(result.linear_totals)))
    if len(result.drawn) > 1:
        rows.append((f"{len(result.drawn)} drawn dampers", "", "", "", "", *_percents(result.totals)))
    if several:
        name = f"{len(result.figures)} random starts"
        rows.append((name, "not of the parts", "", "", "", *_percents(result.spread)))
    return rows


def _percents(values: Float[np.ndarray, "3"]) -> list[str]:
    return [f"{100.0 * value:.3f}" for value in values]


def tolerances(
    scene: Scene,
    parts: Mapping[str, str | float],
    beds: int = 4,
    *,
    amplitude: float | None = None,
    draws: int = 0,
    seed: int = 0,
    out: str | Path | None = None,
    progress: bool = True,
) -> Tolerances:
    """Find how far a damper's parts move its equilibrium height, frequency and damping ratio.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston; its beds start from ``arrangement.seed`` and the seeds after it.
    parts : mapping of str to str or float
        Standard deviations by the dotted keys of the scene's numbers: relative, as "2.5%", or absolute, as
        "0.05 mm" or in SI; of temperatures in kelvin. See `usual_parts`.
    beds : int
        Number of settled beds over which contributions are averaged.
    amplitude : float, optional
        Amplitude of the piston [m] at which the scene's dry friction adds to the damping ratio, while all
        grains slide (`granular.linear.motion_friction`); small motions without friction if not given.
    draws : int
        Number of dampers whose parts are drawn all at once, each from a normal distribution.
    seed : int
        Seed of the drawn numbers.
    out : str or Path, optional
        Directory that keeps the settled beds; a folder of the toolkit among the user's caches if not given.
    progress : bool
        Show a progress bar on standard error while beds settle.

    Returns
    -------
    Tolerances
        Slopes, contributions and totals.

    Raises
    ------
    InputError
        If the scene has no free piston or cannot settle, a key is no number of the scene, a tolerance has
        another unit or is not positive, or a damper within the tolerances has no equilibrium.

    Examples
    --------
    >>> from granular import load_scene, tolerances
    >>> parts = {"grains.remanence": "2.5%", "piston.mass": "0.5%"}
    >>> tolerances(load_scene("damper"), parts).totals  # doctest: +SKIP
    """
    check_free_piston(scene)
    if beds < 1 or draws < 0:
        raise InputError(f"beds = {beds} and draws = {draws}; give 1 bed or more, and no fewer than 0 draws")
    if amplitude is not None and not amplitude > 0.0:
        raise InputError(f"amplitude = {amplitude:g} m must be above 0")
    read = read_parts(scene, parts)
    states = settled_beds(scene, beds, out=out, progress=progress)
    rests = [equilibrium_from(*state) for state in states]
    return tolerances_at(rests, read, amplitude=amplitude, draws=draws, seed=seed)


def tolerances_at(
    rests: Sequence[Equilibrium],
    parts: Sequence[Part],
    *,
    amplitude: float | None = None,
    draws: int = 0,
    seed: int = 0,
) -> Tolerances:
    """Find the same about given equilibria.

    Parameters
    ----------
    rests : sequence of Equilibrium
        Equilibria of beds of one scene, with a free piston.
    parts : sequence of Part
        Parts and their tolerances.
    amplitude : float, optional
        Amplitude of the piston [m] at which the scene's dry friction adds to the damping ratio, while all
        grains slide (`granular.linear.motion_friction`); small motions without friction if not given.
    draws : int
        Number of drawn dampers.
    seed : int
        Seed of the drawn numbers.

    Returns
    -------
    Tolerances
        Slopes, contributions and totals.
    """
    numbers = np.random.default_rng(seed).standard_normal((draws, len(parts)))
    figures, changes, curvatures = [], [], []
    drawn, rearranged = np.empty((draws, 3)), 0
    for bed, rest in enumerate(rests):
        root = piston_roots(rest)[0]
        figures.append(_figures(rest, root, amplitude))
        pairs = np.array([_differences(rest, root, parts, index, amplitude) for index in range(len(parts))])
        changes.append(pairs[:, 0])
        curvatures.append(pairs[:, 1])
        for draw in range(bed, draws, len(rests)):
            try:
                drawn[draw] = _relative_changes(rest, root, parts, numbers[draw], amplitude)[0]
            except InputError:
                # Without them the largest changes would be missing.
                drawn[draw] = numbers[draw] @ pairs[:, 0]
                rearranged += 1
    beds = np.array(figures), np.array(changes), np.array(curvatures)
    return Tolerances(rests[0].scene.name, tuple(parts), *beds, drawn, rearranged, amplitude)


def move_part(scene: Scene, part: Part, by: float) -> Scene:
    """Move the number of a part by a multiple of its deviation."""
    value = (find_field(scene, part.key) or (part.value,))[0]
    change = value * part.deviation / part.value if part.relative else part.deviation
    return scene.replace(**{part.key: value + (abs(by) if part.one_sided else by) * change})


def _figures(rest: Equilibrium, root: Root, amplitude: float | None) -> Float[np.ndarray, "3"]:
    ratio = root.damping_ratio
    if amplitude is not None:
        ratio += motion_friction(rest, root=root).equivalent_damping_ratio(amplitude)
    return np.array([rest.piston_height, root.frequency, ratio])


def _differences(
    rest: Equilibrium, root: Root, parts: Sequence[Part], index: int, amplitude: float | None
) -> Float[np.ndarray, "2 3"]:
    """Relative first and second differences of the figures, at a deviation of one part."""
    cause: object = "the bed rearranges; give a smaller tolerance, or another seed"
    for step in STEPS:
        by = step * np.eye(len(parts))[index]
        try:
            up, far = down, back = _relative_changes(rest, root, parts, by, amplitude)
            if parts[index].one_sided:
                down = -up
            else:
                down, back = _relative_changes(rest, root, parts, -by, amplitude)
        except InputError as error:
            cause = error
            continue
        if max(far, back) < REARRANGED:
            # Drawn dampers that rearrange are no matter of slopes.
            curvature = 0.5 * (up + down) if step == STEPS[0] else np.full(3, np.inf)
            return np.array([(up - down) / (2.0 * step), curvature])
    raise InputError(f"{parts[index].key} cannot change by {step * parts[index].deviation:.3g}: {cause}")


def _relative_changes(
    rest: Equilibrium, root: Root, parts: Sequence[Part], by: Float[np.ndarray, "k"], amplitude: float | None
) -> tuple[Float[np.ndarray, "3"], float]:
    """Relative changes of the figures with each part moved by a multiple of its deviation.

    Also the largest displacement of a grain, beside the even strain of cell and piston [D].
    """
    scene = rest.scene
    for part, multiple in sorted(zip(parts, by, strict=True), key=lambda pair: _LAST.get(pair[0].key, 0)):
        if multiple != 0.0:
            scene = move_part(scene, part, float(multiple))
    bed, piston = BedForces(scene), require_free_piston(rest)
    pencil = find_equilibrium(bed, bed.coordinates(rest.positions, rest.piston_height))
    changed = refine_root(pencil, piston, root.s)
    if changed is None:
        raise InputError("the piston does not oscillate any more")
    height, positions = float(pencil.at[piston]), bed.positions(pencil.at)
    strain = scene.cell.width / rest.scene.cell.width, height / (rest.piston_height or 1.0)
    moved = float(np.hypot(*(positions - rest.positions * strain).T).max()) / bed.length
    after = dataclasses.replace(rest, scene=scene, positions=positions, piston_height=height, pencil=pencil)
    old, new = _figures(rest, root, amplitude), _figures(after, changed, amplitude)
    return np.divide(new, old, out=np.ones(3), where=old > 0.0) - 1.0, moved


def read_parts(scene: Scene, tolerances: Mapping[str, str | float]) -> tuple[Part, ...]:
    """Read tolerances by the keys of a scene's numbers; texts are parsed, never evaluated."""
    if not tolerances:
        raise InputError("no part has a tolerance; give one, as grains.remanence: 2.5 %, or the usual ones")
    return tuple(_read_part(scene, key, tolerance) for key, tolerance in tolerances.items())


def _read_part(scene: Scene, key: str, tolerance: str | float) -> Part:
    value, kind = find_field(scene, key) or (None, None)
    of_part = key.startswith(_SECTIONS) and not key.endswith((".share", ".pitch", "piston.height"))
    if not of_part or not isinstance(value, float) or not isinstance(kind, QuantityKind):
        raise InputError(
            f"{quote(key)} is no number of a part of the scene {quote(scene.name)}; "
            f"there are {', '.join(number_keys(scene))}"
        )
    text = str(tolerance)
    relative, celsius = _RELATIVE.fullmatch(text), isinstance(kind, TemperatureKind)
    if relative is not None:
        if value == 0.0 or celsius:
            raise InputError(
                f"{key} is {value:g} {kind.unit}: give a tolerance with a unit, not {quote(text)}"
            )
        deviation = abs(value) * float(relative[1]) / 100.0
    elif celsius and (match := _KELVINS.fullmatch(text)):
        deviation = float(match[1])
    else:
        try:
            reader = QuantityKind(unit="1" if celsius else kind.unit)
            deviation = reader.parse(tolerance, scene.grains.species[0].diameter)
        except FieldError as error:
            raise InputError(f"the tolerance of {key}: {error}") from None
    if not deviation > 0.0:
        raise InputError(f"the tolerance {quote(text)} of {key} must be above 0")
    return Part(key, value, kind.unit, deviation, relative is not None, value == 0.0 == kind.least)


def usual_parts(scene: Scene) -> dict[str, str | float]:
    """Usual tolerances of the parts that a scene names, as `tolerances` takes them.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston.

    Returns
    -------
    dict of str to str or float
        Standard deviations by key: limits of ``usual_tolerances.toml``, where their sources stand, over the
        square root of 3.
    """
    result: dict[str, str | float] = {}
    text = (Path(__file__).parent / "usual_tolerances.toml").read_text(encoding="utf-8")
    for entry in parse_toml(text)["part"]:
        given = [_is_given(scene, key) for key in (entry["key"], entry.get("with", entry["key"]))]
        if all(given) and not ("without" in entry and _is_given(scene, entry["without"])):
            number, _, unit = str(entry["limits"]).partition(" ")
            result[entry["key"]] = f"{_FACTOR_OF_LIMITS * float(number):.4g} {unit}"
    return result


def _is_given(scene: Scene, key: str) -> bool:
    return (find_field(scene, key) or (None,))[0] not in (None, 0.0)
