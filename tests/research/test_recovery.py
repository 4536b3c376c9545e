"""The recovery benchmark, which fits laws to synthetic records: its systems, and one complete fit."""

import datetime
import json
from pathlib import Path

import numpy as np
import pytest

from research.recovery import peer, runner
from research.recovery.__main__ import CAMPAIGN
from research.recovery.systems import REACHED, SYSTEMS, law_of_system, make_noisy_record, noiseless_motion
from research.recovery.text import table_and_totals_markdown, table_and_totals_text


def test_records_of_the_thirteen_benchmark_systems_are_reproducible() -> None:
    assert len(SYSTEMS) == len({system.name for system in SYSTEMS}) == 13
    for name in ("hardening Duffing", "softening Duffing"):
        motion = noiseless_motion([system.name for system in SYSTEMS].index(name))
        swing = motion.height - motion.height[-1000:].mean()
        halves = np.diff(motion.time[np.flatnonzero(np.diff(np.sign(swing)))])
        assert len(halves) > 280
        assert abs(np.log(halves[:5].mean() / halves[-5:].mean())) > np.log(1.25)
    one, other = make_noisy_record(0, 0.01, 0), make_noisy_record(0, 0.01, 1)
    assert np.array_equal(one.height, make_noisy_record(0, 0.01, 0).height)
    assert not np.array_equal(one.height, other.height)


def test_fits_of_one_system_are_compared_with_scipy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Finished fits are reused."""
    monkeypatch.setattr(runner, "SYSTEMS", SYSTEMS[:1])
    found = runner.run_recovery_study(tmp_path, progress=False)
    assert found["fits"] == found["reached"] == 1
    assert found["wrongly agreed"] == found["rows"][0]["SciPy starts stopped"] == 0
    assert "1 of 1 fits" in table_and_totals_text(found)
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8")) == found
    today = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d")
    assert f"(`python -m research.recovery --quick` on {today}" in table_and_totals_markdown(found)
    for name in ("_run_toolkit_fit", "fit_with_scipy_from_each_start"):
        monkeypatch.setattr(runner, name, pytest.fail)
    assert runner.run_recovery_study(tmp_path, progress=False) == found


def test_the_guide_agrees_with_the_results_file() -> None:
    found = CAMPAIGN.read_committed_results()
    assert CAMPAIGN.outdated_blocks(found) == []
    assert CAMPAIGN.outdated_blocks({**found, "reached": 0}) == ["docs/results/real-records.md: table"]


def test_a_parametric_drive_is_identified() -> None:
    """Its frequency is not a line of the spectrum, but splits the lines of the motion. The noise is 10 %."""
    system = next(k for k, item in enumerate(SYSTEMS) if item.name == "parametric")
    fitted = runner._run_toolkit_fit(runner.RecoveryCase(system, 0.1, 0))
    assert fitted["ratio"] <= REACHED
    assert fitted["agree"] > 0.1


def test_scipy_is_stopped_after_a_maximum_number_of_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """For a Bouc-Wen law, SciPy's steps become tiny at some parameters."""
    place = [system.name for system in SYSTEMS].index("Bouc-Wen")
    record = make_noisy_record(place, 0.01, 0)
    given = peer.make_problem(record, law_of_system(SYSTEMS[place]), 1)
    monkeypatch.setattr(peer, "MOST_CALLS", 20)
    attempt = peer.fit_with_scipy_from_each_start(given)[0]
    assert attempt.stopped
    assert attempt.calls == 20 * len(record)
    assert 0.01 * record.height.std() < attempt.residual < 1e6

    monkeypatch.setattr(runner, "SYSTEMS", SYSTEMS[place : place + 1])
    monkeypatch.setattr(runner, "law_of_system", law_of_system)
    monkeypatch.setattr(runner, "make_noisy_record", lambda *_: record)
    fitted = {"ratio": 1.0, "agree": 1.0, "seconds": 1.0}
    monkeypatch.setattr(runner, "_run_toolkit_fit", lambda _: fitted)
    text = table_and_totals_text(runner.run_recovery_study(progress=False))
    assert "1 of 1 at 20,000 calls" in text
    assert "Each fit by SciPy is stopped after" in text
