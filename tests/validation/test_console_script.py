"""The command granular-damper: the commands of three packages under one name."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import granular.__main__
import reduced_models.__main__
import validation.__main__
from granular import __version__
from granular.commands.console import run_command_and_return_exit_code
from granular.shared.errors import InputError
from validation.console_script import dispatch_command

ROOT = Path(__file__).parents[2]
OWN = """
from granular import effect, quantity

@effect
class ValidatedPush:
    k: float = quantity("N", default="1 mN")

    @staticmethod
    def energy(p, grain, time):
        return p.k * grain.y

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k
"""


def test_each_command_is_passed_to_its_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_and_return_exit_code(dispatch_command, ["show", "bed", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scene"]["grains"]["count"] == 368


@pytest.mark.parametrize(
    ("command", "words"),
    [("run", "--resume"), ("identify", "--discover"), ("validate", "--full"), ("report", "--full")],
)
def test_usage_line_shows_the_typed_command(
    command: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        run_command_and_return_exit_code(dispatch_command, [command, "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    assert words in text
    assert f"usage: granular-damper {command} " in text
    assert "python -m" not in text


MODULES = (granular.__main__, reduced_models.__main__, validation.__main__)


def test_help_mentions_only_installed_programs() -> None:
    """The commands of ``granular`` belong to ``granular-damper``, so that no program ``granular`` is
    installed.
    """
    for module in MODULES:
        for parser in module.parser("granular-damper").parsers.values():
            assert not re.search(r"(?<![\w.-])(?<!from )granular [a-z]", parser.format_help())


def test_no_two_packages_have_a_command_of_the_same_name() -> None:
    names = [name for module in MODULES for name in module.parser().commands]
    assert len(names) == len(set(names))


def test_error_message_repeats_the_typed_command(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["validate"], ["validate", "report"], ["report"]):
        assert run_command_and_return_exit_code(dispatch_command, [*words, "--set", "piston.mass=6"]) == 2
        said = capsys.readouterr().err
        assert f"give one, such as: granular-damper {' '.join(words)} damper" in said


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run_command_and_return_exit_code(dispatch_command, ["--help"])
    shown = {line.split()[0] for line in capsys.readouterr().out.splitlines() if line.split()}
    commands = {name for module in MODULES for name in module.parser().commands}
    assert (commands - {"report"}) | {"validate"} <= shown


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("look record.csv --scael 2", "option '--scael'; did you mean '--scale'; see granular-damper look"),
        ("look one.csv two.csv", "unrecognized arguments: two.csv; see granular-damper look"),
        ("validate energy --quik", "did you mean '--quick'; see granular-damper validate energy"),
        ("cite nonsense", "unknown scene, method or law 'nonsense'"),
        ("rnu", "did you mean 'run'"),
        ("impulse machine", "did you mean 'response --impulse'"),
        ("--loud", "required: COMMAND"),
        ("show", "required: SCENE; see granular-damper show --help"),
        ("show nothing.toml", "the scene file 'nothing.toml' does not exist"),
    ],
)
def test_bad_input_of_the_command_granular_damper_gives_a_one_line_error(
    line: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_and_return_exit_code(dispatch_command, line.split()) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert message in error


@pytest.mark.parametrize("module", MODULES)
def test_the_version_has_a_single_source(module: Any, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run_command_and_return_exit_code(module.main, ["--version"])
    assert capsys.readouterr().out == f"granular-damper {__version__}\n"


def test_the_installed_command_prints_the_version() -> None:
    """Call the entry point of pyproject.toml as the installed script does, from another folder."""
    entry = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    module, _, name = entry["granular-damper"].partition(":")
    code = f"import sys; from {module} import {name}; sys.exit({name}())"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, "--version"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert (done.returncode, done.stdout) == (0, f"granular-damper {__version__}\n")


def test_granular_damper_without_arguments_lists_eight_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_and_return_exit_code(dispatch_command, []) == 0
    out = capsys.readouterr().out
    shown = [line.split()[0] for line in out.splitlines() if line.startswith("  ")]
    assert shown == ["identify", "look", "fit", "design", "run", "render", "sweep", "response"]


def test_validation_commands_run_with_and_without_the_word_validate(
    capsys: pytest.CaptureFixture[str],
) -> None:
    texts = []
    for words in (["energy", "--help"], ["validate", "energy", "--help"]):
        with pytest.raises(SystemExit):
            run_command_and_return_exit_code(dispatch_command, words)
        texts.append(capsys.readouterr().out.replace("granular-damper validate", "granular-damper"))
    assert texts[0].split() == texts[1].split()


@pytest.mark.parametrize("words", [["validate", "mine.toml"], ["cheapest", "mine.toml", "energy", "0.01"]])
def test_validation_accepts_scenes_with_user_defined_effects(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(*_: object, **__: object) -> None:
        raise InputError("that is enough")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("validation.report.report", measure)
    monkeypatch.setattr("validation.recommendation.recommend_settings", measure)
    Path("mine.py").write_text(OWN)
    Path("mine.toml").write_text(
        "effects.validated_push = true\ncell.width = 0.3\narrangement.height = 0.2\n"
        'grains = { count = 1, species = [{ diameter = "5 mm" }] }\n'
    )
    assert run_command_and_return_exit_code(dispatch_command, [*words, "--import", "mine.py"]) == 2
    assert capsys.readouterr().err == "error: that is enough\n"


def test_command_cite_prints_papers_for_names_and_for_paths(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from granular import load_scene, simulate

    simulate(load_scene("single-particle"), 1e-4, 1e-3, out=tmp_path / "run", progress=False)
    load_scene("bed").save(tmp_path / "mine.toml")
    places = [str(tmp_path / name) for name in ("run", "mine.toml")]
    assert run_command_and_return_exit_code(dispatch_command, ["cite", "yoshida-6", "duffing", *places]) == 0
    out = capsys.readouterr().out
    assert "yoshida1990" in out
    assert out.count("@") >= 4


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shell_completion_includes_every_command_and_option(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_and_return_exit_code(dispatch_command, ["completion", shell]) == 0
    out = capsys.readouterr().out
    assert "export-model" in out
    assert "test-fraction" in out
