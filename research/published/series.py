"""Series of runs of one bed from several random starts, which give the scatter of the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from granular.scene.named_scenes import bidisperse, damper, mono_bed
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from granular.studies.cases import Measure
from research.published.protocols import QUICK, STEP, CompressionProtocol
from research.published.records import (
    measure_bed_states_and_curves,
    measure_fall_equilibrium_and_oscillation,
    measure_state_at_pressing_force,
)

RECORDS, FRAMES = 400, 20
"""Numbers of records and frames of a compression."""
DEEPER = 0.6
"""Final height of the pressing, over the height of full compression."""


class Series(NamedTuple):
    """One bed from several random starts.

    Attributes
    ----------
    name : str
        Name of the bed, the same under every protocol.
    protocol : str
        Name of the protocol.
    words : str
        Text of the protocol.
    scene : callable
        Returns the scene of a start from its seed.
    seeds : sequence of int
    step : float or str
        Time step, as in `simulate`.
    measure : callable
        Returns the stored record of a run.
    """

    name: str
    protocol: str
    words: str
    scene: Callable[[int], Scene]
    seeds: Sequence[int] = (1, 2, 3)
    step: float | str = STEP
    measure: Measure = measure_bed_states_and_curves

    @property
    def key(self) -> str:
        """Name and protocol, unique to the series."""
        return f"{self.name} | {self.protocol}"


def equal_grain_series(
    name: str,
    count: int,
    protocol: CompressionProtocol,
    *,
    seeds: Sequence[int] = (1, 2, 3),
    speed: float | None = None,
    step: float | str = STEP,
    **changes: Any,
) -> Series:
    """Make the series of a bed of equal grains through the whole cycle; ``speed`` [m/s] replaces the default.

    ``changes`` are passed to `Scene.replace`, with ``__`` for dots.
    """
    chosen = protocol.speed if speed is None else speed
    relaxation = protocol.relaxation_duration(count, chosen)

    def scene(seed: int) -> Scene:
        made = mono_bed(count, speed=chosen, relaxation=relaxation, seed=seed)
        return _scene_with_first_stages_and_records(made, 4, changes)

    words = protocol._replace(speed=chosen).text(mixture=False)
    return Series(name, protocol.name, words, scene, seeds, step)


def mixture_series(
    name: str,
    aspect: float,
    ratio: float,
    protocol: CompressionProtocol,
    *,
    big: float = 0.005,
    mixing: str = "interspersed",
    seeds: Sequence[int] = (1, 2, 3),
    step: float | str = STEP,
    **changes: Any,
) -> Series:
    """Make the series of a mixture up to full compression."""

    def scene(seed: int) -> Scene:
        made = bidisperse(aspect, ratio, big=big, mixing=mixing, speed=protocol.mixture_speed, seed=seed)
        return _scene_with_first_stages_and_records(made, 2, changes)

    return Series(name, protocol.name, protocol.text(mixture=True), scene, seeds, step)


def pressed_mixture_series(name: str, aspect: float, ratio: float, spread: float) -> Series:
    """Make the series of a mixture pressed beyond 110 N, with scattered moments.

    The force of a bed grows as the height to the power -5/2: 0.6 of the usual height is enough for every
    mixture.
    """

    def scene(seed: int) -> Scene:
        made = bidisperse(aspect, ratio, speed=QUICK.mixture_speed, seed=seed)
        pressed_to = made.protocol[1].prescribed_final_height()
        if pressed_to is None:
            raise InputError(f"{name}: the second stage has no final height; give one")
        end = DEEPER * pressed_to
        changes = {"protocol__compress__to": end, "grains__spread": spread, "grains__seed": seed}
        return _scene_with_first_stages_and_records(
            made, 2, changes if spread else {"protocol__compress__to": end}, 200
        )

    words = QUICK.text(mixture=True) + ", until 110 N"
    return Series(name, QUICK.name, words, scene, (1, 2), STEP, measure_state_at_pressing_force)


def damper_fall_series(
    name: str, mass: float, *, drag: float = 0.1, seeds: Sequence[int] = (1, 2, 3)
) -> Series:
    """Make the series of the damper: dropped from 20 D, at rest, lifted by 0.2 D, released."""

    def scene(seed: int) -> Scene:
        return damper(mass, drag=drag, seed=seed)

    words = "published: dropped from 20 D, at rest, lifted by 0.2 D, released for 6 s"
    return Series(name, "published", words, scene, seeds, "auto", measure_fall_equilibrium_and_oscillation)


def _scene_with_first_stages_and_records(
    scene: Scene, stages: int, changes: dict[str, Any], frames: int = FRAMES
) -> Scene:
    """Return the scene with its first stages, and the number of records needed by the figures."""
    period = 2000.0 * scene.output.scalars
    protocol = scene.to_plain()["protocol"][:stages]
    output = {"scalars": period / RECORDS, "frames": period / frames}
    dotted = {name.replace("__", "."): value for name, value in changes.items()}
    return scene.replace(protocol=protocol, output=output, **dotted)
