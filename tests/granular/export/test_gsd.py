"""GSD files hold what the run holds: read back with the format's own library."""

from pathlib import Path

import gsd.hoomd
import numpy as np
import pytest

from granular.export import to_gsd
from granular.run.trajectory import Trajectory


@pytest.fixture(scope="module")
def frames(run: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> list[gsd.hoomd.Frame]:
    path = to_gsd(run, tmp_path_factory.mktemp("gsd") / "bed.gsd")
    with gsd.hoomd.open(str(path)) as file:
        return list(file)


def test_every_frame_is_there_with_its_time_and_height(
    run: Trajectory, frames: list[gsd.hoomd.Frame]
) -> None:
    assert [one.configuration.step for one in frames] == list(range(90))
    times = np.concatenate([one.log["time"] for one in frames])
    np.testing.assert_array_equal(times, run.dataset["frame_time"].values)
    heights = np.concatenate([one.log["piston_height"] for one in frames])
    np.testing.assert_array_equal(heights, run.dataset["frame_height"].values)


@pytest.mark.parametrize("name", ["position", "velocity", "force"])
def test_fields_are_exact_and_absent_grains_left_out(
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


def test_particles_lie_in_one_centred_box_in_single_precision(
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


def test_species_diameters_and_masses(run: Trajectory, frames: list[gsd.hoomd.Frame]) -> None:
    species = run.scene.grains.species_indices()
    for frame in (frames[0], frames[-1]):
        particles, count = frame.particles, frame.particles.N
        assert list(particles.types) == ["big", "two words, 100 %"]
        np.testing.assert_array_equal(particles.typeid, species[:count])
        diameter = np.array([0.005, 0.003])[species[:count]]
        np.testing.assert_allclose(particles.diameter, diameter, rtol=1e-7)
        mass = 7368.0 * 0.003 * np.pi * diameter**2 / 4.0
        np.testing.assert_allclose(particles.mass, mass, rtol=1e-6)


def test_bed_without_piston(run: Trajectory, tmp_path: Path) -> None:
    """The box then holds all grains of all frames twice over."""
    import dataclasses

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
