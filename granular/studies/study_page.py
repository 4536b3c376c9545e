"""The page of a study: its figures over what is varied, as pictures and as a table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from granular.shared.blocks import format_number
from granular.shared.html_pages import HtmlPage
from granular.shared.plotting import figure, figure_label, line_style
from granular.shared.version import versions
from granular.studies.sweep import Study

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PANELS, MOST_LINES, MOST_ROWS = 6, 8, 200
"""Figures that are drawn, lines in a panel, and rows of the table: a page is read by people."""
_LAST = ("warning", "error", "key")
_SEED = "arrangement.seed"
"""Random starts are repetitions, not an axis."""


def study_page(study: Study) -> HtmlPage:
    """Page of a study: what is varied, its figures over that, and the table [SI]."""
    table, varied = study.table, study.varied
    numbers = table.select_dtypes("number")
    values = numbers.nunique()
    figures = [name for name in numbers if name not in (*varied, *_LAST) and values[name] > 1]
    page = HtmlPage(
        f"Study of {study.cases[0].scene.name}",
        f"{len(table)} cases, varied in {', '.join(varied) or 'nothing'}. All values are in SI.",
    )
    axes = [name for name in varied if name != _SEED and name in numbers]
    axis = max(axes, key=lambda name: values[name], default=None)
    if axis and figures:
        others = [name for name in varied if name not in (axis, _SEED)]
        shown = figures[:MOST_PANELS]
        left = f" The first {len(shown)} of {len(figures)}." if len(figures) > len(shown) else ""
        page.add_figure(
            _draw_figures(study, table, axis, others, shown),
            f"Figures of the cases over {axis}, lines through the means of repeated cases.{left}",
        )
    page.add_section("Cases")
    columns = [name for name in table.columns if name not in _LAST]
    page.add_table(
        ["case", *(_label_with_unit(study, name) for name in columns)],
        [[k, *map(_cell_text, row)] for k, row in enumerate(table[columns].head(MOST_ROWS).to_numpy(), 1)],
    )
    if len(table) > MOST_ROWS:
        page.add_paragraph(f"The first {MOST_ROWS} of {len(table)} cases; table.csv has all of them.")
    for name, title in (("error", "Cases that failed"), ("warning", "Cases in doubt")):
        if name in table and table[name].notna().any():
            page.add_section(title)
            page.add_list(_texts_with_case_numbers(table[name]))
    page.add_footer("Made with " + ", ".join(f"{name} {value}" for name, value in versions().items()))
    return page


def _texts_with_case_numbers(column: pandas.Series[Any]) -> list[str]:
    """Texts with the numbers of their cases, each once."""
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
    lines = len(groups) <= MOST_LINES
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
    look = line_style(index)
    panel.plot(points[axis], points[name], "o", markersize=3.5, color=look["color"])
    if lines:
        mean = points.groupby(axis)[name].mean()
        panel.plot(mean.index, mean.to_numpy(), linewidth=1.2, label=figure_label(label), **look)


def _label_with_unit(study: Study, name: str) -> str:
    unit = study.units.get(name)
    return name if unit is None else f"{name} [{unit}]"


def _cell_text(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else format_number(value)
    return "" if value is None else str(value)
