"""Files in the format of de Paula's program, read back with numpy.loadtxt."""

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

from granular import load_scene, simulate
from granular.observables import per_frame
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError
from research.source_files import depaula_time_units_of_run, main, to_depaula_files

D, T = 0.005, 2.0
MASS = 7368.0 * 0.003 * np.pi * D**2 / 4.0
FORCE = MASS * D / T**2


@pytest.fixture(scope="module")
def files(run: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    written = to_depaula_files(run, tmp_path_factory.mktemp("source") / "dat")
    return {path.stem: np.loadtxt(path) for path in written}


def blocks(values: np.ndarray, every: int = 1) -> np.ndarray:
    """Return the stacked data of the frames, without grains that have left."""
    return np.concatenate([one[np.isfinite(one).reshape(7, -1).all(axis=1)] for one in values[::every]])


def test_units_agree_with_de_paula(run: Trajectory, files: dict[str, np.ndarray]) -> None:
    """The time unit T is the duration of the compression, 10 mm at 5 mm/s."""
    assert depaula_time_units_of_run(run).time_unit == pytest.approx(T, rel=1e-14)
    assert depaula_time_units_of_run(run).frame_interval == pytest.approx(5e-4, rel=1e-14)
    wanted = [D, T, MASS, D / T, FORCE]
    np.testing.assert_allclose(files["charUnits"], wanted, rtol=1e-14)
    species = run.scene.grains.species_indices()
    np.testing.assert_allclose(files["scales"], np.array([1.0, 0.6])[species], rtol=1e-15)


def test_names_of_files_in_de_paulas_format_agree_with_the_thesis(files: dict[str, np.ndarray]) -> None:
    particle = {"posPart", "velPart", "forPart", "comPart", "comPart_norm", "posPart_norm"}
    assert set(files) == particle | {"piston", "piston_0", "charUnits", "avgDis", "scales"}


@pytest.mark.parametrize(
    ("name", "field", "unit"),
    [("posPart", "position", D), ("velPart", "velocity", D / T), ("forPart", "force", FORCE)],
)
def test_particle_files_contain_the_frames(
    run: Trajectory, files: dict[str, np.ndarray], name: str, field: str, unit: float
) -> None:
    wanted = blocks(run.dataset[field].values)
    assert files[name].shape == (40 * 7 + 50 * 6, 2)
    np.testing.assert_allclose(files[name] * unit, wanted, rtol=1e-14)


def test_the_compression_file_contains_sums_of_force_magnitudes(
    run: Trajectory, files: dict[str, np.ndarray]
) -> None:
    sizes = per_frame(run, "compressive_force").values
    there = np.isfinite(run.dataset["position"].values).all(axis=2)
    np.testing.assert_allclose(files["comPart"] * FORCE, sizes[there], rtol=1e-12)
    resulting = np.linalg.norm(blocks(run.dataset["force"].values), axis=1)
    assert not np.allclose(files["comPart"] * FORCE, resulting, rtol=0.1)
    norm = files["comPart_norm"]
    every = sizes[::4]  # every 1000 steps: each fourth frame
    assert np.nanmax(norm) == 1.0
    np.testing.assert_allclose(norm, every[there[::4]] / np.nanmax(every), rtol=1e-12)


def test_the_average_distance_in_the_files_is_half_the_mean_pair_distance(
    run: Trajectory, files: dict[str, np.ndarray]
) -> None:
    place = run.dataset["position"].values
    wanted = []
    for frame in place[::4]:
        points = frame[np.isfinite(frame[:, 0])]
        total = sum(np.hypot(*(p - q)) for p, q in itertools.combinations(points, 2))
        wanted.append(total / (len(points) * (len(points) - 1)) / D)
    np.testing.assert_allclose(files["avgDis"][:, 1], wanted, rtol=1e-13)
    np.testing.assert_allclose(files["avgDis"][:, 0], np.arange(23) * 1e-3, rtol=1e-12)


def test_piston_heights_are_written_at_both_time_intervals(
    run: Trajectory, files: dict[str, np.ndarray]
) -> None:
    """Records are 25 steps apart. All are in the file of fine resolution, every tenth in the usual file."""
    heights = run.dataset["piston_height"].values / D
    np.testing.assert_allclose(files["piston_0"][:, 1], heights, rtol=1e-15)
    np.testing.assert_allclose(files["piston"][:, 1], heights[::10], rtol=1e-15)
    np.testing.assert_allclose(files["piston"][:, 0], np.arange(90) * 2.5e-4, rtol=1e-12)


def test_frames_more_frequent_than_in_the_thesis_are_thinned(run: Trajectory, tmp_path: Path) -> None:
    """Frames are 50 steps apart; every fifth is in the usual file, and all are in the file with _0."""
    data = run.dataset.assign_coords(frame_time=("frame", np.arange(90) * 1e-4))
    written = to_depaula_files(dataclasses.replace(run, dataset=data), tmp_path)
    files = {path.stem: np.loadtxt(path) for path in written}
    place = run.dataset["position"].values
    np.testing.assert_allclose(files["posPart"] * D, blocks(place, 5), rtol=1e-14)
    np.testing.assert_allclose(files["posPart_0"] * D, blocks(place), rtol=1e-14)
    np.testing.assert_allclose(files["posPart_norm"] * D, blocks(place, 20), rtol=1e-14)


def test_less_frequent_frames_are_all_written_with_a_warning(run: Trajectory, tmp_path: Path) -> None:
    data = run.dataset.assign_coords(frame_time=("frame", np.arange(90) * 0.01))
    with pytest.warns(UserWarning, match=r"a frame every 0\.01 s, de Paula every 0\.0005 s"):
        to_depaula_files(dataclasses.replace(run, dataset=data), tmp_path)
    assert len(np.loadtxt(tmp_path / "posPart.dat")) == 40 * 7 + 50 * 6


def test_grains_that_have_left_are_listed_in_the_files(run: Trajectory, tmp_path: Path) -> None:
    to_depaula_files(run, tmp_path)
    heads = [line for line in (tmp_path / "posPart.dat").read_text().splitlines() if "frame" in line]
    assert "without" not in heads[39]
    assert heads[40].endswith("without grains 6")


def test_a_run_without_compression_uses_the_second_as_time_unit(run: Trajectory) -> None:
    scene = run.scene.replace(protocol=[{"kind": "hold", "name": "relax", "duration": 1.0}])
    assert depaula_time_units_of_run(dataclasses.replace(run, scene=scene)).time_unit == 1.0


def test_command_writes_all_files_in_de_paulas_format_completely_or_none(tmp_path: Path) -> None:
    store = tmp_path / "run"
    simulate(load_scene("single-particle"), t_end=0.01, out=store, progress=False)
    main([str(store), "-o", str(tmp_path / "dat"), "--quiet"])
    assert (tmp_path / "dat" / "posPart.dat").is_file()
    with pytest.raises(InputError, match="exists"):
        main([str(store), "-o", str(tmp_path / "dat"), "--quiet"])
    (tmp_path / "file").write_text("here")
    with pytest.raises(InputError, match="cannot be made"):
        main([str(store), "-o", str(tmp_path / "file")])
