"""All public names are documented and exist; notebooks, guide and README use no others."""

import ast
import importlib
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "public.md"
OURS = ("granular", "reduced_models", "validation")


def written() -> dict[str, set[str]]:
    """Return the public names of each module as listed on the reference page."""
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w.]+)` \| (.+) \|$", text, re.MULTILINE)
    rows += re.findall(r"^### From `([\w.]+)`$\n(.*?)(?=^#)", text, re.MULTILINE | re.DOTALL)
    return {module: set(re.findall(r"`(\w+)`", names)) for module, names in rows}


PUBLIC = written()

_PROGRAM = re.compile(r"^from (granular|reduced_models|validation)", re.MULTILINE)


def texts() -> Iterator[tuple[str, str]]:
    """Return the code that users read: notebooks, and the Python blocks of guide and README."""
    for path in sorted((ROOT / "notebooks").glob("*.py")):
        yield path.name, path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        blocks = re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
        for number, block in enumerate(blocks):
            yield f"{path.name}, block {number}", block


def imports(code: str) -> Iterator[tuple[str, str]]:
    """Yield module and name of every import from the toolkit, in code and in programs written as strings."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
            for alias in node.names:
                yield node.module, alias.name
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] in OURS:
                    yield alias.name, ""
        elif isinstance(node, ast.Constant) and _PROGRAM.search(str(node.value)):
            yield from imports(str(node.value))


def test_every_public_module_is_documented() -> None:
    assert set(OURS) < set(PUBLIC)
    for package in OURS:
        found = importlib.import_module(package)
        workspaces = {f"{package}.{one.name}" for one in pkgutil.iter_modules(found.__path__)}
        stubs = {one for one in workspaces if (ROOT / one.replace(".", "/") / "__init__.pyi").is_file()}
        assert stubs <= set(PUBLIC)


@pytest.mark.parametrize("name", PUBLIC)
def test_the_public_names_of_a_module_are_exactly_its_documented_names(name: str) -> None:
    module = importlib.import_module(name)
    assert set(module.__all__) == PUBLIC[name]
    for public in module.__all__:
        assert getattr(module, public) is not None


def test_notebooks_guide_and_readme_import_only_public_names() -> None:
    wrong, seen = [], 0
    for place, code in texts():
        for module, name in imports(code):
            seen += 1
            if name not in PUBLIC.get(module, set()) | {""} or module not in PUBLIC:
                wrong.append(f"{place}: {name} from {module}")
    assert not wrong
    assert seen > 40
