"""What stands in a file: columns of numbers with their names and units."""

from __future__ import annotations

import dataclasses

import numpy as np


@dataclasses.dataclass(eq=False)
class Column:
    """A column of a sheet.

    Attributes
    ----------
    name : str
        As in the file; empty where it has none.
    unit : str or None
        As in the file.
    values : float64 (n,) or None
        NaN where a sample is lost; None where it holds something else than numbers.
    wrong : tuple of int and str, or None
        The first row, from 0, that holds something else, and what; for the message.
    clock : str
        What was read as seconds: ``"date"`` or ``"clock"``; empty for numbers.
    channel : bool
        Whether its name is that of an instrument's input and says nothing of what was measured.
    """

    name: str
    unit: str | None
    values: np.ndarray | None
    wrong: tuple[int, str] | None = None
    clock: str = ""
    channel: bool = False


@dataclasses.dataclass(eq=False)
class Sheet:
    """A table of a file.

    Attributes
    ----------
    columns : list of Column
    lines : int64 (n,) or None
        Line of the file that each row stands in; None where a file has no lines.
    header : bool
        Whether the file names its columns.
    form : str
        What the file is, in words.
    notes : list of str
        What was done to it.
    """

    columns: list[Column]
    lines: np.ndarray | None
    header: bool
    form: str
    notes: list[str] = dataclasses.field(default_factory=list)

    def place(self, row: int) -> str:
        """A row in words."""
        if self.lines is None:
            return f"sample {row}"
        return f"sample {row} (line {int(self.lines[row])})"
