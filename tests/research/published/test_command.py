"""The command line: what comes with the package is shown without running anything."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from granular.commands.console import launch
from research.published.__main__ import CAMPAIGN

QUICK_FORCES = {
    "piston_force_direct_sum.mean[0]": 0.03,
    "piston_force_direct_sum.mean[4]": 0.03,
    "half_mean_distance.minimum[0]": 0.005,
    "half_mean_distance.minimum[3]": 0.005,
    "half_mean_distance.minimum[7]": 0.005,
}


def test_committed_results_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert launch(CAMPAIGN.main, ["-o", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    numbers = found["summary"]
    assert sum(numbers.values()) == len(found["entries"])
    assert sum(found["statement_counts"].values()) == len(found["statements"])
    assert found["series"]["stale"] == 0
    assert all(one["verdict"] for one in found["entries"])
    written = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert written == found
    assert (tmp_path / "report.html").stat().st_size > 10_000
    assert not (tmp_path / "cases").exists()


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert launch(CAMPAIGN.main, ["--workers", "0", "-o", str(tmp_path)]) == 2
    assert "--workers 0; give 1 or more" in capsys.readouterr().err
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    assert launch(CAMPAIGN.main, ["-o", str(file / "below")]) == 2
    assert "give another place" in capsys.readouterr().err


def test_an_unknown_entry_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert launch(CAMPAIGN.main, ["--only", "damper.rest_heigth"]) == 2
    assert "did you mean 'damper.rest_height'" in capsys.readouterr().err


@pytest.mark.long
def test_references_of_the_committed_file_are_todays() -> None:
    """Three series drawn by a seed: what the code gives now is what it gave when they were run."""
    import random

    from research.published.plan import full_plan
    from research.published.reference import agrees, reference
    from research.published.results import committed

    found = committed().series
    done = [one for group in full_plan() for one in group.series if found[one.key]["done"]]
    for series in random.Random(5).sample(done, 3):
        assert agrees(found[series.key]["reference"], reference(series)), series.key


@pytest.mark.long
def test_quick_run_reproduces_what_is_published(tmp_path: Path) -> None:
    from research.published.runner import published

    found = published(tmp_path, "quick", progress=False)
    rows = {one["key"]: one for one in found["quick"]["entries"]}
    for key, tolerance in QUICK_FORCES.items():
        assert rows[key]["ours"] == pytest.approx(rows[key]["published"], rel=tolerance), key
        assert rows[key]["starts"] == 3
    fractions = [one for key, one in rows.items() if key.startswith("voronoi") and one["ours"]]
    assert len(fractions) >= 15
    for one in fractions:
        assert one["ours"] == pytest.approx(one["published"], abs=0.04), one["key"]
