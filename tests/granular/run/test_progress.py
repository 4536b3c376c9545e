"""Announcement and progress bar of long runs, their end by a signal, and compilation in advance."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from granular import Scene, load_scene, load_trajectory, plan, simulate
from granular.__main__ import main
from granular.commands.console import run_command_and_return_exit_code
from granular.compiled import entry
from granular.compiled.numba_insides import kernel_cache_folder, report_compiled_kernels
from granular.run import engines
from granular.run.protocol_runner import ProtocolRunner
from granular.run.run_progress_bar import (
    ApproachToRest,
    RunProgressBar,
    estimate_remaining_step_count,
    remaining_time_text,
)

ROOT = Path(__file__).parents[3]


def test_duration_of_a_long_run_is_announced() -> None:
    assert remaining_time_text(1e12, 1e6) == "up to 1e+12 steps, 12 days at 1e+06 steps a second"
    assert remaining_time_text(2e9, 1e6) == "up to 2e+09 steps, 33 minutes at 1e+06 steps a second"
    assert remaining_time_text(1e20, 1e6) == "up to 1e+20 steps, 3.2e+06 years at 1e+06 steps a second"
    assert remaining_time_text(5e6, 1e6) is None


def test_estimated_number_of_remaining_steps_includes_all_stages() -> None:
    scene = load_scene("single-particle").replace(
        **{"protocol": [{"kind": "hold", "name": name, "duration": 0.01} for name in "abc"]}
    )
    for t_end, count in ((None, 3000), (0.015, 1500), (0.1, 10000)):
        run = ProtocolRunner(plan(scene, 1e-5, t_end=t_end))
        run.advance()
        assert estimate_remaining_step_count(run) + run.step_count == pytest.approx(count)


@pytest.mark.skipif(not hasattr(signal, "SIGTERM"), reason="needs signals")
def test_a_run_that_would_take_weeks_is_announced_and_ends_on_sigterm(tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ("granular", "run", "single-particle", "--dt", "1e-12", "-o", str(out))
    process = subprocess.Popen(
        [sys.executable, "-m", *words, "--set", "protocol.0.duration=1"],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    said = next(line for line in process.stderr if "steps a second" in line)
    assert "up to 1e+12 steps" in said
    process.send_signal(signal.SIGTERM)
    rest = process.communicate(timeout=60)[1]
    assert process.returncode == 143
    assert (
        rest.splitlines()[-1] == f"error: terminated: the results so far are in {out}; to continue, repeat "
        "the command, and add --resume if it is the command run"
    )
    part = load_trajectory(out)
    assert not part.complete
    assert part.settings()["steps"] > 0


def test_progress_bar_of_a_settling_bed_shows_its_motion_and_the_threshold_of_rest(small_bed: Scene) -> None:
    """One grain oscillates with drag, until its motion is so small that the bed counts as at rest."""
    stage = {"kind": "hold", "name": "settle", "until": "rest", "window": 0.2}
    changes = {"protocol": [stage], "effects.drag.coefficient": "5 g/s"}
    scene = small_bed.replace(**{"grains.count": 1}, **changes)
    run = ProtocolRunner(plan(scene, 1e-4))
    fractions, amplitudes = [], []
    run.advance()
    settling = ApproachToRest(run)
    while not run.is_at_end:
        settling.update(run)
        fractions.append(settling.fraction)
        amplitudes.append(settling.amplitude)
        run.advance()
    assert settling.limit == 1e-4
    assert fractions[0] < 0.5
    assert fractions[-1] == 1.0 or amplitudes[-1] < 2.0 * settling.limit
    assert "at rest below 1e-04 D" in str(settling)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("terminal", [False, True])
def test_progress_display_counts_functions_while_they_are_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], terminal: bool
) -> None:
    """Functions outside the package's files are compiled in every process."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    kernels = [entry(lambda x, k=k: x + k) for k in range(5)]
    opening = "compiling for this type of scene, cached for later runs"
    for compiled in (True, False):
        with RunProgressBar(True):
            assert [kernel(1.0) for kernel in kernels] == [1.0, 2.0, 3.0, 4.0, 5.0]
        said = capsys.readouterr().err
        assert said.count(opening) == (0 if not compiled else said.count("\r") if terminal else 2)
        assert (f"{opening}, kernel 5 [" in said) == compiled


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_run_compiles_nothing_after_the_command_scenes_has_compiled_its_code_in_advance(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time loop is cached for the argument types of the run."""
    assert run_command_and_return_exit_code(main, ["scenes", "--warm-up", "single-particle", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told["seconds"]) == ["single-particle"]
    assert told["folder"] == str(kernel_cache_folder())
    kept = set(Path(told["folder"]).glob("*.kernel"))
    compiled: list[int] = []
    loop, met = engines.advance_ticks, []

    def advance(*values: object) -> object:
        met.append(tuple(map(loop.typeof_pyval, values)))
        return loop(*values)

    monkeypatch.setattr(engines, "advance_ticks", advance)
    with report_compiled_kernels(compiled.append):
        simulate(load_scene("single-particle"), t_end=1e-3, progress=False)
    assert not compiled
    assert met
    for types in met:
        file, _ = loop._cache._kernel_file_and_label(types, loop.targetctx.codegen())
        assert file in kept
