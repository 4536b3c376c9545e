"""Run directories: damage is noticed by its file's name, or changes nothing that is read."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import tracemalloc
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

import granular.run.zarr_arrays
from granular import Scene, Trajectory, load_scene, load_trajectory, simulate
from granular.run.checkpoint import read_checkpoint, write_checkpoint
from granular.shared.errors import StoreError

CUT, END = 0.01234, 0.02


@dataclasses.dataclass(frozen=True)
class Damage:
    """A file that was damaged, and how."""

    file: Path
    how: str

    def do(self, directory: Path, random: np.random.Generator) -> None:
        """Do it to a copy of the run."""
        path = directory / self.file
        content = bytearray(path.read_bytes())
        if self.how == "missing":
            path.unlink()
            return
        if self.how == "flipped":
            bit = int(random.integers(8 * len(content)))
            content[bit // 8] ^= 1 << bit % 8
        else:
            del content[0 if self.how == "empty" else int(random.integers(1, len(content))) :]
        path.write_bytes(content)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("single-particle").replace(**{"output.scalars": 2.5e-4, "output.frames": 1e-3})


@pytest.fixture(scope="module")
def directory(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run that was cut within a step, in many small chunks."""
    path = tmp_path_factory.mktemp("store") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(granular.run.zarr_arrays, "TIME_CHUNK", 16)
        patch.setattr(granular.run.zarr_arrays, "FRAME_CHUNK", 8)
        simulate(scene, t_end=CUT, out=path, progress=False)
    assert len(list((path / "trajectory.zarr" / "time" / "c").iterdir())) > 3
    return path


@pytest.fixture(scope="module")
def integer(scene: Scene) -> Trajectory:
    return simulate(scene, t_end=END, progress=False)


def everything(run: Trajectory) -> xarray.Dataset:
    return run.dataset.load()


def resumed(scene: Scene, path: Path) -> Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return simulate(scene, t_end=END, out=path, resume=True, progress=False)


def outcome(made: Callable[[], Trajectory]) -> xarray.Dataset | str:
    """What is read, or the error's line."""
    try:
        return everything(made())
    except StoreError as error:
        return str(error)


def check(
    damages: list[Damage],
    directory: Path,
    scene: Scene,
    integer: Trajectory,
    place: Path,
    random: np.random.Generator,
) -> None:
    """Load and resume a copy with each damage: the same values, or one line with its name."""
    good = everything(load_trajectory(directory))
    for damage in damages:
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(directory, place)
        damage.do(place, random)
        for made, right in (
            (lambda: load_trajectory(place), good),
            (lambda: resumed(scene, place), integer.dataset),
        ):
            read = outcome(made)
            if isinstance(read, str):
                assert str(place / damage.file) in read, damage
                assert "\n" not in read
            else:
                assert read.equals(right), damage
                assert read.attrs["scene"] == right.attrs["scene"]


def damages(directory: Path, hows: list[str], random: np.random.Generator) -> list[Damage]:
    """Damages of files drawn by chance, so that each kind of file is among many."""
    files = sorted(one.relative_to(directory) for one in directory.rglob("*") if one.is_file())
    return [Damage(files[random.integers(len(files))], how) for how in hows]


def test_some_damages_are_noticed(
    directory: Path, scene: Scene, integer: Trajectory, tmp_path: Path, random: np.random.Generator
) -> None:
    chosen = damages(directory, ["flipped"] * 6 + ["truncated", "empty", "missing"], random)
    check(chosen, directory, scene, integer, tmp_path / "run", random)


@pytest.mark.long
def test_many_damages_are_noticed(
    directory: Path, scene: Scene, integer: Trajectory, tmp_path: Path, random: np.random.Generator
) -> None:
    """Of 200 bits, and 50 files."""
    hows = ["flipped"] * 200 + ["truncated", "empty", "missing"] * 17
    check(damages(directory, hows, random), directory, scene, integer, tmp_path / "run", random)


@pytest.mark.parametrize("how", ["flipped", "truncated", "empty", "missing"])
@pytest.mark.parametrize(
    "file",
    [
        "scene.toml",
        "run.json",
        "checkpoint.npz",
        "trajectory.zarr/zarr.json",
        "trajectory.zarr/position/zarr.json",
        "trajectory.zarr/position/c/0/0/0",
        "trajectory.zarr/time/c/3",
    ],
)
def test_each_kind_of_file_is_named(
    directory: Path, tmp_path: Path, random: np.random.Generator, file: str, how: str
) -> None:
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    Damage(Path(file), how).do(copy, random)
    with pytest.raises(StoreError) as caught:
        everything(load_trajectory(copy))
    assert str(caught.value).startswith(f"{copy / file} ")


@pytest.mark.parametrize(
    ("file", "size", "end"),
    [
        *(
            (file, 3 * 2**30, b"")
            for file in (
                "scene.toml",
                "run.json",
                "checkpoint.npz",
                "trajectory.zarr/zarr.json",
                "trajectory.zarr/position/c/0/0/0",
            )
        ),
        ("checkpoint.npz", 2**28, b"0" * 64),
    ],
)
def test_a_file_of_gigabytes_is_not_read_whole(
    directory: Path, tmp_path: Path, file: str, size: int, end: bytes
) -> None:
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    with (copy / file).open("r+b") as opened:
        opened.truncate(size - len(end))
        opened.seek(0, os.SEEK_END)
        opened.write(end)
    tracemalloc.start()
    try:
        with pytest.raises(StoreError) as caught:
            everything(load_trajectory(copy))
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(f"{copy / file} ")
    assert most < 2**26


def test_a_run_without_positions_is_none(directory: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    shutil.rmtree(copy / "trajectory.zarr" / "position")
    with pytest.raises(StoreError, match=r"position/zarr\.json is missing; restore it"):
        load_trajectory(copy)
    shutil.copytree(directory / "trajectory.zarr" / "position", copy / "trajectory.zarr" / "position")
    shutil.rmtree(copy / "trajectory.zarr" / "position" / "c")
    with pytest.raises(StoreError, match=r"position/c/\d/0/0 is missing; restore it"):
        everything(load_trajectory(copy))


def test_an_edited_scene_is_noticed(directory: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    file = copy / "scene.toml"
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace("density = 7368.0", "density = 7369.0"), encoding="utf-8")
    with pytest.raises(StoreError, match=r"scene\.toml is not what the run wrote"):
        load_trajectory(copy)


def test_edited_settings_are_noticed(directory: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    settings = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(settings | {"dt": "auto/2"}))
    with pytest.raises(StoreError, match=r"run\.json is not what the run wrote"):
        load_trajectory(copy)


def test_a_chunk_of_nothing_but_the_fill_value_is_written(directory: Path) -> None:
    """All stages are number 0, which is the fill value: only what was lost is not there."""
    chunks = directory / "trajectory.zarr" / "stage" / "c"
    assert len(list(chunks.iterdir())) == len(list((chunks.parents[1] / "time" / "c").iterdir()))


def test_other_programs_check_the_sums_too(directory: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    plain = xarray.open_zarr(copy / "trajectory.zarr", chunks=None)
    found = load_trajectory(directory).dataset["greatest_speed"]
    np.testing.assert_array_equal(plain["greatest_speed"].values, found.values)
    chunk = copy / "trajectory.zarr" / "greatest_speed" / "c" / "1"
    content = bytearray(chunk.read_bytes())
    content[-1] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(RuntimeError, match="checksum"):
        xarray.open_zarr(copy / "trajectory.zarr", chunks=None).load()


class Trap:
    """What runs a program when it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("sprung"),)


def test_nothing_in_a_checkpoint_is_executed(
    directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    kept, manifest = read_checkpoint(copy)
    for strange in ({"x": np.array(Trap(), dtype=object)}, {"outcome": np.array([Trap()])}):
        write_checkpoint(copy, kept | strange, manifest)
        with pytest.raises(StoreError, match=r"checkpoint\.npz is damaged"):
            load_trajectory(copy)
    assert not (tmp_path / "sprung").exists()


def test_what_is_read_does_not_grow_while_the_run_does(scene: Scene, directory: Path, tmp_path: Path) -> None:
    """A reader of a live run keeps the part that was complete when it opened it."""
    copy = tmp_path / "run"
    shutil.copytree(directory, copy)
    early = load_trajectory(copy)
    before = everything(load_trajectory(copy))
    resumed(scene, copy)
    rows = early.dataset.sizes["time"] - 1  # the last one lay on no whole tick
    assert np.array_equal(
        early.dataset["greatest_speed"].values[:rows], before["greatest_speed"].values[:rows]
    )
