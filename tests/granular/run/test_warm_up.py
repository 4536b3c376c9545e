"""A warm cache: later starts compile nothing."""

import json
from pathlib import Path

import numba
import pytest

from granular import load_scene, simulate
from granular.__main__ import main
from granular.commands.console import launch
from granular.compiled.numba_insides import kernel_cache_folder, report_compiled_kernels
from granular.run import engines

ROOT = Path(__file__).parents[3]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_what_was_warmed_up_is_kept_and_compiled_no_more(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop in a file of its own: for the types that the run gives it."""
    assert launch(main, ["scenes", "--warm-up", "single-particle", "--json"]) == 0
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
