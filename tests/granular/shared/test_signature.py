"""Options of a command from the signature of its function."""

import argparse
import dataclasses
from typing import Annotated, Any, ClassVar, Literal

import pytest

from granular.commands.console import Parser, Program, command, command_registry
from granular.commands.signature import Option, Seconds, add_options, arguments_of
from granular.shared.errors import InputError


@dataclasses.dataclass(frozen=True)
class Group:
    """A group of options."""

    title: ClassVar[str] = "options of a group"
    loud: Annotated[bool, Option("print all")] = False
    names: Annotated[tuple[str, ...], Option("name (repeatable)", "NAME", name="--name")] = ()


def carry_out(
    scene: Annotated[str, Option("a scene", "SCENE")],
    files: Annotated[tuple[str, ...], Option("files", "FILE")] = (),
    *,
    out: Annotated[str, Option("directory", "DIR", "-o")],
    t_end: Annotated[Seconds | None, Option("end", "T")] = None,
    times: Annotated[tuple[Seconds, ...], Option("times", "T", name="--time")] = (),
    count: Annotated[int, Option("how many")] = 3,
    reach: Annotated[float | None, Option("reach", "A")] = None,
    kind: Annotated[Literal["a", "b"], Option("kind")] = "a",
    drift: Annotated[bool | None, Option("drift or not")] = None,
    warm: Annotated[tuple[str, ...] | None, Option("scenes", nargs="*")] = None,
    group: Group,
) -> None:
    """Carry out."""


def parsed(*words: str) -> dict[str, Any]:
    parser = Parser(prog="p")
    add_options(parser, carry_out)
    return arguments_of(carry_out, parser.parse_args(words))


def test_defaults_are_those_of_the_function() -> None:
    found = parsed("bed", "-o", "here")
    assert found == {
        "scene": "bed",
        "files": (),
        "out": "here",
        "t_end": None,
        "times": (),
        "count": 3,
        "reach": None,
        "kind": "a",
        "drift": None,
        "warm": None,
        "group": Group(),
    }


def test_texts_are_read_by_their_types() -> None:
    words = (
        "bed a.csv b.csv --out o --t-end 500ms --time 1ms --time 2s --count 5 --reach 0.5 --kind b --no-drift"
    )
    found = parsed(*words.split(), "--warm", "--loud", "--name", "x", "--name", "y")
    assert found["files"] == ("a.csv", "b.csv")
    assert found["t_end"] == 0.5
    assert found["times"] == (0.001, 2.0)
    assert found["reach"] == 0.5
    assert (found["count"], found["kind"], found["drift"], found["warm"]) == (5, "b", False, ())
    assert found["group"] == Group(True, ("x", "y"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("bed", "required: -o/--out"),
        ("bed -o o --t-end 5kg", "argument --t-end: .*kg"),
        ("bed -o o --count x", "argument --count: invalid int"),
        ("bed -o o --kind c", "argument --kind: invalid choice"),
    ],
)
def test_wrong_words_are_one_line_that_names_the_option(words: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parsed(*words.split())


def test_help_holds_the_words_of_the_signature() -> None:
    program = Program("p", "d", "e", command_registry("", {"carry-out": command("x")(carry_out)}))
    parser = program.parser().parsers["carry-out"]
    text = " ".join(parser.format_help().split())
    assert "options of a group: --loud print all --name NAME name (repeatable)" in text
    assert "-o DIR, --out DIR directory" in text or "-o, --out DIR directory" in text
    assert program.parser().commands == {"carry-out": "carry out"}
    assert isinstance(parser, argparse.ArgumentParser)
