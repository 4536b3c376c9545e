"""A time-loop engine written in NumPy and installed by a user replaces the compiled loop."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granular import Plan, Scene, load_scene, load_trajectory, simulate
from granular.run import engines, simulation
from granular.run.engines import ENGINES, NUMBA
from granular.shared.errors import InputError, StoreError

PLAIN = """
import numpy as np
from granular.engine import columns
from granular.engine.tick_loop import RUNNING
from granular.kernel_data.state import STEPS, TIME
from granular.pairs.dipole_law import ENERGY, STRENGTH
from granular.run.engines import TickOutcome, record_column_count

def advance(system, state, ticks):
    grains, (window, schedule, *_) = system.constants.grains, ticks
    places, speeds = np.array([state.x, state.y])[:, :grains], np.array([state.vx, state.vy])[:, :grains]

    def forces():
        apart = places[:, :, None] - places[:, None]
        distances = np.hypot(*apart) + np.diag(np.full(grains, np.inf))
        energy = 0.5 * ENERGY * (distances**-3).sum()
        return STRENGTH * (apart / distances**5).sum(axis=2), energy, distances.min()

    def record():
        row = np.zeros(record_column_count(system))
        squares = (speeds**2).sum(axis=0)
        row[columns.TIME] = window.start + state.clock[TIME]
        row[columns.KINETIC] = 0.5 * squares.sum()
        row[columns.PAIR], row[columns.CLOSEST] = forces()[1:]
        row[columns.FASTEST], row[columns.STIFFEST] = np.sqrt(squares.max()), 0.1
        row[columns.GRAINS] = grains
        row[columns.TURNED] = row[columns.KINETIC] + abs(row[columns.PAIR] - ticks.watch.potential)
        return row

    rows, last = [], record()
    for tick in range(window.first, window.first + window.ticks):
        before, after = (one * schedule.given // schedule.every for one in (tick, tick + 1))
        for _ in range(after - before):
            speeds += 0.5 * schedule.h * forces()[0]
            places += schedule.h * speeds
            speeds += 0.5 * schedule.h * forces()[0]
            state.clock[TIME] += schedule.h
            state.clock[STEPS] += 1.0
        state.x[:grains], state.y[:grains] = places
        state.vx[:grains], state.vy[:grains] = speeds
        last = record()
        if (tick + 1) % schedule.every == 0:
            rows.append(last)
    return TickOutcome(RUNNING, window.ticks, np.array([*rows, last]))
"""


@pytest.fixture
def scene() -> Scene:
    """Return a scene with five repelling dipoles."""
    places = [[0.1 + 0.012 * k, 0.1 + 0.012 * (k % 2)] for k in range(5)]
    changes = {f"effects.{name}": None for name in ("walls", "drag", "gravity")}
    return load_scene("single-particle").replace(
        **changes, **{"effects.dipole": {}, "grains.count": 5, "arrangement": {"positions": places}}
    )


def test_installed_engine_reproduces_the_compiled_loop(
    scene: Scene, installed: Callable[..., None], tmp_path: Path
) -> None:
    """Records, frames, energy balance and a resumed run agree with the compiled loop up to rounding."""
    installed("engines", PLAIN, {"plain": "advance"})
    known = simulate(scene, 1e-4, 0.06, progress=False)
    made = simulate(scene, 1e-4, 0.06, engine="plain", progress=False)
    assert made.settings()["engine"] == "plain"
    assert made.settings()["steps"] == known.settings()["steps"] == 600
    for name in ("position", "velocity", "time", "kinetic_energy", "pair_energy"):
        np.testing.assert_allclose(made.dataset[name], known.dataset[name], rtol=1e-10, atol=1e-14)
    assert made.settings()["ledger_residual"] < 1e-4
    out = tmp_path / "run"
    simulate(scene, 1e-4, 0.03, engine="plain", out=out, progress=False)
    with pytest.raises(StoreError, match="another engine: plain, not numba"):
        simulate(scene, 1e-4, 0.06, out=out, resume=True, progress=False)
    resumed = simulate(scene, 1e-4, 0.06, engine="plain", out=out, resume=True, progress=False)
    np.testing.assert_array_equal(resumed.dataset["position"][-1], made.dataset["position"][-1])


def test_a_stored_run_that_names_no_engine_is_resumed_by_the_numba_engine(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = simulation._run_settings

    def former(plan: Plan) -> dict[str, object]:
        return {name: value for name, value in plain(plan).items() if name != "engine"}

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "_run_settings", former)
        simulate(scene, 1e-4, 0.03, out=out, progress=False)
    assert "engine" not in load_trajectory(out).settings()
    resumed = simulate(scene, 1e-4, 0.06, out=out, resume=True, progress=False)
    at_once = simulate(scene, 1e-4, 0.06, progress=False)
    np.testing.assert_array_equal(resumed.dataset["position"], at_once.dataset["position"])


def test_unknown_engine_is_refused_with_a_list_of_engines(
    scene: Scene, installed: Callable[..., None]
) -> None:
    installed("engines", PLAIN, {"plain": "advance"})
    with pytest.raises(
        InputError, match=r"unknown engine 'cuda'; known are numba, plain; a custom engine can be added by an"
    ):
        simulate(scene, engine="cuda", progress=False)
    with pytest.raises(InputError, match="did you mean 'numba'"):
        simulate(scene, engine="nunba", progress=False)


def test_numba_engine_is_registered() -> None:
    assert ENGINES.built_in == (NUMBA,)
    assert ENGINES.find(NUMBA) is engines.advance_with_compiled_loop
