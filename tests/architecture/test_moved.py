"""Modules are still found where they stood before they moved."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import granular
import reduced_models

ROOT = Path(__file__).parents[2]


def former_paths(package: str) -> dict[str, str]:
    """The table that a package hands over, from its source."""
    tree = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    (call,) = [one for one in calls if isinstance(one.func, ast.Name) and one.func.id == "forward"]
    name, table = map(ast.literal_eval, call.args)
    return {f"{name}.{old}": f"{name}.{new}" for old, new in table.items()}


MOVED = former_paths("granular") | former_paths("reduced_models")


@pytest.fixture
def anew() -> None:
    """Former paths are imported as if for the first time."""
    for old in MOVED:
        sys.modules.pop(old, None)


@pytest.mark.usefixtures("anew")
@pytest.mark.parametrize("old", MOVED)
def test_a_former_path_gives_the_module_itself(old: str) -> None:
    new = MOVED[old]
    with pytest.warns(DeprecationWarning, match=f"{old} is deprecated .* import {new}") as told:
        found = importlib.import_module(old)
    assert told[0].filename == importlib.__file__  # whoever asked, not the machinery between
    assert found is importlib.import_module(new)
    assert found.__name__ == found.__spec__.name == new


NAMED = {
    "granular.arrangement": ("Arrangement", "initial_motion"),
    "granular.errors": ("InputError",),
    "granular.plotting": ("COLOURS", "figure"),
    "granular.record": ("PistonRecord",),
    "granular.scales": ("Scales",),
    "granular.schema": ("Section", "quantity"),
    "granular.simulation": ("simulate",),
    "granular.summary": ("run_text", "scene_text"),
    "granular.trajectory": ("StageResult", "Trajectory", "load_trajectory"),
    "granular.units": ("si_value", "unit_size"),
    "reduced_models.calibrated": ("Calibrated", "Calibration", "Match"),
    "reduced_models.comparison": ("Comparison", "Row", "compare"),
    "reduced_models.estimates": ("Estimates",),
    "reduced_models.judging": ("RollOut", "roll_out"),
    "reduced_models.law": ("Law", "SwingForm", "parse"),
    "reduced_models.model": ("AtRest", "Direction", "HeightMap", "Quality", "ReducedModel"),
    "reduced_models.report": ("comparison_page",),
    "reduced_models.response": ("Cycle", "FrequencyResponse", "cycle", "decay"),
    "reduced_models.rollout": ("Motion",),
}
"""What guide, reference and notebooks named by paths that have changed."""


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("old", NAMED)
def test_names_are_found_by_former_paths(old: str) -> None:
    module = importlib.import_module(old)
    assert [name for name in NAMED[old] if not hasattr(module, name)] == []


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_former_path_is_an_attribute_of_its_package() -> None:
    from reduced_models import elliptic

    assert elliptic is importlib.import_module("reduced_models.laws.elliptic")


def test_rooms_that_were_modules_have_their_names() -> None:
    from granular.scene import Cell, Scene, load_scene  # noqa: F401
    from reduced_models.calibration import calibrate
    from reduced_models.fitting import fit
    from reduced_models.identification import Figure, Identification, identify  # noqa: F401
    from reduced_models.laws import LAWS, law_named

    assert Scene is granular.Scene
    assert (calibrate, fit, identify) == (
        reduced_models.calibrate, reduced_models.fit, reduced_models.identify
    )  # fmt: skip
    assert law_named("linear") is LAWS["linear"]


@pytest.mark.parametrize("name", ["granular.nothing", "reduced_models.errors", "granular.shared.x"])
def test_a_module_that_never_was_is_not_found(name: str) -> None:
    with pytest.raises(ModuleNotFoundError, match=name):
        importlib.import_module(name)


def test_nothing_that_moved_is_imported_before_it_is_asked_for() -> None:
    code = f"import sys, granular, reduced_models; print({set(MOVED.values())} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.strip() == "set()"


def test_no_former_path_hides_a_public_name() -> None:
    public = {
        f"{one.__name__}.{name}" for one in (granular, reduced_models) for name in one.__all__
    }
    assert not public & MOVED.keys()
