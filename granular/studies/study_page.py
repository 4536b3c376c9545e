"""HTML page of a study, which shows its results as functions of the varied quantities."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from granular.scene.scene import Scene
from granular.shared.blocks import Block, Heading, Items, Picture, Printout, Table, Text, format_number
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, GREY, READABLE, figure, figure_label, line_style
from granular.studies.sweep import Study
from granular.studies.tolerances import FIGURES, Tolerances, tolerance_table_rows

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAXIMUM_PANELS, MAXIMUM_LINES, MAXIMUM_ROWS = 6, 8, 200
"""Maximum numbers of panels, lines in a panel and rows of the table, to keep the page readable."""
_LAST = ("warning", "error", "key")
_SEED = "arrangement.seed"
"""Key of the random seed; cases that differ only in the seed count as repetitions."""


def study_page(study: Study) -> Page:
    """Make the page of a study: varied quantities, plots of the results against them, and a table in SI."""
    varied = ", ".join(study.varied) or "nothing"
    return Page(
        f"Study of {study.cases[0].scene.name}",
        f"{len(study.table)} cases, varied in {varied}, {_end_time_text(study)}. All values are in SI.",
        tuple(_blocks(study)),
        result=study,
    )


def _blocks(study: Study) -> Iterator[Block]:
    table, varied = study.table, study.varied
    numbers = table.select_dtypes("number")
    values = numbers.nunique()
    figures = [name for name in numbers if name not in (*varied, *_LAST) and values[name] > 1]
    axes = [name for name in varied if name != _SEED and name in numbers]
    axis = max(axes, key=lambda name: values[name], default=None)
    if axis and figures:
        others = [name for name in varied if name not in (axis, _SEED)]
        shown = figures[:MAXIMUM_PANELS]
        left = f" Shown are the first {len(shown)} of {len(figures)}." if len(figures) > len(shown) else ""
        yield Picture(
            partial(_draw_figures, study, table, axis, others, shown),
            f"Results of the cases against {axis}; lines connect the means of repeated cases.{left}",
        )
    if _SEED in varied:
        yield from _packing_mean_blocks(study, figures)
    yield Heading("Cases")
    columns = [name for name in table.columns if name not in _LAST[:2]]
    yield Table(
        ["case", *(_label_with_unit(study, name) for name in columns)],
        [[k, *map(_cell_text, row)] for k, row in enumerate(table[columns].head(MAXIMUM_ROWS).to_numpy(), 1)],
    )
    if len(table) > MAXIMUM_ROWS:
        yield Text(f"The first {MAXIMUM_ROWS} of {len(table)} cases; table.csv has all of them.")
    for name, title in (("error", "Cases that failed"), ("warning", "Cases with warnings")):
        if name in table and table[name].notna().any():
            yield Heading(title)
            yield Items(_texts_with_case_numbers(table[name]))


def _end_time_text(study: Study) -> str:
    ends = dict.fromkeys(case.settings["t_end"] for case in study.cases)
    if list(ends) == [None]:
        return "each run to the end of its stages"
    return f"run until {', '.join('the end' if end is None else f'{end} s' for end in ends)}"


def _packing_mean_blocks(study: Study, figures: list[str]) -> Iterator[Block]:
    """Yield a table of the means of the results over random packings, ± standard deviation."""
    others = [name for name in study.varied if name != _SEED]
    table, groups = study.table, dict[tuple[str, ...], list[int]]()
    for index, row in enumerate(table[others].to_numpy()):
        groups.setdefault(tuple(map(_cell_text, row)), []).append(index)
    rows = [
        [*values, str(len(indices)), *(_mean_text(table[name].iloc[indices].dropna()) for name in figures)]
        for values, indices in list(groups.items())[:MAXIMUM_ROWS]
    ]
    header = [*(_label_with_unit(study, name) for name in (*others, "starts", *figures))]
    yield Heading("Means over random packings")
    yield Table(header, rows)
    yield Text("± is the standard deviation over the random packings whose cases did not fail.")


def _mean_text(column: pandas.Series[Any]) -> str:
    if column.empty:
        return ""
    spread = f" ± {format_number(column.std(), 2)}" if len(column) > 1 else ""
    return f"{_cell_text(column.mean())}{spread}"


def _texts_with_case_numbers(column: pandas.Series[Any]) -> list[str]:
    """List the distinct messages in a column, each preceded by the numbers of the cases that have it."""
    cases: dict[str, list[str]] = {}
    for k, text in enumerate(column, 1):
        if isinstance(text, str):
            cases.setdefault(text, []).append(str(k))
    return [f"{', '.join(numbers)}: {text}" for text, numbers in cases.items()]


def _draw_figures(
    study: Study, table: pandas.DataFrame, axis: str, others: list[str], shown: list[str]
) -> Figure:
    labels = [
        ", ".join(f"{name} = {_cell_text(value)}" for name, value in zip(others, row, strict=True))
        for row in table[others].to_numpy()
    ]
    groups = list(table.groupby(labels, sort=False))
    lines = len(groups) <= MAXIMUM_LINES
    rows = (len(shown) + 1) // 2
    with figure(rows, 2, height=2.8 * rows, squeeze=False) as (drawing, panels):
        for panel, name in zip(panels.flat, shown, strict=False):
            for index, (label, group) in enumerate(groups):
                _draw_line(panel, group[[axis, name]].dropna(), index if lines else 0, label, lines)
            panel.set(
                xlabel=figure_label(_label_with_unit(study, axis)),
                ylabel=figure_label(_label_with_unit(study, name)),
            )
        for panel in panels.flat[len(shown) :]:
            panel.axis("off")
        if len(groups) > 1 and lines:
            drawing.legend(*panels.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return drawing


def _draw_line(panel: Axes, points: pandas.DataFrame, index: int, label: str, lines: bool) -> None:
    axis, name = points.columns
    style = line_style(index)
    panel.plot(points[axis], points[name], "o", markersize=3.5, color=style["color"])
    if lines:
        mean = points.groupby(axis)[name].mean()
        panel.plot(mean.index, mean.to_numpy(), linewidth=1.2, label=figure_label(label), **style)


def _label_with_unit(study: Study, name: str) -> str:
    unit = study.units.get(name)
    return name if unit is None else f"{name} [{unit}]"


def _cell_text(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else format_number(value)
    return "" if value is None else str(value)


def tolerances_page(result: Tolerances, scene: Scene) -> Page:
    """Make the HTML page of the tolerances of a damper."""
    blocks = [*tolerance_blocks(result), Heading("Scene"), Printout(scene.to_toml())]
    return Page(f"Tolerances of scene {scene.name!r}", f"{len(result.parts)} parts.", blocks, result=result)


def tolerance_blocks(result: Tolerances) -> Iterator[Block]:
    """Yield bar charts, table and notes of the tolerances of a damper."""
    yield Heading("Tolerances of the parts")
    yield Text(
        f"Small motions: {result.means}; {result.summary}. About 95 % of dampers built from such parts lie "
        "within twice these deviations. In other sections, ± has the same meaning in lines that begin with "
        "'of the parts'. Elsewhere ± is the uncertainty due to fit, time step and random packing of the bed "
        "(real dampers also differ in packing)."
    )
    yield Picture(
        partial(_draw_tolerance_bars, result),
        "Relative standard deviations due to each part alone and to all parts together."
        + " Grey: spread over random packings, which is not due to the parts." * (len(result.figures) > 1),
    )
    moved_by = dict(zip((part.key for part in result.parts), result.contributions, strict=True))
    largest = (
        f"of {name} {', '.join(f'{key} ± {100.0 * moved_by[key][k]:.2g} %' for key in keys)}"
        for k, (name, keys) in enumerate(result.largest().items())
        if keys
    )
    yield Text(
        f"Largest causes: {'; '.join(largest) or 'none'}. Each is one standard deviation, in % of the "
        "result; for the damping ratio zeta in % of zeta, not of critical damping."
    )
    header, *rows = tolerance_table_rows(result)
    yield Table(header, rows)
    yield from map(Text, result.notes)


def _draw_tolerance_bars(result: Tolerances) -> Figure:
    labels, *_, rest, frequency, damping = zip(*tolerance_table_rows(result)[1:], strict=True)
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
