"""The packaged damper reproduces the results on the page of the physical model."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray

from granular import Scene, simulate
from granular.run.trajectory import Trajectory
from reduced_models import fit


@pytest.mark.filterwarnings("ignore:two grains came as close")
@pytest.mark.parametrize(
    ("dt", "changes"),
    [
        pytest.param("auto", {}, marks=pytest.mark.long),
        pytest.param("auto*2", {"pairs.far_every": 8}, marks=pytest.mark.long),
        # The setting of `identify`.
        pytest.param("auto*4", {"pairs.method": "mesh"}, marks=pytest.mark.long),
        ("auto*6", {"protocol.release.duration": 2.0}),
    ],
)
def test_packaged_damper_has_the_documented_equilibrium_height_period_and_damping(
    damper: Scene, tmp_path: Path, dt: str, changes: dict[str, Any]
) -> None:
    """N = 368, M = 7.5 kg, gamma = 0.1 kg/s, drop from 20 D. Long tests also use long-range impulses."""
    run = simulate(damper.replace(**changes), dt=dt, progress=False)
    diameter = damper.grains.species[0].diameter
    assert run.stage("drop").height / diameter == pytest.approx(9.86, abs=0.1)
    assert run.dataset["piston_height"].values.min() / diameter == pytest.approx(5.8, abs=0.1)
    model = fit(run.piston(), "linear", starts=2)
    assert model.at_rest.height / diameter == pytest.approx(9.86, abs=0.1)
    assert model.at_rest.period == pytest.approx(0.288, abs=0.003)
    assert model.at_rest.damping_ratio == pytest.approx(0.037, abs=0.003)
    _check_dataset_operations(run, tmp_path)


def _check_dataset_operations(run: Trajectory, folder: Path) -> None:
    """Check selection and interpolation at the jump of the piston, export, and memory use."""
    tracemalloc.start()
    data, jump = run.dataset, run.stage("lift").start
    height = data.sel(time=jump, method="nearest")["piston_height"].item()
    assert height == pytest.approx(run.stage("drop").height, rel=1e-3)
    assert np.isfinite(data["piston_height"].interp(time=[jump - 5e-4, jump + 5e-4])).all()
    table = run.scalars.to_dataframe()
    assert len(table) == data.sizes["time"]
    assert table.index.is_unique
    data.to_netcdf(folder / "run.nc")
    with xarray.open_dataset(folder / "run.nc") as back:
        assert dict(back.sizes) == dict(data.sizes)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e9
