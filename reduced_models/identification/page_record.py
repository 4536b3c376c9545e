"""Pictures of a report: the record and its best law, all fits, phase portrait, another lift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.html import Page, number
from granular.shared.plotting import GREY, READABLE, figure, line_look, plain_label
from reduced_models.identification.data import IdentificationData
from reduced_models.models.roll_out import RollOut

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_POINTS = 3000  # of a line; more cannot be seen
_MOST_LINES = 4  # of laws over a lift; more hide each other


class _Shown(NamedTuple):
    """How a coordinate is drawn: its name, unit, and what to multiply it by."""

    name: str
    unit: str
    scale: float
    fine_unit: str
    fine_scale: float


def _shown(record: PistonRecord) -> _Shown:
    if record.angle:
        return _Shown("angle", "°", 180.0 / math.pi, "°", 180.0 / math.pi)
    return _Shown("height", "mm", 1e3, "µm", 1e6)


def thinned(*columns: np.ndarray) -> list[np.ndarray]:
    """Columns with as many of their samples as can be seen."""
    every = max(1, len(columns[0]) // _MOST_POINTS)
    return [column[::every] for column in columns]


def add_record(page: Page, found: IdentificationData) -> None:
    """The record, and the best law over it."""
    page.section("The record")
    record, shown = found.record, _shown(found.record)
    time = record.time - record.time[0]
    motion = found.best.follow(record)
    with figure(2, 1, height=6.0, size=READABLE, sharex=True, height_ratios=(2, 1)) as (
        drawing, (top, bottom),
    ):  # fmt: skip
        t, height, fitted, left = thinned(
            time, shown.scale * record.height, shown.scale * motion.height,
            shown.fine_scale * (record.height - motion.height),
        )  # fmt: skip
        top.plot(t, height, color=GREY, linewidth=3.0, label="record")
        top.plot(t, fitted, linewidth=1.2, label=plain_label(found.best.law.name))
        bottom.plot(t, left, linewidth=1.0)
        _shade(found, (top, bottom), time)
        top.set_ylabel(f"{shown.name} [{shown.unit}]")
        top.legend(loc="upper right")
        bottom.set_ylabel(f"left over [{shown.fine_unit}]")
        bottom.set_xlabel("time [s]")
        page.figure(
            drawing,
            "The record, the best law over it, and what it leaves over. The shaded stretch is held "
            "out: the laws are judged on it by fits that have not seen it.",
        )


def _shade(found: IdentificationData, places: Sequence[Axes], time: np.ndarray) -> None:
    start = found.best.quality.holdout_from
    if start is not None:
        for axes in places:
            axes.axvspan(start, time[-1], color=GREY, alpha=0.15, linewidth=0.0)


def add_fits(page: Page, found: IdentificationData) -> None:
    """All fits over the record, and what they leave over."""
    page.section("The record and the fits")
    record, shown = found.record, _shown(found.record)
    time = record.time - record.time[0]
    lines = len(found.models)
    with figure(
        2, 1, height=6.0 + 0.15 * lines, size=READABLE, sharex=True, height_ratios=(2, 1)
    ) as (drawing, (top, bottom)):
        t, height = thinned(time, shown.scale * record.height)
        top.plot(t, height, color=GREY, linewidth=3.0, label="record")
        for k, model in enumerate(found.models):
            motion = model.follow(record)
            t, height, residual = thinned(
                time,
                shown.scale * motion.height,
                shown.fine_scale * (record.height - motion.height),
            )
            style = {"linewidth": 1.2, **line_look(k)}
            top.plot(t, height, label=plain_label(model.law.name), **style)
            bottom.plot(t, residual, **style)
        _shade(found, (top, bottom), time)
        top.set_ylabel(f"{shown.name} [{shown.unit}]")
        bottom.set_ylabel(f"left over [{shown.fine_unit}]")
        bottom.set_xlabel("time [s]")
        drawing.legend(loc="outside upper left", ncols=2)
        page.figure(drawing, "The fits of all laws, and what they leave over.")


def add_portrait(page: Page, found: IdentificationData) -> None:
    """Velocity over height."""
    record, shown = found.record, _shown(found.record)
    with figure(height=4.8, size=READABLE) as (drawing, axes):
        speed = record.velocity
        if speed is None:
            speed = np.gradient(record.height, record.time)
        axes.plot(
            *thinned(shown.scale * record.height, shown.scale * speed),
            color=GREY, linewidth=3, label="record",
        )  # fmt: skip
        motion = found.best.follow(record)
        assert motion.velocity is not None
        axes.plot(
            *thinned(shown.scale * motion.height, shown.scale * motion.velocity),
            linewidth=1.0, label=plain_label(found.best.law.name),
        )  # fmt: skip
        axes.set_xlabel(f"{shown.name} [{shown.unit}]")
        axes.set_ylabel(f"velocity [{shown.unit}/s]")
        axes.legend(loc="upper right")
        page.figure(drawing, "Phase portrait, with the best law.")


def add_lift(page: Page, found: IdentificationData) -> None:
    """A lift that no law has seen, and what the laws predict of it."""
    lift = found.lift
    assert lift is not None
    judged: list[tuple[str, RollOut]] = sorted(
        ((row.name, row.records[-1]) for row in found.comparison.rows if row.records),
        key=lambda pair: pair[1].relative,
    )
    best = judged[0][1].relative
    page.section("A lift that no law has seen")
    page.text(
        "The same scene with a lift three times as high. Each law starts from height and velocity "
        "that the first period tells; all the rest is its prediction."
    )
    page.table(
        ("law", "error [% of the rms swing]", "times the best"),
        [
            (name, number(100.0 * one.relative, 3), number(one.relative / max(best, 1e-300), 3))
            if math.isfinite(one.relative) else (name, "diverges", "")
            for name, one in judged
        ],
    )  # fmt: skip
    shown = _shown(lift)
    with figure(2, 1, height=6.2, size=READABLE, sharex=True, height_ratios=(2, 1)) as (
        drawing, (top, bottom),
    ):  # fmt: skip
        time = lift.time - lift.time[0]
        t, height = thinned(time, shown.scale * lift.height)
        top.plot(t, height, color=GREY, linewidth=3.0, label="simulated")
        for k, (name, one) in enumerate(judged[:_MOST_LINES]):
            count = len(one.motion)
            t, height, left = thinned(
                time[:count], shown.scale * one.motion.height,
                shown.scale * (lift.height[:count] - one.motion.height),
            )  # fmt: skip
            style = {"linewidth": 1.2, **line_look(k)}
            top.plot(t, height, label=plain_label(name), **style)
            bottom.plot(t, left, **style)
        top.set_ylabel(f"{shown.name} [{shown.unit}]")
        bottom.set_ylabel(f"missed [{shown.unit}]")
        bottom.set_xlabel("time [s]")
        drawing.legend(loc="outside upper left", ncols=2)
        page.figure(drawing, "The other lift, and what the best laws predict of it.")
