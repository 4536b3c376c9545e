"""Scenes by name and from files, and de Paula's beds with a variable number of grains.

>>> from granular import mono_bed, simulate
>>> run = simulate(mono_bed(92, relaxation=0.5, speed=0.033))
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

from granular.scene.scene import Scene
from granular.schema.apparatus import Species
from granular.shared.errors import InputError, SceneError, quote, unknown_word_message
from granular.shared.files import read_toml

SCENES = Path(__file__).parents[1] / "scenes"


def scene_names() -> tuple[str, ...]:
    """Names of the packaged scenes.

    Returns
    -------
    tuple of str
        Names for `load_scene`, sorted.

    Examples
    --------
    >>> from granular import scene_names
    >>> scene_names()
    ('bed', 'damper', 'damper-source', 'machine', 'magnets', 'silo', 'single-particle', 'workshop')
    """
    return tuple(sorted(path.stem for path in SCENES.glob("*.toml")))


def load_scene(source: str | Path) -> Scene:
    """Return a packaged scene by name, or a scene from a TOML file.

    Parameters
    ----------
    source : str or Path
        Name of a packaged scene (`scene_names`), or path of a TOML file.

    Returns
    -------
    Scene
        The scene, validated.

    Raises
    ------
    SceneError
        If the scene does not exist, the file cannot be read or is not TOML, or the scene is not valid.

    Examples
    --------
    >>> from granular import load_scene
    >>> scene = load_scene("damper").replace(**{"piston.mass": "6.5 kg"})
    >>> scene.piston.mass, scene.grains.count
    (6.5, 368)
    """
    path = Path(source)
    if str(source) in scene_names():
        path = SCENES / f"{source}.toml"
    elif not os.path.isfile(path):  # also for invalid file names
        if path.suffix:
            raise SceneError(f"the scene file {quote(str(source))} does not exist; check the path")
        raise SceneError(unknown_word_message(str(source), scene_names(), "scene"))
    plain = read_toml(path, SceneError)
    try:
        return Scene.from_plain(plain)
    except SceneError as error:
        raise SceneError(f"{path.name}: {error}") from None


REFERENCE_COUNT = 368
WIDTH, START, END = 60.0, 75.0, 20.0
"""Cell width, and piston heights before and after the compression, in diameters, for 368 grains [D, Table
2.1]. For N grains these lengths are multiplied by sqrt(N/368) [D, 3.4]."""
LOWEST_START = 50.0
"""Minimum initial height of the piston [D]. A bed settled under its weight is about 40 D high for any width.
De Paula's piston on 92 grains also starts higher than the height scaled by sqrt(N/368); he does not state
its height."""
HEADROOM = 1.2
"""Ratio of the piston heights before the relaxation and before the compression; de Paula does not give this
ratio."""

BIDISPERSE_COUNT = 400
BIDISPERSE_WIDTH = 0.33
BIDISPERSE_START = 0.445
BIDISPERSE_END = 0.07
"""Cell width, piston height before the compression, and piston height after the compression of a bed without
small grains [m] [D, Table A.1]: 66 D, 89 D and 14 D for big grains of 5 mm. The cell size in Table 4.3
is inconsistent with Table A.1. For grains of 8 mm the final height is 22.4 D = 0.1792 m."""


def piston_height_of_mixture(reference: float, species: Sequence[Species]) -> float:
    """Height H_f = H_r sum_k R_k (D_k/D_1)^2 [m] of a mixture [D, eq. 4.23]; H_r is ``reference`` [m]."""
    first = species[0].diameter
    return reference * math.fsum(specy.share * (specy.diameter / first) ** 2 for specy in species)


def _check_parameter(name: str, value: float, unit: str, maximum: float = math.inf) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not 0.0 < value <= maximum or math.isinf(value):
        limit = "" if math.isinf(maximum) else f" and up to {maximum:g}"
        raise InputError(
            f"{name} = {quote(value)} is outside the limits; give a number above 0{limit} {unit}".rstrip()
        )


def _compressed_bed(
    changes: dict[str, object], heights: tuple[float, float], speed: float, relaxation: float, seed: int
) -> Scene:
    """Return the packaged bed with changes, compressed from one height to another [m] [D, 2.3]."""
    start, end = heights
    _check_parameter("speed", speed, "m/s")
    _check_parameter("relaxation", relaxation, "T")
    if not start > end:
        raise InputError(
            f"a compression from {start:g} to {end:g} m would move the piston upwards; use smaller grains"
        )
    period = (start - end) / speed
    scalars = period / 2000.0
    protocol = [
        {"name": "relax", "kind": "descend", "to": start, "duration": relaxation * period},
        {"name": "compress", "kind": "move", "to": end, "speed": speed},
        {"name": "expand", "kind": "move", "to": start, "speed": speed},
        {"name": "settle", "kind": "hold", "duration": period},
    ]
    changes |= {
        "piston.height": HEADROOM * start,
        "effects.drag": None,
        "effects.friction": True,
        "arrangement.height": start,
        "arrangement.seed": seed,
        "protocol": protocol,
        "output": {"scalars": scalars, "frames": 20.0 * scalars},
    }
    return load_scene("bed").replace(**changes)


def mono_bed(
    count: int = REFERENCE_COUNT, *, speed: float = 8.33e-3, relaxation: float = 5.0, seed: int = 1
) -> Scene:
    """Bed of equal grains, compressed and released as in [D, chapter 3].

    Parameters
    ----------
    count : int
        Number of grains, 1 or more. The width of the cell and the final height of the piston are scaled by
        sqrt(count/368). The initial height of the piston, 75 D, is also scaled, but is at least 50 D.
    speed : float
        Speed of the piston [m/s], above 0.
    relaxation : float
        Duration of the relaxation before the compression, in units of the compression's duration T; above 0.
    seed : int
        Seed of the arrangement, 0 or more.

    Returns
    -------
    Scene
        Scene with dipoles, experimental walls, gravity and dry friction; change it by `Scene.replace`.

    Raises
    ------
    InputError
        If an argument is outside its limits, or the number of grains does not give a valid scene.

    Examples
    --------
    >>> from granular import mono_bed
    >>> scene = mono_bed(92)
    >>> round(scene.cell.width, 3), round(scene.piston.height, 3)  # [m]
    (0.18, 0.36)
    """
    diameter = load_scene("bed").grains.species[0].diameter
    _check_parameter("count", count, "grains")
    size = math.sqrt(count / REFERENCE_COUNT) * diameter
    heights = max(START * size, LOWEST_START * diameter), END * size
    changes = {"name": f"mono-{count}", "grains.count": count, "cell.width": WIDTH * size}
    return _compressed_bed(changes, heights, speed, relaxation, seed)


def bidisperse(
    aspect: float = 0.6,
    ratio: float = 0.5,
    *,
    big: float = 0.005,
    mixing: str = "interspersed",
    speed: float = 1e-3,
    relaxation: float = 5.0,
    seed: int = 1,
) -> Scene:
    """Mixture of 400 big and small grains, compressed and released as in [D, chapter 4].

    Parameters
    ----------
    aspect : float
        Ratio of the small grains' diameter to the big grains' diameter, above 0 and up to 1.
    ratio : float
        Fraction R of small grains, from 0 to 1. The piston's final height is computed from this nominal value
        [D, eq. 4.23]; the actual fraction after mixing is given by `Grains.species_fractions`.
    big : float
        Diameter of the big grains [m], above 0.
    mixing : str
        ``"interspersed"`` or de Paula's ``"every-kth"``; see `Grains`.
    speed : float
        Speed of the piston [m/s], above 0.
    relaxation : float
        Duration of the relaxation before the compression, in units of the compression's duration T;
        above 0. After the expansion the bed rests for T.
    seed : int
        Seed of the random packing, 0 or more.

    Returns
    -------
    Scene
        Scene with dipoles, experimental walls, gravity and dry friction; change it by `Scene.replace`.

    Raises
    ------
    InputError
        If an argument is outside its limits, or the grains are too big for a compression.

    Examples
    --------
    >>> from granular import bidisperse
    >>> scene = bidisperse(aspect=0.6, ratio=0.5)
    >>> [(kind.name, kind.diameter) for kind in scene.grains.species]  # [m]
    [('big', 0.005), ('small', 0.003)]
    """
    _check_parameter("aspect", aspect, "", maximum=1.0)
    _check_parameter("big", big, "m")
    if not isinstance(ratio, int | float) or not 0.0 <= ratio <= 1.0:
        raise InputError(f"ratio = {quote(ratio)} is not a fraction; give a number from 0 to 1")
    species = [
        Species(name="big", diameter=big, share=1.0 - ratio),
        Species(name="small", diameter=aspect * big, share=ratio),
    ]
    end = BIDISPERSE_END * (big / 0.005) ** 2  # at the packing fraction of de Paula
    changes = {
        "name": f"bidisperse-{aspect:g}-{ratio:g}",
        "grains.count": BIDISPERSE_COUNT,
        "grains.species": [specy.to_plain() for specy in species],
        "grains.mixing": mixing,
        "cell.width": BIDISPERSE_WIDTH,
    }
    heights = BIDISPERSE_START, piston_height_of_mixture(end, species)
    return _compressed_bed(changes, heights, speed, relaxation, seed)


def damper(
    mass: float = 7.5,
    *,
    count: int = REFERENCE_COUNT,
    drag: float = 0.1,
    drop: float = 20.0,
    lift: float = 0.2,
    seed: int = 1,
    magnets: str = "dipoles",
) -> Scene:
    """Magnetic granular damper of [D, 5.3]: the piston falls, comes to rest, is lifted, and is released.

    Parameters
    ----------
    mass : float
        Mass of the piston [kg] for 368 grains, above 0; for other counts the mass is proportional to the
        width of the cell.
    count : int
        Number of grains; width and heights are scaled by sqrt(count/368) to keep the packing fraction.
    drag : float
        Drag coefficient of a grain [kg/s], above 0.
    drop : float
        Height [D] from which the piston falls, for 368 grains; above 0.
    lift : float
        Height [D] by which the piston is lifted from rest, independent of ``count``.
    seed : int
        Seed of the arrangement, 0 or more.
    magnets : str
        ``"dipoles"``, or ``"cylinders"``: discs as in the packaged scene ``magnets``.

    Returns
    -------
    Scene
        Scene of the damper; change it by `Scene.replace`.

    Raises
    ------
    InputError
        If an argument is outside its limits, or the grains do not fit below the piston, for example
        for a small ``drop`` or ``count``.

    Examples
    --------
    >>> from granular import damper
    >>> scene = damper(mass=9.0, lift=0.5)
    >>> [stage.name for stage in scene.protocol]
    ['drop', 'lift', 'release']
    """
    if magnets not in ("dipoles", "cylinders"):
        raise InputError(f"magnets = {quote(magnets)} is unknown; use 'dipoles' or 'cylinders'")
    base = load_scene("damper" if magnets == "dipoles" else "magnets")
    _check_parameter("mass", mass, "kg")
    _check_parameter("count", count, "grains")
    _check_parameter("drag", drag, "kg/s")
    _check_parameter("drop", drop, "D")
    if isinstance(lift, bool) or not isinstance(lift, int | float) or not math.isfinite(lift):
        raise InputError(f"lift = {quote(lift)} is not a number; give the lift's height in D")
    scale = math.sqrt(count / REFERENCE_COUNT)
    diameter = base.grains.species[0].diameter
    return base.replace(
        **{
            "name": base.name if count == REFERENCE_COUNT else f"{base.name}-{count}",
            "grains.count": count,
            "cell.width": WIDTH * scale * diameter,
            "piston.mass": mass * scale,
            "piston.height": drop * scale * diameter,
            "effects.drag.coefficient": drag,
            "arrangement.height": (drop * scale - 1.0) * diameter,
            "arrangement.seed": seed,
            "protocol.lift.by": f"{float(lift)!r} D",
        }
    )
