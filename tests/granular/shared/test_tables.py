"""Blocks as text, for a terminal and as LaTeX."""

import io
import re

import pytest

from granular.shared.blocks import (
    Block,
    Caution,
    Equation,
    Heading,
    Items,
    Picture,
    Printout,
    Table,
    Text,
    blocks_text,
    latex_array,
    print_blocks,
)
from granular.shared.html_pages import Shown


def test_signs_of_latex_are_letters() -> None:
    found = latex_array(Table(["law", "C:\\"], [["a_1 & 50 %", "{x}^2"]]))
    assert r"\text{a\_1 \& 50 \%} & \text{\{x\}\^{}2} \\" in found
    assert r"\text{law} & \text{C:\textbackslash{}} \\ \hline" in found
    assert found.startswith("$$\\begin{array}{ll}\n")


BLOCKS = [
    Heading("Errors"),
    Text("Two laws."),
    Caution("few cycles"),
    Items(["one", "two"]),
    Table(["law", "error [%]"], [["linear", 12.5], ["duffing", "3"]]),
    Printout("a = 1\nb = 2"),
    Equation("<math></math>", "z'' = 0"),
    Heading("Nothing but a picture"),
    Picture(lambda: pytest.fail("a terminal draws nothing"), "a curve"),
]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_blocks_as_plain_text() -> None:
    stream = io.StringIO()
    print_blocks(BLOCKS, stream)
    lines = stream.getvalue().splitlines()
    assert lines == blocks_text(BLOCKS).splitlines()
    assert lines[1:] == [
        "Errors",
        "Two laws.",
        "caution: few cycles",
        "  one",
        "  two",
        "law      error [%]",
        "linear   12.5",
        "duffing  3",
        "a = 1",
        "b = 2",
        "z'' = 0",
    ]


def test_a_table_is_broken_to_the_width_of_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    stream = Terminal()
    print_blocks([Table(["law", "what it says"], [["[bold]x[/]", "many words " * 8]])], stream)
    lines = [re.sub("\x1b\\[[0-9;]*m", "", line).rstrip() for line in stream.getvalue().splitlines()]
    assert max(map(len, lines)) <= 40
    assert any("[bold]x[/]" in line for line in lines)
    assert sum(line.count("many words") for line in lines) >= 4


def test_a_narrow_terminal_shows_every_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    stream = Terminal()
    print_blocks([Table([f"temperature_{k}" for k in range(4)], [["1.124372e-12"] * 4])], stream)
    plain = re.sub("\x1b\\[[0-9;]*m", "", stream.getvalue())
    assert "\u2026" not in plain
    columns = zip(*(line.split() for line in plain.splitlines()[-4:] if line.strip()), strict=True)
    assert all("".join(column).endswith("1.124372e-12") for column in columns)


def test_rows_are_as_wide_as_their_header() -> None:
    with pytest.raises(ValueError, match="other widths"):
        Table(["a", "b"], [["1"], ["1", "2", "3"]])
    assert str(Table(["", ""], [["a\nb", "c"]])) == "a b  c"


def test_a_notebook_shows_a_result_as_text_and_html() -> None:
    class Result(Shown):
        def blocks(self) -> list[Block]:
            return [Text("a < b"), Table(["k"], [["1e-06 m"]])]

    assert str(Result()) == "a < b\nk\n1e-06 m"
    assert "<p>a &lt; b</p>" in Result()._repr_html_()
    assert "<td class=number>1e-06 m</td>" in Result()._repr_html_()
