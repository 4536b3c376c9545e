"""An installed package of a user can add parts of every kind.

A broken part is reported, and does not affect the others.
"""

import importlib
import pkgutil
import re
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest

import granular.__main__
import granular.effects
import granular.shared.registry
from granular import load_scene, load_trajectory, simulate
from granular.effects.effect import EFFECTS, WALL_LAWS, Effect
from granular.export import EXPORTERS
from granular.methods import METHODS, method_named
from granular.observables import OBSERVABLES
from granular.records.formats import READERS, read_sheet
from granular.records.options import ReadOptions
from granular.run.engines import ENGINES
from granular.shared.blocks import ADDED_BLOCKS
from granular.shared.errors import InputError
from granular.shared.html_pages import Page
from granular.shared.registry import Registry
from granular.studies.cases import MEASURES, find_measure
from reduced_models import PistonRecord, load_model
from reduced_models.laws import FORCE_LAWS, LAWS
from reduced_models.models.export import MODEL_EXPORTERS
from validation.report import SECTIONS, report

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "tests" / "data" / "laboratory_parts"
OFFERED = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]["entry-points"]
COMMANDS = ("granular", "reduced_models", "validation")
BROKEN = (
    r"broken' of laboratory-parts 1\.2 cannot be loaded: RuntimeError: the driver of the bench is missing; "
    r"correct 'laboratory_parts\.broken:part'"
)
Command = Callable[..., CompletedProcess[str]]


def registries() -> dict[str, Registry[Any]]:
    """Return the registry of each kind of part, by the name of its entry-point group."""
    programs = [sys.modules[f"{package}.__main__"].PROGRAM for package in COMMANDS]
    every: list[Registry[Any]] = [
        *(EFFECTS, WALL_LAWS, METHODS, ENGINES, OBSERVABLES, MEASURES, READERS, EXPORTERS, ADDED_BLOCKS),
        *(LAWS, FORCE_LAWS, MODEL_EXPORTERS, SECTIONS),
        *(program.commands for program in programs),
    ]
    return {registry.group: registry for registry in every}


@pytest.fixture(autouse=True)
def package(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, command: Command
) -> Iterator[None]:
    """Install the example package as described by its pyproject.toml."""
    for program in COMMANDS:
        command(program, "--version")
    place = tmp_path_factory.mktemp("installed")
    about = place / "laboratory_parts-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: laboratory-parts\nVersion: 1.2\n")
    lines = [
        line
        for group, points in OFFERED.items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in points.items()))
    ]
    (about / "entry_points.txt").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(place)
    monkeypatch.syspath_prepend(PACKAGE)
    yield
    for registry in registries().values():
        for name in OFFERED[registry.group]:
            registry._own.pop(name, None)


def test_the_example_package_has_a_part_of_every_kind() -> None:
    assert registries().keys() == OFFERED.keys()
    sources = [path.read_text("utf-8") for name in COMMANDS for path in (ROOT / name).rglob("*.py")]
    named = re.compile(r"(?:Registry\[[^(]*\(\s*\"[^\"]+\",|command_registry\()\s*\"([\w.]+)\"")
    groups = {group for text in sources for group in named.findall(text)}
    assert groups == OFFERED.keys()


@pytest.mark.parametrize("group", OFFERED)
def test_built_in_parts_have_the_type_of_their_kind(group: str) -> None:
    registry = registries()[group]
    assert tuple(registry._built_in) == registry.built_in
    for name in registry.built_in:
        assert registry._accepts(name, registry[name])


def test_the_table_of_effects_is_complete() -> None:
    modules = [f"granular.effects.{found.name}" for found in pkgutil.iter_modules(granular.effects.__path__)]
    defined = [thing for name in modules for thing in vars(importlib.import_module(name)).values()]
    effects = (thing for thing in defined if isinstance(thing, type) and issubclass(thing, Effect))
    keys = {made.key for made in effects if made.key}
    assert keys == set(EFFECTS.built_in)


@pytest.mark.parametrize("group", OFFERED)
def test_an_installed_part_is_listed_and_a_broken_one_is_reported(group: str) -> None:
    registry = registries()[group]
    good, broken = OFFERED[group]
    assert set(registry) >= {good, broken, *registry.built_in}
    with pytest.raises(InputError, match=BROKEN) as told:
        registry.find(broken)
    assert "\n" not in str(told.value)
    with pytest.warns(UserWarning, match=f"{BROKEN}.*is not used"):
        working = registry.usable_parts()
    assert set(working) == set(registry) - {broken}
    assert re.search(BROKEN, registry.descriptions()[broken])
    with pytest.raises(InputError, match=rf"did you mean '{re.escape(good)}'.*group '{group}'"):
        registry.find(f"{good}s")


@pytest.mark.parametrize("program", COMMANDS)
def test_commands_of_an_installed_package_are_listed_in_the_help_and_can_be_run(
    command: Command, program: str
) -> None:
    text = " ".join(command(program, "--help").stdout.split())
    assert "bench show the state of the bench" in text
    assert "'broken' of laboratory-parts 1.2 cannot be loaded" in text
    assert command(program, "bench").stdout == "the bench is ready\n"
    done = command(program, "broken")
    assert done.returncode == 2
    assert re.search(f"error: command '{BROKEN}", done.stderr)
    assert "did you mean 'bench'" in command(program, "bensh").stderr


def test_a_broken_part_does_not_affect_others(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two commands and a reader with a missing requirement are tested.

    One command has no valid parser, the other has the name of a built-in command.
    """
    points = [
        EntryPoint("untyped", "laboratory_parts.commands:UNTYPED", "granular.commands"),
        EntryPoint("run", "laboratory_parts.commands:bench", "granular.commands"),
        EntryPoint(".csv", "laboratory_parts.broken:part", "granular.readers"),
    ]
    monkeypatch.setattr(
        granular.shared.registry,
        "_installed_entry_points",
        lambda group: {point.name: point for point in points if point.group == group},
    )
    commands = registries()["granular.commands"]
    with pytest.raises(InputError, match=r"'untyped' is not made by .* typed options"):
        commands.find("untyped")
    with pytest.warns(
        UserWarning, match="command 'run' is not used, because a built-in command has this name"
    ):
        parser = granular.__main__.PROGRAM.parser()
    assert parser.parse_args(["run", "bed"]).command == "run"
    (tmp_path / "lab.csv").write_text("time [s],height [mm]\n0,1\n1,2\n")
    assert len(read_sheet(tmp_path / "lab.csv", ReadOptions()).columns) == 2
    with pytest.raises(InputError, match=r"lower case that is not a text suffix|cannot be loaded"):
        registries()["granular.readers"].find(".csv")


def test_simulations_use_the_parts_of_an_installed_package(command: Command, tmp_path: Path) -> None:
    scene = load_scene("single-particle").replace(
        **{"effects.bench_spring.k": "3 N/m", "effects.walls.left": {"law": "bench_rubber", "k": "9 N/m"}}
    )
    assert scene.to_plain()["effects"]["bench_spring"]["k"] == pytest.approx(3.0)
    with pytest.raises(InputError, match=BROKEN):
        scene.replace(**{"effects.broken": True})
    with pytest.raises(InputError, match=BROKEN):
        scene.replace(**{"effects.walls.left": {"law": "broken"}})
    assert method_named("bench-verlet").order == 2
    where = tmp_path / "run"
    run = simulate(load_scene("single-particle"), t_end=0.01, engine="bench", out=where, progress=False)
    assert sys.modules["laboratory_parts.engines"].CALLS
    assert find_measure("bench-end")(run) == {"end": pytest.approx(0.01)}
    shown = command("granular", "observe", str(where), "bench_height", "--quiet").stdout
    assert "bench_height [m]" in shown
    words = ("export", str(where), "--format", "bench", "-o", str(tmp_path / "run.txt"), "--quiet")
    assert command("granular", *words).returncode == 0
    frames = load_trajectory(where).dataset.sizes["frame"]
    assert (tmp_path / "run.txt").read_text() == f"{frames} frames\n"
    listed = command("granular", "scenes").stdout
    for group in ("effects", "wall_laws", "methods", "engines", "observables"):
        assert set(OFFERED[f"granular.{group}"]) <= set(re.split(r"[,\s]+", listed))
    methods = command("granular", "scenes", "--methods").stdout
    assert re.search(BROKEN, methods)
    assert "bench-verlet" in methods


def test_reduced_models_use_the_parts_of_an_installed_package(command: Command, tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 50)
    np.savetxt(tmp_path / "lab.bench", np.c_[time, 60.0 + np.cos(20.0 * time)])
    with warnings.catch_warnings(action="ignore"):
        record = PistonRecord.from_file(tmp_path / "lab.bench")
    np.testing.assert_allclose(record.height, 0.06 + 1e-3 * np.cos(20.0 * time), rtol=1e-12)
    (tmp_path / "lab.csv").write_bytes(b"\x00\x01\x02")
    with pytest.raises(InputError, match=r"one of these suffixes: .*\.bench"):
        PistonRecord.from_file(tmp_path / "lab.csv")
    model = load_model(ROOT / "tests" / "data" / "model.json")
    assert model.export(tmp_path / "model.bench") == "a text for the bench"
    assert (tmp_path / "model.bench").read_text() == model.law.equation
    with pytest.raises(InputError, match=r"give one of .*\.fmu, \.bench, broken"):
        model.export(tmp_path / "model.xyz")
    laws = command("reduced_models", "fit", "--laws").stdout
    assert "bench-spring" in laws
    assert "bench-damper" in laws
    assert len(re.findall(BROKEN, laws)) == 2


def test_result_pages_and_reports_show_the_blocks_and_sections_of_an_installed_package() -> None:
    class Result:
        level = 0.5

    page = Page("Bench", result=Result())
    assert "<meter value=0.5></meter>" in page.to_html()
    assert "gauge: 0.5" in str(page)
    assert re.search(BROKEN, str(page).replace("\n  ", " "))
    assert not Page("Bench").blocks
    shown = report(None, [SECTIONS.find("bench")], progress=False)
    assert shown["verdicts"] == {"bench": "level"}
    assert shown["holds"]
