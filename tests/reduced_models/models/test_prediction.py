"""What a fitted model offers: its covariance, bands, residuals, a plot, and draws."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import ReducedModel, fit, load_model, sample_posterior

TRUE = {"lam": 0.05, "omega": 1.05, "g0": -1.0}


def test_covariance_and_bands(made: Callable[..., PistonRecord], tmp_path: Path) -> None:
    record = made("linear")
    model = fit(record, "linear")
    assert model.covariance_names == ("lam", "omega", "g0", "height", "velocity")
    spread = np.sqrt(np.diag(model.covariance))
    for k, name in enumerate(TRUE):
        width = float(np.diff(model.intervals[name])[0]) / 2.0
        assert width == pytest.approx(1.96 * spread[k], rel=0.01)
    np.testing.assert_allclose(np.diag(model.correlation), 1.0)
    band = model.predict_with_band(record.time)
    clean = made("linear", level=0.0).height
    covered = (band.low <= clean) & (clean <= band.high)
    assert covered.mean() > 0.8
    assert 1e-4 < float((band.high - band.low).mean()) < 0.02
    np.testing.assert_allclose(model.residuals(record), record.height - band.height, atol=1e-12)
    model.save(tmp_path / "model.json")
    back = load_model(tmp_path / "model.json")
    np.testing.assert_array_equal(back.covariance, model.covariance)
    wider = back.predict_with_band(record.time, confidence=0.99)
    assert float((wider.high - wider.low).mean()) > float((band.high - band.low).mean())
    with pytest.raises(InputError, match="a fraction between 0 and 1"):
        model.predict_with_band(record.time, confidence=2.0)
    bare = model.to_plain() | {"covariance_names": [], "covariance": []}
    with pytest.raises(InputError, match="has no covariance; fit it to a record"):
        ReducedModel.from_plain(bare).predict_with_band(record.time)


def test_a_model_shows_itself(made: Callable[..., PistonRecord]) -> None:
    record = made("linear", level=0.02)
    model = fit(record, "linear")
    above = model.plot(record)
    assert [len(one.lines) for one in above.figure.axes] == [2, 1]
    ax = Figure().subplots()
    assert model.plot(record, ax) is ax
    assert len(ax.figure.axes) == 1
    swing = model.plot().lines[0].get_ydata()
    seen = np.array(model.domain["height"])
    rest = model.at_rest.height if model.at_rest else np.nan
    assert abs(swing[0] - 1e3 * rest) == pytest.approx(1e3 * np.abs(seen - rest).max())
    assert repr(model).startswith("ReducedModel 'linear': z'' + 2*lam*z' + omega**2*z = g0\n  lam =")
    assert len(repr(model).splitlines()) == 3
    assert "<math" in model._repr_html_()
    assert model._repr_latex_() == f"$${model.fitted_latex}$$"


@pytest.mark.long
def test_the_posterior_is_that_of_the_linearisation(made: Callable[..., PistonRecord]) -> None:
    """Where the noise is small, draws are normal about the fit with its covariance."""
    pytest.importorskip("numpyro")
    integer = made("linear", level=0.02)
    record = PistonRecord(integer.time[::5], integer.height[::5])
    model = fit(record, "linear")
    draws = sample_posterior(model, record, draws=200, warmup=150).posterior
    for name in TRUE:
        values = draws[name].values.ravel()
        width = float(np.diff(model.intervals[name])[0]) / 2.0
        assert abs(values.mean() - model.parameters[name]) < 0.3 * width
        assert 1.96 * values.std() == pytest.approx(width, rel=0.25)
    assert float(draws["noise"].mean()) == pytest.approx(model.quality.residual, rel=0.1)
    with pytest.raises(InputError, match="1 models for 2 records"):
        sample_posterior(model, [record, record])
