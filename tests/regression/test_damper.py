"""The packaged damper gives the figures of the model page."""

from __future__ import annotations

import pytest

from granular import Scene, simulate
from reduced_models import fit


@pytest.mark.filterwarnings("ignore:two grains came as close")
@pytest.mark.parametrize("dt", ["auto", pytest.param("auto*2", marks=pytest.mark.long)])
def test_rest_height_period_and_damping(damper: Scene, dt: str) -> None:
    """N = 368, M = 7.5 kg, gamma = 0.1 kg/s, drop from 20 D."""
    run = simulate(damper, dt=dt, progress=False)
    diameter = damper.grains.species[0].diameter
    assert run.stage("drop").height / diameter == pytest.approx(9.86, abs=0.1)
    assert run.dataset["piston_height"].values.min() / diameter == pytest.approx(5.8, abs=0.1)
    model = fit(run.piston(), "linear")
    assert model.at_rest.height / diameter == pytest.approx(9.86, abs=0.1)
    assert model.at_rest.period == pytest.approx(0.288, abs=0.003)
    assert model.at_rest.damping_ratio == pytest.approx(0.037, abs=0.003)
