"""Packages import each other in one direction only, and importing them is fast."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FORBIDDEN = {
    "granular": {"reduced_models", "validation", "research", "benchmarks"},
    "reduced_models": {"validation", "research", "benchmarks"},
    "validation": {"research", "benchmarks"},
    "research": {"benchmarks"},
    "benchmarks": {"research"},
}
HEAVY = ("numba", "jax", "matplotlib", "pandas", "xarray", "zarr", "sympy", "scipy")


def imported(path: Path) -> set[str]:
    """Return the top-level packages that a file imports anywhere, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


def module_name(path: Path, root: Path) -> str:
    name = ".".join(path.relative_to(root).with_suffix("").parts)
    return name.removesuffix(".__init__")


def named_modules(path: Path, root: Path) -> set[str]:
    """Return every dotted name in a file's imports that may be a module."""
    package = module_name(path.parent, root)
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")
            above = above[: len(above) - node.level + 1] if node.level else []
            start = ".".join([*above, *([node.module] if node.module else [])])
            found |= {start, *(f"{start}.{name.name}" for name in node.names)}
    return found


def imports_within(package: str, root: Path = ROOT) -> dict[str, set[str]]:
    """Return, for each module of a package, the modules of the same package that it imports."""
    paths = {module_name(path, root): path for path in (root / package).rglob("*.py")}
    return {name: (named_modules(path, root) & paths.keys()) - {name} for name, path in paths.items()}


def folder_of(module: str) -> str:
    """Return the folder that contains a module within its package, or the module if there is no such
    folder.
    """
    return ".".join(module.split(".")[:2])


def imports_of_folders(package: str, root: Path = ROOT) -> dict[str, set[str]]:
    """Return the imports between folders of a package.

    The package's `__init__.py`, which re-exports names, is not counted.
    """
    arrows: dict[str, set[str]] = {}
    for name, ends in imports_within(package, root).items():
        if name != package:
            reached = arrows.setdefault(folder_of(name), set())
            reached |= {folder_of(end) for end in ends} - {folder_of(name), package}
    return arrows


def circles(arrows: dict[str, set[str]]) -> set[str]:
    """Return the modules that are part of a circular import, or on a chain of imports between two of them."""
    while True:
        reached = set().union(*arrows.values())
        left = {name for name, ends in arrows.items() if ends and name in reached}
        if left == arrows.keys():
            return left
        arrows = {name: arrows[name] & left for name in left}


WITHOUT_CIRCLES = tuple(FORBIDDEN)


@pytest.mark.parametrize("package", WITHOUT_CIRCLES)
def test_modules_have_no_circular_imports(package: str) -> None:
    """Imports inside functions and imports only for type checkers are included."""
    assert circles(imports_within(package)) == set()


@pytest.mark.parametrize("package", WITHOUT_CIRCLES)
def test_folders_have_no_circular_imports(package: str) -> None:
    """A reader can therefore take the folders in the order of their imports, which `lint-imports` checks."""
    assert circles(imports_of_folders(package)) == set()


def test_a_circular_import_is_detected(tmp_path: Path) -> None:
    (tmp_path / "house" / "room").mkdir(parents=True)
    for name, text in {
        "__init__": "from house.room import table",
        "low": "import math",
        "high": "from house import low",
        "room/__init__": "",
        "room/table": "def turned():\n    from ..room.chair import leg",
        "room/chair": "if False:  # as for type checkers\n    import house.room.table",
    }.items():
        (tmp_path / "house" / f"{name}.py").write_text(text, encoding="utf-8")
    assert circles(imports_within("house", tmp_path)) == {"house.room.table", "house.room.chair"}
    assert circles(imports_of_folders("house", tmp_path)) == set()
    (tmp_path / "house" / "low.py").write_text("from house.room import table", encoding="utf-8")
    (tmp_path / "house" / "room" / "table.py").write_text("import house.low", encoding="utf-8")
    assert circles(imports_of_folders("house", tmp_path)) == {"house.low", "house.room"}


@pytest.mark.parametrize("package", FORBIDDEN)
def test_imports_between_packages_go_one_way(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    wrong = {str(path): imported(path) & FORBIDDEN[package] for path in files}
    assert not {path: names for path, names in wrong.items() if names}


@pytest.mark.parametrize("package", FORBIDDEN)
def test_importing_a_package_loads_no_heavy_library(package: str) -> None:
    code = f"import sys, {package}; print([one for one in {HEAVY!r} if one in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


PACKAGES = (
    "granular",
    "granular.observables",
    "granular.schema",
    "reduced_models",
    "reduced_models.laws",
    "reduced_models.machines",
    "validation",
)


@pytest.mark.parametrize("name", PACKAGES)
def test_no_module_has_the_name_of_a_public_function_of_its_package(name: str) -> None:
    """On import, the module would replace the function as an attribute of the package."""
    package = importlib.import_module(name)
    modules = {one.name for one in pkgutil.iter_modules(package.__path__)}
    assert not modules & set(package.__all__)


def test_files_have_at_most_600_lines() -> None:
    long = {
        str(path.relative_to(ROOT)): lines
        for package in FORBIDDEN
        for path in (ROOT / package).rglob("*.py")
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > 600
    }
    assert not long
