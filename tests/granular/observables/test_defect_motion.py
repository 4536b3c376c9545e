"""Tracks of defects in twenty synthetic sequences of frames.

Each defect gives one track, at its prescribed positions.
"""

import csv
import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial import cKDTree
from xarray import Dataset

from granular.__main__ import main
from granular.commands.console import run_command_and_return_exit_code
from granular.observables import detect_defects, track_defects
from granular.observables.defect_tracks import (
    DefectTrack,
    detect_defects_in_frames,
    fit_velocity_of_track,
    link_defect_tracks,
)
from granular.observables.plots import plot_defect_paths
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError

from .conftest import MakeRun, displacement, hexagonal, rotated

SPACING = 0.0123
COLUMNS, ROWS = 43, 25
LATTICE = hexagonal(COLUMNS, ROWS)
MIDDLE = LATTICE[(ROWS // 2) * COLUMNS + COLUMNS // 2] + [0.3, math.sqrt(3.0) / 4.0]


class Made(NamedTuple):
    """A defect prescribed in a synthetic sequence."""

    kind: str
    burgers: np.ndarray
    start: np.ndarray
    velocity: np.ndarray
    first: int = 0
    last: int = 39

    def place(self, frame: int) -> np.ndarray:
        return np.asarray(self.start + frame * self.velocity)

    def there(self, frame: int) -> bool:
        return self.first <= frame <= self.last


def direction(sixth: int) -> np.ndarray:
    return np.array([math.cos(sixth * math.pi / 3.0), math.sin(sixth * math.pi / 3.0)])


def dislocation(
    start: tuple[float, float], velocity: tuple[float, float], sixth: int = 0, first: int = 0, last: int = 39
) -> Made:
    """Return a dislocation that moves along and across its Burgers vector, from ``start`` relative to
    the centre.
    """
    b = direction(sixth)
    across = np.array([-b[1], b[0]])
    turned = np.stack([b, across])
    return Made("dislocation", b, MIDDLE + np.array(start) @ turned, np.array(velocity) @ turned, first, last)


def crystal(made: list[Made], jitter: float) -> Callable[[int, np.random.Generator], np.ndarray]:
    def frame(k: int, random: np.random.Generator) -> np.ndarray:
        points = LATTICE.copy()
        for one in made:
            if one.there(k):
                points += displacement(LATTICE, one.place(k), one.burgers)
        return points + jitter * random.normal(size=points.shape)

    return frame


NOTHING = np.zeros(2)


def hopping(kind: str, every: int) -> tuple[list[Made], Callable[..., np.ndarray]]:
    """Return a vacancy or an interstitial that hops to the next site every ``every`` frames."""
    first = (ROWS // 2) * COLUMNS + 14
    aside = NOTHING if kind == "vacancy" else np.array([0.5, math.sqrt(3.0) / 6.0])
    # Over an integer number of hops the fitted line has the mean speed of the steps.
    made = Made(
        kind, NOTHING, LATTICE[first] + aside - [0.5 - 0.5 / every, 0.0], np.array([1.0 / every, 0.0])
    )

    def frame(k: int, random: np.random.Generator) -> np.ndarray:
        site = first + k // every
        noise = 0.02 * random.normal(size=(len(LATTICE) + 1, 2))
        if kind == "vacancy":
            return np.asarray(np.delete(LATTICE, site, 0) + noise[:-2])
        arm = LATTICE - (LATTICE[site] + aside)
        pushed = LATTICE + 0.25 * arm / np.linalg.norm(arm, axis=1)[:, None] ** 2
        return np.concatenate([pushed, [LATTICE[site] + aside]]) + noise

    return [made], frame


def boundary(turn: float, speed: float) -> tuple[list[Made], Callable[..., np.ndarray]]:
    """Return two crystals that meet at a line, one rotated relative to the other."""
    block = hexagonal(60, 60) - hexagonal(60, 60).mean(axis=0)
    halves = rotated(block, 0.5 * turn), rotated(block, -0.5 * turn)
    made = Made("grain boundary", NOTHING, np.array([-4.0, 0.0]), np.array([speed, 0.0]))

    def frame(k: int, random: np.random.Generator) -> np.ndarray:
        edge = made.place(k)[0]
        left, right = (one[(np.abs(one) < [15.0, 12.0]).all(axis=1)] for one in halves)
        left, right = left[left[:, 0] < edge], right[right[:, 0] >= edge]
        right = right[cKDTree(left).query(right)[0] > 0.6]
        points = np.concatenate([left, right])
        return np.asarray(points + 0.01 * random.normal(size=points.shape))

    return [made], frame


def of_dislocations(*made: Made, jitter: float = 0.02) -> tuple[list[Made], Callable[..., np.ndarray]]:
    return list(made), crystal(list(made), jitter)


def moves(way: float, glide: float, climb: float = 0.0, sixth: int = 0, last: int = 39) -> Made:
    return dislocation((-way, 0.0), (glide, climb), sixth, last=last)


FILMS: dict[str, tuple[list[Made], Callable[..., np.ndarray]]] = {
    "glide": of_dislocations(moves(7.0, 0.35)),
    "fast glide": of_dislocations(moves(13.0, 0.7)),
    "glide backward": of_dislocations(moves(-7.0, -0.35)),
    "glide at 60 degrees": of_dislocations(moves(6.0, 0.3, sixth=1)),
    "glide at 120 degrees": of_dislocations(moves(6.0, 0.3, sixth=2)),
    "opposite sign": of_dislocations(moves(-7.0, -0.35, sixth=3)),
    "glide with jitter": of_dislocations(moves(7.0, 0.35), jitter=0.03),
    "fast glide with jitter": of_dislocations(moves(13.0, 0.7), jitter=0.03),
    "climb": of_dislocations(dislocation((0.0, -5.0), (0.0, 0.3))),
    "climb downward": of_dislocations(dislocation((0.0, 5.0), (0.0, -0.3))),
    "glide and climb": of_dislocations(dislocation((-7.0, -4.0), (0.35, 0.2))),
    "pair born": of_dislocations(
        dislocation((-2.5 + 1.6, 0.0), (-0.4, 0.0), first=4),
        dislocation((-2.5 + 1.6, 0.0), (-0.4, 0.0), 3, first=4),
    ),
    "pair annihilated": of_dislocations(
        dislocation((-15.7, 0.0), (0.4, 0.0), last=33), dislocation((-15.7, 0.0), (0.4, 0.0), 3, last=33)
    ),
    "pair born and annihilated": of_dislocations(
        dislocation((-2.5, 0.0), (0.0, 0.0), first=5, last=30),
        dislocation((-2.5, 0.0), (0.0, 0.0), 3, first=5, last=30),
    ),
    "two that pass": of_dislocations(
        dislocation((-7.0, 3.5), (0.35, 0.0)), dislocation((-7.0, 3.5), (0.35, 0.0), 3)
    ),
    "leaves": of_dislocations(moves(-5.0, 0.4)),
    "comes in": of_dislocations(moves(20.0, 0.4)),
    "vacancy": hopping("vacancy", 4),
    "interstitial": hopping("interstitial", 4),
    "grain boundary": boundary(math.radians(18.0), 0.2),
}
QUICK = ("glide with jitter", "pair annihilated", "leaves", "vacancy", "grain boundary")
EVENTS = {
    "pair born": ["birth"],
    "pair annihilated": ["annihilation"],
    "pair born and annihilated": ["birth", "annihilation"],
    "leaves": ["leaving"],
    "comes in": ["entry"],
}
STEP = 0.05


def place_among(one: Made, made: list[Made], frame: int) -> np.ndarray:
    """Return the position of a defect, shifted by the displacement that the other defects cause there."""
    place = one.place(frame)
    if one.kind != "dislocation":
        return place
    sides = np.array([place + side * np.array([-one.burgers[1], one.burgers[0]]) for side in (-0.4, 0.4)])
    others = [other for other in made if other is not one and other.there(frame)]
    moves = [displacement(sides, other.place(frame), other.burgers) for other in others]
    return np.asarray(place + np.sum(moves, axis=0).mean(axis=0) if moves else place)


def run_of(film: Callable[..., np.ndarray], make_run: MakeRun) -> Trajectory:
    random = np.random.default_rng(3)
    frames = [film(k, random) for k in range(40)]
    most = max(map(len, frames))
    positions = np.full((40, most, 2), np.nan)
    for k, one in enumerate(frames):
        positions[k, : len(one)] = SPACING * one
    run = make_run(positions)
    run.dataset["frame_time"] = ("frame", STEP * np.arange(40.0))
    return run


def check(name: str, found: Dataset) -> None:
    made, _ = FILMS[name]
    assert found.sizes["track"] == len(made), found["kind"].values
    assert sorted(found["event_kind"].values) == sorted(EVENTS.get(name, []))
    paths = found["position"].values / SPACING
    at_rim = name in ("leaves", "comes in")
    for one in made:
        ways = [
            np.nanmax(np.abs(paths[:, k] - [one.place(frame) for frame in range(40)]))
            for k in range(len(made))
        ]
        mine = int(np.argmin(ways))
        assert found["kind"].values[mine] == one.kind
        seen = np.flatnonzero(np.isfinite(paths[:, mine, 0]))
        if not at_rim:
            # Detected at its prescribed position; jitter may hide it for a frame.
            assert (seen[0], seen[-1]) == (one.first, one.last)
            assert len(seen) >= 0.9 * (one.last - one.first + 1)
        wanted = np.array([place_among(one, made, frame) for frame in seen])
        across = 1 if one.kind == "grain boundary" else 2
        away = np.linalg.norm((paths[seen, mine] - wanted)[:, :across], axis=1)
        assert away.max() < 0.5
        if one.kind == "dislocation":
            np.testing.assert_allclose(found["burgers"][mine], SPACING * one.burgers, atol=1e-3)
        speed = np.linalg.norm(one.velocity) * SPACING / STEP
        measured = found["velocity"].values[mine, :across]
        if speed > 0.0:
            assert np.linalg.norm(measured) == pytest.approx(speed, rel=0.03)
        else:
            assert np.linalg.norm(measured) < 0.01 * SPACING / STEP
    assert not found.attrs["conserved"] < 1.0


@pytest.fixture(scope="module")
def annihilated(make_run: MakeRun) -> tuple[Trajectory, Dataset]:
    """Return a sequence in which two dislocations annihilate, and their tracks."""
    run = run_of(FILMS["pair annihilated"][1], make_run)
    return run, track_defects(run)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=() if one in QUICK else pytest.mark.long) for one in FILMS]
)
def test_defects_of_synthetic_sequences_are_tracked(
    name: str, make_run: MakeRun, annihilated: tuple[Trajectory, Dataset]
) -> None:
    known = annihilated[1] if name == "pair annihilated" else None
    check(name, track_defects(run_of(FILMS[name][1], make_run)) if known is None else known)


def test_burgers_vector_found_by_a_circuit_is_the_prescribed_one() -> None:
    for sixth in range(6):
        points = LATTICE + displacement(LATTICE, MIDDLE, direction(sixth))
        found = detect_defects(points)
        assert found.kinds == ("dislocation",)
        np.testing.assert_allclose(found.burgers[0], found.spacing * direction(sixth), atol=1e-2)
        assert found.charge[0] == 0


def test_an_empty_lattice_site_is_a_vacancy_and_a_perfect_crystal_has_no_defects() -> None:
    """The six neighbours of the site lie on one circle, so that their triangulation is not unique.

    Any triangulation must give the vacancy.
    """
    site = (ROWS // 2) * COLUMNS + 20
    found = detect_defects(np.delete(LATTICE, site, 0))
    assert found.kinds == ("vacancy",)
    np.testing.assert_allclose(found.positions[0], LATTICE[site], atol=0.1)
    assert not detect_defects(LATTICE).kinds


def test_total_burgers_vector_is_conserved_when_two_dislocations_annihilate(
    annihilated: tuple[Trajectory, Dataset],
) -> None:
    found = annihilated[1]
    np.testing.assert_allclose(found["total_burgers"], 0.0, atol=1e-12)
    assert found.attrs["conserved"] == 1.0
    assert found["count"].sel(defect="dislocation").values[[0, -1]].tolist() == [2, 0]


def test_plot_draws_every_defect_path(annihilated: tuple[Trajectory, Dataset]) -> None:
    run, found = annihilated
    axes = plot_defect_paths(found, run.dataset["position"].values[-1])
    (path,) = [one for one in axes.get_lines() if one.get_label() == "dislocation"]
    seen = np.isfinite(found["position"].values[:, 0, 0])
    np.testing.assert_allclose(path.get_xdata(), 1e3 * found["position"].values[seen, 0, 0])


def test_command_for_defects_writes_tables_and_a_picture(
    annihilated: tuple[Trajectory, Dataset],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    last = slice(24, 40)
    run = dataclasses.replace(annihilated[0], dataset=annihilated[0].dataset.isel(frame=last))
    monkeypatch.setattr("granular.run.trajectory.load_trajectory", lambda _: run)
    assert (
        run_command_and_return_exit_code(
            main, ["defects", "runs/bed", "-o", str(tmp_path / "out"), "--quiet"]
        )
        == 0
    )
    with (tmp_path / "out" / "tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == ["dislocation", "dislocation"]
    assert {row["ended"] for row in rows} == {"annihilation"}
    with (tmp_path / "out" / "paths.csv").open(newline="") as file:
        paths = list(csv.DictReader(file))
    assert len(paths) == int(np.isfinite(annihilated[1]["position"][last, ..., 0]).sum())
    assert (tmp_path / "out" / "paths.png").stat().st_size > 1000
    capsys.readouterr()
    assert run_command_and_return_exit_code(main, ["defects", "runs/bed", "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["conserved"] == 1.0
    assert run_command_and_return_exit_code(main, ["defects", "runs/bed", "--start", "5 m"]) == 2


def test_velocity_of_a_dislocation_is_resolved_into_glide_and_climb() -> None:
    """Climb is the component along the Burgers vector rotated by 90 degrees."""
    times, frames = np.linspace(0.0, 2.0, 5), [1, 2, 4]
    burgers = 0.01 * np.array([0.6, 0.8])
    velocity = 3.0 * np.array([0.6, 0.8]) - 2.0 * np.array([-0.8, 0.6])
    path = times[frames, None] * velocity
    track = DefectTrack("dislocation", np.array([1, 0]), np.array(frames), path, burgers)
    found = fit_velocity_of_track(track, times)
    np.testing.assert_allclose(found.velocity, velocity, rtol=1e-12)
    assert (found.glide, found.climb) == pytest.approx((3.0, -2.0), rel=1e-12)
    assert found.speed == pytest.approx(math.sqrt(13.0), rel=1e-12)
    alone = fit_velocity_of_track(track._replace(burgers=np.zeros(2)), times)
    assert math.isnan(alone.glide)
    assert math.isnan(alone.climb)


def test_direction_of_a_rotating_lattice_is_tracked_beyond_60_degrees() -> None:
    turned = [rotated(LATTICE, 0.1 * k) for k in range(16)]
    angles = [one.angle for one in detect_defects_in_frames(np.array(turned))]
    np.testing.assert_allclose(np.diff(angles), 0.1, atol=1e-6)


def test_tracking_of_defects_refuses_invalid_input(make_run: MakeRun) -> None:
    run = make_run(SPACING * LATTICE[None])
    with pytest.raises(InputError, match="minimum_frames = 0"):
        track_defects(run, minimum_frames=0)
    with pytest.raises(InputError, match="reach = -1"):
        link_defect_tracks([], -1.0)
    with pytest.raises(InputError, match="larger bed"):
        detect_defects(hexagonal(2, 2))
    found = track_defects(run)
    assert found.sizes["track"] == 0
    assert math.isnan(found.attrs["conserved"])
