"""Each optional folder may be missing.

Identification still runs, lists omit the folder's parts, and a request for such a part gives an error.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]

MODEL = "reduced_models export-model {model} -o {out}"
ROOMS = {
    "FMU": (["reduced_models.models.fmu"], ".fmu", f"{MODEL}.fmu"),
    "C": (["reduced_models.models.c_code"], ".c", f"{MODEL}.c"),
    "MATLAB": (["reduced_models.models.matlab_code"], ".m", f"{MODEL}.m"),
    "Modelica": (["reduced_models.models.modelica_code"], ".mo", f"{MODEL}.mo"),
    "LAMMPS": (
        [f"granular.export.{name}" for name in ("lammps", "lammps_script", "lammps_stages")],
        "lammps",
        "granular export bed --format lammps -o {out}",
    ),
    "machines": (
        ["reduced_models.machines"],
        "compare --response",
        "reduced_models compare --response {out}",
    ),
    "response": (["granular.response"], "response", "granular response machine --from 1Hz --to 2Hz"),
}
"""Modules of each optional folder, the name of its part, and a command that requests it."""

ANSWERS = {
    "FMU": "ends in '.fmu'; give one of .py, .c, .m, .mo",
    "C": "ends in '.c'; give one of .py, .m, .mo, .fmu",
    "MATLAB": "ends in '.m'; give one of .py, .c, .mo, .fmu",
    "Modelica": "ends in '.mo'; give one of .py, .c, .m, .fmu",
    "LAMMPS": "unknown format 'lammps'",
    "machines": "unknown form of a command 'compare --response'",
    "response": "unknown command 'response'",
}

PROGRAM = """
import contextlib, importlib, io, json, shlex, sys

rooms, words = json.loads(sys.argv[1]), json.loads(sys.argv[2])
hidden = set()
needing = {("C",): ("FMU",), ("response",): ("machines",)}


class Hider:
    def find_spec(self, name, path=None, target=None):
        if any(name == module or name.startswith(module + ".") for module in hidden):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Hider())


def hide(*names):
    hidden.clear()
    hidden.update(module for name in names for module in rooms[name][0])
    every = [module for modules, *_ in rooms.values() for module in modules]
    for loaded in list(sys.modules):
        if any(loaded == module or loaded.startswith(module + ".") for module in every):
            del sys.modules[loaded]


def run(line):
    from granular.commands.console import run_command_and_return_exit_code

    package, *arguments = shlex.split(line)
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        main = importlib.import_module(f"{package}.__main__").main
        code = run_command_and_return_exit_code(main, arguments)
    return code, out.getvalue(), error.getvalue()


def listed():
    from granular.__main__ import PROGRAM
    from granular.export import EXPORTERS
    from reduced_models.commands.forms import FORMS
    from reduced_models.models.export import MODEL_EXPORTERS

    return [*PROGRAM.commands, *EXPORTERS, *FORMS, *MODEL_EXPORTERS]


def seen(*names):
    hide(*names)
    job = run("reduced_models identify {record} --law linear --quiet --json".format(**words))
    asked = {name: run(rooms[name][2].format(**words)) for name in (*names, *needing.get(names, ()))}
    return {"job": job, "listed": listed(), "asked": asked}


print(json.dumps({"all": seen(*rooms), "none": seen(), **{name: seen(name) for name in rooms}}))
"""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the outcomes with all optional folders, with none of them, and with each one removed in turn."""
    here = tmp_path_factory.mktemp("rooms")
    time = np.linspace(0.0, 3.0, 300)
    height = 0.06 + 0.004 * np.exp(-0.8 * time) * np.cos(21.0 * time)
    columns, header = np.c_[time, height], "time [s],height [m]"
    np.savetxt(here / "lab.csv", columns, delimiter=",", header=header, comments="")
    places = {
        "record": here / "lab.csv",
        "out": here / "out",
        "model": ROOT / "tests" / "data" / "model.json",
    }
    words = json.dumps({name: str(place) for name, place in places.items()})
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps(ROOMS), words],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    outcomes: dict[str, Any] = json.loads(done.stdout)
    return outcomes


@pytest.mark.parametrize("room", [*ROOMS, "all", "none"])
def test_identification_gives_the_same_result_without_optional_folders(
    seen: dict[str, Any], room: str
) -> None:
    code, out, error = seen[room]["job"]
    assert code == 0, error
    result, usual = json.loads(out), json.loads(seen["none"]["job"][1])
    del result["seconds"], usual["seconds"]
    assert result == usual


@pytest.mark.parametrize("room", ROOMS)
def test_lists_omit_only_the_parts_of_a_missing_folder(seen: dict[str, Any], room: str) -> None:
    name = ROOMS[room][1]
    assert name in seen["none"]["listed"]
    assert not {listed[1] for listed in ROOMS.values()} & set(seen["all"]["listed"])
    lacking = {name, *(["export-model SCENE"] if room == "machines" else [])}
    assert set(seen["none"]["listed"]) - set(seen[room]["listed"]) == lacking


@pytest.mark.parametrize("room", ROOMS)
def test_requesting_a_part_of_a_missing_folder_gives_a_one_line_error(
    seen: dict[str, Any], room: str
) -> None:
    code, _, error = seen[room]["asked"][room]
    assert code == 2
    assert error.count("\n") == 1
    assert ANSWERS[room] in error


def test_error_names_the_missing_folder_that_the_requested_part_requires(seen: dict[str, Any]) -> None:
    needs = {("C", "FMU"): "reduced_models.models.c_code", ("response", "machines"): "granular.response"}
    for (missing, asked), module in needs.items():
        code, _, error = seen[missing]["asked"][asked]
        assert code == 2
        assert f"needs {module}, which is missing" in error
