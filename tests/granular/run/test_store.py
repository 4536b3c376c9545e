"""Damaged or exchanged files in a run directory are reported by name, or do not change the results."""

import os
import shutil
import signal
import tracemalloc
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray

import granular.run.zarr_arrays
from granular import Scene, Trajectory, load_scene, load_trajectory, simulate
from granular.run.run_directory import read_checkpoint_and_manifest, write_checkpoint
from granular.shared.errors import StoreError

EARLY, CUT, END = 0.00634, 0.01234, 0.02
SECONDS = 60
"""Until a test that hangs is broken off."""


class Runs(NamedTuple):
    """An interrupted run, its continuation, copies, and another run."""

    run: Path
    early: Path
    other: Path
    data: xarray.Dataset
    end: xarray.Dataset


@contextmanager
def in_time() -> Iterator[None]:
    def give_up(*_: Any) -> None:
        raise TimeoutError("it hangs")

    former = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, former)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("single-particle").replace(**{"output.scalars": 2.5e-4, "output.frames": 1e-3})


@pytest.fixture(scope="module")
def runs(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Runs:
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(granular.run.zarr_arrays, "TIME_CHUNK", 16)
        patch.setattr(granular.run.zarr_arrays, "FRAME_CHUNK", 8)
        simulate(scene, t_end=EARLY, out=folder / "run", progress=False)
        shutil.copytree(folder / "run", folder / "early")
        run = simulate(scene, t_end=CUT, out=folder / "run", resume=True, progress=False)
        other = scene.replace(**{"arrangement.positions": [[0.16, 0.06]]})
        simulate(other, t_end=CUT, out=folder / "other", progress=False)
    end = simulate(scene, t_end=END, progress=False)
    paths = (folder / name for name in ("run", "early", "other"))
    return Runs(*paths, run.dataset.load(), end.dataset)


def resumed(scene: Scene, path: Path) -> Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return simulate(scene, t_end=END, out=path, resume=True, progress=False)


def check(runs: Runs, scene: Scene, place: Path, damaged: str, how: str) -> list[str]:
    """Load and resume a damaged copy; return the error messages."""
    lines = []
    outcomes: tuple[tuple[Callable[[], Trajectory], xarray.Dataset], ...] = (
        (lambda: load_trajectory(place), runs.data),
        (lambda: resumed(scene, place), runs.end),
    )
    for made, right in outcomes:
        try:
            with in_time():
                read = made().dataset.load()
        except StoreError as error:
            lines.append(str(error))
            assert str(place / damaged) in lines[-1], how
            assert "\n" not in lines[-1], how
        else:
            assert read.equals(right), how
    return lines


def copied(runs: Runs, place: Path) -> Path:
    shutil.rmtree(place, ignore_errors=True)
    return Path(shutil.copytree(runs.run, place))


def chunks(run: Path) -> list[str]:
    return sorted(
        str(file.relative_to(run)) for file in run.rglob("trajectory.zarr/*/c/**/*") if file.is_file()
    )


def files(run: Path) -> list[str]:
    return sorted(str(file.relative_to(run)) for file in run.rglob("*") if file.is_file())


def damage(path: Path, how: str, random: np.random.Generator) -> None:
    """Damage a file by a flipped bit, truncation, emptying or removal."""
    content = bytearray(path.read_bytes())
    if how == "missing":
        path.unlink()
        return
    if how == "flipped":
        bit = int(random.integers(8 * len(content)))
        content[bit // 8] ^= 1 << bit % 8
    else:
        del content[0 if how == "empty" else int(random.integers(1, len(content))) :]
    path.write_bytes(content)


@pytest.mark.parametrize(("bits", "others"), [(6, 1), pytest.param(200, 17, marks=pytest.mark.long)])
def test_damaged_files_of_a_run_are_detected(
    runs: Runs, scene: Scene, tmp_path: Path, random: np.random.Generator, bits: int, others: int
) -> None:
    """Files are drawn at random. The long test has enough draws to include every kind of file."""
    for how in ["flipped"] * bits + ["truncated", "empty", "missing"] * others:
        place, names = copied(runs, tmp_path / "run"), files(runs.run)
        name = names[random.integers(len(names))]
        damage(place / name, how, random)
        check(runs, scene, place, name, f"{name} {how}")


CHUNK = "trajectory.zarr/position/c/0/0/0"
MAIN_FILES = ("scene.toml", "run.json", "checkpoint.npz", "trajectory.zarr/zarr.json", CHUNK)


@pytest.mark.parametrize("how", ["flipped", "truncated", "empty", "missing"])
@pytest.mark.parametrize(
    "file", [*MAIN_FILES, "trajectory.zarr/position/zarr.json", "trajectory.zarr/time/c/3"]
)
def test_error_for_a_damaged_run_names_the_file(
    runs: Runs, tmp_path: Path, random: np.random.Generator, file: str, how: str
) -> None:
    copy = copied(runs, tmp_path / "run")
    damage(copy / file, how, random)
    with pytest.raises(StoreError) as caught:
        load_trajectory(copy).dataset.load()
    assert str(caught.value).startswith(f"{copy / file} ")


@pytest.mark.parametrize(
    ("file", "size", "end"),
    [*((file, 3 * 2**30, b"") for file in MAIN_FILES), ("checkpoint.npz", 2**28, b"0" * 64)],
)
def test_huge_files_in_a_run_directory_are_refused_without_being_read(
    runs: Runs, tmp_path: Path, file: str, size: int, end: bytes
) -> None:
    copy = copied(runs, tmp_path / "run")
    with (copy / file).open("r+b") as opened:
        opened.truncate(size - len(end))
        opened.seek(0, os.SEEK_END)
        opened.write(end)
    tracemalloc.start()
    try:
        with pytest.raises(StoreError) as caught:
            load_trajectory(copy).dataset.load()
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(f"{copy / file} ")
    assert most < 2**26


def test_run_directory_without_positions_is_refused(runs: Runs, tmp_path: Path) -> None:
    copy = copied(runs, tmp_path / "run")
    shutil.rmtree(copy / "trajectory.zarr" / "position")
    with pytest.raises(StoreError, match=r"position/zarr\.json is missing; restore it"):
        load_trajectory(copy)
    shutil.copytree(runs.run / "trajectory.zarr" / "position", copy / "trajectory.zarr" / "position")
    shutil.rmtree(copy / "trajectory.zarr" / "position" / "c")
    with pytest.raises(StoreError, match=r"position/c/\d/0/0 is missing; restore it"):
        load_trajectory(copy).dataset.load()


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [("scene.toml", "density = 7368.0", "density = 7369.0"), ("run.json", '"dt": "auto"', '"dt": "auto/2"')],
)
def test_edited_scene_or_settings_of_a_stored_run_are_detected(
    runs: Runs, tmp_path: Path, name: str, old: str, new: str
) -> None:
    file = copied(runs, tmp_path / "run") / name
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(StoreError, match=f"{name} has changed since it was written"):
        load_trajectory(file.parent)


def test_chunks_that_contain_only_fill_values_are_written(runs: Runs) -> None:
    """All stage indices are 0, which is the fill value.

    If such chunks were omitted, lost ones would go unnoticed.
    """
    chunks = runs.run / "trajectory.zarr" / "stage" / "c"
    assert len(list(chunks.iterdir())) == len(list((chunks.parents[1] / "time" / "c").iterdir()))


def test_zarr_verifies_checksums_of_stored_runs(runs: Runs, tmp_path: Path) -> None:
    copy = copied(runs, tmp_path / "run")
    plain = xarray.open_zarr(copy / "trajectory.zarr", chunks=None)
    found = load_trajectory(runs.run).dataset["greatest_speed"]
    np.testing.assert_array_equal(plain["greatest_speed"].values, found.values)
    chunk = copy / "trajectory.zarr" / "greatest_speed" / "c" / "1"
    content = bytearray(chunk.read_bytes())
    content[-1] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(RuntimeError, match="checksum"):
        xarray.open_zarr(copy / "trajectory.zarr", chunks=None).load()


class Trap:
    """Object that would run a program when unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("sprung"),)


def test_code_in_a_checkpoint_is_not_executed(
    runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    copy = copied(runs, tmp_path / "run")
    kept, manifest = read_checkpoint_and_manifest(copy)
    for strange in ({"x": np.array(Trap(), dtype=object)}, {"outcome": np.array([Trap()])}):
        write_checkpoint(copy, kept | strange, manifest)
        with pytest.raises(StoreError, match=r"checkpoint\.npz is damaged"):
            load_trajectory(copy)
    assert not (tmp_path / "sprung").exists()


def test_a_trajectory_opened_during_the_simulation_keeps_its_values_when_the_run_continues(
    scene: Scene, runs: Runs, tmp_path: Path
) -> None:
    """The reader sees the part that was complete when it opened the run."""
    copy = copied(runs, tmp_path / "run")
    early = load_trajectory(copy)
    before = load_trajectory(copy).dataset.load()
    resumed(scene, copy)
    rows = early.dataset.sizes["time"] - 1  # the last one lay on no whole tick
    assert np.array_equal(
        early.dataset["greatest_speed"].values[:rows], before["greatest_speed"].values[:rows]
    )


def test_a_data_chunk_replaced_by_its_older_version_is_detected(
    runs: Runs, scene: Scene, tmp_path: Path
) -> None:
    """The older chunk ends in fill values instead of later records."""
    assert "trajectory.zarr/position/c/1/0/0" in chunks(runs.early)
    for name in ("time/c/1", "piston_height/c/1", "position/c/1/0/0", "kinetic_energy/c/1"):
        chunk = f"trajectory.zarr/{name}"
        if chunk not in chunks(runs.early):
            continue
        place = copied(runs, tmp_path / "run")
        shutil.copyfile(runs.early / chunk, place / chunk)
        assert len(check(runs, scene, place, chunk, name)) == 2, name


@pytest.mark.parametrize(
    ("chunk", "donor"),
    [
        ("greatest_speed/c/0", "stiffest_mode/c/0"),
        ("greatest_speed/c/1", "greatest_speed/c/0"),
        ("position/c/0/0/0", "velocity/c/0/0/0"),
        ("position/c/1/0/0", "position/c/0/0/0"),
        ("stage/c/0", "time/c/0"),
        ("time/c/0", "frame_time/c/0"),
        ("position/c/0/0/0", "kinetic_energy/c/0"),
    ],
)
def test_a_data_chunk_replaced_by_one_of_another_index_is_detected(
    runs: Runs, scene: Scene, tmp_path: Path, chunk: str, donor: str
) -> None:
    place = copied(runs, tmp_path / "run")
    shutil.copyfile(runs.run / "trajectory.zarr" / donor, place / "trajectory.zarr" / chunk)
    assert len(check(runs, scene, place, f"trajectory.zarr/{chunk}", donor)) == 2


def test_a_data_chunk_replaced_by_one_of_another_run_is_detected(
    runs: Runs, scene: Scene, tmp_path: Path
) -> None:
    for chunk in ("trajectory.zarr/position/c/0/0/0", "trajectory.zarr/kinetic_energy/c/3"):
        place = copied(runs, tmp_path / "run")
        shutil.copyfile(runs.other / chunk, place / chunk)
        assert len(check(runs, scene, place, chunk, "other")) == 2


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="makes a pipe")
@pytest.mark.parametrize("name", [*MAIN_FILES, "trajectory.zarr/time/c/3"])
def test_pipe_in_place_of_a_file_of_a_run_is_reported(
    runs: Runs, scene: Scene, tmp_path: Path, name: str
) -> None:
    place = copied(runs, tmp_path / "run")
    (place / name).unlink()
    os.mkfifo(place / name)
    with pytest.raises(StoreError) as caught, in_time():
        load_trajectory(place).dataset.load()
    assert str(caught.value).startswith((f"{place / name} is not a regular file", f"{place} holds no run"))


def exchange(runs: Runs, place: Path, random: np.random.Generator) -> tuple[str, str]:
    """Replace a random chunk of a copy, or rarely another file, and return its name and the change."""
    donor = (runs.run, runs.early, runs.other)[random.integers(3)]
    listed = chunks if random.random() < 0.85 else files
    names, others = listed(runs.run), listed(donor)
    name = names[random.integers(len(names))]
    if name == "checkpoint.npz":
        name = "scene.toml"  # an older checkpoint is equivalent to a killed run
    same = donor is not runs.run and random.random() < 0.6 and name in others
    source = name if same else others[random.integers(len(others))]
    shutil.copyfile(donor / source, place / name)
    return name, f"{name} from {donor.name}/{source}"


@pytest.mark.parametrize("count", [20, pytest.param(200, marks=pytest.mark.long)])
def test_exchanged_files_of_runs_are_detected(
    runs: Runs, scene: Scene, tmp_path: Path, random: np.random.Generator, count: int
) -> None:
    noticed = 0
    for _ in range(count):
        place = copied(runs, tmp_path / "run")
        noticed += bool(check(runs, scene, place, *exchange(runs, place, random)))
    assert noticed > count // 2


def test_a_checkpoint_replaced_by_an_earlier_one_is_detected(runs: Runs, tmp_path: Path) -> None:
    """The interruption lay within a record interval. When the run continued, its last record was replaced."""
    place = copied(runs, tmp_path / "run")
    shutil.copyfile(runs.early / "checkpoint.npz", place / "checkpoint.npz")
    with pytest.raises(StoreError, match=r"/c/1 is damaged, or has changed since it was written"):
        load_trajectory(place).dataset.load()


@pytest.mark.parametrize(("length", "noticed"), [(b"7", False), (b"07", True), (b"-7", True)])
def test_invalid_array_length_in_the_metadata_of_a_run_is_detected(
    runs: Runs, tmp_path: Path, length: bytes, noticed: bool
) -> None:
    """The length is read from the checkpoint; the metadata are for other programs.

    A valid but wrong length in the metadata therefore changes nothing.
    """
    place = copied(runs, tmp_path / "run")
    for name in ("zarr.json", "time/zarr.json"):
        file = place / "trajectory.zarr" / name
        count = str(runs.data.sizes["time"]).encode()
        content = file.read_bytes()
        assert content.count(b" " + count + b"\n")
        file.write_bytes(content.replace(b" " + count + b"\n", b" " + length + b"\n"))
    if noticed:
        with pytest.raises(StoreError, match=r"zarr\.json has changed since it was written"):
            load_trajectory(place)
    else:
        assert load_trajectory(place).dataset.load().equals(runs.data)
