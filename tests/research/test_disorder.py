"""Measures of local temperature, forces and slip, on synthetic data with known answers."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import spearmanr

from granular import Trajectory
from granular.commands.console import run_command_and_return_exit_code
from granular.observables import voronoi_cells
from research.disorder import text
from research.disorder.__main__ import CAMPAIGN
from research.disorder.beds import GROUPS, all_beds, scene_of_bed
from research.disorder.candidates import (
    CANDIDATES,
    ORDERS,
    local_kinetic_temperature,
    subtract_drive_response,
)
from research.disorder.cycles import annealing_scene, cycle_scene, plastic_strain_by_annealing_law
from research.disorder.data_collapse import (
    held_out_skill,
    isotonic_regression_curve,
    judge_collapse,
    rank_correlation,
)
from research.disorder.dislocation_strain import fit_dislocation_strain_fraction
from research.disorder.force_heterogeneity import (
    QUIET,
    SHELLS,
    ForceField,
    choose_random_grains_of_same_classes,
    neighbour_steps_to_nearest_defect,
)
from research.disorder.forces import mean_with_bootstrap_interval, row_of_force_field
from research.disorder.results import STUDIES, run_studies

DRAWS = 40
OWNERS = [one for one in GROUPS for _ in range(12)]


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(5)


def test_the_collapse_of_synthetic_data_onto_one_curve_is_detected(random: np.random.Generator) -> None:
    x = 10.0 ** random.uniform(-4.0, 1.0, len(OWNERS))
    y = np.tanh(0.4 * np.log(x) + 2.0) + 0.05 * random.normal(size=len(x))
    found = judge_collapse(x, y, OWNERS, DRAWS)
    assert found.orders
    assert found.skill.value > 0.9
    assert found.skill.chance < 0.2
    assert found.rank.chance < 0.5
    assert found.rank.low > 0.8


def test_separate_curves_do_not_count_as_a_collapse(random: np.random.Generator) -> None:
    """In each group y rises with x, but from a different offset."""
    place = np.repeat(np.arange(4.0), 12)
    x = random.uniform(size=len(OWNERS)) + 3.0 - place
    y = x + 3.0 * place
    found = judge_collapse(x, y, OWNERS, DRAWS)
    assert not found.orders
    # A rising curve through falling groups is flat: it predicts no better than the mean.
    assert found.skill.value == pytest.approx(0.0, abs=1e-9)
    for group in range(4):
        assert rank_correlation(x[place == group], y[place == group]) == pytest.approx(1.0)


def test_random_and_constant_quantities_do_not_predict_the_data(random: np.random.Generator) -> None:
    x, y = random.normal(size=(2, len(OWNERS)))
    assert not judge_collapse(x, y, OWNERS, DRAWS).orders
    assert not judge_collapse(np.zeros(len(x)), y, OWNERS, DRAWS).orders
    assert rank_correlation(np.zeros(len(x)), y) == 0.0


def test_predictive_skill_depends_on_ranks_and_not_on_scales(random: np.random.Generator) -> None:
    x, y = random.integers(0, 6, size=(2, 30)).astype(float)
    assert rank_correlation(x, y) == pytest.approx(spearmanr(x, y).statistic)
    groups = np.arange(30) % 3
    assert held_out_skill(x, y, groups) == pytest.approx(held_out_skill(np.exp(x), y**3, groups))


def test_fitted_rising_curve_agrees_with_a_hand_calculation() -> None:
    curve = isotonic_regression_curve(np.array([1.0, 2.0, 2.0, 3.0]), np.array([0.0, 5.0, 3.0, 1.0]))
    # 4 twice and 1 fall: their mean is 3.
    np.testing.assert_allclose(curve(np.array([0.0, 1.0, 1.5, 2.0, 9.0])), [0.0, 0.0, 1.5, 3.0, 3.0])


def test_motion_shared_by_grains_does_not_count_as_local_temperature(random: np.random.Generator) -> None:
    points = random.random((400, 2))
    cells, masses = voronoi_cells(points), np.full(400, 2.0)
    heat = random.normal(scale=3.0, size=points.shape)
    assert local_kinetic_temperature(heat, cells, masses) == pytest.approx(18.0, rel=0.1)
    assert local_kinetic_temperature(heat + 100.0, cells, masses) == pytest.approx(
        local_kinetic_temperature(heat, cells, masses)
    )


def test_the_response_to_the_drive_is_subtracted_from_a_signal(random: np.random.Generator) -> None:
    time = np.arange(0.0, 6.0, 1e-3)
    noise = random.normal(size=len(time))
    drive = 7.0 * np.sin(2.0 * np.pi * 20.0 * time + 1.0) + np.cos(2.0 * np.pi * 60.0 * time)
    left = subtract_drive_response(time, 3.0 + 2.0 * time + drive + noise, 20.0)
    np.testing.assert_allclose(left, subtract_drive_response(time, noise, 20.0), atol=1e-9)
    assert np.mean(left**2) == pytest.approx(1.0, rel=0.1)
    # The force of a bed compressed by a fifth is curved: with a straight line it would seem to fluctuate.
    bent = 9.0 * (1.0 - 0.03 * time) ** -2.5
    assert np.abs(subtract_drive_response(time, bent, None, 4)).max() < 1e-3
    assert np.ptp(subtract_drive_response(time, bent, None)) > 0.1


def test_simulated_beds_of_the_campaign_have_different_random_seeds() -> None:
    beds = all_beds()
    assert len({one.seed for one in beds}) == len({one.key for one in beds}) == len(beds)
    assert {one.group for one in beds} == set(GROUPS)
    for group in GROUPS:
        scene_of_bed(next(one for one in beds if one.group == group))


def made_field(random: np.random.Generator, *, uneven: float) -> ForceField:
    """Return a line of grains; one pair of defects visits each grain in turn for three frames."""
    frames, grains = 60 * QUIET, 40
    away = np.full((frames, grains), SHELLS)
    for k, start in enumerate(range(2 * QUIET, frames - 2 * QUIET, 2 * QUIET)):
        steps = np.abs(np.arange(grains) - (3 + 7 * k) % grains)
        away[start : start + 3] = np.minimum(steps, SHELLS)
    depth = np.broadcast_to(np.arange(grains) % 3, away.shape)
    value = (1.0 + depth) * random.uniform(0.9, 1.1, away.shape)
    value[away == 0] *= uneven
    sides = np.where(away == 0, 5, 6)
    return ForceField(np.ones(away.shape), value, sides, away, np.array(depth))


def test_uneven_forces_at_synthetic_defects_are_detected(random: np.random.Generator) -> None:
    found = row_of_force_field(made_field(random, uneven=1.5))
    assert found["uneven"] == pytest.approx(1.5, rel=0.05)
    assert found["uneven, shuffled"] == pytest.approx(1.0, abs=0.05)
    about = np.array(found["uneven about"])
    assert found["arrivals"] > 20
    np.testing.assert_allclose(about[QUIET : QUIET + 3], 1.5, rtol=0.1)
    np.testing.assert_allclose(about[:QUIET], 1.0, rtol=0.1)
    assert found["force 5"] == 1.0
    assert row_of_force_field(made_field(random, uneven=1.0))["uneven"] == pytest.approx(1.0, abs=0.05)


def test_randomly_chosen_grains_keep_the_number_per_frame_and_the_sum_of_depths(
    random: np.random.Generator,
) -> None:
    field = made_field(random, uneven=1.0)
    chosen = field.shell == 0
    other = choose_random_grains_of_same_classes(field, chosen, random)
    assert (other.sum(axis=1) == chosen.sum(axis=1)).all()
    assert (field.depth[other].sum()) == field.depth[chosen].sum()
    assert (other != chosen).any()


def test_distance_of_grains_from_defects_is_counted_in_neighbour_steps(random: np.random.Generator) -> None:
    cells = voronoi_cells(random.random((200, 2)))
    defects = np.zeros(200, dtype=bool)
    defects[17] = True
    found = neighbour_steps_to_nearest_defect(cells, defects)
    assert found[17] == 0
    i, j = cells.neighbours.T
    assert set(np.flatnonzero(found == 1)) == set(j[i == 17]) | set(i[j == 17])
    assert np.abs(found[i] - found[j]).max() <= 1


def test_bootstrap_interval_of_a_mean_has_the_expected_width(random: np.random.Generator) -> None:
    values = random.normal(2.0, 0.3, 400)
    found = mean_with_bootstrap_interval([*values.tolist(), float("nan")])
    assert found.value == pytest.approx(values.mean())
    assert found.high - found.low == pytest.approx(3.92 * 0.3 / 20.0, rel=0.15)


def made_cycles(random: np.random.Generator, fraction: float) -> list[dict[str, list[float]]]:
    rows = []
    for _ in range(6):
        steps = np.repeat(random.exponential(size=20) * (random.random(20) < 0.3), 5)
        plastic = np.cumsum(steps)
        rows.append({"plastic": plastic.tolist(), "moves": (fraction * plastic).tolist()})
    return rows


def test_a_synthetic_strain_fraction_is_recovered(random: np.random.Generator) -> None:
    found = fit_dislocation_strain_fraction(made_cycles(random, 0.7), ["moves"])
    assert found[:3] == pytest.approx((0.7, 0.7, 0.7))
    assert found.left == pytest.approx(0.0, abs=1e-12)
    assert found.control < 0.5
    assert fit_dislocation_strain_fraction(made_cycles(random, 0.0), ["moves"]).slope == 0.0


def test_the_law_has_no_plastic_strain_in_the_elastic_range() -> None:
    from reduced_models.laws.annealing_bed import MODULUS, STIFFENING

    height = np.linspace(1.0, 0.97, 20)
    stress = -MODULUS * (1.0 + STIFFENING) * np.log(height)
    np.testing.assert_allclose(plastic_strain_by_annealing_law(height, stress), 0.0, atol=1e-15)
    np.testing.assert_allclose(plastic_strain_by_annealing_law(height, 0.0 * height), np.log(height))


@pytest.mark.parametrize("question", STUDIES)
def test_results_of_the_disorder_campaign_are_committed(
    question: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("research.disorder.temperature.DRAWS", 5)
    monkeypatch.setattr(
        "research.disorder.text.strain_fractions_from_moves_and_in_total", lambda size: (0.8, 0.9)
    )
    rows = CAMPAIGN.read_committed_results()[question]["rows"]
    assert len(rows) == len(STUDIES[question].cases)
    assert run_command_and_return_exit_code(CAMPAIGN.main, [question, "--json", "--quiet"]) == 0
    assert len(json.loads(capsys.readouterr().out)[question]["rows"]) == len(rows)
    if question == "temperature":
        assert {one.seed for one in all_beds()} == {row["seed"] for row in rows}
        assert set(CANDIDATES) | set(ORDERS) <= set(rows[0])
    assert "|---|" in text.TEXTS[question](rows)


@pytest.mark.long  # quick: each text, with few draws
def test_the_guide_agrees_with_the_results_of_disorder() -> None:
    assert CAMPAIGN.outdated_blocks(CAMPAIGN.read_committed_results()) == []


def test_rows_of_disorder_results_are_cached_and_reused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[object] = []
    for name in ("forces", "slip"):
        row = lambda case: made.append(case) or {"value": 1.0 / 3.0}  # noqa: E731
        monkeypatch.setitem(STUDIES, name, STUDIES[name]._replace(row=row))
    first = run_studies(["forces"], tmp_path, quick=True, progress=False)["forces"]
    assert first["rows"] == [{"value": 0.33333}] * 2
    run_studies(["forces", "slip"], tmp_path, quick=True, progress=False)
    assert len(made) == 3
    written = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert {name: len(one["rows"]) for name, one in written.items()} == {"forces": 2, "slip": 1}
    assert "forces: 2 of 24 beds are run" in text.results_text(written)


def test_a_compression_cycle_starts_from_the_annealed_bed() -> None:
    places = annealing_scene(184, 3).initial_positions_and_velocities()[0]
    annealed = SimpleNamespace(dataset={"position": SimpleNamespace(values=places[None])})
    started, speeds = cycle_scene(184, 3, cast("Trajectory", annealed)).initial_positions_and_velocities()
    np.testing.assert_allclose(started, places)
    assert not speeds.any()
