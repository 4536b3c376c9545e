"""Metadata of the distribution are consistent.

Simulations and fits each work without the packages needed only by the other.
"""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from granular import __version__
from granular.shared.errors import (
    NEEDED_BY,
    InputError,
    MissingPackageError,
    missing_package_error,
    with_missing_package_advice,
)

ROOT = Path(__file__).parents[2]
PROJECT_FILE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT: dict[str, Any] = PROJECT_FILE["project"]


def group(name: str) -> set[str]:
    """Return the requirements of a dependency group, including nested groups."""
    found: set[str] = set()
    for one in PROJECT_FILE["dependency-groups"][name]:
        found |= {one} if isinstance(one, str) else group(one["include-group"])
    return found


def test_requirements_of_simulations_and_fits_are_together_all_requirements_of_the_package() -> None:
    assert group("simulation") | group("fits") == set(PROJECT["dependencies"])


def test_the_installation_option_all_includes_every_extra_for_users() -> None:
    (words,) = PROJECT["optional-dependencies"]["all"]
    inside = set(re.findall(r"[a-z0-9]+", words.partition("[")[2]))
    for_developers = {"all", "dev", "docs", "lammps", "notebooks", "peers", "programs", "test"}
    assert inside == set(PROJECT["optional-dependencies"]) - for_developers


def test_the_citation_file_has_the_version_of_the_package() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in citation


def test_changelog_begins_with_unreleased_changes_or_the_present_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## \[(.+?)\]", text, re.MULTILINE)
    assert versions[0] == "Unreleased"
    assert versions[1:2] in ([], [__version__])


def test_the_readme_of_the_distribution_has_no_relative_link() -> None:
    settings = PROJECT_FILE["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    (rule,) = settings["substitutions"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", readme)
    made = re.findall(r"\]\(([^)]+)\)", re.sub(rule["pattern"], rule["replacement"], readme))
    assert any(not link.startswith("https://") for link in links)
    assert all(link.startswith("https://") for link in made)
    assert PROJECT["urls"]["Source"] + "/docs/images/fall.gif" in made


def test_the_conda_recipe_has_the_same_requirements_as_the_pip_package() -> None:
    recipe = (ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    assert f'version: "{__version__}"' in recipe
    run = recipe.partition("  run:\n")[2].partition("tests:")[0]
    asked = {row.replace(" ", "").replace("-base", "") for row in re.findall(r"- (.+)", run)}
    assert asked == {"python" + PROJECT["requires-python"]} | set(PROJECT["dependencies"])


def test_workflows_run_existing_scripts_on_every_supported_version_of_python() -> None:
    text = "".join(one.read_text() for one in sorted((ROOT / ".github/workflows").glob("*.yml")))
    scripts = set(re.findall(r"- run: (\.ci/\w+)", text))
    assert {".ci/run", ".ci/lowest", ".ci/wheel", ".ci/coverage"} <= scripts
    assert all(os.access(ROOT / one, os.X_OK) for one in scripts)
    (matrix,) = re.findall(r"python: \[(.+)\]", text)
    promised = re.findall(r"Python :: (3\.\d+)", " ".join(PROJECT["classifiers"]))
    assert re.findall(r"3\.\d+", matrix) == promised


def test_installation_page_lists_the_requirements_of_simulations_and_of_fits() -> None:
    page = (ROOT / "docs" / "guide" / "installation.md").read_text(encoding="utf-8")
    for name in ("simulation", "fits"):
        (line,) = re.findall(rf"^pip install (.+?) +# {name}$", page, re.MULTILINE)
        assert set(line.split()) == {re.split("[><=]", one)[0] for one in group(name)}


def test_installation_page_lists_every_extra() -> None:
    page = (ROOT / "docs" / "guide" / "installation.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert sorted(listed) == sorted(PROJECT["optional-dependencies"])


def half(without: str, code: str) -> None:
    """Run code in a process without the modules needed only by simulations, or only by fits."""
    blocked = [name for name, need in NEEDED_BY.items() if need == without]
    # Pillow comes with matplotlib, which both halves have.
    hidden = f"import sys; sys.modules |= dict.fromkeys({blocked!r}); sys.modules.pop('PIL', None)"
    done = subprocess.run(
        [sys.executable, "-c", f"{hidden}\n{code}"], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr


MISSES = """
try:
    from {package} import {name}
except ImportError as error:
    assert {module!r} in str(error) and {group!r} in str(error), error
else:
    raise AssertionError("{name} was found")
"""


def test_fits_work_without_the_requirements_of_simulations() -> None:
    half(
        "simulation",
        "from granular import PistonRecord\n"
        "from reduced_models import commands, compare, discover, fit, identify\n"
        "from reduced_models.identification import page\n"
        "from reduced_models.records.sources import load_record\n"
        "assert 'jax' in sys.modules\n"
        + MISSES.format(package="granular", name="simulate", module="numba", group="simulation"),
    )


def test_simulations_work_without_the_requirements_of_fits() -> None:
    half(
        "fits",
        "from granular import evaluate, load_scene, simulate, sweep\n"
        "from granular.render import still\n"
        "assert load_scene('damper').piston is not None\n"
        + MISSES.format(package="reduced_models", name="fit", module="is not installed", group="fits"),
    )


def test_import_error_of_an_unrelated_package_is_passed_on_unchanged() -> None:
    error = ModuleNotFoundError("No module named 'tea'", name="tea")
    assert missing_package_error(error) is None

    def attribute(name: str) -> Any:
        raise error

    with pytest.raises(ModuleNotFoundError, match="tea"):
        with_missing_package_advice(attribute)("leaves")


def test_error_for_a_missing_requirement_is_an_input_error_and_an_import_error() -> None:
    found = missing_package_error(ModuleNotFoundError("No module named 'jax.numpy'", name="jax.numpy"))
    assert isinstance(found, MissingPackageError)
    assert isinstance(found, InputError)
    assert isinstance(found, ImportError)
    assert "pip install granular-damper" in str(found)
