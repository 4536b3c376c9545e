"""Pictures and timing of movies, also after Ctrl-C."""

import dataclasses
import os
import signal
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from granular.export.frames import iterate_frames
from granular.observables import Frame
from granular.render import movie
from granular.render.movie import interpolate_frames_at_times
from granular.render.picture import BedPicture, highest_point_of_bed
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError


@pytest.fixture(scope="module")
def short(run: Trajectory) -> Trajectory:
    """Return a run of seven frames, three of them in the second stage."""
    stages = (
        dataclasses.replace(run.stages[0], end=0.0019),
        dataclasses.replace(run.stages[1], start=0.0019, end=0.0031),
    )
    data = run.dataset.isel(frame=slice(0, 7))
    return dataclasses.replace(run, dataset=data, stages=stages)


def pictures(path: Path) -> list[np.ndarray]:
    """Return all pictures of a movie, each of shape (height, width, 3)."""
    if path.suffix == ".gif":
        with Image.open(path) as file:
            found = []
            for k in range(file.n_frames):
                file.seek(k)
                found.append(np.asarray(file.convert("RGB")))
            return found
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["source_size"]
    return [np.frombuffer(one, dtype=np.uint8).reshape(height, width, 3) for one in reader]


@pytest.fixture(scope="module")
def made(short: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return a movie in each format, each in a separate directory."""
    return {
        ending: movie(
            short, tmp_path_factory.mktemp(ending) / f"bed.{ending}", fps=8.0, speed=None, progress=False
        )
        for ending in ("mp4", "gif")
    }


@pytest.mark.parametrize("ending", ["mp4", "gif"])
def test_without_speed_a_movie_has_one_picture_per_frame(
    short: Trajectory, made: dict[str, Path], ending: str
) -> None:
    path = made[ending]
    found = pictures(path)
    assert len(found) == 7
    top, total_duration = highest_point_of_bed(short, iterate_frames(short)), (0.0, 0.003)
    picture = BedPicture(short, "species", (0.0, 1.0), top, total_duration)
    for frame, image in zip(iterate_frames(short), found, strict=True):
        picture.show_frame(frame)
        error = np.abs(image.astype(float) - picture.pixels())
        assert error.mean() < 4.0
    assert min(one[:4].min() for one in found) >= (255 if ending == "gif" else 253)  # white background
    assert [one.name for one in path.parent.iterdir()] == [path.name]


def test_movie_has_the_requested_duration(made: dict[str, Path]) -> None:
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(made["mp4"]))
    assert (count, seconds) == (7, pytest.approx(0.875, abs=0.02))
    with Image.open(made["gif"]) as file:
        assert file.info["duration"] == pytest.approx(125.0, abs=10.0)


def test_movie_has_the_requested_width_in_pixels(short: Trajectory, tmp_path: Path) -> None:
    """A wide bed is reduced to the requested width and keeps its proportions."""
    path = tmp_path / "bed.gif"
    movie(short, path, fps=10.0, speed=None, width=760, stage="compress", progress=False)
    assert pictures(path)[0].shape[1] == 760


def test_movie_can_be_limited_to_a_single_stage(short: Trajectory, tmp_path: Path) -> None:
    path = movie(short, tmp_path / "bed.gif", stage="compress", speed=None, progress=False)
    assert len(pictures(path)) == 3  # 0.002, 0.0025, 0.003 s
    with pytest.raises(InputError, match="unknown stage"):
        movie(short, tmp_path / "more.gif", stage="expand", progress=False)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("ending", ["mp4", "gif"])
def test_ctrl_c_keeps_the_pictures_of_a_movie_made_so_far(
    short: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    shown, show = [], BedPicture.show_frame

    def interrupted(self: BedPicture, frame: Frame) -> None:
        shown.append(frame)
        if len(shown) == 4:
            os.kill(os.getpid(), signal.SIGINT)
        show(self, frame)

    monkeypatch.setattr(BedPicture, "show_frame", interrupted)
    path = tmp_path / f"bed.{ending}"
    with pytest.warns(UserWarning, match="contains 4 of 7 pictures"), pytest.raises(KeyboardInterrupt):
        movie(short, path, speed=None, progress=False)
    assert len(pictures(path)) == 4
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_after_the_last_picture_of_a_movie_still_interrupts_the_program(
    short: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = os.replace

    def interrupted(*places: Path) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        replace(*places)

    path = tmp_path / "bed.gif"
    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        movie(short, path, stage="compress", speed=None, progress=False)
    assert len(pictures(path)) == 3


def test_colour_scale_is_the_same_in_all_pictures_of_a_movie(short: Trajectory, tmp_path: Path) -> None:
    path = movie(short, tmp_path / "bed.mp4", colour="speed", speed=None, progress=False)
    found = pictures(path)
    side = [one[:, int(0.83 * one.shape[1]) :].astype(float) for one in found]
    assert max(np.abs(one - side[0]).mean() for one in side) < 1.0
    assert (side[0] < 100).any()


@pytest.mark.parametrize(
    ("name", "choice", "message"),
    [
        ("bed.avi", {}, "unknown format '.avi'"),
        ("bed.mp4", {"fps": 0.0}, "fps = 0 is outside the limits of a .mp4 movie; give a value above 0"),
        ("bed.gif", {"fps": 60.0}, "at most 50"),
        ("bed.mp4", {"fps": float("nan")}, "fps = nan"),
        ("bed.mp4", {"speed": 0.0}, "speed 0 is not above 0"),
        ("bed.mp4", {"speed": float("nan")}, "speed nan"),
        ("bed.gif", {"width": 640}, "width 640 is outside the limits; give 760 to 960 pixels"),
        ("bed.mp4", {"colour": "blue"}, "unknown colour 'blue'"),
        ("missing/bed.mp4", {}, "does not exist; make it first"),
        ("there.gif", {}, "exists"),
    ],
)
def test_invalid_options_of_a_movie_are_refused(
    short: Trajectory, tmp_path: Path, name: str, choice: dict, message: str
) -> None:
    (tmp_path / "there.gif").touch()
    with pytest.raises(InputError, match=message):
        movie(short, tmp_path / name, progress=False, **choice)
    assert [one.name for one in tmp_path.iterdir()] == ["there.gif"]


def test_a_movie_shows_real_time_by_default(circling: Trajectory, tmp_path: Path) -> None:
    """A part of the run is shown at 25 pictures per second, for any frame interval."""
    part = dataclasses.replace(circling, dataset=circling.dataset.isel(frame=slice(0, 5)))  # 0.4 s
    path = movie(part, tmp_path / "bed.mp4", progress=False)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert (count, seconds) == (11, pytest.approx(0.44, abs=0.02))
    slow = movie(part, tmp_path / "slow.mp4", fps=5.0, speed=0.5, progress=False)
    assert imageio_ffmpeg.count_frames_and_secs(str(slow))[0] == 5


def test_positions_interpolated_between_frames_follow_a_circular_path(circling: Trajectory) -> None:
    times = np.linspace(0.0, 1.0, 101)
    found = list(interpolate_frames_at_times(circling, range(11), times))
    place = np.array([one.positions[0] for one in found])
    true = PLACE + SIZE * np.array([np.cos(PACE * times), np.sin(PACE * times)]).T
    assert np.abs(place - true).max() < 1e-3 * SIZE  # straight lines would give 5e-2
    heights = np.array([one.piston_height for one in found])
    assert np.allclose(heights, np.interp(times, circling.dataset["time"], circling.dataset["piston_height"]))
    assert [one.time for one in found] == list(times)


def test_movie_warns_if_frames_are_too_far_apart_to_interpolate(circling: Trajectory) -> None:
    with pytest.warns(UserWarning, match="reduce the interval output.frames for accurate paths"):
        list(interpolate_frames_at_times(circling, [0, 5, 10], np.linspace(0.0, 1.0, 101)))


PLACE, SIZE, PACE = np.array([0.02, 0.01]), 0.004, 2.0 * np.pi


@pytest.fixture(scope="module")
def circling(run: Trajectory) -> Trajectory:
    """Return a run with grains on circles with a period of one second, in eleven frames."""
    time = np.linspace(0.0, 1.0, 11)[:, None, None]
    circle = np.concatenate([np.cos(PACE * time), np.sin(PACE * time)], axis=2)
    ahead = PACE * np.concatenate([-np.sin(PACE * time), np.cos(PACE * time)], axis=2)
    data = run.dataset.isel(frame=slice(0, 11)).copy(deep=True)
    data["position"].values[:] = PLACE + SIZE * circle
    data["velocity"].values[:] = SIZE * ahead
    data = data.assign_coords(
        time=np.linspace(0.0, 1.0, data.sizes["time"]), frame_time=("frame", time[:, 0, 0])
    )
    return dataclasses.replace(run, dataset=data)
