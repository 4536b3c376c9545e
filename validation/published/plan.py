"""What is run, group by group: the cheap and the most telling first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from validation.published.protocols import PUBLISHED, QUICK, SHORT, Protocol
from validation.published.series import Series, fall, mixture, mono

SIZES = (92, 184, 276, 368, 460, 552, 644, 736)
LISTED = (368, 460, 552, 644, 736)
"""Sizes that the source ran three times both ways."""
LARGE = (1472, 2208)
ASPECTS = (0.75, 0.6, 0.5)
RATIOS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
VARIANT_RATIOS = (0.0, 0.25, 0.5, 0.75, 1.0)
SPEEDS = (5.63, 8.33, 16.0, 32.0, 64.0, 128.0)
"""[mm/s]"""
RADII = (6.26, 7.26, 8.26, 9.26, 10.26, 11.26, 12.26)
"""Radii of the source's list in Fig. 5.2 [D]."""
TEN = tuple(range(1, 11))
CYCLE_SPEED = 5.63e-3
"""Speed of the studies of start and friction [m/s]."""
DRAG = {"coefficient": 0.1}
MISPRINT = 42.0
"""Factor of the load on 5 mm grains when the angle of [D, eq. 4.10] is taken as printed."""
WIDE_CELL = 0.36
"""Width that [D, Table 4.3] prints, where text and Table A.1 have 0.33 [m]."""
MASSES = (7.5, 6.24)
"""Pistons [kg]: that of the packaged damper, and the one that rests where the source's does."""
MIXTURE_PERIOD = 400.0
"""Duration of the compression of a mixture at 1 mm/s [s], within 7 % for every size ratio."""
VARIANTS: dict[str, dict[str, Any]] = {
    "dry and viscous": {"effects__drag": DRAG},
    "no gravity": {"effects__gravity": None},
    "no gravity, dry and viscous": {"effects__gravity": None, "effects__drag": DRAG},
}


class Group(NamedTuple):
    """Series that are run together."""

    title: str
    series: Sequence[Series]


def mixture_name(aspect: float, ratio: float, big: float = 0.005) -> str:
    """Name of a mixture's series; without small grains the aspect ratio is that of none."""
    if big != 0.005:
        return f"mixture {1e3 * aspect * big:g}:{1e3 * big:g} mm, R = {ratio:g}"
    return "mixture, R = 0" if ratio == 0.0 else f"mixture a = {aspect:g}, R = {ratio:g}"


def quick_plan() -> list[Group]:
    """What fits into a quarter of an hour on two cores."""
    return [
        Group("sizes", [*_direct(QUICK), _listed(368, QUICK), _listed(736, QUICK)]),
        Group("damper", [fall(f"damper {mass:g} kg", mass, seeds=(1,)) for mass in MASSES[:1]]),
        Group("starts, speeds and friction", _cycle(QUICK, starts=3)),
        Group("mixtures at R = 0.5", _halves(QUICK)),
    ]


def full_plan() -> list[Group]:
    """Everything: hours."""
    return [
        Group("sizes, quick protocol", _sizes(QUICK)),
        Group("mixtures at R = 0.5, quick protocol", _halves(QUICK)),
        Group("damper", [fall(f"damper {mass:g} kg", mass) for mass in MASSES]),
        Group("drag and friction, quick protocol", _cycle(QUICK, starts=3)),
        Group("the source's friction and step", _source_friction()),
        Group("mixtures over R, quick protocol", _scan(QUICK)),
        Group("radii of the list", _radii()),
        Group("starts, speeds and friction", _cycle(PUBLISHED, starts=10)),
        Group("variants, quick protocol", _variants(QUICK)),
        Group("large beds, quick protocol", _large(QUICK)),
        Group("steps, and the source's friction", _causes()),
        Group("mixing rule and friction angle", _mixture_causes()),
        Group("sizes", _sizes(PUBLISHED)),
        Group("mixtures at R = 0.5, short protocol", _halves(SHORT)),
        Group("mixtures over R, short protocol", _scan(SHORT)),
        Group("mixtures at R = 0.5, published protocol", _halves(PUBLISHED)),
        Group("large beds, with the list", _large(PUBLISHED, direct=False)),
        Group("variants, short protocol", _variants(SHORT)),
        Group("large beds, every pair", _large(PUBLISHED, direct=True)),
    ]


def _sizes(protocol: Protocol) -> list[Series]:
    return _direct(protocol) + [_listed(n, protocol) for n in LISTED]


def _direct(protocol: Protocol) -> list[Series]:
    return [mono(f"direct {n}", n, protocol) for n in SIZES]


def _listed(count: int, protocol: Protocol) -> Series:
    return mono(f"list {count}", count, protocol, pairs__method="verlet-list")


def _large(protocol: Protocol, direct: bool | None = None) -> list[Series]:
    """One start for the direct sum, as in the source; three with the list."""
    chosen: list[Series] = []
    if direct is not True:
        chosen += [_listed(n, protocol) for n in LARGE]
    if direct is not False:
        chosen += [
            mono(f"direct {n}", n, protocol, seeds=(1,), pairs__method="direct") for n in LARGE
        ]
    return chosen


def _cycle(protocol: Protocol, starts: int) -> list[Series]:
    """Studies of start, speed and friction; the quick protocol keeps its own speed."""
    speed = CYCLE_SPEED if protocol is PUBLISHED else None
    high = {"static": 0.8, "dynamic": 0.8, "torque": "second"}
    drag: dict[str, Any] = {"effects__friction": None, "effects__drag": DRAG}
    found = [mono("starts", 368, protocol, seeds=TEN[:starts], speed=speed)] if starts > 3 else []
    found += [
        mono("second order", 368, protocol, speed=speed, effects__friction={"torque": "second"}),
        # Rough grains slip in larger jumps, which longer steps do not follow.
        mono(
            "second order, 0.8", 368, protocol, speed=speed, step="auto/2", effects__friction=high
        ),
        mono("drag", 368, protocol, speed=speed, **drag),
    ]
    if protocol is PUBLISHED:
        found += [mono(f"speed {v:g}", 368, protocol, speed=1e-3 * v) for v in SPEEDS[2:]]
    return found


def _halves(protocol: Protocol) -> list[Series]:
    """R = 0.5 for every aspect ratio, and big grains alone."""
    return [mixture(mixture_name(0.6, 0.0), 0.6, 0.0, protocol)] + [
        mixture(mixture_name(a, 0.5), a, 0.5, protocol) for a in ASPECTS
    ]


def _scan(protocol: Protocol) -> list[Series]:
    """All other R, two starts each, as in the source."""
    two = (1, 2)
    common = [
        mixture(mixture_name(a, r), a, r, protocol, seeds=two)
        for r in reversed(RATIOS)
        for a in ASPECTS
        if r not in (0.0, 0.5)
    ]
    large = [
        mixture(mixture_name(0.75, r, 0.008), 0.75, r, protocol, big=0.008, seeds=two)
        for r in reversed(RATIOS)
    ]
    return common + large


def _variants(protocol: Protocol) -> list[Series]:
    return [
        mixture(f"{name}, R = {r:g}", 0.6, r, protocol, seeds=(1,), **changes)
        for name, changes in VARIANTS.items()
        for r in VARIANT_RATIOS
    ] + [mixture(mixture_name(0.6, r), 0.6, r, protocol, seeds=(1,)) for r in (0.25, 0.75)]


def _radii() -> list[Series]:
    return [
        mono(f"list of radius {radius:g} D", 368, QUICK, pairs__method="verlet-list",
             pairs__cut_off=f"{radius} D")
        for radius in RADII
    ]  # fmt: skip


def _causes() -> list[Series]:
    return [
        mono("direct 368, a third of the step", 368, QUICK, step="auto/2"),
        mixture("mixture a = 0.6, R = 0.5, a third of the step", 0.6, 0.5, QUICK, step="auto/2"),
        mono("direct 368, source's friction", 368, QUICK, step=4e-5,
             effects__friction=_regularised(39.6, 0.006)),
        _rounded_184(),
        mono("cut-off 368", 368, QUICK, pairs__method="cut-off"),
        mono("cut-off 736", 736, QUICK, pairs__method="cut-off"),
    ]  # fmt: skip


def _rounded_184() -> Series:
    """184 grains in a cell whose scale, sqrt(1/2), is rounded to 0.70."""
    scale, height = 0.7, 75.0
    start, end = scale * height * 0.006, scale * 20.0 * 0.006
    return mono("direct 184, scale 0.70", 184, QUICK, cell__width="42 D",
                piston__height=1.2 * start, arrangement__height=start,
                protocol__relax__to=start, protocol__compress__to=end,
                protocol__expand__to=start)  # fmt: skip


def _regularised(period: float, diameter: float) -> dict[str, Any]:
    """The source's friction, with its threshold of 1e-6 D/T; its step is 1e-6 T."""
    return {"scheme": "regularised", "threshold": 1e-6 * diameter / period}


def _source_friction() -> list[Series]:
    """Mixtures with the source's friction at the source's step, 1e-6 T of its own compression."""
    friction = _regularised(MIXTURE_PERIOD, 0.005)
    beds = [(0.6, 0.0), *((a, 0.5) for a in ASPECTS), (0.6, 1.0)]
    return [
        mixture(f"source's friction, {mixture_name(a, r)}", a, r, QUICK, seeds=(1, 2),
                step=1e-6 * MIXTURE_PERIOD, effects__friction=friction)
        for a, r in beds
    ]  # fmt: skip


def _mixture_causes() -> list[Series]:
    rough = {"static": 0.6 * MISPRINT, "dynamic": 0.45 * MISPRINT}
    found = [
        mixture(f"every k-th, a = 0.6, R = {r:g}", 0.6, r, QUICK, mixing="every-kth")
        for r in (0.3, 0.4, 0.5)
    ]
    found += [
        mixture(f"misprinted angle, a = {a:g}", a, 0.5, QUICK, effects__friction=rough)
        for a in ASPECTS
    ]
    found += [
        mixture(f"wide cell, a = {a:g}", a, 0.5, QUICK, seeds=(1, 2), cell__width=WIDE_CELL)
        for a in ASPECTS
    ]
    return found
