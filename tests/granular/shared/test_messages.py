"""Print-outs and messages: user values on one short line, and results as text, for a terminal and as
LaTeX.
"""

import io
import re
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from granular import PistonRecord, load_scene
from granular.commands.console import BAD_INPUT, print_result, run_command_and_return_exit_code
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
from granular.shared.errors import (
    LONGEST,
    MOST,
    GranularError,
    InputError,
    RunError,
    format_factor,
    one_line,
    printable,
    quote,
    sanitize,
)
from granular.shared.html_pages import Page, ResultShownAsBlocks
from granular.shared.plotting import READABLE, figure, figure_label, label_log_axis_plainly, line_style

STEERING = "\x1b[2J\x1b]0;title\x07\r\n\x00\u202e\u2028\x9b31m\ud800"
LARGE = (
    "x" * 10**6,
    ["y" * 10**6] * 10**4,
    {k: k for k in range(10**5)},
    10**5000,
    10**400,
    -(10**999),
    b"\x00" * 10**6,
    np.zeros(10**6),
    STEERING,
    [STEERING],
    {STEERING: STEERING},
    (((((1,),),),),),
)


@pytest.mark.parametrize("value", LARGE, ids=[type(one).__name__ for one in LARGE])
def test_user_values_quoted_in_messages_fit_on_a_short_line(value: object) -> None:
    text = quote(value)
    assert text.isprintable()
    assert 0 < len(text) <= LONGEST


def test_a_no_break_space_between_a_number_and_its_uncertainty_mark_is_kept() -> None:
    assert printable("3.326\xa0(!)") == "3.326\xa0(!)"


def test_factors_are_formatted_without_powers_of_ten() -> None:
    said = {3.14159: "3.1", 29.7: "30", 12345.0: "12,000", 9.9e5: "990,000", 0.0: "0"}
    for value, words in said.items():
        assert format_factor(value) == words
    assert (format_factor(16.72, 3), format_factor(123.4, 3), format_factor(12345.0, 3)) == (
        "16.7",
        "123",
        "12,300",
    )
    for value in (4.2e12, 1e6, 1e306, float("inf"), float("nan")):
        assert format_factor(value) == format_factor(value, 3) == "more than a million"


def test_short_values_are_quoted_as_python_writes_them() -> None:
    for value in ("", "a b", "it's", 3, -2.5, None, True, [1, 2], {"a": 1}, "größe λ"):
        assert quote(value) == repr(value)
    assert quote("a\x1b[31m") == r"'a\x1b[31m'"
    assert sanitize("a\tb" * 100).startswith(r"a\tb")
    assert len(sanitize("ab" * 1000)) == LONGEST


def test_a_shortened_message_keeps_its_remedy() -> None:
    text = one_line(f"the value {'x' * 10**6} is too long;\n  write it shorter")
    assert text.endswith("; write it shorter")
    assert text.startswith("the value xxx")
    assert len(text) < MOST + 100
    assert printable("two\nlines\tand \x1b[1m") == "two\nlines\tand \\x1b[1m"


def test_every_error_message_is_one_line() -> None:
    for error in (
        GranularError(f"a\nb{STEERING}"),
        InputError(f"a\nb{STEERING}"),
        RunError(f"a\nb{STEERING}", step=1, time=2.0, remedy="wait"),
    ):
        assert str(error).isprintable()


def record_of(folder: Path, text: str) -> PistonRecord:
    path = folder / "record.csv"
    path.write_text(text, encoding="utf-8", errors="replace")
    return PistonRecord.from_csv(path)


BAD = {
    "a scene's name": lambda words, _: load_scene(words),
    "a scene's file": lambda words, _: load_scene(f"{words[:50]}.toml"),
    "a key": lambda words, _: load_scene("bed").replace(**{f"grains.{words}": 1}),
    "a part": lambda words, _: load_scene("bed").replace(**{words: 1}),
    "a number": lambda words, _: load_scene("bed").replace(**{"cell.width": words}),
    "a unit": lambda words, _: load_scene("bed").replace(**{"cell.width": f"1 {words}"}),
    "an integer": lambda words, _: load_scene("bed").replace(**{"grains.count": words}),
    "a list": lambda words, _: load_scene("bed").replace(**{"grains.count": [words] * 1000}),
    "a name": lambda words, _: load_scene("bed").replace(name=words),
    "a choice": lambda words, _: load_scene("bed").replace(**{"grains.mixing": words}),
    "a kind": lambda words, _: load_scene("bed").replace(protocol=[{"kind": words}]),
    "a table": lambda words, _: load_scene("bed").replace(grains=words),
    "a column": lambda words, _: PistonRecord([0, 1], [0, 1], extra={words: [1]}),
    "a column's unit": lambda words, folder: record_of(folder, f'time,"height [{words}]"\n0,1\n1,2\n'),
    "a cell": lambda words, folder: record_of(folder, f'time,height\n0,"{words}"\n1,2\n'),
}


@pytest.mark.parametrize("words", ["z" * 10**5, STEERING * 100], ids=["long", "steering"])
@pytest.mark.parametrize("place", BAD)
def test_long_user_values_are_shortened_in_messages(place: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        BAD[place](words, tmp_path)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 1200  # with paths, known words and remedies around quoted values


def test_control_characters_in_user_values_are_not_printed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def command(_: object) -> None:
        warnings.warn(f"look {STEERING}", stacklevel=1)
        print_result({"name": STEERING}, f"result\n{STEERING}\n", as_json=False)
        print_result({"name": STEERING}, "", as_json=True)
        raise InputError(f"bad {STEERING}")

    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert run_command_and_return_exit_code(command, []) == BAD_INPUT
    for stream in capsys.readouterr():
        assert all(sign.isprintable() or sign == "\n" for sign in stream)


def test_long_notes_are_wrapped_to_several_lines(capsys: pytest.CaptureFixture[str]) -> None:
    note, table = "  note: " + "fit with --drift " * 20, "0.123 " * 40
    print_result({}, f"{note}\n{table}", as_json=False)
    *lines, last = capsys.readouterr().out.splitlines()
    assert len(lines) > 1
    assert max(map(len, lines)) <= 100
    assert last == table
    assert " ".join(lines).split() == note.split()


def test_characters_that_a_terminal_lacks_are_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    """An example is a terminal with LANG=C, which has only ASCII characters."""
    buffers = [io.BytesIO(), io.BytesIO()]
    streams = [io.TextIOWrapper(buffer, encoding="ascii") for buffer in buffers]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)

    def command(_: object) -> None:
        print_result({}, "5 µm", as_json=False)
        raise InputError("größe λ")

    assert run_command_and_return_exit_code(command, []) == BAD_INPUT
    wanted = (b"5 \\xb5m\n", b"error: gr\\xf6\\xdfe \\u03bb\n")
    for stream, buffer, words in zip(streams, buffers, wanted, strict=True):
        stream.flush()
        assert buffer.getvalue() == words


def test_html_pages_contain_no_control_characters() -> None:
    texts = [make(STEERING) for make in (Heading, Text, Caution, Printout)]
    tables = [Items([STEERING]), Table([STEERING], [[STEERING], ["<b>"]])]
    text = Page(STEERING, STEERING, [*texts, *tables], STEERING).to_html()
    assert all(sign.isprintable() or sign in "\n\t" for sign in text)
    assert "<b>" not in text
    text.encode("utf-8")


def test_32_lines_of_a_plot_have_different_styles_and_labels_are_escaped_and_shortened() -> None:
    looks = [line_style(place) for place in range(32)]
    assert len({tuple(one.values()) for one in looks}) == 32
    assert figure_label("$\\frac{$") == "\\$\\frac{\\$"
    assert len(figure_label("x" * 1000)) == 60


def test_latex_special_characters_are_escaped() -> None:
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


def test_headings_tables_and_notes_of_a_page_are_printed_as_plain_text() -> None:
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


def test_table_is_wrapped_to_the_terminal_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    stream = Terminal()
    print_blocks([Table(["law", "what it says"], [["[bold]x[/]", "many words " * 8]])], stream)
    lines = [re.sub("\x1b\\[[0-9;]*m", "", line).rstrip() for line in stream.getvalue().splitlines()]
    assert max(map(len, lines)) <= 40
    assert any("[bold]x[/]" in line for line in lines)
    assert sum(line.count("many words") for line in lines) >= 4


def test_a_table_in_a_narrow_terminal_shows_every_digit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    stream = Terminal()
    print_blocks([Table([f"temperature_{k}" for k in range(4)], [["1.124372e-12"] * 4])], stream)
    plain = re.sub("\x1b\\[[0-9;]*m", "", stream.getvalue())
    assert "\u2026" not in plain
    columns = zip(*(line.split() for line in plain.splitlines()[-4:] if line.strip()), strict=True)
    assert all("".join(column).endswith("1.124372e-12") for column in columns)


def test_table_rows_must_have_as_many_cells_as_the_header() -> None:
    with pytest.raises(ValueError, match="too many or too few cells"):
        Table(["a", "b"], [["1"], ["1", "2", "3"]])
    assert str(Table(["", ""], [["a\nb", "c"]])) == "a b  c"


def test_a_result_has_a_text_and_an_html_representation_for_notebooks() -> None:
    class Result(ResultShownAsBlocks):
        def blocks(self) -> list[Block]:
            return [Text("a < b"), Table(["k"], [["1e-06 m"]])]

    assert str(Result()) == "a < b\nk\n1e-06 m"
    assert "<p>a &lt; b</p>" in Result()._repr_html_()
    assert "<td class=number>1e-06 m</td>" in Result()._repr_html_()


@pytest.mark.parametrize(("size", "fits"), [(READABLE, True), (7.0, False)])
def test_the_smallest_font_of_a_picture_on_a_page_has_nine_pixels(size: float, fits: bool) -> None:
    with figure(width=7.2, size=size) as (drawing, axes):
        axes.set_xlabel("time [s]")
    page = Page("report", "", [Picture(lambda: drawing, "a motion")])
    (least,) = map(float, re.findall(r'style="--least:(\d+)px"', page.to_html()))
    assert size * least / (72.0 * 7.2) == pytest.approx(9.0, abs=0.02)
    assert (least <= 358.0) == fits  # a phone's 390 pixels without the page's rims


@pytest.mark.parametrize("values", [(0.1, 3.0, 20.0), (1.2, 1.6, 2.4), (1e-5, 3.0)])
def test_labels_of_a_logarithmic_axis_contain_no_superscripts(values: tuple[float, ...]) -> None:
    with figure() as (drawing, axes):
        axes.plot(values)
        axes.set_yscale("log")
        label_log_axis_plainly(axes.yaxis)
        drawing.draw_without_rendering()
        ticks = [*axes.yaxis.get_major_ticks(), *axes.yaxis.get_minor_ticks()]
        labels = [tick.label1.get_text() for tick in ticks]
    assert any(labels)
    assert all(re.fullmatch(r"[\d.e+\u2212-]*", one) for one in labels), labels
