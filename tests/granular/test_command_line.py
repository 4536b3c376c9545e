"""Output, exit status and one-line errors of the commands."""

import importlib
import json
import shlex
import shutil
import subprocess
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from granular import damper
from granular.commands.console import run_command_and_return_exit_code

Command = Callable[..., subprocess.CompletedProcess[str]]

CHANGES_OF_SMALL = ("grains.count=23", "cell.width=15 D", "piston.height=6 D", "arrangement.height=5.5 D")
SMALL = tuple(word for change in CHANGES_OF_SMALL for word in ("--set", change))


def test_command_scenes_lists_scenes_and_command_show_prints_one(command: Command) -> None:
    done = command("granular", "scenes", "--json")
    assert done.returncode == 0
    assert {"bed", "damper", "single-particle"} <= set(json.loads(done.stdout))
    done = command("granular", "show", "damper", "--set", "piston.mass=6.5")
    assert done.returncode == 0
    assert "6.5 kg" in done.stdout
    assert "packing fraction 0.2409" in done.stdout


def test_option_methods_lists_all_integration_methods(command: Command) -> None:
    done = command("granular", "scenes", "--methods")
    assert "stormer-verlet    order 2, 1 force evaluation per step, " in done.stdout
    done = command("granular", "scenes", "--methods", "--json")
    assert json.loads(done.stdout)["kahan-li-8"]["order"] == 8


@pytest.mark.parametrize(
    ("words", "blamed"),
    [
        ((), "error: dt = 5 s is longer than the time between records"),
        (
            ("--set", "output.scalars=10", "--set", "output.frames=10"),
            "error: step 1, t = 5 s, grain 0: dt = 5 s is ",
        ),
    ],
)
def test_error_names_a_time_step_that_is_too_long_as_the_cause(
    command: Command, words: tuple[str, ...], blamed: str
) -> None:
    done = command("granular", "run", "single-particle", "--dt", "5", "--t-end", "20", *words)
    (line,) = done.stderr.splitlines()[-1:]
    assert line.startswith(blamed)
    assert "shorten dt" in line


def test_run_without_an_output_directory_reports_that_nothing_is_stored(command: Command) -> None:
    done = command("granular", "run", "bed", *SMALL, "--t-end", "5 ms", "--quiet")
    assert "0 to 0.005 s" in done.stdout
    assert "the run is not stored; -o DIR stores it" in done.stdout.splitlines()


def test_command_run_stores_a_run_and_resumes_it(command: Command, tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    first = command("granular", "run", "bed", *SMALL, "--t-end", "0.01", "-o", out, "--json")
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["time"] == pytest.approx(0.01)
    assert "settle" in first.stderr
    again = command("granular", "run", "bed", *SMALL, "--t-end", "0.02", "-o", out, "--resume", "--quiet")
    assert again.returncode == 0
    assert "0 to 0.02 s" in again.stdout
    assert "the run is not stored" not in again.stdout
    assert "settle" not in again.stderr  # no progress bar


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> dict[str, str]:
    """Return paths of a short run, of damaged copies of it, and of files that are not records."""
    folder = tmp_path_factory.mktemp("places")
    run = folder / "run"
    command: Command = request.getfixturevalue("command")
    words = ("run", "bed", *SMALL, "--t-end", "0.25", "-o", str(run), "--quiet")
    assert command("granular", *words).returncode == 0
    damage = {
        "truncated": ("checkpoint.npz", (run / "checkpoint.npz").read_bytes()[:300]),
        "emptied": ("checkpoint.npz", b""),
        "bare": ("run.json", b"{}"),
        "garbled": ("run.json", b"nonsense"),
        "edited": ("scene.toml", (run / "scene.toml").read_bytes() + b"# mine"),
    }
    for name, (file, content) in damage.items():
        shutil.copytree(run, folder / name)
        (folder / name / file).write_bytes(content)
    shutil.copytree(run, folder / "hollow")
    shutil.rmtree(folder / "hollow" / "trajectory.zarr")
    shutil.copytree(run, folder / "stripped")
    shutil.rmtree(folder / "stripped" / "trajectory.zarr" / "position")
    shutil.copytree(run, folder / "flipped")
    chunk = folder / "flipped" / "trajectory.zarr" / "position" / "c" / "0" / "0" / "0"
    chunk.write_bytes(bytes([chunk.read_bytes()[0] ^ 1]) + chunk.read_bytes()[1:])
    (folder / "empty.csv").touch()
    (folder / "words.csv").write_text("time,height\n0,low\n1,high\n")
    (folder / "there.png").write_bytes(b"precious")
    (folder / "list.toml").write_text("grains = [1, 2]\n")
    (folder / "open.toml").write_text("[grains\n")
    return {
        "here": str(folder),
        "long": "x" * 300,
        **{path.name.split(".")[0]: str(path) for path in folder.iterdir()},
    }


@pytest.fixture
def here(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], tuple[int, str, str]]:
    """Return a function that runs a command in this process.

    It returns exit status, standard output and standard error.
    """
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)

    def run(line: str) -> tuple[int, str, str]:
        package, *words = shlex.split(line)
        code = run_command_and_return_exit_code(importlib.import_module(f"{package}.__main__").main, words)
        return code, *capsys.readouterr()

    return run


Here = Callable[[str], tuple[int, str, str]]


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize(
    "line",
    ["scenes", "show bed", "show damper", "show single-particle", "run bed {small} --t-end 1e-3 --quiet"],
)
def test_json_output_of_a_command_is_one_strict_json_object(here: Here, line: str) -> None:
    code, out, _ = here(f"granular {line.format(small=shlex.join(SMALL))} --json")
    assert code == 0
    assert isinstance(json.loads(out, parse_constant=refuse), dict)


@pytest.mark.parametrize("form", ["gsd", "extxyz", "csv"])
def test_command_export_writes_files_and_reports_them(
    here: Here, places: dict[str, str], tmp_path: Path, form: str
) -> None:
    code, out, _ = here(f"granular export {places['run']} --format {form} -o {tmp_path / 'bed'} --json")
    said = json.loads(out)
    assert (code, said["format"], said["frames"]) == (0, form, 4)  # 0, 0.1, 0.2 and 0.25 s
    assert all(Path(one).stat().st_size for one in said["files"])


def test_command_render_writes_a_picture_and_reports_it(
    here: Here, places: dict[str, str], tmp_path: Path
) -> None:
    png, gif = tmp_path / "bed.png", tmp_path / "bed.gif"
    line = f"granular render {places['run']} -o {png} --colour force --json"
    code, out, error = here(f"{line} --time '100 ms'")
    assert (code, json.loads(out), error) == (0, {"file": str(png), "colour": "force"}, "")
    first = png.read_bytes()
    assert first.startswith(b"\x89PNG")
    assert here(f"{line} --frame 0 --force")[0] == 0
    assert png.read_bytes() != first
    code, out, error = here(f"granular render {places['run']} -o {gif} --stage settle --json")
    assert (code, json.loads(out)["file"]) == (0, str(gif))
    assert "bed.gif" in error  # the progress bar
    assert gif.read_bytes().startswith(b"GIF89a")


BAD = [
    ("granular", "required: COMMAND"),
    ("granular fly", "unknown command 'fly'"),
    ("granular run", "required: SCENE"),
    ("granular run dampr", "did you mean 'damper'"),
    ("granular run {list}", "grains"),
    ("granular run {open}", "not a TOML file"),
    ("granular run {run}", "scene"),
    ("granular show {long}", "unknown scene"),
    ("granular run bed --sett a=b", "did you mean '--set'"),
    ("granular run bed --set grains.count", "is not KEY=VALUE"),
    ("granular run bed --set grains.cuont=3", "did you mean 'count'"),
    ("granular run bed --set protocol.settle.kind=[1]", "unknown kind '[1]'"),
    ("granular run bed --set 'cell.width=3 kg'", "a quantity in m is wanted"),
    ("granular run bed --set piston.height=nan", "must be finite"),
    ("granular run bed --dt soon", "is not a quantity"),
    ("granular run bed --dt '1 mm'", "a quantity in s is wanted"),
    ("granular run bed --method euler?", "unknown method"),
    ("granular run bed --threads many", "invalid int value"),
    ("granular run bed --resume", "needs the argument out"),
    ("granular run bed -o /proc/nowhere/run", "cannot be made"),
    ("granular run bed -o {long}", "File name too long"),
    ("granular run bed -o {run}", "give a new directory"),
    ("granular run bed -o {run} --resume", "another scene"),
    ("granular run bed {small} -o {truncated} --resume", "checkpoint.npz"),
    ("granular run bed {small} -o {bare} --resume", "run.json"),
    ("granular run bed {small} -o {hollow} --resume", "trajectory.zarr"),
    ("granular run bed --dt 1e10", "longer than the time between records, output.scalars"),
    ("reduced_models design --frequency '3 m' --damping 0.1 -o out", "in Hz is wanted"),
    ("granular export {stripped} --format gsd -o {here}/a.gsd", "position/zarr.json is missing"),
    ("granular export {flipped} --format extxyz -o {here}/a.xyz --quiet", "/0 is damaged"),
    ("granular render {edited} -o {here}/a.png", "scene.toml has changed since it was written"),
    ("granular export", "required: RUN, --format, -o"),
    ("granular export {run} --format gsd", "required: -o"),
    ("granular export {run} --format xls -o {here}/a.xls", "unknown format 'xls'"),
    ("granular export {empty} --format gsd -o {here}/a.gsd", "empty.csv"),
    ("granular export {run} --format gsd -o {there}", "exists; give another name"),
    ("granular export {run} --format gsd -o {here}", "is a directory"),
    ("granular export {run} --format extxyz -o {here}/no/a.xyz", "does not exist; make it first"),
    ("granular export {run} --format csv -o {there}", "cannot be made"),
    ("granular render {run}", "required: -o"),
    ("granular render {run} -o {there}", "exists; give another name"),
    ("granular render {run} -o {here}/a.tiff", "unknown format '.tiff'"),
    ("granular render {run} -o {here}/a.png --colour mauve", "unknown colour 'mauve'"),
    ("granular render {run} -o {here}/a.png --frame 99", "no frame 99"),
    ("granular render {run} -o {here}/a.png --frame first", "invalid int value"),
    ("granular render {run} -o {here}/a.png --time 9", "give a time from 0 to 0.25 s"),
    ("granular render {run} -o {here}/a.png --time 0.1 --frame 1", "give only one of them"),
    ("granular render {run} -o {here}/a.png --fps 25", "are for movies"),
    ("granular render {run} -o {here}/a.mp4 --frame 1", "apply only to stills"),
    ("granular render {run} -o {here}/a.mp4 --stage compress", "unknown stage"),
    ("reduced_models identify", "required: SOURCE"),
    ("reduced_models identify nothing.csv", "does not exist"),
    ("reduced_models identify {empty}", "is empty"),
    ("reduced_models identify {words}", "is 'low', not a number"),
    ("reduced_models identify single-particle", "has no piston"),
    ("reduced_models identify damper --law linaer", "did you mean 'linear'"),
    ("reduced_models identify damper --starts 0", "integer from 1"),
]


@pytest.mark.parametrize(("line", "message"), BAD, ids=[one[0] for one in BAD])
def test_bad_input_gives_a_one_line_error_and_exit_status_2(
    line: str, message: str, places: dict[str, str], here: Here
) -> None:
    code, out, error = here(line.format(**places, small=shlex.join(SMALL)))
    assert code == 2
    assert out == ""
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert message in error
    assert Path(places["there"]).read_bytes() == b"precious"
    assert not list(Path(places["here"]).glob("a.*"))


@pytest.mark.parametrize("package", ["granular", "reduced_models"])
def test_exit_status_of_a_command_is_returned_to_the_shell(process: Command, package: str) -> None:
    done = process(package, "fly")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1


def test_a_failed_run_gives_a_one_line_error_and_exit_status_1(command: Command) -> None:
    seldom = ("--set", "output.scalars=2e-3")
    done = command("granular", "run", "bed", *SMALL, *seldom, "--dt", "2e-3", "--quiet")
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1
    assert lines[0].startswith("error: step ")
    assert "shorten dt" in lines[0]


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        ((), ["method: stormer-verlet, of order 2", "sum over pairs: direct", "threads: 1"]),
        (("--accuracy", "1 % period"), ["step: auto*8, 0.8 divided by the highest angular frequency"]),
        (
            ("--method", "pefrl", "--dt", "1", "--set", "effects.friction={}"),
            [
                "refused: method = 'pefrl' cannot run a scene with friction, which is undefined for",
                "refused: dt = 1 s is longer than the time between records, output.scalars = 0.001 s; "
                "shorten",
            ],
        ),
        (
            ("--set", "pairs.method=mesh", "--set", "cell.width=1e5 D", "--set", "piston.height=1e5 D"),
            ["sum over pairs: mesh", "refused: pairs.method = 'mesh' needs"],
        ),
    ],
    ids=["damper", "an accuracy", "two refusals", "a mesh that does not fit"],
)
def test_command_show_prints_method_and_step_or_the_reasons_why_a_run_is_refused(
    command: Command, words: tuple[str, ...], lines: list[str]
) -> None:
    done = command("granular", "show", "damper", *words)
    assert done.returncode == 0, done.stderr
    shown = [line.strip() for line in done.stdout.splitlines()]
    for line in lines:
        assert sum(one.startswith(line) for one in shown) == 1, shown
    refused = [line for line in shown if line.startswith("refused")]
    assert len(refused) == sum(line.startswith("refused") for line in lines)


CHANGES: dict[str, dict[str, Any]] = {
    "cell.sides": {
        "cell": {
            "sides": [
                {"name": "left", "ends": [[0.0, 1.0], [0.0, 0.0]]},
                {"name": "floor", "ends": [[0.0, 0.0], [0.36, 0.0]]},
                {"name": "right", "ends": [[0.36, 0.0], [0.36, 1.0]]},
                {"name": "lid", "ends": [[0.36, 0.0], [0.0, 0.0]], "body": "piston"},
            ]
        }
    },
    "host": {
        "effects.host": {
            "mount": "base",
            "pistons": [{"name": "floor", "mass": 0.3, "side": "bottom"}],
            "springs": [{"upper": "floor", "stiffness": 2e4, "preload": 80.0}],
        }
    },
}


@pytest.mark.parametrize("key", CHANGES)
@pytest.mark.parametrize(
    "words",
    [("granular", "export", "--format", "lammps", "-o", "out"), ("reduced_models", "fall")],
    ids=["export", "fall"],
)
def test_commands_without_support_for_polygons_or_further_pistons_refuse_such_scenes(
    key: str, words: tuple[str, ...], command: Callable[..., Any], tmp_path: Path
) -> None:
    package, name, *options = words
    scene = tmp_path / "scene.toml"
    scene.write_text(damper().replace(**CHANGES[key]).to_toml(), encoding="utf-8")
    done = command(package, name, str(scene), *options)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert key in done.stderr
