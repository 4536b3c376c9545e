"""The part of a report that tells of whole falls."""

from __future__ import annotations

import numpy as np

from granular.shared.html import Page
from granular.shared.plotting import GREY, READABLE, figure, line_look, plain_label
from reduced_models.falls.data import Falls
from reduced_models.identification.page_equation import add_equations
from reduced_models.identification.page_record import thinned

_MOST_LINES = 3  # of laws over a fall; more hide each other


def add_falls(page: Page, falls: Falls) -> None:
    """The law of the fall, what it says of falls that it has not seen, and the others beside it."""
    page.section("The whole fall")
    best = falls.best.model
    if best is not None:
        add_equations(page, best)
    page.table(falls.header, falls.cells())
    page.text(
        "Each law was fitted to the scene's own fall, and predicts the others from the height that "
        "the piston is let go at, without anything else of them. Errors are root mean squares over "
        "the height of the drop. How far a bed from another random start falls otherwise is what "
        "no law can tell."
    )
    _drawn(page, falls)
    with figure(height=4.4, size=READABLE) as (drawing, axes):
        falls.plot(axes)
        page.figure(drawing, "Errors of the laws over the height that the piston fell from.")


def _drawn(page: Page, falls: Falls) -> None:
    """The fall from farthest away, and what the best laws predict of it."""
    far = max(falls.unseen, key=lambda one: float(one.height[0]))
    time = far.time - far.time[0]
    with figure(height=4.4, size=READABLE) as (drawing, axes):
        axes.plot(*thinned(time, 1e3 * far.height), color=GREY, linewidth=3.0, label="simulated")
        sound = [row for row in falls.rows if row.model is not None and np.isfinite(row.median)]
        for k, row in enumerate(sound[:_MOST_LINES]):
            assert row.model is not None
            motion = row.model.simulate(far.time, z0=float(far.height[0]), v0=0.0)
            axes.plot(
                *thinned(time, 1e3 * motion.height), linewidth=1.2, label=plain_label(row.name),
                **line_look(k),
            )  # fmt: skip
        axes.set_xlabel("time [s]")
        axes.set_ylabel("height [mm]")
        axes.legend(loc="upper right")
        page.figure(drawing, "A fall from farther up, and what the best laws predict of it.")
