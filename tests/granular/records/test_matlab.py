"""MATLAB files with a start and an interval, or with times, and what cannot be either."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from granular import PistonRecord
from granular.shared.errors import RecordError

HEIGHT = 55.0 + np.sin(np.arange(60.0))


def saved(path: Path, **variables: Any) -> Path:
    scipy.io.savemat(path, variables)
    return path


def test_a_letter_is_a_channel_and_no_acceleration(tmp_path: Path) -> None:
    """Nor a force, nor a time: a letter of an oscilloscope says nothing."""
    times = {"Tstart": 0.0, "Tinterval": 0.01}
    for letters in ("A", "AB", "FH"):
        path = saved(tmp_path / "a.mat", **times, **dict.fromkeys(letters, HEIGHT))
        with pytest.raises(RecordError, match="only channels: ") as caught:
            PistonRecord.from_file(path)
        assert f"--columns height={letters[0]} --units height=mm" in str(caught.value)
        said = {"columns": {"height": letters[-1]}, "units": {"height": "mm"}}
        record = PistonRecord.from_file(path, **said)
        assert record.height == pytest.approx(1e-3 * HEIGHT)
        assert record.time == pytest.approx(0.01 * np.arange(60))
    path = saved(tmp_path / "b.mat", time=0.01 * np.arange(60), A=HEIGHT)
    with pytest.raises(RecordError, match="only the acceleration 'A'"):
        PistonRecord.from_file(path)


@pytest.mark.parametrize(
    "numbers",
    [
        {"Tinterval": 0.0},
        {"Tinterval": -0.01},
        {"Tinterval": math.nan},
        {"Tinterval": "fast"},
        {"Tinterval": np.arange(3.0)},
        {"Tinterval": 1j},
        {"Tinterval": 0.01, "Tstart": "noon"},
        {"Tinterval": 0.01, "Tstart": np.zeros(3)},
        {"Tinterval": 0.01, "Tstart": 1j},
        {"Tinterval": 0.01, "Tstart": math.inf},
    ],
    ids=str,
)
def test_a_wrong_interval_is_one_line(numbers: dict[str, Any], tmp_path: Path) -> None:
    path = saved(tmp_path / "a.mat", height=HEIGHT, **numbers)
    with pytest.raises(RecordError, match="Tinterval = ") as caught:
        PistonRecord.from_file(path)
    assert "\n" not in str(caught.value)


def test_times_that_are_there_count(tmp_path: Path) -> None:
    """Next to an interval of any kind."""
    time = 0.02 * np.arange(60)
    for step in (0.01, 0.0, "fast"):
        path = saved(tmp_path / "a.mat", time=time, height=HEIGHT, Tinterval=step)
        assert PistonRecord.from_file(path).time == pytest.approx(time)
        path = saved(tmp_path / "b.mat", column=time, height=HEIGHT, Tinterval=step)
        assert PistonRecord.from_file(path, columns={"time": "column"}).time == pytest.approx(time)
