"""Files appear whole or not at all."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from granular.export import to_extxyz, to_gsd, to_tables, to_vtk
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError

WRITERS = {"bed.gsd": to_gsd, "bed.xyz": to_extxyz, "vtk": to_vtk, "tables": to_tables}
Writer = Callable[..., object]


@pytest.mark.parametrize(("name", "write"), WRITERS.items(), ids=WRITERS)
def test_existing_files_stay_unless_told(run: Trajectory, tmp_path: Path, name: str, write: Writer) -> None:
    write(run, tmp_path / name)
    first = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    longer = dataclasses.replace(run, dataset=run.dataset.isel(frame=slice(0, 50)))
    with pytest.raises(InputError, match="exists"):
        write(longer, tmp_path / name)
    assert {path: path.read_bytes() for path in first} == first
    write(longer, tmp_path / name, overwrite=True)
    again = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert set(again) == set(first)
    assert again != first


@pytest.mark.parametrize(("name", "write"), WRITERS.items(), ids=WRITERS)
def test_failure_half_way_leaves_no_file(
    run: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, write: Writer
) -> None:
    from granular.export import frames

    original = frames.frames

    def failing(of: Trajectory, numbers: list[int]) -> object:
        if numbers[-1] > 80 and list(tmp_path.rglob("*.part*")):
            raise MemoryError
        return original(of, numbers)

    monkeypatch.setattr(frames, "frames", failing)
    with pytest.raises(MemoryError):
        write(run, tmp_path / name)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.parametrize("write", [to_gsd, to_extxyz])
def test_places_that_cannot_be_written(run: Trajectory, tmp_path: Path, write: Writer) -> None:
    with pytest.raises(InputError, match="there is no directory"):
        write(run, tmp_path / "missing" / "bed")
    with pytest.raises(InputError, match="is a directory"):
        write(run, tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        write(run, tmp_path / ("x" * 300))


def test_directory_that_cannot_be_made(run: Trajectory, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here")
    with pytest.raises(InputError, match="cannot be made"):
        to_tables(run, tmp_path / "file")


def test_run_without_frames(run: Trajectory, tmp_path: Path) -> None:
    empty = dataclasses.replace(run, dataset=run.dataset.isel(frame=slice(0, 0)))
    with pytest.raises(InputError, match="no frames"):
        to_gsd(empty, tmp_path / "bed.gsd")
