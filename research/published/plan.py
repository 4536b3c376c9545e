"""Plan of the runs in groups, with short and informative runs first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from research.published.protocols import ACCELERATED, PUBLISHED, QUICK, CompressionProtocol
from research.published.series import (
    Series,
    damper_fall_series,
    equal_grain_series,
    mixture_series,
    pressed_mixture_series,
)
from research.published.start_and_creep import (
    creep_series,
    grid_height_changes,
    regularised_friction_settings,
    series_with_both_causes_by_size,
)
from validation.measured_quantities import compression_duration

SIZES = (92, 184, 276, 368, 460, 552, 644, 736)
LISTED = (368, 460, 552, 644, 736)
"""Sizes that de Paula ran three times by both methods."""
LARGE = (1472, 2208)
ASPECTS = (0.75, 0.6, 0.5)
RATIOS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
VARIANT_RATIOS = (0.0, 0.25, 0.5, 0.75, 1.0)
OWN_RATIOS = (0.25, 0.3, 0.4, 0.45, 0.55, 0.6, 0.7, 0.75)
"""Values of R in Table A.1 for which de Paula's mixing rule gives a fraction other than R, or the next
one."""
SPEEDS = (5.63, 8.33, 16.0, 32.0, 64.0, 128.0)
"""[mm/s]"""
RADII = (6.26, 7.26, 8.26, 9.26, 10.26, 11.26, 12.26)
"""Radii of de Paula's list in Fig. 5.2 [D]."""
TEN = tuple(range(1, 11))
CYCLE_SPEED = 5.63e-3
"""Speed in the studies of start and friction [m/s]."""
DRAG = {"coefficient": 0.1}
MISPRINT = 42.0
"""Factor of the load on 5 mm grains when the angle of [D, eq. 4.10] is taken as printed."""
WIDE_CELL = 0.36
"""Width printed in [D, Table 4.3], while text and Table A.1 have 0.33 [m]."""
WIDER = WIDE_CELL / 0.33
"""The same change of width for beds of equal grains."""
LOOSE = 1.35
"""Height of a loose arrangement over the height at the compression's start: its grains are farther apart, and
fall from a larger height. The thesis does not print the height of the grid."""
MASSES = (7.5, 6.24)
"""Piston masses [kg]: of the packaged damper, and with the equilibrium height of de Paula's damper."""
GAMMAS = (0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2)
"""Drag of a grain [kg/s]."""
SOURCE_DRAG = 1.0
"""Drag at which de Paula's law fits [kg/s]; the thesis does not print the drag of its damper."""
NEAR_MASSES = (6.0, 6.5)
"""Further piston masses near the one with de Paula's equilibrium height [kg]."""
MIXTURE_PERIOD = 400.0
"""Duration of the compression of a mixture at 1 mm/s [s], within 7 % for every size ratio."""
HYSTERESIS_SIZES = (92, 184, 368, 736)
"""Sizes at which causes of the hysteresis were tested."""
SPREADS = (0.0, 0.1)
"""Relative scatter of the grains' moments in pressed beds."""
VARIANTS: dict[str, dict[str, Any]] = {
    "dry and viscous": {"effects__drag": DRAG},
    "no gravity": {"effects__gravity": None},
    "no gravity, dry and viscous": {"effects__gravity": None, "effects__drag": DRAG},
}
WALLS: dict[str, dict[str, Any]] = {
    "infinite walls": {f"effects__walls__{side}": "infinite" for side in ("left", "right", "bottom", "top")},
    "slabs": {
        "effects__walls__left": {"law": "slab", "length": "100 D"},
        "effects__walls__right": {"law": "slab", "length": "100 D"},
        "effects__walls__bottom": "slab",
        "effects__walls__top": "slab",
    },
}


class SeriesGroup(NamedTuple):
    """Series that are run together."""

    title: str
    series: Sequence[Series]


def mixture_series_name(aspect: float, ratio: float, big: float = 0.005) -> str:
    """Return the name of a mixture's series; without small grains it has no aspect ratio."""
    if big != 0.005:
        return f"mixture {1e3 * aspect * big:g}:{1e3 * big:g} mm, R = {ratio:g}"
    return "mixture, R = 0" if ratio == 0.0 else f"mixture a = {aspect:g}, R = {ratio:g}"


def damper_series_name(mass: float, drag: float = 0.1) -> str:
    """Return the name of a damper's series."""
    return f"damper {mass:g} kg" + ("" if drag == 0.1 else f", {drag:g} kg/s")


def quick_plan() -> list[SeriesGroup]:
    """Return the plan for a quarter of an hour on two cores."""
    return [
        SeriesGroup(
            "sizes",
            [*_direct_sum_series(QUICK), _verlet_list_series(368, QUICK), _verlet_list_series(736, QUICK)],
        ),
        SeriesGroup("damper", [damper_fall_series(damper_series_name(MASSES[0]), MASSES[0], seeds=(1,))]),
        SeriesGroup("friction", _friction_series(QUICK)),
        SeriesGroup("mixtures at R = 0.5", _half_mixture_series(QUICK)),
    ]


def full_plan() -> list[SeriesGroup]:
    """Return the full plan (hours), with references of comparisons and cheap runs first."""
    return [
        SeriesGroup("dampers", _damper_series()),
        SeriesGroup("sizes, quick protocol", _direct_sum_series(QUICK)),
        SeriesGroup("small sizes", _direct_sum_series(PUBLISHED, SIZES[:3])),
        SeriesGroup(
            "mixtures, quick protocol",
            [*_half_mixture_series(QUICK), *_small_grain_and_reference_series(QUICK)],
        ),
        SeriesGroup("causes of the hysteresis, 92 and 184 grains", _hysteresis_cause_series((92, 184))),
        SeriesGroup("368 grains", _direct_sum_series(PUBLISHED, (368,))),
        SeriesGroup(
            "loose starts", [*_loose_start_series(QUICK), *_loose_start_series(PUBLISHED, SIZES[:4])]
        ),
        SeriesGroup(
            "de Paula's friction and protocol, 92 and 184 grains", _source_friction_series((92, 184))
        ),
        SeriesGroup("causes of the hysteresis, 368 and 736 grains", _hysteresis_cause_series((368, 736))),
        SeriesGroup("large sizes", _direct_sum_series(PUBLISHED, SIZES[4:])),
        SeriesGroup("large sizes, loose starts", _loose_start_series(PUBLISHED, SIZES[4:])),
        SeriesGroup("mixtures at R = 0 and 0.5", _half_mixture_series(PUBLISHED)),
        SeriesGroup("starts, speeds and friction", _start_speed_and_friction_series()),
        SeriesGroup("mixtures, de Paula's friction and the wide cell", _mixture_cause_series()),
        SeriesGroup("mixtures over R, quick protocol", _series_of_other_big_grain_fractions(QUICK)),
        SeriesGroup("drag and weightlessness, quick protocol", _drag_and_gravity_variant_series(QUICK)),
        SeriesGroup("walls, quick protocol", _wall_law_series()),
        SeriesGroup("sizes, with the list", [_verlet_list_series(n, PUBLISHED) for n in LISTED]),
        SeriesGroup("small grains alone, and 6 and 8 mm", _small_grain_and_reference_series(PUBLISHED)),
        SeriesGroup("lists and cut-offs, quick protocol", _list_radius_series()),
        SeriesGroup("de Paula's mixing rule, quick protocol", _mixing_rule_series()),
        SeriesGroup("up to 110 N", _pressed_mixture_series()),
        SeriesGroup("shorter steps", _smaller_step_series()),
        SeriesGroup("every pair by the mesh", _mesh_series()),
        SeriesGroup("de Paula's friction and protocol, 368 grains", _source_friction_series((368,))),
        SeriesGroup(
            "both causes of the hysteresis", series_with_both_causes_by_size(SIZES, ACCELERATED, (1, 2))
        ),
        SeriesGroup("creep", creep_series(368)),
        SeriesGroup(
            "both causes, a large bed", series_with_both_causes_by_size(LARGE[:1], ACCELERATED, (1,))
        ),
        SeriesGroup("de Paula's friction and protocol, 736 grains", _source_friction_series((736,), (1,))),
        SeriesGroup("large beds, with the list", [_verlet_list_series(n, PUBLISHED) for n in LARGE]),
    ]


def _direct_sum_series(protocol: CompressionProtocol, sizes: Sequence[int] = SIZES) -> list[Series]:
    return [equal_grain_series(f"direct {n}", n, protocol) for n in sizes]


def _verlet_list_series(count: int, protocol: CompressionProtocol) -> Series:
    return equal_grain_series(f"list {count}", count, protocol, pairs__method="verlet-list")


def _mesh_series() -> list[Series]:
    """Return beds too expensive for the direct sum, and one bed that both methods can run."""
    mesh: dict[str, Any] = {"pairs__method": "mesh"}
    return [
        equal_grain_series("mesh 736", 736, PUBLISHED, **mesh),
        *(equal_grain_series(f"direct {n}", n, PUBLISHED, **mesh) for n in LARGE),
    ]


def _friction_series(protocol: CompressionProtocol, speed: float | None = None) -> list[Series]:
    high = {"static": 0.8, "dynamic": 0.8, "torque": "second"}
    drag: dict[str, Any] = {"effects__friction": None, "effects__drag": DRAG}
    second = {"torque": "second"}
    return [
        equal_grain_series("second order", 368, protocol, speed=speed, effects__friction=second),
        # Grains with high friction slip in larger jumps, which longer steps cannot follow.
        equal_grain_series(
            "second order, 0.8", 368, protocol, speed=speed, step="auto/2", effects__friction=high
        ),
        equal_grain_series("drag", 368, protocol, speed=speed, **drag),
    ]


def _start_speed_and_friction_series() -> list[Series]:
    """Return the studies of start, speed and friction."""
    return [
        equal_grain_series("starts", 368, PUBLISHED, seeds=TEN, speed=CYCLE_SPEED),
        *_friction_series(PUBLISHED, CYCLE_SPEED),
        *(equal_grain_series(f"speed {v:g}", 368, PUBLISHED, speed=1e-3 * v) for v in SPEEDS[2:]),
    ]


def _half_mixture_series(protocol: CompressionProtocol) -> list[Series]:
    """Return R = 0.5 for every aspect ratio, and big grains alone."""
    return [mixture_series(mixture_series_name(0.6, 0.0), 0.6, 0.0, protocol)] + [
        mixture_series(mixture_series_name(a, 0.5), a, 0.5, protocol) for a in ASPECTS
    ]


def _small_grain_and_reference_series(protocol: CompressionProtocol) -> list[Series]:
    """Return small grains alone, the reference of forces, and the mixture of 6 and 8 mm."""
    two = (1, 2)
    alone = [mixture_series(mixture_series_name(a, 1.0), a, 1.0, protocol, seeds=two) for a in ASPECTS]
    large = [
        mixture_series(mixture_series_name(0.75, r, 0.008), 0.75, r, protocol, big=0.008, seeds=two)
        for r in (0.0, 0.5, 1.0)
    ]
    return alone + large


def _series_of_other_big_grain_fractions(protocol: CompressionProtocol) -> list[Series]:
    """Return all other R, two starts each, as in the thesis."""
    two = (1, 2)
    between = [r for r in reversed(RATIOS) if r not in (0.0, 0.5, 1.0)]
    return [
        mixture_series(mixture_series_name(a, r), a, r, protocol, seeds=two) for r in between for a in ASPECTS
    ] + [
        mixture_series(mixture_series_name(0.75, r, 0.008), 0.75, r, protocol, big=0.008, seeds=two)
        for r in between
    ]


def _drag_and_gravity_variant_series(protocol: CompressionProtocol) -> list[Series]:
    return [
        mixture_series(f"{name}, R = {r:g}", 0.6, r, protocol, seeds=(1,), **changes)
        for name, changes in VARIANTS.items()
        for r in VARIANT_RATIOS
    ] + [mixture_series(mixture_series_name(0.6, r), 0.6, r, protocol, seeds=(1,)) for r in (0.25, 0.75)]


def _wall_law_series() -> list[Series]:
    return [equal_grain_series(name, 368, QUICK, **changes) for name, changes in WALLS.items()]


def _list_radius_series() -> list[Series]:
    return [
        equal_grain_series(
            f"list of radius {radius:g} D",
            368,
            QUICK,
            pairs__method="verlet-list",
            pairs__cut_off=f"{radius} D",
        )
        for radius in RADII
    ] + [equal_grain_series(f"cut-off {n}", n, QUICK, pairs__method="cut-off") for n in (368, 736)]


def _smaller_step_series() -> list[Series]:
    return [
        equal_grain_series("direct 368, a third of the step", 368, QUICK, step="auto/2"),
        mixture_series("mixture a = 0.6, R = 0.5, a third of the step", 0.6, 0.5, QUICK, step="auto/2"),
    ]


def _source_step_and_friction_settings(count: int) -> dict[str, Any]:
    """Return step and friction of a bed of equal grains, as in the thesis."""
    period = compression_duration(count, PUBLISHED.speed)
    return {"step": 1e-6 * period, "effects__friction": regularised_friction_settings(period)}


def _source_friction_series(sizes: Sequence[int], seeds: Sequence[int] = (1, 2, 3)) -> list[Series]:
    """Return beds with de Paula's friction at its step, with the thesis's protocol."""
    return [
        equal_grain_series(
            f"direct {n}, source's friction",
            n,
            PUBLISHED,
            seeds=seeds,
            **_source_step_and_friction_settings(n),
        )
        for n in sizes
    ]


def _hysteresis_cause_series(sizes: Sequence[int]) -> list[Series]:
    """Return beds with one change each, and with all changes."""
    made = []
    for n in sizes:
        name, two = f"direct {n}", (1, 2)
        own = _source_step_and_friction_settings(n)
        wide: dict[str, Any] = {"cell__width": f"{60.0 * WIDER * (n / 368) ** 0.5!r} D"}
        made += [
            equal_grain_series(f"{name}, wider cell", n, QUICK, seeds=two, **wide),
            equal_grain_series(
                f"{name}, half the friction",
                n,
                QUICK,
                seeds=two,
                effects__friction={"static": 0.3, "dynamic": 0.225},
            ),
            equal_grain_series(f"{name}, source's friction", n, QUICK, seeds=two if n < 736 else (1,), **own),
            equal_grain_series(
                f"{name}, all together",
                n,
                QUICK,
                seeds=two if n < 736 else (1,),
                **own,
                **wide,
                **grid_height_changes(n, LOOSE),
            ),
        ]
    return [*made, _rounded_cell_series_of_184_grains()] if 184 in sizes else made


def _loose_start_series(protocol: CompressionProtocol, sizes: Sequence[int] = SIZES) -> list[Series]:
    return [
        equal_grain_series(f"direct {n}, loose start", n, protocol, **grid_height_changes(n, LOOSE))
        for n in sizes
    ]


def _rounded_cell_series_of_184_grains() -> Series:
    """Return 184 grains in a cell whose scale, sqrt(1/2), is rounded to 0.70."""
    scale, height = 0.7, 75.0
    start, end = scale * height * 0.006, scale * 20.0 * 0.006
    return equal_grain_series(
        "direct 184, scale 0.70",
        184,
        QUICK,
        cell__width="42 D",
        piston__height=1.2 * start,
        arrangement__height=start,
        protocol__relax__to=start,
        protocol__compress__to=end,
        protocol__expand__to=start,
    )


def _mixture_cause_series() -> list[Series]:
    """Return mixtures with de Paula's friction at its step, the wide cell, both, and a misprint as printed.

    The step is 1e-6 T of the thesis's compression.
    """
    friction: dict[str, Any] = {
        "step": 1e-6 * MIXTURE_PERIOD,
        "effects__friction": regularised_friction_settings(MIXTURE_PERIOD, 0.005),
    }
    wide: dict[str, Any] = {"cell__width": WIDE_CELL}
    beds = [(0.6, 0.0), *((a, 0.5) for a in ASPECTS), (0.6, 1.0)]
    made = [
        mixture_series(f"{words}, {mixture_series_name(a, r)}", a, r, QUICK, seeds=(1, 2), **changes)
        for words, changes in (
            ("source's friction", friction),
            ("wide cell", wide),
            ("both", friction | wide),
        )
        for a, r in beds
    ]
    rough = {"static": 0.6 * MISPRINT, "dynamic": 0.45 * MISPRINT}
    return made + [
        mixture_series(f"misprinted angle, a = {a:g}", a, 0.5, QUICK, effects__friction=rough)
        for a in ASPECTS
    ]


def _mixing_rule_series() -> list[Series]:
    return [
        mixture_series(f"every k-th, a = 0.6, R = {r:g}", 0.6, r, QUICK, mixing="every-kth", seeds=(1, 2))
        for r in OWN_RATIOS
    ]


def _pressed_mixture_series() -> list[Series]:
    """Return mixtures pressed up to the experiment's force, with equal and with scattered moments."""
    return [
        pressed_mixture_series(f"pressed, R = {r:g}" + (f", moments ± {s:g}" if s else ""), 0.6, r, s)
        for r in (0.0, 0.1, 0.5, 0.9, 1.0)
        for s in SPREADS
    ]


def _damper_series() -> list[Series]:
    packaged = [damper_fall_series(damper_series_name(mass), mass) for mass in MASSES]
    scan = [
        damper_fall_series(damper_series_name(MASSES[1], g), MASSES[1], drag=g, seeds=(1, 2))
        for g in GAMMAS[1:]
    ]
    adjacent = [
        damper_fall_series(damper_series_name(m, SOURCE_DRAG), m, drag=SOURCE_DRAG, seeds=(1, 2))
        for m in NEAR_MASSES
    ]
    return [*packaged, *scan, *adjacent]
