"""Flow out of a silo: the fitted flow law, the opening, and the flow rates of a small silo."""

from types import SimpleNamespace

import numpy as np
import pytest

from granular import Scene, load_scene
from granular.shared.errors import InputError
from granular.studies.silo import SiloFlow, _flow_rate_clogged_and_outflow_count, silo, with_opening

D, G = 6e-3, 9.8


def made_flow(factor: float, margin: float, clogged: int = 0) -> SiloFlow:
    """Return flow rates by an exact law for six openings; the narrowest ones clog."""
    widths = np.arange(3.0, 15.0, 2.0)
    rates = factor * np.sqrt(G / D) * np.outer((widths - margin) ** 1.5, np.ones(2))
    stuck = np.arange(6)[:, None] < clogged + np.zeros(2, dtype=int)
    return SiloFlow(D, G, widths * D, np.where(stuck, 1.0, rates), stuck, np.full((6, 2), 200))


@pytest.mark.parametrize("clogged", [0, 2])
def test_fit_of_the_silo_flow_law_recovers_its_parameters_from_exact_flow_rates(clogged: int) -> None:
    flow = made_flow(0.2, 1.5, clogged)
    np.testing.assert_allclose(flow.law, [0.2, 1.5], rtol=1e-9)
    np.testing.assert_allclose(flow.predict(flow.openings[-1:]), flow.rates[-1, 0], rtol=1e-9)


def test_flow_rates_of_a_silo_are_printed_if_too_few_openings_flow_for_a_fit() -> None:
    flow = made_flow(0.2, 1.5, 5)
    assert np.isnan(flow.law).all()
    assert "no fitted law: grains flow through fewer than two openings" in str(flow)
    assert f"{flow.rates[-1, 0]:.1f}" in str(flow)
    assert flow.to_plain()["factor"] is None


def test_a_pause_of_more_than_one_second_in_silo_flow_counts_as_a_clog_even_if_the_flow_resumes() -> None:
    early, late = np.arange(30) / 20.0, 5.0 + np.arange(100) / 20.0
    for times, clogged in ((np.concatenate([early, late]), True), (late - 5.0, False), (early[:20], True)):
        run = SimpleNamespace(
            dataset={name: SimpleNamespace(values=values) for name, values in _dataset(times).items()},
            scene=SimpleNamespace(grains=SimpleNamespace(count=200)),
        )
        assert _flow_rate_clogged_and_outflow_count(run)[1] == clogged  # type: ignore[arg-type]


def _dataset(times: np.ndarray) -> dict[str, np.ndarray]:
    return {"departure_time": times, "time": np.array([0.0, times[-1] + 2.0])}


def small_silo() -> Scene:
    """Return a silo 20 D wide with 40 grains on inclined floors."""
    slopes = [[[0.0, 40.0 * D], [0.0, 6.0 * D]], [[0.0, 6.0 * D], [7.0 * D, 0.0]]]
    slopes += [[[13.0 * D, 0.0], [20.0 * D, 6.0 * D]], [[20.0 * D, 6.0 * D], [20.0 * D, 40.0 * D]]]
    names = ("left", "left-floor", "right-floor", "right")
    sides = [{"name": name, "ends": ends} for name, ends in zip(names, slopes, strict=True)]
    return load_scene("silo").replace(
        **{
            "cell.sides": sides,
            "grains.count": 40,
            "arrangement.height": "30 D",
            "effects.drag.coefficient": 0.05,
        }
    )


def test_opening_of_a_silo_has_the_requested_width_and_can_be_closed() -> None:
    scene = small_silo()
    ends = [line.ends(0.0, 0.0) for line in with_opening(scene, 3.0 * D).cell.lines]
    assert ends[2][0][0] - ends[1][1][0] == pytest.approx(3.0 * D)
    assert ends[2][0][0] + ends[1][1][0] == pytest.approx(20.0 * D)
    assert scene.effects.walls.has_gap  # type: ignore[union-attr]
    assert not with_opening(scene, 0.0).effects.walls.has_gap  # type: ignore[union-attr]
    with pytest.raises(InputError, match=r"opening is 0\.12 m wide; .* less than 0\.12 m, the distance"):
        silo(scene, [2.0 * D, 20.0 * D])
    with pytest.raises(InputError, match="is not a silo"):
        with_opening(load_scene("bed"), D)


def test_more_grains_leave_a_silo_through_a_wider_opening() -> None:
    flow = silo(small_silo(), [8.0 * D, 14.0 * D], 1)
    assert not flow.clogged.any()
    assert 0.0 < 1.2 * flow.rates[0, 0] < flow.rates[1, 0]
    assert (flow.left > 20).all()
    assert "grains/s" in str(flow)
