"""Models exported to other languages give the same motion; users' text never becomes code."""

import ctypes
import dataclasses
import importlib.util
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granular.shared.errors import InputError
from reduced_models import ReducedModel, load_model
from reduced_models.derived.derive import HeldState, fit_polynomial_law_values_and_text
from reduced_models.laws.catalogue import law_named
from reduced_models.laws.law import law_from_text
from reduced_models.models.c_code import c_source
from reduced_models.models.matlab_code import matlab_source
from reduced_models.models.modelica_code import modelica_source
from reduced_models.models.source_code import ascii_names, escape_comment

SAVED = Path(__file__).parents[2] / "data" / "model.json"
VDP, BED = ("alpha", "omega", "g0", "shift", "scale"), ("lam", "omega", "rest", "bend", "travel")
TIMES = np.linspace(0.0, 2.0, 101)
LAWS = {
    "linear": ({"lam": 0.8, "omega": 21.0, "g0": 26.0}, (0.062, 0.0)),
    "power-law-spring": ({"lam": 0.8, "weight": 11.0, "rest": 0.059, "power": 2.54}, (0.061, 0.01)),
    "van-der-pol-like": (dict(zip(VDP, (4.0, 21.0, -20.0, 0.06, 0.02), strict=True)), (0.061, 0.0)),
    "quadratic-drag": ({"c": 90.0, "omega": 21.0, "g0": 26.0}, (0.062, -0.02)),
    "bouc-wen": ({"omega": 21.0, "friction": 0.1, "rho": 2000.0, "sigma": 0.8, "g0": 26.0}, (0.061, 0.0)),
    "rubbing-bed": (dict(zip(BED, (0.8, 21.8, 0.0591, -30.0, 2.6e-3), strict=True)), (0.0651, 0.0)),
}
HELD = [
    HeldState(0.059 + x, 70.0 * np.sinh(50.0 * x), 3500.0 * np.cosh(50.0 * x), 7.56 - 0.6 * x, 12.0 + x, 8j)
    for x in np.linspace(-4e-3, 4e-3, 17)
]
"""States of a piston held at several heights, from which a hardening spring about 59 mm is derived."""


def model_of(name: str) -> ReducedModel:
    """A model with values of a law's parameters."""
    if name == "derived":
        law, parameters, _ = fit_polynomial_law_values_and_text(HELD, 8, None)
        initial = (0.0615, 0.0)
    else:
        law, (parameters, initial) = law_named(name), LAWS[name]
    changes = {"law": law, "parameters": parameters, "initial": initial, "at_rest": None}
    return dataclasses.replace(load_model(SAVED), **changes, hidden={}, provenance={})


def with_step(model: ReducedModel) -> ReducedModel:
    """Return a model with an equilibrium.

    The period of its small oscillations sets the exported time step.
    """
    at_rest = load_model(SAVED).at_rest
    assert at_rest is not None
    period = 2.0 * np.pi / 21.0
    return dataclasses.replace(model, at_rest=dataclasses.replace(at_rest, period=period))


def close(found: np.ndarray, model: ReducedModel) -> bool:
    """Return whether heights at `TIMES` agree with the model to 1e-6 of the amplitude."""
    ours = model.simulate(TIMES).height
    swing = float(np.abs(ours - ours[-1]).max())
    return bool(np.abs(found - ours).max() < 1e-6 * swing)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("name", [*LAWS, "derived"])
def test_a_model_exported_to_c_gives_the_same_motion(name: str, tmp_path: Path) -> None:
    model = with_step(model_of(name))
    model.export(tmp_path / "model.c")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
    words = ["gcc", *flags, "model.c", "-o", "model.so", "-lm"]
    done = subprocess.run(words, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    heights, numbers = np.empty_like(TIMES), ctypes.POINTER(ctypes.c_double)
    ctypes.CDLL(str(tmp_path / "model.so")).model_simulate(
        TIMES.ctypes.data_as(numbers), len(TIMES), None, None, heights.ctypes.data_as(numbers)
    )
    assert close(heights, model)


@pytest.mark.skipif(shutil.which("octave") is None, reason="octave is not installed")
@pytest.mark.parametrize("name", ["linear", "power-law-spring", "van-der-pol-like"])
def test_a_model_exported_to_matlab_gives_the_same_motion(name: str, tmp_path: Path) -> None:
    model = with_step(model_of(name))
    model.export(tmp_path / "damper.m")
    program = "h = damper(linspace(0, 2, 101)); printf('%.17g\\n', h)"
    done = subprocess.run(
        ["octave", "--no-gui", "--quiet", "--norc", "--eval", program],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert close(np.array(done.stdout.split(), dtype=float), model)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.skipif(importlib.util.find_spec("fmpy") is None, reason="FMPy is not installed")
@pytest.mark.parametrize("name", ["linear", "power-law-spring", "bouc-wen", "rubbing-bed", "derived"])
def test_a_model_exported_as_an_fmu_gives_the_same_motion(name: str, tmp_path: Path) -> None:
    import fmpy
    from fmpy.validation import validate_fmu

    model = with_step(model_of(name))
    model.export(tmp_path / "damper.fmu")
    assert validate_fmu(str(tmp_path / "damper.fmu")) == []
    found = fmpy.simulate_fmu(str(tmp_path / "damper.fmu"), stop_time=2.0, output_interval=0.02)
    np.testing.assert_allclose(found["time"], TIMES, atol=1e-12)
    assert close(found["height"], model)


@pytest.mark.parametrize("name", LAWS)
def test_a_model_exported_to_modelica_declares_all_its_variables(name: str) -> None:
    """Only names and brackets are checked, since no Modelica compiler is available."""
    text = modelica_source(model_of(name))
    code = re.sub(r'//.*|"[^"\n]*"', "", text)
    words = "model parameter Real unit start fixed true protected equation der end DamperModel"
    known = {*words.split(), "abs", "sign", "tanh", "min", "max", "e"}
    declared = set(re.findall(r"Real (\w+)", code))
    assert set(re.findall(r"[A-Za-z_]\w*", code)) <= known | declared
    assert code.count("(") == code.count(")")
    assert "**" not in code


HOSTILE = ("*/ #error x", "//\\", "??/", "\n#include <x>", '"; system("x")', "%}", "\u2028x", "\x00")


@pytest.mark.parametrize("words", HOSTILE)
@pytest.mark.parametrize("source", [c_source, matlab_source, modelica_source])
def test_text_of_a_user_stays_within_comments_of_exported_code(
    words: str, source: Callable[[ReducedModel], str]
) -> None:
    model = model_of("linear")
    plain = source(dataclasses.replace(model, provenance={"data": "x"}))
    law = dataclasses.replace(model.law, name=words, source=words)
    hostile = source(dataclasses.replace(model, law=law, provenance={"data": words}))
    assert hostile.isascii()
    assert hostile.count("\n") == plain.count("\n")
    kept = [line for line in hostile.splitlines() if line in plain.splitlines()]
    changed = [line for line in hostile.splitlines() if line not in kept]
    assert all(re.match(r"\s*(/\*.*\*/$|//|%|model DamperModel \")", line) for line in changed)
    assert all("\\" not in line and "*/" not in line[:-2] for line in changed)


def test_names_in_other_alphabets_and_keywords_are_replaced_in_exported_code() -> None:
    assert ascii_names("p_", ("double", "λ", "lambda", "end", "k_1")) == (
        "p_double",
        "p_lamda",
        "p_lambda",
        "p_end",
        "p_k_1",
    )
    assert len(set(ascii_names("p_", ("α", "alpha")))) == 2
    law = law_from_text("z'' + double*z' + λ*max(z, 0) = end")
    model = dataclasses.replace(
        model_of("linear"), law=law, parameters={"double": 1.0, "λ": 400.0, "end": 0.0}
    )
    assert "p_double" in c_source(model)
    assert "fmax(" in c_source(model)
    assert escape_comment("a\\") == "a/"


def test_export_to_a_file_with_an_unsuitable_ending_or_name_is_refused(tmp_path: Path) -> None:
    model = model_of("linear")
    with pytest.raises(InputError, match=r"give one of \.py, \.c, \.m, \.mo, \.fmu"):
        model.export(tmp_path / "model.exe")
    for name in ("2nd.m", "a-b.m", "end.m", "x y.mo"):
        with pytest.raises(InputError, match="cannot be a function's name"):
            model.export(tmp_path / name)
    assert not list(tmp_path.iterdir())
