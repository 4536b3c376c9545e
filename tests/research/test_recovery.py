"""The recovery suite: its systems, and one complete fit."""

import datetime
import json
from pathlib import Path

import numpy as np
import pytest

from research.recovery import peer, runner
from research.recovery.__main__ import CAMPAIGN
from research.recovery.systems import REACHED, SYSTEMS, clean_motion, law_of_system, made_record
from research.recovery.text import recovery_markdown, recovery_text


def test_thirteen_systems() -> None:
    assert len(SYSTEMS) == len({system.name for system in SYSTEMS}) == 13
    for name in ("hardening Duffing", "softening Duffing"):
        motion = clean_motion([system.name for system in SYSTEMS].index(name))
        swing = motion.height - motion.height[-1000:].mean()
        halves = np.diff(motion.time[np.flatnonzero(np.diff(np.sign(swing)))])
        assert len(halves) > 280
        assert abs(np.log(halves[:5].mean() / halves[-5:].mean())) > np.log(1.25)
    one, other = made_record(0, 0.01, 0), made_record(0, 0.01, 1)
    assert np.array_equal(one.height, made_record(0, 0.01, 0).height)
    assert not np.array_equal(one.height, other.height)


def test_one_system_is_compared_with_scipy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Finished fits are reused."""
    monkeypatch.setattr(runner, "SYSTEMS", SYSTEMS[:1])
    found = runner.recovery(tmp_path, progress=False)
    assert found["fits"] == found["reached"] == 1
    assert found["wrongly agreed"] == found["rows"][0]["SciPy starts stopped"] == 0
    assert "1 of 1 fits" in recovery_text(found)
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8")) == found
    today = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d")
    assert f"(`python -m research.recovery --quick` on {today}" in recovery_markdown(found)
    for name in ("_fitted", "scipy_fit"):
        monkeypatch.setattr(runner, name, pytest.fail)
    assert runner.recovery(tmp_path, progress=False) == found


def test_the_guide_agrees_with_the_results_file() -> None:
    found = CAMPAIGN.committed()
    assert CAMPAIGN.different(found) == []
    assert CAMPAIGN.different({**found, "reached": 0}) == ["docs/results/real-records.md: table"]


def test_a_parametric_drive_is_identified() -> None:
    """Its frequency is not a line of the spectrum, but splits the lines of the motion; 10 % of noise."""
    system = next(k for k, item in enumerate(SYSTEMS) if item.name == "parametric")
    fitted = runner._fitted(runner.Case(system, 0.1, 0))
    assert fitted["ratio"] <= REACHED
    assert fitted["agree"] > 0.1


def test_scipy_is_stopped_at_a_number_of_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """For Bouc-Wen the steps become tiny at some parameters; the table gives the number of calls."""
    place = [system.name for system in SYSTEMS].index("Bouc-Wen")
    record = made_record(place, 0.01, 0)
    given = peer.problem(record, law_of_system(SYSTEMS[place]), 1)
    monkeypatch.setattr(peer, "MOST_CALLS", 20)
    attempt = peer.scipy_fit(given)[0]
    assert attempt.stopped
    assert attempt.calls == 20 * len(record)
    assert 0.01 * record.height.std() < attempt.residual < 1e6

    monkeypatch.setattr(runner, "SYSTEMS", SYSTEMS[place : place + 1])
    monkeypatch.setattr(runner, "law_of_system", law_of_system)
    monkeypatch.setattr(runner, "made_record", lambda *_: record)
    fitted = {"ratio": 1.0, "agree": 1.0, "seconds": 1.0}
    monkeypatch.setattr(runner, "_fitted", lambda _: fitted)
    text = recovery_text(runner.recovery(progress=False))
    assert "1 of 1 at 20,000 calls" in text
    assert "A start of SciPy is stopped after" in text
