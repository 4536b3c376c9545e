"""The page of a damper's tolerances: bars of all parts, and the table."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from granular.scene.scene import Scene
from granular.shared.blocks import Block, Heading, Picture, Printout, Table, Text
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, GREY, READABLE, figure
from granular.studies.tolerances import FIGURES, Tolerances, table_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def tolerances_page(result: Tolerances, scene: Scene) -> Page:
    """Page of a damper's tolerances."""
    blocks = [*tolerance_blocks(result), Heading("Scene"), Printout(scene.to_toml())]
    return Page(f"Tolerances of scene {scene.name!r}", f"{len(result.parts)} parts.", blocks, result=result)


def tolerance_blocks(result: Tolerances) -> Iterator[Block]:
    """Bars, table and notes of a damper's tolerances."""
    yield Heading("Tolerances of the parts")
    yield Text(
        f"Small motions: {result.means}; {result.summary}. Of dampers built of such parts, about 95 % lie "
        "within twice that. Except in a line 'of the parts', any ± outside of this section is numerical: of "
        "fit, step, and the random packing of the bed, by which built dampers differ too."
    )
    yield Picture(
        partial(_draw_bars, result),
        "Relative standard deviations by each part alone and by all together."
        + " Grey: random starts of the bed, which are not of the parts." * (len(result.figures) > 1),
    )
    moved_by = dict(zip((part.key for part in result.parts), result.contributions, strict=True))
    largest = (
        f"of {name} {', '.join(f'{key} ± {100.0 * moved_by[key][k]:.2g} %' for key in keys)}"
        for k, (name, keys) in enumerate(result.largest().items())
        if keys
    )
    yield Text(
        f"Largest causes: {'; '.join(largest) or 'none'}. Each is one standard deviation, in % of "
        "the figure itself: that of zeta is in % of zeta, not of critical."
    )
    header, *rows = table_rows(result)
    yield Table(header, rows)
    yield from map(Text, result.notes)


def _draw_bars(result: Tolerances) -> Figure:
    labels, *_, rest, frequency, damping = zip(*table_rows(result)[1:], strict=True)
    colours = [COLOURS[0]] * len(result.parts) + [COLOURS[1]] * 2
    if len(result.figures) > 1:
        colours[len(labels) - 1 :] = [GREY]
    with figure(1, 3, height=1.2 + 0.32 * len(labels), size=READABLE, sharey=True) as (drawing, panels):
        for axes, title, column in zip(panels, FIGURES, (rest, frequency, damping), strict=True):
            axes.barh(range(len(labels)), [float(text) for text in column], color=colours[: len(labels)])
            axes.set(title=title, xlabel="± %")
        panels[0].set_yticks(range(len(labels)), labels)
        panels[0].invert_yaxis()
        return drawing
