"""Exported runs are exact to the last bit of their format and are read by other programs.

A failed export leaves no file.
"""

import dataclasses
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gsd.hoomd
import numpy as np
import pytest

from granular.export import to_extxyz, to_gsd, to_tables, to_vtk
from granular.run.trajectory import Trajectory
from granular.shared.errors import InputError

FRAME = 50
RADIUS = 0.021
"""Distance within which neighbours are counted [m]: a few diameters."""


@pytest.fixture
def spread(run: Trajectory) -> Trajectory:
    """Return a run with grains up to both walls, so that a periodic box would give false neighbours."""
    data = run.dataset.load().copy(deep=True)
    width = run.scene.cell.width
    present = np.isfinite(data["position"].values[FRAME, :, 0])
    x = np.linspace(1e-3, width - 1e-3, present.sum())
    position = data["position"].values.copy()
    position[FRAME, present, 0] = x
    data["position"] = data["position"].copy(data=position)
    for name, unit in (("time", "s"), ("piston_height", "m")):
        data[name].attrs["units"] = unit
    return dataclasses.replace(run, dataset=data)


def places(run: Trajectory) -> np.ndarray:
    """Return positions (k, 2) [m] of the k grains that are in the cell."""
    found = run.dataset["position"].values[FRAME]
    return np.asarray(found[np.isfinite(found).all(axis=1)])


def neighbours(positions: np.ndarray) -> int:
    """Return the number of pairs within a fixed radius, counted directly."""
    apart = np.linalg.norm(positions[:, None] - positions[None, :], axis=2)
    return int((apart[np.triu_indices(len(positions), 1)] < RADIUS).sum())


def test_ase_reads_an_exported_extended_xyz_file(spread: Trajectory, tmp_path: Path) -> None:
    reader = pytest.importorskip("ase.io")
    path = to_extxyz(spread, tmp_path / "bed.xyz")
    atoms = reader.read(path, index=FRAME)
    np.testing.assert_array_equal(atoms.positions[:, :2], places(spread))
    species = spread.scene.grains.species_indices()[: len(atoms)]
    np.testing.assert_array_equal(atoms.arrays["kind"], species)
    assert atoms.cell.lengths()[0] == spread.scene.cell.width
    assert not atoms.pbc.any()
    assert len(reader.read(path, index=":")) == spread.dataset.sizes["frame"]


def test_mdanalysis_reads_an_exported_extended_xyz_file(spread: Trajectory, tmp_path: Path) -> None:
    library = pytest.importorskip("MDAnalysis")
    # MDAnalysis requires the same number of atoms in the whole trajectory.
    later = dataclasses.replace(spread, dataset=spread.dataset.isel(frame=slice(FRAME, None)))
    path = to_extxyz(later, tmp_path / "bed.xyz")
    universe = library.Universe(str(path))
    np.testing.assert_allclose(universe.atoms.positions[:, :2], places(spread), rtol=1e-6)
    assert len(universe.trajectory) == later.dataset.sizes["frame"]


@pytest.mark.parametrize("write", [to_extxyz, to_gsd], ids=["xyz", "gsd"])
def test_ovito_counts_the_same_neighbour_pairs_in_an_exported_run(
    spread: Trajectory, tmp_path: Path, write: Any
) -> None:
    reader = pytest.importorskip("ovito.io")
    from ovito.data import CutoffNeighborFinder

    path = write(spread, tmp_path / f"bed.{write.__name__[-3:]}")
    data = reader.import_file(str(path)).compute(FRAME)
    positions = data.particles.positions[...]
    middle = np.zeros(2) if write is to_extxyz else positions[:, :2].mean(axis=0)
    wanted = places(spread) if write is to_extxyz else places(spread) - places(spread).mean(axis=0)
    np.testing.assert_allclose(positions[:, :2] - middle, wanted, atol=1e-8)
    finder = CutoffNeighborFinder(RADIUS, data)
    found = sum(1 for k in range(len(positions)) for _ in finder.find(k)) // 2
    assert found == neighbours(places(spread)) > 0


def test_freud_counts_the_same_neighbour_pairs_in_an_exported_run(spread: Trajectory, tmp_path: Path) -> None:
    freud = pytest.importorskip("freud")

    path = to_gsd(spread, tmp_path / "bed.gsd")
    with gsd.hoomd.open(str(path)) as file:
        query = freud.locality.AABBQuery.from_system(file[FRAME])
        found = query.query(query.points, {"r_max": RADIUS, "exclude_ii": True}).toNeighborList()
    assert len(found) // 2 == neighbours(places(spread)) > 0


def test_meshio_reads_the_vtk_files_exported_for_paraview(spread: Trajectory, tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    import xml.etree.ElementTree as Xml

    paths = to_vtk(spread, tmp_path / "vtk")
    listed = Xml.parse(paths[0]).getroot().findall("Collection/DataSet")
    times = [float(one.attrib["timestep"]) for one in listed]
    np.testing.assert_array_equal(times, spread.dataset["frame_time"].values)
    mesh = meshio.read(paths[0].with_name(listed[FRAME].attrib["file"]))
    np.testing.assert_array_equal(mesh.points[:, :2], places(spread))
    np.testing.assert_array_equal(
        mesh.point_data["radius"], spread.scene.grains.diameters()[: len(mesh.points)] / 2.0
    )


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_pandas_reads_exported_tables(spread: Trajectory, tmp_path: Path, kind: Any) -> None:
    pandas = pytest.importorskip("pandas")
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    # By default some versions read numbers from text only to within rounding.
    exactly = {"float_precision": "round_trip"} if kind == "csv" else {}
    read = partial(getattr(pandas, f"read_{kind}"), **exactly)
    scalars, grains = map(read, to_tables(spread, tmp_path / "out", kind))
    np.testing.assert_array_equal(scalars["time [s]"], spread.dataset["time"])
    np.testing.assert_array_equal(scalars["piston_height [m]"], spread.dataset["piston_height"])
    chosen = grains[grains["frame"] == FRAME]
    found = chosen[["position_x [m]", "position_y [m]"]].to_numpy()
    np.testing.assert_array_equal(found, places(spread))


Frame = tuple[dict[str, str], dict[str, np.ndarray]]


def parsed(path: Path) -> list[Frame]:
    """Yield header and columns of every frame of an exported file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    frames = []
    while lines:
        count, comment = int(lines[0]), lines[1]
        pairs = re.findall(r'(\w+)=(?:"([^"]*)"|(\S+))', comment)
        header = {key: quote or plain for key, quote, plain in pairs}
        rows = [line.split() for line in lines[2 : 2 + count]]
        del lines[: 2 + count]
        columns, start = {}, 0
        kinds = header["Properties"].split(":")
        for name, kind, width in zip(kinds[::3], kinds[1::3], kinds[2::3], strict=True):
            part = [row[start : start + int(width)] for row in rows]
            columns[name] = np.array(part, dtype={"S": str, "R": float, "I": int}[kind])
            start += int(width)
        assert all(len(row) == start for row in rows)
        frames.append((header, columns))
    return frames


def test_exported_values_are_exact_to_the_last_bit(run: Trajectory, tmp_path: Path) -> None:
    frames = parsed(to_extxyz(run, tmp_path / "bed.xyz"))
    data, scene = run.dataset, run.scene
    assert len(frames) == 90
    for k, (header, columns) in enumerate(frames):
        present = 7 if k < 40 else 6
        assert float(header["Time"]) == data["frame_time"].values[k]
        height = data["frame_height"].values[k]
        assert float(header["Piston_height"]) == height
        lattice = np.array(header["Lattice"].split(), dtype=float).reshape(3, 3)
        np.testing.assert_array_equal(lattice, np.diag([scene.cell.width, height, 0.0031]))
        assert [float(one) for one in header["Origin"].split()] == [0.0, 0.0, -0.00155]
        assert header["pbc"] == "F F F"
        for name, short in (("position", "pos"), ("velocity", "velo"), ("force", "force")):
            np.testing.assert_array_equal(columns[short][:, :2], data[name].values[k, :present])
            assert (columns[short][:, 2] == 0.0).all()
        assert columns["id"].ravel().tolist() == list(range(present))
        diameters = scene.grains.diameters()[:present]
        np.testing.assert_array_equal(columns["radius"].ravel(), diameters / 2.0)
        masses = 7368.0 * 0.003 * np.pi * diameters**2 / 4.0
        np.testing.assert_allclose(columns["mass"].ravel(), masses, rtol=1e-14)
        names = np.array(["big", "two_words,_100_%"])
        wanted = names[scene.grains.species_indices()[:present]]
        assert columns["species"].ravel().tolist() == wanted.tolist()


@pytest.fixture(scope="module")
def frames(run: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> list[gsd.hoomd.Frame]:
    path = to_gsd(run, tmp_path_factory.mktemp("gsd") / "bed.gsd")
    with gsd.hoomd.open(str(path)) as file:
        return list(file)


def test_every_exported_frame_has_its_time_and_piston_height(
    run: Trajectory, frames: list[gsd.hoomd.Frame]
) -> None:
    assert [one.configuration.step for one in frames] == list(range(90))
    times = np.concatenate([one.log["time"] for one in frames])
    np.testing.assert_array_equal(times, run.dataset["frame_time"].values)
    heights = np.concatenate([one.log["piston_height"] for one in frames])
    np.testing.assert_array_equal(heights, run.dataset["frame_height"].values)


@pytest.mark.parametrize("name", ["position", "velocity", "force"])
def test_exported_fields_are_exact_and_grains_that_have_left_are_omitted(
    run: Trajectory, frames: list[gsd.hoomd.Frame], name: str
) -> None:
    wanted = run.dataset[name].values
    for k, frame in enumerate(frames):
        present = 7 if k < 40 else 6
        assert present == frame.particles.N
        field = frame.log[f"particles/{name}"]
        assert field.dtype == np.float64
        np.testing.assert_array_equal(field[:, :2], wanted[k, :present])
        assert (field[:, 2] == 0.0).all()
        np.testing.assert_array_equal(frame.log["particles/grain"], np.arange(present))


def test_gsd_positions_in_one_centred_box_are_accurate_to_single_precision(
    run: Trajectory, frames: list[gsd.hoomd.Frame]
) -> None:
    width, height = run.scene.cell.width, 0.03
    for k, frame in enumerate(frames):
        assert frame.configuration.dimensions == 2
        box = [2 * width, 2 * height, 0, 0, 0, 0]
        np.testing.assert_allclose(frame.configuration.box, box, rtol=1e-7)
        place = frame.particles.position
        wanted = run.dataset["position"].values[k, : frame.particles.N] - [width / 2, height / 2]
        np.testing.assert_allclose(place[:, :2], wanted, rtol=0, atol=1e-8)
        assert (np.abs(place[:, :2]) <= [width / 2 * (1 + 1e-6), height / 2 * (1 + 1e-6)]).all()
        speed = run.dataset["velocity"].values[k, : frame.particles.N]
        np.testing.assert_allclose(frame.particles.velocity[:, :2], speed, rtol=1e-6)


def test_gsd_file_contains_species_diameters_and_masses(
    run: Trajectory, frames: list[gsd.hoomd.Frame]
) -> None:
    species = run.scene.grains.species_indices()
    for frame in (frames[0], frames[-1]):
        particles, count = frame.particles, frame.particles.N
        assert list(particles.types) == ["big", "two words, 100 %"]
        np.testing.assert_array_equal(particles.typeid, species[:count])
        diameter = np.array([0.005, 0.003])[species[:count]]
        np.testing.assert_allclose(particles.diameter, diameter, rtol=1e-7)
        mass = 7368.0 * 0.003 * np.pi * diameter**2 / 4.0
        np.testing.assert_allclose(particles.mass, mass, rtol=1e-6)


def test_gsd_box_of_a_bed_without_piston_is_twice_as_high_as_its_grains(
    run: Trajectory, tmp_path: Path
) -> None:
    """The highest grain in all frames determines the height."""
    scene = run.scene.replace(
        **{
            "piston": None,
            "effects.walls.top": None,
            "protocol": [{"kind": "hold", "name": "relax", "duration": 1.0}],
        }
    )
    with gsd.hoomd.open(str(to_gsd(dataclasses.replace(run, scene=scene), tmp_path / "a.gsd"))) as file:
        top = np.nanmax(run.dataset["position"].values[..., 1])
        assert file[0].configuration.box[1] == pytest.approx(2.0 * top, rel=1e-6)
        assert "piston_height" not in file[0].log


WRITERS = {"bed.gsd": to_gsd, "bed.xyz": to_extxyz, "vtk": to_vtk, "tables": to_tables}
Writer = Callable[..., object]


@pytest.mark.parametrize(("name", "write"), WRITERS.items(), ids=WRITERS)
def test_export_replaces_existing_files_only_with_overwrite(
    run: Trajectory, tmp_path: Path, name: str, write: Writer
) -> None:
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
def test_a_failed_export_leaves_no_file(
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
def test_export_to_a_path_that_cannot_be_written_is_refused(
    run: Trajectory, tmp_path: Path, write: Writer
) -> None:
    with pytest.raises(InputError, match=r"the directory .* does not exist"):
        write(run, tmp_path / "missing" / "bed")
    with pytest.raises(InputError, match="is a directory"):
        write(run, tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        write(run, tmp_path / ("x" * 300))


def test_export_to_a_directory_that_cannot_be_created_is_refused(run: Trajectory, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("here")
    with pytest.raises(InputError, match="cannot be made"):
        to_tables(run, tmp_path / "file")


def test_export_of_a_run_without_frames_is_refused(run: Trajectory, tmp_path: Path) -> None:
    empty = dataclasses.replace(run, dataset=run.dataset.isel(frame=slice(0, 0)))
    with pytest.raises(InputError, match="no frames"):
        to_gsd(empty, tmp_path / "bed.gsd")
