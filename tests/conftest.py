"""Scenes and helpers shared by many tests."""

from __future__ import annotations

import gc
import importlib
import io
import os
import signal
import subprocess
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import xarray

from granular import Scene, load_scene
from granular.commands.console import run_command_and_return_exit_code
from granular.run.trajectory import Trajectory, make_trajectory
from granular.shared.files import ResultCache
from granular.shared.garbage import RARE

ROOT = Path(__file__).parent.parent

LONG_FILES = (
    "reduced_models/fitting/test_fit.py",
    "architecture/test_plain_python.py",
    "reduced_models/discovery/test_discovery.py",
    "granular/compiled/test_cache.py",
    "reduced_models/identification/test_identify.py",
    "granular/run/test_simulate.py",
    "reduced_models/identification/test_compare.py",
    "physics/test_contact.py",
    "reduced_models/designs/test_design.py",
    "research/published/test_running.py",
    "reduced_models/models/test_printed_equation.py",
    "granular/effects/test_custom.py",
    "reduced_models/models/test_ports.py",
    "granular/effects/test_host.py",
    "reduced_models/fitting/test_search.py",
    "granular/render/test_movie.py",
    "reduced_models/test_command_line.py",
    "physics/test_friction.py",
    "reduced_models/fitting/test_forces.py",
    "reduced_models/fitting/test_observations.py",
    "reduced_models/fitting/test_driven.py",
    "reduced_models/laws/test_laws.py",
    "reduced_models/records/test_release.py",
)
"""Files that take longest without compiled code, ten seconds or more.

Fits and simulations alternate, so that two neighbouring workers rarely compile the same code twice.
"""


LEAST_SECONDS = 60.0
"""Minimum duration of a run that shows seconds by folder."""


def pytest_configure(config: pytest.Config) -> None:
    """Let workers take the files in the order given below, and limit their threads.

    Workers use all cores, so that threads of linear algebra would only compete.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put files with long run times first, since one that starts last leaves the other workers idle."""
    place = {ROOT / "tests" / name: k for k, name in enumerate(LONG_FILES)}
    items.sort(key=lambda item: place.get(item.path, len(place)))


def pytest_collection_finish() -> None:
    """Collect garbage rarely, which saves an eighth of the compilation time.

    Compilers make millions of objects, few of them in reference cycles.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*RARE)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show the seconds of each folder of tests, for which CONTRIBUTING.md sets limits."""
    seconds: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for one in reports:
            if isinstance(one, pytest.TestReport):
                seconds[one.nodeid.split("/")[1]] += one.duration
    if seconds.total() > LEAST_SECONDS:
        terminalreporter.section("seconds by folder, of all workers together")
        for folder, length in seconds.most_common():
            terminalreporter.write_line(f"{length:6.0f} s  {folder}")


@pytest.fixture(autouse=True, scope="session")
def user_table(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Store measured costs of scenes in a temporary folder instead of the user's."""
    kept = ResultCache(tmp_path_factory.mktemp("work-precision"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("granular.run.work_precision.user_work_precision_table", lambda: kept)
        yield


@pytest.fixture(scope="session")
def bed() -> Scene:
    """Return the packaged bed."""
    return load_scene("bed")


@pytest.fixture(scope="session")
def damper() -> Scene:
    """Return the packaged damper."""
    return load_scene("damper")


@pytest.fixture(scope="session")
def small_bed(bed: Scene) -> Scene:
    """Return a bed of 23 grains, for tests that need many runs."""
    return bed.replace(
        **{"grains.count": 23, "cell.width": "15 D", "piston.height": "6 D", "arrangement.height": "5.5 D"}
    )


@pytest.fixture(scope="session")
def small_damper(damper: Scene) -> Scene:
    """Return a damper of 23 grains, with a piston at rest on it."""
    return damper.replace(
        **{
            "grains.count": 23,
            "cell.width": "15 D",
            "piston.height": "6 D",
            "piston.mass": 1.0,
            "arrangement.height": "5.5 D",
        }
    )


FRAMES, GRAINS = 90, 7
"""Of the made run."""


@pytest.fixture(scope="session")
def mixture(small_bed: Scene) -> Scene:
    """Return seven grains of two species, held for one second and compressed for two."""
    return small_bed.replace(
        **{
            "grains.count": GRAINS,
            "grains.species": [
                {"name": "big", "diameter": "5 mm", "share": 0.6},
                {"name": "two words, 100 %", "diameter": "3 mm", "share": 0.4},
            ],
            "protocol": [
                {"kind": "hold", "name": "relax", "duration": 1.0},
                {"kind": "move", "name": "compress", "to": "20 mm", "speed": "5 mm/s"},
            ],
        }
    )


@pytest.fixture(scope="session")
def run(mixture: Scene) -> Trajectory:
    """Return a random motion with a frame every 0.5 ms (250 of de Paula's time steps).

    One grain leaves after 40 frames.
    """
    random = np.random.default_rng(7)
    height = 0.03
    every = 2.5e-4 * 2.0
    shape = (FRAMES, GRAINS, 2)
    place = random.uniform(0.0, 1.0, shape) * [mixture.cell.width, height]
    fields = {
        "position": place,
        "velocity": random.normal(0.0, 0.1, shape),
        "force": random.normal(0.0, 0.3, shape),
    }
    for field in fields.values():
        field[40:, -1] = np.nan
    time = np.arange(10 * FRAMES) * every / 10.0
    data = xarray.Dataset(
        {name: (("frame", "grain", "axis"), field) for name, field in fields.items()}
        | {
            "frame_time": ("frame", np.arange(FRAMES) * every),
            "frame_height": ("frame", np.linspace(height, 0.02, FRAMES)),
            "piston_height": ("time", np.linspace(height, 0.02, 10 * FRAMES)),
            "piston_force": ("time", np.linspace(1.0, 2.0, 10 * FRAMES)),
            "stage": ("time", np.zeros(10 * FRAMES, dtype=int)),
        },
        coords={"time": time},
    )
    stages = [
        {"name": "relax", "start": 0.0, "end": 1.0, "reason": "duration", "height": height, "spread": 0.0},
        {"name": "compress", "start": 1.0, "end": 3.0, "reason": "duration", "height": 0.02, "spread": 0.0},
    ]
    outcome = {"stages": stages, "complete": True, "figures": {}}
    return make_trajectory(
        mixture.replace(**{"piston.height": height}), data, {"method": "none"}, outcome, None
    )


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Let Ctrl-C stop this process and its children, even if the shell ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(20260101)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install a distribution for one test, given its entry points and its module's source."""

    def install(kind: str, source: str, offered: dict[str, str]) -> None:
        module = f"laboratory_{kind}"
        about = tmp_path / "laboratory-1.0.dist-info"
        about.mkdir()
        (tmp_path / f"{module}.py").write_text(source)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: laboratory\nVersion: 1.0\n")
        points = (f"{name} = {module}:{held}\n" for name, held in offered.items())
        (about / "entry_points.txt").write_text(f"[granular.{kind}]\n{''.join(points)}")
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, module, raising=False)

    return install


Done = subprocess.CompletedProcess[str]


@pytest.fixture(scope="session")
def command() -> Callable[..., Done]:
    """Run the command line of a package in this process, and return output and exit code."""

    def run(package: str, *words: str) -> Done:
        main = importlib.import_module(f"{package}.__main__").main
        said, told = io.StringIO(), io.StringIO()
        # Changes of warning filters by a command must not persist.
        with redirect_stdout(said), redirect_stderr(told), warnings.catch_warnings():
            try:
                code = run_command_and_return_exit_code(main, words)
            except SystemExit as stop:  # --help
                code = int(stop.code or 0)
        return Done((package, *words), code, said.getvalue(), told.getvalue())

    return run


@pytest.fixture(scope="session")
def process() -> Callable[..., Done]:
    """Run ``python -m`` with arguments in a separate process and environment."""

    def run(*words: str, **environment: str) -> Done:
        return subprocess.run(
            [sys.executable, "-m", *words],
            capture_output=True,
            text=True,
            cwd=ROOT,
            env=os.environ | environment,
            timeout=600,
            check=False,
        )

    return run
