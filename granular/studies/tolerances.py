"""Effect of the tolerances of a damper's parts on equilibrium height, frequency and damping ratio.

A tolerance is the standard deviation of a part's value. Each value is shifted up and down by its tolerance.
The changed bed relaxes from the settled packing to an equilibrium; grains may rearrange. The complex root of
small oscillations about this equilibrium gives frequency and damping ratio. The same is done for dampers
whose parts are all drawn at random.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.linear import motion_friction, piston_roots
from granular.linear.bed_forces import check_free_piston, scene_with_value
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.linear.friction import has_friction
from granular.linear.roots import Root, coordinate_index_of_free_piston, refine_root
from granular.linear.small_motions import keys_of_nonzero_numbers
from granular.scene.scene import Scene
from granular.schema.field_kinds import FieldError, QuantityKind, TemperatureKind
from granular.schema.sections import find_field_value_and_kind
from granular.shared.array_types import Float
from granular.shared.blocks import Block, Table, Text
from granular.shared.errors import InputError, quote
from granular.shared.files import parse_toml
from granular.shared.html_pages import ResultShownAsBlocks
from granular.shared.progress_bars import progress_bar
from granular.studies.bed_slopes import settled_beds

_SECTIONS = ("grains.", "cell.", "piston.", "effects.")
_LAST = {"grains.remanence": 1, "effects.drag.viscosity": 1, "effects.drag.coefficient": 2, "piston.drag": 2}
"""Keys whose values can also be computed from other keys. They are shifted last, so that the shifts of the
other keys do not overwrite theirs."""


class Part(NamedTuple):
    """The value of a part and its tolerance.

    Attributes
    ----------
    key : str
        Dotted key of the value.
    value : float
        Value in the scene, in SI; temperatures in [deg C].
    unit : str
        Unit of the value.
    deviation : float
        Standard deviation, in that unit.
    relative : bool
        True if the deviation is proportional to the value.
    one_sided : bool
        True for a value of 0 that cannot be negative and is only increased.
    """

    key: str
    value: float
    unit: str
    deviation: float
    relative: bool
    one_sided: bool = False

    @property
    def absolute_slope_unit(self) -> str:
        """Unit of a slope with respect to the value, such as " /K"; empty if the change is relative."""
        return "" if self.value and self.unit != "degC" else f" /{self.unit.replace('degC', 'K')}"

    @property
    def slope_step(self) -> float:
        """One standard deviation, in the same form as slopes: relative, or in the unit of the value."""
        return self.deviation / (1.0 if self.absolute_slope_unit else abs(self.value))

    @property
    def text(self) -> str:
        """Value and tolerance as text."""
        size, name = {"1": (1.0, ""), "degC": (1.0, " °C"), "m": (1e3, " mm")}.get(
            self.unit, (1.0, f" {self.unit}")
        )
        tolerance = f"{size * self.deviation:.3g}{name}"
        if self.relative:
            tolerance = f"{100.0 * self.deviation / abs(self.value):.3g} %"
        return f"{size * self.value:.5g}{name} ± {tolerance}"


def read_part_tolerances(scene: Scene, tolerances: Mapping[str, str | float]) -> tuple[Part, ...]:
    """Return a `Part` for each key and its tolerance; a tolerance may be a string with a unit."""
    if not tolerances:
        raise InputError(
            "no part has a tolerance; give tolerances, such as grains.remanence: 2.5 %, or use the usual "
            "tolerances"
        )
    return tuple(_read_part(scene, key, tolerance) for key, tolerance in tolerances.items())


def _read_part(scene: Scene, key: str, tolerance: str | float) -> Part:
    value, kind = find_field_value_and_kind(scene, key) or (None, None)
    of_part = key.startswith(_SECTIONS) and not key.endswith((".share", ".pitch", "piston.height"))
    if not of_part or not isinstance(value, float) or not isinstance(kind, QuantityKind):
        raise InputError(
            f"{quote(key)} is not a numeric key of a part of the scene {quote(scene.name)}; choose "
            f"one of {', '.join(keys_of_nonzero_numbers(scene))}"
        )
    text, unit = str(tolerance).strip(), kind.unit
    relative = text.endswith("%")
    if isinstance(kind, TemperatureKind):
        text, unit = text.removesuffix("K").removesuffix("°C"), "1"
    if relative and (value == 0.0 or unit != kind.unit):
        raise InputError(
            f"{key} = {value:g} {kind.unit} cannot have a relative tolerance, {quote(text)}; give a "
            "tolerance with a unit"
        )
    try:
        reader = QuantityKind(unit="1" if relative else unit, above=0.0)
        deviation = reader.parse(text, scene.grains.species[0].diameter)
    except FieldError as error:
        raise InputError(f"the tolerance of {key}: {error}") from None
    size = abs(value) if relative else 1.0
    return Part(key, value, kind.unit, size * deviation, relative, value == 0.0 == kind.least)


def scene_with_shifted_parts(scene: Scene, parts: Sequence[Part], multiples: Float[np.ndarray, "k"]) -> Scene:
    """Shift the value of each part by a multiple of its deviation."""
    for part, multiple in sorted(
        zip(parts, multiples, strict=True), key=lambda pair: _LAST.get(pair[0].key, 0)
    ):
        if multiple == 0.0:
            continue
        value = (find_field_value_and_kind(scene, part.key) or (part.value,))[0]
        step = (value / part.value if part.relative else 1.0) * part.deviation
        drag = scene.effects.drag
        scene = scene_with_value(
            scene, part.key, value + float(abs(multiple) if part.one_sided else multiple) * step
        )
        if part.key == "effects.drag.viscosity" and drag is not None and not drag.is_from_liquid:
            # The drag of a disc was measured; the liquid determines only the piston's drag.
            scene = scene_with_value(scene, "effects.drag.coefficient", drag.coefficient)
    return scene


def usual_parts(scene: Scene) -> dict[str, str | float]:
    """Return usual tolerances of a scene's parts, as `tolerances` takes them.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston.

    Returns
    -------
    dict of str to str or float
        Standard deviations by key: the limits in ``usual_tolerances.toml``, which cites their sources,
        divided by the square root of 3. This is the standard deviation of a uniform distribution between the
        limits.
    """
    result: dict[str, str | float] = {}
    text = (Path(__file__).parent / "usual_tolerances.toml").read_text(encoding="utf-8")
    for entry in parse_toml(text)["part"]:
        given = [_is_given(scene, key) for key in (entry["key"], entry.get("with", entry["key"]))]
        if all(given) and not ("without" in entry and _is_given(scene, entry["without"])):
            number, _, unit = str(entry["limits"]).partition(" ")
            result[entry["key"]] = f"{float(number) / math.sqrt(3.0):.4g} {unit}"
    return result


def _is_given(scene: Scene, key: str) -> bool:
    if key == "effects.drag.coefficient" and getattr(scene.effects.drag, "is_from_liquid", False):
        return False
    return (find_field_value_and_kind(scene, key) or (None,))[0] not in (None, 0.0)


__all__ = ["Part", "Tolerances", "tolerances", "tolerances_at", "usual_parts"]

FIGURES = ("rest", "f0", "zeta")

DRAWS = 200
"""Number of dampers drawn at random if slopes are not sufficient. With this number the standard error of a
standard deviation is 5 %."""

STEPS = (1.0, 0.25, 0.0625)
"""Shifts of a part, in standard deviations. Slopes are computed from the first shift that does not rearrange
the bed."""

REARRANGED = 0.2
"""Displacement of a grain [D], relative to a uniform strain, above which the bed counts as rearranged. A
grain that changes neighbours moves by about half a spacing."""

MAXIMUM_NONLINEARITY = 0.05
"""Fraction by which nonlinearity may increase a standard deviation before slopes are reported as not
sufficient."""

ROUNDED = 1e-8
"""Relative change of a result that counts as rounding error, not as nonlinearity."""

BEDS_DIFFER = 0.1
"""If the standard error of a total over beds exceeds this fraction of the total, the error is reported."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tolerances(ResultShownAsBlocks):
    """Standard deviations of a damper's results due to the tolerances of its parts.

    The results, called figures, are equilibrium height [m], natural frequency [Hz] and damping ratio.

    Attributes
    ----------
    scene : str
        Name of the scene.
    parts : tuple of Part
        Parts and their tolerances.
    figures : float64 (b, 3)
        Figures of each settled bed.
    slopes : float64 (b, k, 3)
        Slopes of each bed, d ln figure/d ln value; for temperatures and values of 0, d ln figure/d value.
    sides : float64 (b, k, 2, 3)
        Relative change of the figures of each bed with each part shifted by one standard deviation, up and
        down.
    drawn : float64 (d, 3)
        Relative changes of the figures of the dampers drawn at random; empty if slopes are enough.
    rearranged : int
        Number of drawn dampers whose packing differs from the settled one.
    amplitude : float or None
        Amplitude at which dry friction is included in the damping ratio [m]; None for small motions without
        dry friction.
    """

    scene: str
    parts: tuple[Part, ...]
    figures: Float[np.ndarray, "b 3"]
    slopes: Float[np.ndarray, "b k 3"]
    sides: Float[np.ndarray, "b k 2 3"]
    drawn: Float[np.ndarray, "d 3"]
    rearranged: int = 0
    amplitude: float | None = None

    @property
    def contributions(self) -> Float[np.ndarray, "k 3"]:
        """Relative standard deviations of the figures due to each part: rms over beds and both shifts."""
        # A damper has one of these beds, so its variance is the mean of their variances.
        return np.sqrt((self.sides**2).mean(axis=(0, 2)))

    @property
    def sums_of_squares(self) -> Float[np.ndarray, "3"]:
        """Relative standard deviations of the figures: the root of the sum of all squared contributions."""
        return np.sqrt((self.contributions**2).sum(axis=0))

    @property
    def totals(self) -> Float[np.ndarray, "3"]:
        """Relative standard deviations of the figures due to all parts, from the drawn dampers if any."""
        return self.sums_of_squares if len(self.drawn) < 2 else np.asarray(self.drawn.std(axis=0, ddof=1))

    @property
    def spread(self) -> Float[np.ndarray, "3"]:
        """Relative standard deviations of the figures between random packings of the same parts."""
        means = self.figures.mean(axis=0)
        return np.asarray(self.figures.std(axis=0, ddof=1) / np.where(means > 0.0, means, 1.0))

    @property
    def errors(self) -> Float[np.ndarray, "3"]:
        """Relative standard errors of the totals, from the spread over beds; zeros for a single bed."""
        beds, variances = len(self.figures), (self.sides**2).mean(axis=2).sum(axis=1)
        if len(self.drawn) > beds:
            variances = np.array([self.drawn[k::beds].var(axis=0) for k in range(beds)])
        size = 2.0 * np.maximum(variances.mean(axis=0), ROUNDED**2) * beds**0.5
        return np.asarray(variances.std(axis=0, ddof=int(beds > 1)) / size)

    @property
    def curved(self) -> tuple[str, ...]:
        """Keys of the parts for which nonlinearity increases a standard deviation by more than 5 %."""
        by_slopes = self.slopes * np.array([part.slope_step for part in self.parts])[:, None]
        departures = self.sides - by_slopes[:, :, None] * np.array([[1.0], [-1.0]])
        # A change a x + c x^2 with standard normal x has the variance a^2 + 2 c^2.
        variance = np.maximum((by_slopes**2).mean(axis=0).sum(axis=0), ROUNDED**2)
        excess = np.sqrt(1.0 + 2.0 * (departures**2).mean(axis=(0, 2)) / variance) - 1.0
        return tuple(
            part.key for part, row in zip(self.parts, excess, strict=True) if row.max() > MAXIMUM_NONLINEARITY
        )

    def largest(self, count: int = 3) -> dict[str, tuple[str, ...]]:
        """Keys of the parts with the largest effect on each figure.

        Parameters
        ----------
        count : int
            Number of parts.

        Returns
        -------
        dict of str to tuple of str
            Keys by figure, the largest contribution first, without parts that have no effect.
        """
        order = np.argsort(-self.contributions, axis=0)[:count].T.tolist()
        return {
            name: tuple(self.parts[k].key for k in column if self.contributions[k, figure] > ROUNDED)
            for figure, (name, column) in enumerate(zip(FIGURES, order, strict=True))
        }

    def to_plain(self) -> dict[str, Any]:
        """Return parts, slopes, contributions and totals as plain data.

        Returns
        -------
        dict of str to Any
            Numbers in SI; contributions and totals relative to the mean figures.
        """
        rows = {"figures": self.figures.mean(axis=0), "totals": self.totals, "by_parts": self.sums_of_squares}
        return {name: dict(zip(FIGURES, row.tolist(), strict=True)) for name, row in rows.items()} | {
            "scene": self.scene,
            "figures_of_beds": self.figures.tolist(),
            "parts": {
                part.key: part._asdict()
                | {"slopes": self.slopes[:, k].tolist(), "contributions": self.contributions[k].tolist()}
                for k, part in enumerate(self.parts)
            },
            "amplitude": self.amplitude,
            "errors": self.errors.tolist(),
            "draws": len(self.drawn),
            "rearranged": self.rearranged,
            "curved": list(self.curved),
        }

    @property
    def means(self) -> str:
        """Line with the mean figures."""
        rest, frequency, damping = self.figures.mean(axis=0)
        figures = f"rest {1e3 * rest:.5g} mm, f0 {frequency:.5g} Hz, zeta {100.0 * damping:.4g} %"
        return f"{figures} (mean over {len(self.figures)} settled bed(s))"

    @property
    def summary(self) -> str:
        """Line with the totals and the largest causes."""
        rest, frequency, damping = self.figures.mean(axis=0) * self.totals
        causes = (f"of {name} {keys[0]}" for name, keys in self.largest(1).items() if keys)
        return (
            f"of the parts: rest ± {1e3 * rest:.2g} mm, f0 ± {frequency:.2g} Hz, zeta ± "
            f"{100.0 * damping:.2g} % of critical (one standard deviation each; largest cause "
            f"{', '.join(causes) or 'none'})"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences that explain the table."""
        notes = [
            "A tolerance is the standard deviation of a part's value between batches. A value given by "
            "--part is used unchanged; a usual value (--usual) is a limit divided by the square root of 3. "
            "All magnets of a bed have the same deviation. Scatter between single magnets of a batch has "
            "little effect: in the packaged damper, a scatter of the moments by 3 % changes rest height and "
            "frequency by 0.02 %, and the damping ratio by 0.3 %.",
            "Parts that are not listed are assumed exact.",
            "A slope is in % of the result per % of the part's value; a slope with a unit is the relative "
            "change of the result per unit of the value. The number after ± is the standard deviation of the "
            "slope over beds; for a single bed it is missing.",
            "The damping ratio is for small motions, without dry friction."
            if self.amplitude is None
            else f"The damping ratio includes dry friction, at an amplitude of {1e3 * self.amplitude:g} mm.",
        ]
        if self.curved:
            remedy = (
                "the drawn dampers include this effect"
                if len(self.drawn) > 1
                else "draw dampers at random (--draws 200)"
            )
            keys = ", ".join(self.curved)
            notes.append(f"Slopes alone are not sufficient for {keys}, whose effect is nonlinear: {remedy}.")
        for name, error in zip(FIGURES, self.errors, strict=True):
            if error > BEDS_DIFFER:
                notes.append(
                    f"The beds differ so much that ± of {name} has a standard error of "
                    f"{100.0 * error:.0f} %; use more --beds to reduce this error."
                )
        if self.rearranged:
            notes.append(
                f"The packing differs from the settled bed in {self.rearranged} drawn dampers, which "
                "are included."
            )
        return tuple(notes)

    def blocks(self) -> list[Block]:
        """Table of all parts, with totals and notes.

        Returns
        -------
        list of Block
            Blocks of `granular.shared.blocks`, for a terminal, a page and a notebook.
        """
        header, *rows = tolerance_table_rows(self)
        head = f"{self.scene}: tolerances of {len(self.parts)} parts"
        texts = map(Text, (self.summary, *self.notes))
        return [Text(head), Text(self.means), Table(header, rows), *texts]


def tolerance_table_rows(result: Tolerances) -> list[tuple[str, ...]]:
    """Return header and rows of the table, including rows for all parts together."""
    beds, draws = len(result.figures), len(result.drawn)
    header = (
        "part",
        "tolerance",
        *(f"slope of {f}" for f in FIGURES),
        *(f"{f} ± [% of it]" for f in FIGURES),
    )
    rows = [header]
    for k, part in enumerate(result.parts):
        cells = []
        for slopes in result.slopes[:, k].T:
            error = f" ± {slopes.std(ddof=1):.4f}" if beds > 1 else ""
            cells.append(f"{slopes.mean():+.4f}{error}{part.absolute_slope_unit}")
        rows.append((part.key, part.text, *cells, *_percent_texts(result.contributions[k])))
    sums = [("all parts", "root of the sum of squares", result.sums_of_squares)]
    if draws > 1:
        sums.append((f"{draws} drawn dampers", "all parts at once", result.totals))
    if beds > 1:
        sums.append((f"{beds} random packings", "not due to the parts", result.spread))
    return rows + [(name, words, "", "", "", *_percent_texts(values)) for name, words, values in sums]


def _percent_texts(values: Float[np.ndarray, "3"]) -> list[str]:
    return [f"{100.0 * value:.3f}" for value in values]


def tolerances(
    scene: Scene,
    parts: Mapping[str, str | float],
    beds: int = 4,
    *,
    amplitude: float | None = None,
    draws: int | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    progress: bool = True,
) -> Tolerances:
    """Compute how tolerances of parts affect equilibrium height, frequency and damping ratio of a damper.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston; its beds use ``arrangement.seed`` and the seeds after it.
    parts : mapping of str to str or float
        Standard deviations by dotted keys of the scene's values. They are relative, such as "2.5%", or
        absolute, such as "0.05 mm" or a number in SI (kelvin for temperatures). See
        `granular.studies.tolerances.usual_parts`.
    beds : int
        Number of settled beds over which contributions are averaged.
    amplitude : float, optional
        Amplitude of the piston [m] at which the scene's dry friction adds to the damping ratio; all grains
        are assumed to slide (`granular.linear.motion_friction`). If not given, motions are small and dry
        friction is ignored.
    draws : int, optional
        Number of dampers whose parts are all drawn at random from normal distributions; the beds are used in
        turn. By default 200 if slopes alone are not sufficient, otherwise none.
    seed : int
        Seed of the random numbers.
    out : str or Path, optional
        Directory that keeps the settled beds; by default a folder in the user's cache.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    Tolerances
        Slopes, contributions and totals.

    Raises
    ------
    InputError
        If the scene has no free piston or cannot settle, a key is not a number of the scene, a tolerance has
        a wrong unit or is not positive, or a damper within the tolerances has no equilibrium; or if an
        amplitude is given and the scene has no friction.

    Examples
    --------
    >>> from granular import load_scene, tolerances
    >>> parts = {"grains.remanence": "2.5%", "piston.mass": "0.5%"}
    >>> tolerances(load_scene("damper"), parts).totals  # doctest: +SKIP
    """
    check_free_piston(scene)
    if beds < 1 or min(draws or 0, seed) < 0:
        raise InputError(
            f"beds = {beds}, draws = {draws}, seed = {seed}; beds must be 1 or more, draws and seed 0 or more"
        )
    if amplitude is not None and not amplitude > 0.0:
        raise InputError(f"amplitude = {amplitude:g} m must be above 0")
    if amplitude is not None and not has_friction(scene):
        raise InputError(
            f"the scene {scene.name!r} has no friction, which amplitude = {amplitude:g} m "
            "requires; add effects.friction or piston.friction, or omit the amplitude"
        )
    read = read_part_tolerances(scene, parts)
    states = settled_beds(scene, beds, out=out, progress=progress)
    rests = [equilibrium_from(*state) for state in states]
    return tolerances_at(rests, read, amplitude=amplitude, draws=draws, seed=seed, progress=progress)


def tolerances_at(
    rests: Sequence[Equilibrium],
    parts: Sequence[Part],
    *,
    amplitude: float | None = None,
    draws: int | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Tolerances:
    """Compute tolerances for beds at given equilibria.

    Parameters
    ----------
    rests : sequence of Equilibrium
        Equilibria of beds of one scene, with a free piston.
    parts : sequence of Part
        Parts and their tolerances.
    amplitude, draws, seed, progress : float or None, int or None, int, bool
        As in `tolerances`.

    Returns
    -------
    Tolerances
        Slopes, contributions and totals.
    """
    beds = [_BedWithShiftedParts(rest, parts, amplitude) for rest in rests]
    figures = np.array([bed.figures for bed in beds])
    bar = progress_bar(wanted=progress, iterable=beds, desc="beds with shifted parts")
    slopes, sides = map(np.array, zip(*(bed.slopes_and_changes_of_parts() for bed in bar), strict=True))
    name, no_draws = rests[0].scene.name, np.empty((0, 3))
    result = Tolerances(name, tuple(parts), figures, slopes, sides, no_draws, amplitude=amplitude)
    if draws is None:
        draws = DRAWS if result.curved else 0
    numbers = np.random.default_rng(seed).standard_normal((draws, len(parts)))
    bar = progress_bar(wanted=progress and draws > 0, iterable=numbers, desc="drawn dampers")
    drawn = [
        bed.relative_changes_and_rearranged(multiples)
        for bed, multiples in zip(itertools.cycle(beds), bar, strict=False)
    ]
    changes = np.array([change for change, _ in drawn]).reshape(draws, 3)
    return dataclasses.replace(result, drawn=changes, rearranged=sum(rearranged for _, rearranged in drawn))


class _BedWithShiftedParts:
    """Settled bed, and the changes of its results if values of parts are shifted."""

    def __init__(self, rest: Equilibrium, parts: Sequence[Part], amplitude: float | None) -> None:
        self._rest, self._parts, self._amplitude = rest, parts, amplitude
        self._root = piston_roots(rest)[0]
        self.figures = self._height_frequency_and_damping(rest, self._root)

    def _height_frequency_and_damping(self, rest: Equilibrium, root: Root) -> Float[np.ndarray, "3"]:
        ratio = root.damping_ratio
        if self._amplitude is not None:
            ratio += motion_friction(rest, root=root).equivalent_damping_ratio(self._amplitude)
        return np.array([rest.piston_height, root.frequency, ratio])

    def slopes_and_changes_of_parts(self) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 2 3"]]:
        """Return the slopes for each part, and the relative changes of the results for shifts up and down."""
        slopes, sides = [], []
        for part, unit in zip(self._parts, np.eye(len(self._parts)), strict=True):
            for step in STEPS:
                up, rearranged_up = self.relative_changes_and_rearranged(step * unit)
                down, rearranged_down = (
                    (-up, rearranged_up)
                    if part.one_sided
                    else self.relative_changes_and_rearranged(-step * unit)
                )
                if step == 1.0:
                    sides.append((up, down))
                if not (rearranged_up or rearranged_down):
                    break
            slopes.append(0.5 * (up - down) / (step * part.slope_step))
        return np.array(slopes), np.array(sides)

    def relative_changes_and_rearranged(
        self, multiples: Float[np.ndarray, "k"]
    ) -> tuple[Float[np.ndarray, "3"], bool]:
        """Return relative changes of the results with shifted parts, and True if the bed rearranges."""
        rest = self._rest
        try:
            scene = scene_with_shifted_parts(rest.scene, self._parts, multiples)
            width_ratio = np.array([scene.cell.width / rest.scene.cell.width, 1.0])
            changed = equilibrium_from(scene, rest.positions * width_ratio, rest.heights, rest.pencil)
            root = refine_root(changed.pencil, coordinate_index_of_free_piston(rest), self._root.s)
        except InputError as error:
            shifted = [f"{part.key} by {b:+.2g}" for part, b in zip(self._parts, multiples, strict=True) if b]
            raise InputError(
                f"with shifts of {', '.join(shifted)} standard deviations: {error}; use smaller tolerances"
            ) from None
        if root is None:
            raise InputError(
                "for some values within the tolerances the piston is overdamped; reduce the drag"
            )
        figures = self._height_frequency_and_damping(changed, root)
        strain = width_ratio * [1.0, figures[0] / self.figures[0]]
        largest_displacement = np.hypot(*(changed.positions - rest.positions * strain).T).max()
        ratios = np.divide(figures, self.figures, out=np.ones(3), where=self.figures > 0.0)
        return ratios - 1.0, bool(largest_displacement > REARRANGED * rest.pencil.bed.length)
