"""Label the cells of tables by their columns, so that a narrow page can show each row as a list."""

from __future__ import annotations

import html
import re
from typing import Any

TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
HEADING = re.compile(r"<th[ >].*?</th>", re.DOTALL)
ROW = re.compile(r"<tr[ >].*?</tr>", re.DOTALL)
TAG = re.compile(r"<[^>]+>")


def on_page_content(content: str, **_: Any) -> str:
    """Give each cell the heading of its column as an attribute."""
    return TABLE.sub(lambda table: label_cells(table[0]), content)


def label_cells(table: str) -> str:
    """Return the table with labelled cells."""
    head, end, body = table.partition("</thead>")
    if not end:
        return table
    labels = [html.escape(html.unescape(TAG.sub("", heading).strip())) for heading in HEADING.findall(head)]
    return f"{head}{end}{ROW.sub(lambda row: label_row(row[0], labels), body)}"


def label_row(row: str, labels: list[str]) -> str:
    """Return the row with labelled cells."""
    columns = iter(labels)
    return re.sub("<td", lambda _: f'<td data-label="{next(columns, "")}"', row)
