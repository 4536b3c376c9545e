"""Example records: what is found in them is what they were made with."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular.shared.errors import InputError
from reduced_models import fit, read_record
from reduced_models.records.example_records import EXAMPLES, write_example_records

pytestmark = pytest.mark.filterwarnings("ignore::granular.shared.errors.RecordWarning")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with all of them."""
    directory = tmp_path_factory.mktemp("lab")
    assert set(write_example_records(directory)) == {f"{name}.csv" for name in EXAMPLES}
    return directory


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "driven.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(InputError, match=r"driven\.toml is in .* already"):
        write_example_records(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["driven.toml"]


def test_the_same_files_come_again(lab: Path, tmp_path: Path) -> None:
    write_example_records(tmp_path)
    for path in lab.iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_description_is_read(name: str, lab: Path) -> None:
    record = read_record(lab / f"{name}.toml")
    assert len(record) > 1000
    assert (record.coordinate_unit == "rad") == (name in ("encoder", "pendulum"))
    assert (record.force is not None) == (name in ("driven", "force-stroke"))


def test_volts_by_their_scale_alone(lab: Path, command: Callable[..., Any]) -> None:
    words = ("--scale", "2.4894 mm/V", "--zero", "2.513 V", "--law", "linear")
    done = command("reduced_models", "identify", str(lab / "lvdt.csv"), *words)
    assert done.returncode == 0, done.stderr
    frequency, ratio = (
        float(re.search(rf"{name} +\w+ +([0-9.]+)", done.stdout)[1])  # type: ignore[index]
        for name in ("natural frequency", "damping ratio")
    )
    assert frequency == pytest.approx(4.1, rel=1e-3)
    assert ratio == pytest.approx(5.0, rel=0.02)


def test_the_hold_of_the_lvdt_is_left_out_and_said(lab: Path) -> None:
    with pytest.warns(UserWarning, match=r"stands still until 0\.40"):
        assert read_record(lab / "lvdt.toml").time[0] == pytest.approx(0.4, abs=0.005)


def test_a_written_description_holds_the_calibration(
    lab: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    written = tmp_path / "record.toml"
    words = ("--scale", "2.4894 mm/V", "--zero", "2.513 V", "--write", str(written))
    assert command("reduced_models", "look", str(lab / "lvdt.csv"), *words).returncode == 0
    again, first = read_record(written), read_record(lab / "lvdt.toml")
    assert np.array_equal(again.height, first.height)


@pytest.mark.long  # quick: a real pendulum, below
def test_a_pendulum(lab: Path) -> None:
    law = "a'' + 2*lam*a' + k*sin(a - rest) = 0"
    pendulum = fit(read_record(lab / "encoder.toml"), law, starts=2)
    assert pendulum.parameters["k"] == pytest.approx(30.0, rel=1e-3)
    assert pendulum.parameters["lam"] == pytest.approx(0.05, rel=0.01)


@pytest.mark.long  # quick: `test_driven`
def test_a_driven_mass(lab: Path) -> None:
    driven = fit(read_record(lab / "driven.toml"), "z'' + 2*lam*z' + k*(z - rest) = force/m", starts=2)
    assert driven.parameters["m"] == pytest.approx(7.5, rel=2e-3)
    assert driven.parameters["k"] == pytest.approx((2.0 * np.pi * 4.1) ** 2, rel=1e-3)


def test_a_laser_next_to_an_accelerometer(lab: Path) -> None:
    record = read_record(lab / "accelerometer.toml")
    found = fit(record, "linear").at_rest
    assert 1.0 / found.period == pytest.approx(6.0, rel=1e-3)
    assert found.damping_ratio == pytest.approx(0.03, rel=0.02)
    omega = 2.0 * np.pi * 6.0
    assert record.extra["accelerometer"][0] == pytest.approx(-3e-3 * omega**2 / 9.80665, abs=0.01)


def test_a_damper_on_a_dynamometer(lab: Path) -> None:
    record = read_record(lab / "force-stroke.toml")
    assert record.force is not None
    speed = np.gradient(record.height, record.time)
    columns = np.stack([speed, record.height], axis=1)
    drag, stiffness = np.linalg.lstsq(columns, record.force, rcond=None)[0]
    assert drag == pytest.approx(120.0, rel=1e-3)
    assert stiffness == pytest.approx(900.0, rel=2e-3)


def test_a_real_pendulum_has_dry_friction(lab: Path) -> None:
    """Its source and its licence go with it; degrees of the board were eleven counts of 4000 a turn."""
    head = (lab / "pendulum.csv").read_text(encoding="utf-8").splitlines()[:28]
    assert any("https://github.com/" in line for line in head)
    assert any("Permission is hereby granted" in line for line in head)
    found = fit(read_record(lab / "pendulum.toml"), "pendulum-coulomb", starts=2)
    assert found.parameters["omega"] == pytest.approx(10.96, rel=2e-3)
    assert found.parameters["friction"] == pytest.approx(2.0, rel=0.1)
    assert found.quality.relative < 0.012
