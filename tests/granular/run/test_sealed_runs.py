"""Runs whose checkpoints stand under a seal, as earlier versions wrote them: the same bits; they go on."""

import hashlib
import tarfile
from pathlib import Path

import numpy as np
import pytest

from granular import load_trajectory, simulate
from granular.shared.errors import StoreError

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
def test_the_bits_are_those_that_were_written(name: str, folder: Path) -> None:
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
def test_a_run_goes_on(name: str, folder: Path) -> None:
    scene = load_trajectory(folder / name).scene
    simulate(scene, dt=STEP, t_end=END, out=folder / name, resume=True, progress=False)
    found = load_trajectory(folder / name).dataset
    known = simulate(scene, dt=STEP, t_end=END, progress=False).dataset
    assert found.sizes == known.sizes
    for variable, size in (("position", 1e-7), ("velocity", 1e-4), ("piston_height", 1e-7)):
        np.testing.assert_allclose(found[variable], known[variable], rtol=0.0, atol=size)


def test_each_array_of_a_checkpoint_is_there_once(folder: Path) -> None:
    """A bit that turns the name of one into that of another hides it."""
    file = folder / "plain" / "checkpoint.npz"
    content = bytearray(file.read_bytes())
    start = content.index(b"x.npy", content.index(b"PK\x01\x02"))
    content[start : start + 1] = b"y"
    file.write_bytes(content)
    with pytest.raises(StoreError, match="is damaged"):
        load_trajectory(folder / "plain")
