"""Run directories: links, simultaneous starts, incomplete directories, a full disk, and runs of earlier
versions.
"""

import contextlib
import hashlib
import resource
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import granular.run.simulation
from granular import Scene, load_scene, load_trajectory, simulate
from granular.run.run_directory import (
    create_and_lock_partial_directory,
    lock_directory,
    move_to_final_path,
    unlock_directory,
)
from granular.shared.errors import StoreError

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("single-particle").replace(
        **{"output.scalars": 1e-4, "output.frames": 1e-4, "protocol.0.duration": 0.2}
    )


def started(scene: Scene, path: Path) -> None:
    simulate(scene, t_end=1e-3, out=path, progress=False)


def parts(path: Path) -> list[Path]:
    return list(path.glob(".*.part"))


@pytest.mark.parametrize("name", ["whole", "dangling", "relative"])
def test_run_is_written_into_the_directory_to_which_a_link_points(
    scene: Scene, tmp_path: Path, name: str
) -> None:
    (tmp_path / "real").mkdir()
    link = tmp_path / name
    where = {"whole": tmp_path / "real", "dangling": tmp_path / "later", "relative": "real"}
    link.symlink_to(where[name])
    started(scene, link)
    assert link.is_symlink()
    assert (link.resolve() / "checkpoint.npz").is_file()
    simulate(scene, t_end=2e-3, out=link, resume=True, progress=False)
    assert load_trajectory(link).dataset.sizes["time"] == 21
    assert not parts(tmp_path)


def test_links_that_cannot_become_a_run_directory_are_refused(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "there").symlink_to("back")
    (tmp_path / "back").symlink_to("there")
    (tmp_path / "file").touch()
    (tmp_path / "to-file").symlink_to("file")
    for name, words in (
        ("loop", "a link to itself"),
        ("there", "a link to itself"),
        ("file", "is a file"),
        ("to-file", "is a file"),
        ("file/run", "cannot be made"),
    ):
        with pytest.raises(StoreError, match=words):
            started(scene, tmp_path / name)
    assert not parts(tmp_path)


def test_of_two_processes_the_first_gets_the_run_directory(tmp_path: Path) -> None:
    path = tmp_path / "run"
    first, held = create_and_lock_partial_directory(path)
    second, other = create_and_lock_partial_directory(path)
    assert first != second
    for part in (first, second):
        (part / "scene.toml").touch()
    move_to_final_path(second, path)
    with pytest.raises(StoreError, match="another process has begun a run in"):
        move_to_final_path(first, path)
    with pytest.raises(StoreError, match="another process is running in"):
        lock_directory(path)  # the partial directory's lock becomes the run's lock
    unlock_directory(other)
    unlock_directory(lock_directory(path))
    unlock_directory(held)


@pytest.mark.long
def test_only_one_of_several_simultaneous_processes_gets_the_run_directory(
    scene: Scene, tmp_path: Path
) -> None:
    scene.save(tmp_path / "scene.toml")
    words = ("granular", "run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "run"))
    for _ in range(3):
        begun_by = [
            subprocess.Popen(
                [sys.executable, "-m", *words, "--t-end", "1e-3", "--quiet"],
                cwd=ROOT,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            for _ in range(3)
        ]
        said = [one.communicate()[1] for one in begun_by]
        codes = [one.returncode for one in begun_by]
        assert sorted(codes) == [0, 2, 2], said
        lines = [line for code, line in zip(codes, said, strict=True) if code]
        assert all(line.startswith("error: ") and line.count("\n") == 1 for line in lines)
        assert load_trajectory(tmp_path / "run").complete
        assert not parts(tmp_path)
        (tmp_path / "run").rename(tmp_path / f"run{_}")


def test_incomplete_directories_of_killed_runs_are_removed(scene: Scene, tmp_path: Path) -> None:
    """Directories of running processes, and other files, are kept."""
    remains, kept = tmp_path / ".run.0123abcd.part", tmp_path / ".run.0123abce.part"
    former, other = tmp_path / ".run.part", tmp_path / ".run.more.0123abcd.part"
    for part in (remains, kept, former, other):
        (part / "trajectory.zarr").mkdir(parents=True)
    (kept / "thesis.tex").touch()
    live, held = create_and_lock_partial_directory(tmp_path / "run")
    started(scene, tmp_path / "run")
    assert sorted(parts(tmp_path)) == sorted([kept, other, live])
    unlock_directory(held)


@contextlib.contextmanager
def full_disk(workspace: int) -> Iterator[None]:
    """Limit the size of files, which acts like a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (workspace, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("workspace", [100, 5000])
def test_a_full_disk_at_the_start_of_a_run_is_reported(scene: Scene, tmp_path: Path, workspace: int) -> None:
    started(scene, tmp_path / "other")  # loads compiled code
    with full_disk(workspace), pytest.raises(StoreError, match="run cannot be made: File too large"):
        started(scene, tmp_path / "run")
    assert [one.name for one in tmp_path.iterdir()] == ["other"]


def test_run_resumes_after_the_disk_was_full(
    small_bed: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = small_bed.replace(**{"protocol.settle.duration": 0.1, "output.frames": 1e-3})
    integer = simulate(scene, progress=False)
    monkeypatch.setattr(granular.run.simulation, "COMMIT_SECONDS", 0.0)
    with full_disk(30_000), pytest.raises(StoreError, match="resume the run when there is space"):
        simulate(scene, out=tmp_path / "run", progress=False)
    part = load_trajectory(tmp_path / "run").dataset.load()
    assert 0 < part.sizes["frame"] < integer.dataset.sizes["frame"]
    monkeypatch.undo()
    again = simulate(scene, out=tmp_path / "run", resume=True, progress=False)
    assert again.dataset.equals(integer.dataset)


ARCHIVE = Path(__file__).parents[2] / "data" / "sealed_runs.tar.xz"
DIGESTS = {
    "plain": "d79329a60aec0002ccbd553845729258d31a5cc26069b03c6a1288efbc6f6fc7",
    "gap-and-contact": "d36a3473a29d71d1d6fb98b51fb66aeafd1e88db3bf14e1e3b3024b7b062d8e3",
    "machine": "717349d3ddb277b1767661ee5c4f221568f3f8c772674da8f54774cbe07f5cb3",
}
"""SHA-256 of the names and values of all variables, in the order of the names."""
STEP, PAUSE, END = 2e-5, 0.0041, 0.006
"""[s]: step of the runs, when they paused, and when their protocol ends."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path


@pytest.mark.parametrize("name", DIGESTS)
def test_data_of_runs_of_earlier_versions_are_unchanged_to_the_last_bit(name: str, folder: Path) -> None:
    data = load_trajectory(folder / name).dataset.load()
    digest = hashlib.sha256()
    for variable in sorted(map(str, data.variables)):
        digest.update(variable.encode() + data[variable].values.tobytes())
    assert digest.hexdigest() == DIGESTS[name]
    assert data["time"].values[-1] == pytest.approx(PAUSE, rel=1e-9)


@pytest.mark.filterwarnings("ignore:.*was made with other versions")
@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=() if one == "plain" else pytest.mark.long) for one in DIGESTS]
)
def test_runs_of_earlier_versions_are_resumed(name: str, folder: Path) -> None:
    scene = load_trajectory(folder / name).scene
    simulate(scene, dt=STEP, t_end=END, out=folder / name, resume=True, progress=False)
    found = load_trajectory(folder / name).dataset
    known = simulate(scene, dt=STEP, t_end=END, progress=False).dataset
    assert found.sizes == known.sizes
    for variable, size in (("position", 1e-7), ("velocity", 1e-4), ("piston_height", 1e-7)):
        np.testing.assert_allclose(found[variable], known[variable], rtol=0.0, atol=size)


def test_checkpoint_with_two_arrays_of_the_same_name_is_refused_as_damaged(folder: Path) -> None:
    """A flipped bit may change the name of one array into the name of another."""
    file = folder / "plain" / "checkpoint.npz"
    content = bytearray(file.read_bytes())
    start = content.index(b"x.npy", content.index(b"PK\x01\x02"))
    content[start : start + 1] = b"y"
    file.write_bytes(content)
    with pytest.raises(StoreError, match="is damaged"):
        load_trajectory(folder / "plain")
