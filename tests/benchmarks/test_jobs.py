"""Jobs are timed as users start them, with the processors of all their processes."""

from __future__ import annotations

import pytest

from benchmarks import jobs

BUSY = """
import json, time
started = time.process_time()
while time.process_time() - started < 0.3:
    pass
print(json.dumps({"seconds": {"loop": 0.3}}))
"""


def test_processor_time_and_parts_are_those_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "JOBS", {jobs.MAIN: ("-c", BUSY), "idle": ("-c", "pass")})
    busy, idle = jobs.job_times([jobs.MAIN, "idle"])
    assert 0.3 <= busy["processor"] <= busy["seconds"] + 0.5
    assert busy["parts"] == {"loop": 0.3}
    assert idle["processor"] < busy["processor"] - 0.2
    assert idle["parts"] == {}
