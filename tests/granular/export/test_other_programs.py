"""Exported runs, opened by the programs that they are for."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular.export import to_extxyz, to_gsd, to_tables, to_vtk
from granular.run.trajectory import Trajectory

FRAME = 50
RADIUS = 0.021
"""Within which neighbours are counted [m]: a few diameters."""


@pytest.fixture
def spread(run: Trajectory) -> Trajectory:
    """The run with its grains from wall to wall, so that a periodic box shows false neighbours."""
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
    """Positions (k, 2) [m] of the grains in the cell."""
    found = run.dataset["position"].values[FRAME]
    return np.asarray(found[np.isfinite(found).all(axis=1)])


def neighbours(positions: np.ndarray) -> int:
    """Pairs within the radius, counted one by one."""
    apart = np.linalg.norm(positions[:, None] - positions[None, :], axis=2)
    return int((apart[np.triu_indices(len(positions), 1)] < RADIUS).sum())


def test_ase_reads_extended_xyz(spread: Trajectory, tmp_path: Path) -> None:
    reader = pytest.importorskip("ase.io")
    path = to_extxyz(spread, tmp_path / "bed.xyz")
    atoms = reader.read(path, index=FRAME)
    np.testing.assert_array_equal(atoms.positions[:, :2], places(spread))
    species = spread.scene.grains.species_indices()[: len(atoms)]
    np.testing.assert_array_equal(atoms.arrays["kind"], species)
    assert atoms.cell.lengths()[0] == spread.scene.cell.width
    assert not atoms.pbc.any()
    assert len(reader.read(path, index=":")) == spread.dataset.sizes["frame"]


def test_mdanalysis_reads_extended_xyz(spread: Trajectory, tmp_path: Path) -> None:
    library = pytest.importorskip("MDAnalysis")
    # One number of atoms for the whole trajectory.
    later = dataclasses.replace(spread, dataset=spread.dataset.isel(frame=slice(FRAME, None)))
    path = to_extxyz(later, tmp_path / "bed.xyz")
    universe = library.Universe(str(path))
    np.testing.assert_allclose(universe.atoms.positions[:, :2], places(spread), rtol=1e-6)
    assert len(universe.trajectory) == later.dataset.sizes["frame"]


@pytest.mark.parametrize("write", [to_extxyz, to_gsd], ids=["xyz", "gsd"])
def test_ovito_counts_the_same_neighbours(spread: Trajectory, tmp_path: Path, write: Any) -> None:
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


def test_freud_counts_the_same_neighbours(spread: Trajectory, tmp_path: Path) -> None:
    freud = pytest.importorskip("freud")
    import gsd.hoomd

    path = to_gsd(spread, tmp_path / "bed.gsd")
    with gsd.hoomd.open(str(path)) as file:
        query = freud.locality.AABBQuery.from_system(file[FRAME])
        found = query.query(query.points, {"r_max": RADIUS, "exclude_ii": True}).toNeighborList()
    assert len(found) // 2 == neighbours(places(spread)) > 0


def test_meshio_reads_what_paraview_opens(spread: Trajectory, tmp_path: Path) -> None:
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
def test_pandas_reads_tables(spread: Trajectory, tmp_path: Path, kind: Any) -> None:
    pandas = pytest.importorskip("pandas")
    if kind == "parquet":
        pytest.importorskip("pyarrow")
    # Some of its versions read numbers of a text to within a rounding if not asked for more.
    exactly = {"float_precision": "round_trip"} if kind == "csv" else {}
    read = partial(getattr(pandas, f"read_{kind}"), **exactly)
    scalars, grains = map(read, to_tables(spread, tmp_path / "out", kind))
    np.testing.assert_array_equal(scalars["time [s]"], spread.dataset["time"])
    np.testing.assert_array_equal(scalars["piston_height [m]"], spread.dataset["piston_height"])
    chosen = grains[grains["frame"] == FRAME]
    found = chosen[["position_x [m]", "position_y [m]"]].to_numpy()
    np.testing.assert_array_equal(found, places(spread))
