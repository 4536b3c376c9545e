"""Text from users is never run as code: functions that could run it are called only in listed places."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("granular", "reduced_models", "validation", "research", "benchmarks")

NAMES = {"eval", "exec", "compile", "__import__", "execfile", "input", "breakpoint"}
"""Built-in functions."""
CALLED = {
    "sympify",
    "parse_expr",
    "lambdify",
    "parse_latex",
    "nsimplify",
    "import_module",
    "run_path",
    "run_module",
    "system",
    "popen",
    "getoutput",
    "getstatusoutput",
    "read_pickle",
    "unsafe_load",
    "full_load",
}
"""Functions of modules, by their last name."""
PICKLES = {"pickle", "_pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
"""Modules whose load or loads builds any object."""
COMMANDS = {"subprocess", "os", "asyncio", "pty"}

ALLOWED = {
    (
        "granular/formulas/algebra.py",
        "lambdify",
    ): "the one place at which formulas become code: trees of the grammar, with generated names",
    ("granular/shared/user_file.py", "exec"): "the file given by the user on the command line, by --import",
    ("granular/shared/user_file.py", "compile"): "the same file",
    ("granular/run/plan.py", "import_module"): "two modules of Numba, by names in the source",
    ("granular/shared/errors.py", "import_module"): "libraries of the extras, by names in the source",
    (
        "granular/compiled/kernel_cache.py",
        "pickle.loads",
    ): "sealed compiled code, in a folder owned by the user alone",
    ("granular/effects/custom_law.py", "compile"): "Numba's method, for a function defined in a file",
    ("reduced_models/jax_setup.py", "pickle.loads"): "sealed programs, in a folder owned by the user alone",
    ("benchmarks/available_engines.py", "import_module"): "names from a table in the source",
    ("validation/console_script.py", "import_module"): "the three packages' own names",
    ("validation/console_script.py", "complete with shell"): "prints a script; runs no shell",
}
"""Places of such calls, and the reason why they never get user text."""


def is_constant(node: ast.Call) -> bool:
    """Return True if all arguments of a call are constants in the source."""
    return bool(node.args) and all(isinstance(one, ast.Constant) for one in node.args)


def suspicious(node: ast.Call) -> str | None:
    """Return the name of the called function if it could run its argument as code, otherwise None."""
    function = node.func
    if isinstance(function, ast.Name):
        name, owner = function.id, ""
    elif isinstance(function, ast.Attribute):
        name = function.attr
        owner = function.value.id if isinstance(function.value, ast.Name) else ""
    else:
        return None
    words = {one.arg: one.value for one in node.keywords}
    for word in ("shell", "allow_pickle"):
        value = words.get(word)
        if value is not None and not (isinstance(value, ast.Constant) and value.value is False):
            return f"{name} with {word}"
    if name in NAMES and not owner:
        return name
    if name in CALLED and not (name == "import_module" and is_constant(node)):
        return None if owner == "platform" else name
    if owner in PICKLES and name in {"load", "loads", "Unpickler", "open"}:
        return f"{owner}.{name}"
    if owner in COMMANDS and name.startswith(("exec", "spawn", "create_subprocess_shell")):
        return f"{owner}.{name}"
    if name == "S" and owner == "sympy":
        return "sympy.S"
    return None


def found(path: Path) -> Iterator[tuple[str, str, int]]:
    place = path.relative_to(ROOT).as_posix()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and (name := suspicious(node)) is not None:
            yield place, name, node.lineno
        if isinstance(node, ast.ImportFrom) and node.module in PICKLES:
            for one in node.names:
                if one.name in {"load", "loads", "Unpickler"}:
                    yield place, f"{node.module}.{one.name}", node.lineno
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sympy"):
            for one in node.names:
                if one.name in CALLED:
                    yield place, one.name, node.lineno


def test_functions_that_could_run_user_text_as_code_are_called_only_in_listed_places() -> None:
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    assert len(files) > 100
    calls = [call for path in files for call in found(path)]
    assert not [call for call in calls if call[:2] not in ALLOWED]
    # A listed place that no longer exists must be removed from the list.
    assert set(ALLOWED) == {call[:2] for call in calls}


@pytest.mark.parametrize(
    "source",
    [
        "eval(text)",
        "exec(text)",
        "compile(text, '', 'exec')",
        "__import__(name)",
        "sympy.sympify(text)",
        "sympy.parse_expr(text)",
        "from sympy import parse_expr",
        "sympy.S(text)",
        "sympy.lambdify(x, text)",
        "importlib.import_module(name)",
        "pickle.loads(content)",
        "from pickle import loads",
        "os.system(text)",
        "subprocess.run(text, shell=True)",
        "subprocess.run(text, shell=given)",
        "os.execv(path, words)",
        "np.load(path, allow_pickle=True)",
    ],
)
def test_the_search_detects_calls_that_run_text_as_code(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "module.py").write_text(source)
    assert list(found(tmp_path / "module.py"))


@pytest.mark.parametrize(
    "source",
    [
        "re.compile(pattern)",
        "importlib.import_module('distributed')",
        "platform.system()",
        "np.load(path, allow_pickle=False)",
        "subprocess.run(words)",
        "json.loads(text)",
        "ast.parse(text, mode='eval')",
    ],
)
def test_the_search_accepts_safe_calls(source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "module.py").write_text(source)
    assert not list(found(tmp_path / "module.py"))
