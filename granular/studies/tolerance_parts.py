"""Parts of a damper with their tolerances: as given, usual ones, and scenes whose parts are moved by them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from granular.linear.bed_forces import with_number
from granular.linear.slopes import number_keys
from granular.scene.scene import Scene
from granular.schema.field_kinds import FieldError, QuantityKind, TemperatureKind
from granular.schema.sections import find_field
from granular.shared.errors import InputError
from granular.shared.files import parse_toml
from granular.shared.message_text import quote

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

__all__ = ["Part", "usual_parts"]

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
    def slope_step(self) -> float:
        """Deviation over which slopes are: relative, or in their unit."""
        return self.deviation / (1.0 if self.slope_unit else abs(self.value))

    @property
    def text(self) -> str:
        """Number and tolerance in words."""
        size, name = {"1": (1.0, ""), "degC": (1.0, " °C"), "m": (1e3, " mm")}.get(
            self.unit, (1.0, f" {self.unit}")
        )
        tolerance = f"{size * self.deviation:.3g}{name}"
        if self.relative:
            tolerance = f"{100.0 * self.deviation / abs(self.value):.3g} %"
        return f"{size * self.value:.5g}{name} ± {tolerance}"


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
    text, unit = str(tolerance).strip(), kind.unit
    relative = text.endswith("%")
    if isinstance(kind, TemperatureKind):
        text, unit = text.removesuffix("K").removesuffix("°C"), "1"
    if relative and (value == 0.0 or unit != kind.unit):
        raise InputError(f"{key} is {value:g} {kind.unit}: give a tolerance with a unit, not {quote(text)}")
    try:
        reader = QuantityKind(unit="1" if relative else unit, above=0.0)
        deviation = reader.parse(text, scene.grains.species[0].diameter)
    except FieldError as error:
        raise InputError(f"the tolerance of {key}: {error}") from None
    size = abs(value) if relative else 1.0
    return Part(key, value, kind.unit, size * deviation, relative, value == 0.0 == kind.least)


def move_parts(scene: Scene, parts: Sequence[Part], by: Float[np.ndarray, "k"]) -> Scene:
    """Move the number of each part by a multiple of its deviation."""
    for part, multiple in sorted(zip(parts, by, strict=True), key=lambda pair: _LAST.get(pair[0].key, 0)):
        if multiple == 0.0:
            continue
        value = (find_field(scene, part.key) or (part.value,))[0]
        step = (value / part.value if part.relative else 1.0) * part.deviation
        drag = scene.effects.drag
        scene = with_number(
            scene, part.key, value + float(abs(multiple) if part.one_sided else multiple) * step
        )
        if part.key == "effects.drag.viscosity" and drag is not None and not drag.follows:
            # The drag of a disc was measured: the liquid is the piston's.
            scene = with_number(scene, "effects.drag.coefficient", drag.coefficient)
    return scene


def usual_parts(scene: Scene) -> dict[str, str | float]:
    """Usual tolerances of the parts that a scene names, as `tolerances` takes them.

    Parameters
    ----------
    scene : Scene
        Scene with a free piston.

    Returns
    -------
    dict of str to str or float
        Standard deviations by key: limits of ``usual_tolerances.toml``, which names their sources, over the
        square root of 3. That is the standard deviation if nothing is known between the limits.
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
    if key == "effects.drag.coefficient" and getattr(scene.effects.drag, "follows", False):
        return False
    return (find_field(scene, key) or (None,))[0] not in (None, 0.0)
