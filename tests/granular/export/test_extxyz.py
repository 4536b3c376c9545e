"""Extended XYZ files, read back with a parser written from the format's description."""

import re
from pathlib import Path

import numpy as np

from granular.export import to_extxyz
from granular.run.trajectory import Trajectory

Frame = tuple[dict[str, str], dict[str, np.ndarray]]


def parsed(path: Path) -> list[Frame]:
    """Header and columns of every frame."""
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


def test_everything_comes_back_to_the_last_bit(run: Trajectory, tmp_path: Path) -> None:
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
        names = np.array(["big", "two_words,_100_%"])
        wanted = names[scene.grains.species_indices()[:present]]
        assert columns["species"].ravel().tolist() == wanted.tolist()


def test_masses(run: Trajectory, tmp_path: Path) -> None:
    (_, columns), *_ = parsed(to_extxyz(run, tmp_path / "bed.xyz"))
    diameters = run.scene.grains.diameters()
    wanted = 7368.0 * 0.003 * np.pi * diameters**2 / 4.0
    np.testing.assert_allclose(columns["mass"].ravel(), wanted, rtol=1e-14)
