"""Blocks as text, for a terminal and as LaTeX, and figures whose letters a phone shows."""

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
from granular.shared.html_pages import Page, Shown
from granular.shared.plotting import READABLE, figure, label_log_axis_plainly


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


@pytest.mark.parametrize(("size", "fits"), [(READABLE, True), (7.0, False)])
def test_the_smallest_letters_are_nine_pixels(size: float, fits: bool) -> None:
    with figure(width=7.2, size=size) as (drawing, axes):
        axes.set_xlabel("time [s]")
    page = Page("report", "", [Picture(lambda: drawing, "a motion")])
    (least,) = map(float, re.findall(r'style="--least:(\d+)px"', page.to_html()))
    assert size * least / (72.0 * 7.2) == pytest.approx(9.0, abs=0.02)
    assert (least <= 358.0) == fits  # a phone's 390 pixels without the page's rims


@pytest.mark.parametrize("values", [(0.1, 3.0, 20.0), (1.2, 1.6, 2.4), (1e-5, 3.0)])
def test_a_logarithmic_axis_has_no_small_exponents(values: tuple[float, ...]) -> None:
    with figure() as (drawing, axes):
        axes.plot(values)
        axes.set_yscale("log")
        label_log_axis_plainly(axes.yaxis)
        drawing.draw_without_rendering()
        ticks = [*axes.yaxis.get_major_ticks(), *axes.yaxis.get_minor_ticks()]
        labels = [tick.label1.get_text() for tick in ticks]
    assert any(labels)
    assert all(re.fullmatch(r"[\d.e+\u2212-]*", one) for one in labels), labels
