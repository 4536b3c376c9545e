"""Commands for reduced models: errors of one line for bad input, and strict JSON."""

import json
import math
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from granular import PistonRecord, load_scene
from granular.commands.console import BAD_INPUT
from granular.commands.signature import collect_arguments_from_options
from granular.shared.files import replace_non_finite_by_none
from reduced_models.__main__ import parser
from reduced_models.commands.identification import parse_parameters
from reduced_models.commands.records import look
from reduced_models.discovery.result import CandidateEquation, Discovery
from reduced_models.fitting.parameter import parameter_settings
from reduced_models.laws import LAWS
from reduced_models.laws.law import HeightLine
from tests.reduced_models.made import damped_cosine, noisy


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a good record and some files that are not records."""
    folder = tmp_path_factory.mktemp("files")
    time = np.linspace(0.0, 2.0, 2000)  # as in other tests: fits of one shape are compiled once
    noisy(time, 0.059 + damped_cosine(time, 0.0012), 3e-6, 3).to_csv(folder / "lab.csv")
    (folder / "unit.csv").write_text("time,height [mm^-200]\n0,1\n1,2\n")
    run = folder / "run"
    run.mkdir()
    np.savez(run / "checkpoint.npz", outcome=np.array("{}"))
    (run / "run.json").write_text("{}")
    load_scene("damper").save(run / "scene.toml")
    return folder


@pytest.fixture
def files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


BAD = [
    (("lab.csv", "-o", "lab.csv/out"), "cannot be created"),
    (("lab.csv", "-o", "x" * 300), "cannot be created"),
    (("lab.csv", "-o", "lab.csv"), "is a file; give a directory"),
    (("damper", "-o", "lab.csv"), "is a file; give a directory"),
    (("x" * 300,), "x"),
    (("x" * 300 + ".csv",), "check the path"),
    (("nothing.csv",), "does not exist"),
    (("run",), "run"),
    (("unit.csv",), "exceeds 9"),
    (("damper", "--method", "eulr"), "unknown method"),
    (("lab.csv", "--method", "symplectic-euler"), "applies to a scene"),
    (("lab.csv", "--dt", "1e-5"), "applies to a scene"),
    (("damper", "--dt", "-1"), "above 0 s"),
    (("damper", "--dt", "1 s^-200"), "exceeds 9"),
    (("damper", "--dt", "auto*9"), "above 0 and up to 8"),
    (("lab.csv", "--threads", "2"), "applies to a scene"),
    (("lab.csv", "--packings", "8"), "applies to the checks of a scene"),
    (("lab.csv", "--set", "piston.mass=1"), "applies to a scene"),
    (("lab.csv", "--law", "linaer"), "did you mean 'linear'"),
    (("lab.csv", "--starts", "1000000000"), "integer from 1 to 10000"),
    (("lab.csv", "--starts", "few"), "invalid int value"),
    (("single-particle",), "has no piston"),
    (("lab.csv", "--law", "k*z = 0"), "equations of motion for no coordinate"),
]


@pytest.mark.parametrize(("words", "message"), BAD, ids=[" ".join(row[0])[:40] for row in BAD])
@pytest.mark.usefixtures("files")
def test_bad_input_gives_a_one_line_error_and_exit_status_2(
    words: tuple[str, ...], message: str, command: Callable[..., Any]
) -> None:
    done = command("reduced_models", "identify", *words, "--quiet")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (BAD_INPUT, "", 1)
    assert done.stderr.startswith("error: ")
    assert message in done.stderr


@pytest.mark.usefixtures("files")
def test_json_output_of_the_commands_is_strict(command: Callable[..., Any]) -> None:
    """Since JSON has no infinity, intervals without an end are included in the test."""
    words = ("lab.csv", "--law", "relaxing-column", "--starts", "2", "--json", "--quiet")
    done = command("reduced_models", "identify", *words)
    assert done.returncode == 0, done.stderr
    plain = json.loads(done.stdout, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    assert plain["best"] == "relaxing-column"
    assert None in plain["models"][0]["intervals"]["weight"]


def test_numbers_that_json_cannot_represent_become_null() -> None:
    plain = {"a": [1.0, np.inf, (-np.inf, "x")], "b": {"c": np.nan, "d": np.float64(2.0)}}
    assert replace_non_finite_by_none(plain) == {"a": [1.0, None, [None, "x"]], "b": {"c": None, "d": 2.0}}


@pytest.mark.usefixtures("files")
def test_the_commands_fit_compare_and_simulate_work_together(command: Callable[..., Any]) -> None:
    """A law is fitted and saved as a model, whose prediction agrees with the record."""

    def run(*words: str) -> str:
        done = command("reduced_models", *words)
        assert done.returncode == 0, done.stderr
        return str(done.stdout)

    words = ("fit", "lab.csv", "--law", "z'' + 2*d*z' + k*z = g", "--starts", "1", "--quiet")
    assert "model: fitted.json" in run(*words, "--bound", "d=0:5", "-o", "fitted.json")
    (model,) = json.loads(run(*words, "--fix", "d=0.75", "--start", "k=476", "--json"))["models"]
    assert model["parameters"]["d"] == pytest.approx(0.75, rel=1e-12)
    run("simulate", "fitted.json", "--until", "2 s", "--samples", "2000", "-o", "motion.csv")
    record, predicted = (PistonRecord.from_csv(Path(name)) for name in ("lab.csv", "motion.csv"))
    assert np.abs(predicted.height - record.height).max() < 2e-5
    words = ("compare", "lab.csv", "--law", "linear", "--law", "coulomb", "--test-records", "lab.csv")
    plain = json.loads(run(*words, "-o", "compared", "--json", "--quiet"))
    assert {row["law"] for row in plain["rows"]} == {"linear", "coulomb"}
    assert "Laws compared" in Path("compared/report.html").read_text()
    assert Path("compared/equations.txt").is_file()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("simulate nothing.json --until 3", "the file 'nothing.json' does not exist"),
        ("simulate nothing.json", "--until"),
        ("fit lab.csv --bound lam", "is not NAME=LOW:HIGH"),
        ("fit lab.csv --law linear --bound lam=2:1", "low must be less than high"),
        ("fit lab.csv --law linear --own mass", "unknown parameter 'mass'"),
        ("fit lab.csv --law linear --bound 'lam=1 m:2'", "in 1/s is wanted"),
        ("fit lab.csv --law linear --bound 'omega=3 Hz:'", "give the angular frequency, 2 pi times it"),
        ("fit lab.csv --law \"q'' + k*q = g0\" --bound k=one:2", "give a number in SI"),
        ("fit lab.csv --fix lam", "--fix 'lam' is not NAME=VALUE"),
        ("fit lab.csv --start 'lam=1 m'", "in 1/s is wanted"),
        ("fit lab.csv --test-fraction 1", "from 0 to 0.9"),
        ("fit lab.csv --test-fraction '2 s'", "a pure number or a fraction in % is wanted"),
        ("compare lab.csv --test-records nothing.csv", "does not exist"),
        ("fit", "required: SOURCE; see python -m reduced_models fit --help"),
        ("compare lab.csv --response out", "SOURCE cannot be combined with --response"),
        ("design --damping 0.1", "required: --frequency"),
        ("design --frequency 3.3 --damping 0.9", "damping ratios from 0.023 to 0.27"),
    ],
)
@pytest.mark.usefixtures("files")
def test_bad_arguments_of_other_commands_give_a_one_line_error_and_exit_status_2(
    words: str, message: str, command: Callable[..., Any]
) -> None:
    done = command("reduced_models", *shlex.split(words))
    assert (done.returncode, done.stderr.count("\n")) == (BAD_INPUT, 1)
    assert message in done.stderr


def test_parameters_on_the_command_line_may_have_units() -> None:
    found = parse_parameters(["rest=1 cm:20 mm", "k2=-1e-3 1/(mm s^2):", "lam=0:2"], ["lam"])
    settings = parameter_settings(LAWS["polynomial-spring"], found, 1)
    assert settings.bounds == {"rest": (0.01, 0.02), "k2": (-1.0, math.inf), "lam": (0.0, 2.0)}
    assert settings.per_record == ("lam",)
    found = parse_parameters(["lam=0:2"], [], ["rest=12 mm"], ["k2=1e-3 1/(mm s^2)", "lam=0.5"])
    settings = parameter_settings(LAWS["polynomial-spring"], found, 1)
    assert settings.bounds == {"rest": (0.012, 0.012), "lam": (0.0, 2.0)}
    assert settings.start == {"k2": 1.0, "lam": 0.5}
    words = ["design", "--frequency", "3.5 Hz", "--damping", "4 %", "--small-share", "25 %"]
    options = parser().parse_args(words)
    assert (options.frequency, options.damping, options.small_share) == (3.5, 0.04, 0.25)
    options = parser().parse_args(["look", "lab.csv", "--between", "500 ms:"])
    assert collect_arguments_from_options(look.carry_out, options)["reading"].parse().between == (
        0.5,
        math.inf,
    )


def test_option_laws_lists_all_laws(command: Callable[..., Any]) -> None:
    printed = command("reduced_models", "fit", "--laws").stdout.splitlines()
    assert "linear              z'' + 2*lam*z' + omega**2*z = g0" in printed


@pytest.mark.usefixtures("files")
def test_a_discovery_without_a_model_is_shown_before_it_is_refused(
    monkeypatch: pytest.MonkeyPatch, command: Callable[..., Any]
) -> None:
    """The Pareto front, which takes minutes, is printed even if none of its equations can be fitted to
    the motion.
    """
    z = sympy.Symbol("z", real=True)
    candidate = CandidateEquation(-2 * z, 3, 1.0, 0.0, note="the fit failed")
    found = Discovery("sindy", (candidate,), 0, HeightLine())
    monkeypatch.setattr("reduced_models.discovery.discover.discover", lambda *_, **__: found)
    done = command("reduced_models", "discover", "lab.csv", "--json", "-o", "found.json")
    shown = json.loads(done.stdout)
    assert shown["candidates"][0]["note"] == "the fit failed"
    assert (shown["method"], shown["method_asked_for"]) == ("sindy", "auto")
    assert done.returncode == BAD_INPUT
    assert done.stderr == "error: no model was written to found.json: the fit failed\n"
    assert not Path("found.json").exists()
