"""Designing a damper: maps, proposals, refusals, and checks by simulation."""

from __future__ import annotations

import json
import math
import re
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular import simulate
from granular.linear import piston_roots
from granular.linear.equilibrium import equilibrium_from
from granular.shared.errors import InputError, StoreError
from reduced_models import DamperCandidate, DamperMaps, damper_maps, design, fit
from reduced_models.designs.damper import affine_damping_ratio, damper_at_coordinates
from reduced_models.designs.design import DesignError
from reduced_models.designs.maps import PredictedFigures
from reduced_models.designs.proposal import DesignTarget, propose_design
from reduced_models.designs.result import DAMPING_TOLERANCE, FREQUENCY_TOLERANCE, DesignCheck, DesignRound
from reduced_models.designs.steps import mean_damper, step_damper
from reduced_models.designs.study import (
    design_points,
    figures_of_design_check,
    measure_design_check,
    run_design_study,
)

ROOT = Path(__file__).parents[3]
TARGETS = [
    (2.9, 0.05, {}),
    (3.3, 0.1, {}),
    (3.5, 0.2, {}),
    (4.2, 0.15, {}),
    (4.8, 0.2, {}),
    (3.4, 0.12, {"mass": 5.0}),
    (4.4, 0.12, {"grains": 184, "small_share": 0.5}),
]

inside = st.floats(-1.0, 1.0)


@given(st.tuples(inside, inside, inside, inside))
def test_coordinates_return(place):
    made = damper_at_coordinates(np.array(place))
    found = made.map_coordinates()
    # The number of grains is rounded, and everything else goes on from the rounded one.
    assert np.abs(found[[0, 2, 3]] - np.array(place)[[0, 2, 3]]).max() < 1e-9
    # Rounding changes the logarithm by at most half a grain over the smaller of both numbers.
    most = 2.0 / math.log(4.0) * 0.5 / (made.grains - 0.5)
    assert abs(found[1] - place[1]) < most + 1e-9


@given(st.floats(0.5, 2.0))
def test_drag_scales_the_affine_damping_ratio(factor):
    one = DamperCandidate(7.5, 368, 0.1)
    more = one._replace(drag=0.1 * factor)
    assert affine_damping_ratio(more) == pytest.approx(factor * affine_damping_ratio(one))


def test_published_damper_is_in_the_maps():
    maps = damper_maps()
    said = maps.predict(DamperCandidate(7.5, 368, 0.1))
    # tests/regression/test_damper.py: 9.856 D, 0.2880 s, 0.0367.
    expected = {"rest_height": 9.856 * 0.006, "frequency": 1.0 / 0.2880, "damping_ratio": 0.0367}
    for name, value in expected.items():
        workspace = 2.0 * maps.surfaces[name].error  # two standard errors of a prediction
        assert getattr(said, name) == pytest.approx(value, rel=workspace)
    assert said.k1 == pytest.approx((2.0 * math.pi * said.frequency) ** 2)


def test_discs_are_proposed_by_theory_from_the_maps_of_dipoles():
    """As simulated from two starts: 64.4 and 62.7 mm, 3.25 and 3.33 Hz; what is asked for is promised."""
    maps = damper_maps()
    said = maps.predict(DamperCandidate(7.5, 368, 0.1, magnets="cylinders"))
    assert said.rest_height == pytest.approx(0.0636, rel=0.015)
    assert said.frequency == pytest.approx(3.29, rel=0.03)
    found = propose_design(maps, DesignTarget(3.5, 0.05, magnets="cylinders"))
    assert found.scene().grains.magnets == "cylinders"
    promise = maps.predict(found)
    assert (promise.frequency, promise.damping_ratio) == pytest.approx((3.5, 0.05), rel=1e-3)


def test_the_sliders_hold_the_maps():
    """The page's terms, summed as its script does, give what the maps say."""
    maps = damper_maps()
    (text,) = re.findall(r'type="application/json">(.*)</script>', maps.interactive_page().page)
    place = np.array([0.4, -0.5, -0.3, 0.5])
    single = np.polynomial.legendre.legvander(place, 3)
    for name, one in json.loads(text)["surfaces"].items():
        terms = [np.prod([single[c, p] for c, p in enumerate(powers)]) for powers in one["powers"]]
        assert np.dot(one["coefficients"], terms) == pytest.approx(maps.figure_at(name, place))


def test_the_sliders_of_the_site_are_of_these_maps():
    """`python docs/pictures.py sliders` made them; other processors round otherwise."""
    kept = (ROOT / "docs" / "images" / "sliders.html").read_text(encoding="utf-8")
    data = re.compile(r'(?<=type="application/json">).*(?=</script>)')
    assert data.sub("", kept) == data.sub("", damper_maps().interactive_page().page)
    (text,) = data.findall(kept)
    for name, one in json.loads(text)["surfaces"].items():
        expected = damper_maps().surfaces[name].coefficients
        np.testing.assert_allclose(one["coefficients"], expected, rtol=1e-6)


def test_maps_find_a_polynomial_again():
    """On figures that are quadratic in the coordinates the maps are exact; on others they say how
    far off they are.
    """
    random = np.random.default_rng(1)
    dampers = design_points(128)
    places = np.array([one.map_coordinates() for one in dampers])
    quadratic = 1.0 + 0.2 * places[:, 0] ** 2 - 0.1 * places[:, 1] * places[:, 2]
    noisy = quadratic + 0.05 * random.standard_normal(len(quadratic))

    def maps(frequency):
        table = pandas.DataFrame([one._asdict() for one in dampers])
        return DamperMaps(
            table.assign(
                rest_height=0.05, frequency=np.exp(frequency), damping_ratio=0.1, k1=1.0, k2=0.0, k3=0.0
            )
        )

    exact = maps(quadratic)
    assert exact.surfaces["frequency"].error < 1e-12
    unseen = damper_at_coordinates(np.array([0.3, 1.0, -0.2, 0.7]))
    expected = math.exp(1.0 + 0.2 * 0.09 + 0.1 * 0.2)
    assert exact.predict(unseen).frequency == pytest.approx(expected, rel=1e-9)
    assert 0.045 < maps(noisy).surfaces["frequency"].error < 0.075


def test_maps_predict_what_they_did_not_see():
    surfaces = damper_maps().surfaces
    assert surfaces["rest_height"].error < 0.01
    assert surfaces["frequency"].error < 0.02
    # Beds of one kind come to rest in one order or another, whose dampings differ by this much.
    assert surfaces["damping_ratio"].error < 0.1


@settings(max_examples=25, deadline=None)
@given(inside, inside, inside, st.floats(0.0, 0.5))
def test_a_damper_of_the_maps_is_found_again(mass, grains, drag, fraction):
    maps = damper_maps()
    wanted = damper_at_coordinates(np.array([0.98 * mass, grains, 0.98 * drag, 4.0 * fraction - 1.0]))
    said = maps.predict(wanted)
    wish = DesignTarget(said.frequency, said.damping_ratio, wanted.grains, None, wanted.small_share)
    found = maps.predict(propose_design(maps, wish))
    assert found.frequency == pytest.approx(said.frequency, rel=1e-3)
    assert found.damping_ratio == pytest.approx(said.damping_ratio, rel=1e-3)


def test_given_mass_is_kept():
    proposal = propose_design(damper_maps(), DesignTarget(3.6, 0.1, mass=4.0))
    assert proposal.mass == 4.0
    said = damper_maps().predict(proposal)
    assert said.frequency == pytest.approx(3.6, rel=0.005)  # the number of grains is whole
    assert said.damping_ratio == pytest.approx(0.1, rel=0.01)


def test_published_number_of_grains_where_it_does():
    assert propose_design(damper_maps(), DesignTarget(3.3, 0.1)).grains == 368
    assert propose_design(damper_maps(), DesignTarget(4.8, 0.1)).grains < 368


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        # Quick: what that refusal offers, and by command.
        pytest.param({"frequency": 9.0, "damping": 0.1}, "frequency = 9 Hz", marks=pytest.mark.long),
        ({"frequency": 1.0, "damping": 0.1}, "give a frequency from"),
        ({"frequency": 3.3, "damping": 0.9}, "damping = 0.9"),
        # Quick: too much of it, above.
        pytest.param({"frequency": 3.3, "damping": 0.001}, "give one from", marks=pytest.mark.long),
        ({"frequency": 4.8, "damping": 0.1, "grains": 368}, "or leave grains and mass free"),
        ({"frequency": 3.3, "damping": 0.1, "mass": 50.0}, "mass = 50 kg"),
        ({"frequency": 3.3, "damping": 0.1, "grains": 5000}, "integer from 92 to 368"),
        ({"frequency": 3.3, "damping": 0.1, "grains": 200, "mass": 5.0}, "give one of them"),
        ({"frequency": -3.3, "damping": 0.1}, "frequency = -3.3"),
        ({"frequency": 3.3, "damping": float("nan")}, "damping = nan"),
        ({"frequency": None, "damping": 0.1}, "frequency = None"),
        ({"frequency": 3.3, "damping": 0.1, "small_share": 0.8}, "small_share = 0.8"),
        ({"frequency": 3.3, "damping": 0.1, "magnets": "cubes"}, "magnets = 'cubes'"),
        ({"frequency": 3.3, "damping": 0.1, "seeds": (-1,)}, "give integers from 0 on"),
        ({"frequency": 3.3, "damping": 0.1, "workers": 0}, "workers = 0; give an integer from 1 on"),
    ],
)
def test_refusals_name_value_limit_and_remedy(wish, words):
    with pytest.raises(InputError) as caught:
        design(**wish, progress=False)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_a_refusal_offers_can_be_had():
    with pytest.raises(InputError) as caught:
        propose_design(damper_maps(), DesignTarget(9.0, 0.1))
    high = float(str(caught.value).split(" to ")[-1].split(" Hz")[0])
    propose_design(damper_maps(), DesignTarget(0.99 * high, 0.1))
    with pytest.raises(InputError):
        propose_design(damper_maps(), DesignTarget(1.05 * high, 0.1))


def test_study_refuses_other_numbers_of_points():
    with pytest.raises(InputError, match="power of two"):
        run_design_study(points=100, progress=False)


def test_maps_refuse_other_tables(tmp_path):
    (tmp_path / "other.csv").write_text("mass,grains\n1,2\n")
    with pytest.raises(InputError, match="no column"):
        damper_maps(tmp_path / "other.csv")
    with pytest.raises(InputError, match="holds no study"):
        damper_maps(tmp_path / "none.csv")
    with pytest.raises(InputError, match="a k2 that is no number"):
        DamperMaps(damper_maps().study.assign(k2="soft"))


@pytest.mark.parametrize("wrong", [{"mass": 0.0}, {"grains": -3}, {"drag": np.nan}, {"small_share": 1.5}])
def test_figures_of_a_damper_out_of_range_are_refused(wrong):
    candidate = DamperCandidate(7.5, 368, 0.1)._replace(**wrong)
    for act in (candidate.map_coordinates, candidate.scene, lambda: damper_maps().predict(candidate)):
        with pytest.raises(InputError, match=f"{next(iter(wrong))} = "):
            act()


def test_a_directory_that_cannot_be_made_is_no_missed_design(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError):
        design(3.5, 0.05, out=tmp_path / "file", progress=False)


def test_design_is_met_and_kept(tmp_path):
    wanted = {"frequency": 3.9, "damping": 0.12, "grains": 92, "seeds": (5,)}
    with ThreadPoolExecutor(1) as here:
        found = design(**wanted, out=tmp_path, executor=here, progress=False)
        assert found.frequency == pytest.approx(3.9, rel=0.01)
        assert found.damping_ratio == pytest.approx(0.12, rel=0.03)
        plain = json.loads((tmp_path / "design.json").read_text())
        assert plain["damper"]["grains"] == 92
        assert "<svg" in (tmp_path / "report.html").read_text()
        again = design(**wanted, out=tmp_path, executor=here, progress=False)
    assert again.to_plain() == found.to_plain()


def test_unknown_figures_of_maps_are_refused_by_those_there_are():
    with pytest.raises(InputError, match="no figure 'period'; give one of rest_height, frequency"):
        damper_maps().figure_at("period", np.zeros(4))
    with pytest.raises(InputError, match="give four numbers"):
        damper_maps().figure_at("frequency", np.zeros(3))


def test_steps_lead_a_settled_bed_to_other_figures():
    """The bed with the stepped mass and drag has the wanted figures, at an equilibrium without a fall."""
    before = DamperCandidate(3.0, 92, 0.3)
    run = simulate(before.scene(5), progress=False)
    check = DesignCheck(5, **figures_of_design_check(measure_design_check(run)))
    target = DesignTarget(1.01 * check.frequency, 1.2 * check.damping_ratio, grains=92)
    stepped, promise = step_damper(target, DesignRound(before, PROMISE, (check,)))
    assert (promise.frequency, promise.damping_ratio) == pytest.approx(target[:2], rel=1e-3)
    rest = equilibrium_from(stepped.scene(5), np.array(check.positions), check.rest_height)
    root = piston_roots(rest)[0]
    # Fitted figures of a lift of 0.2 D are those of the root to 1e-3.
    assert (root.frequency, root.damping_ratio) == pytest.approx(target[:2], rel=2e-3)
    assert rest.piston_height == pytest.approx(promise.rest_height, rel=1e-3)


PROMISE = PredictedFigures(0.05, 4.0, 0.08, 2.0, 632.0, 0.0, 0.0)
SLOPES = {"piston.mass": [-0.35, 0.1, -1.0], "effects.drag.coefficient": [0.0, 0.0, 1.0]}
"""Of rest, frequency and damping ratio by mass and by drag, about those of the packaged damper."""


def made_up_check(seed, frequency):
    zeros = dict.fromkeys(("lam", "k2", "k3", "misfit", "ledger"), 0.0)
    ones = dict.fromkeys(("rest_height", "rest_gap", "fall_gap", "k1"), 1.0)
    lists = {"times": [], "heights": [], "positions": [], "slopes": SLOPES}
    return DesignCheck(seed, frequency=frequency, damping_ratio=0.08, **zeros, **ones, **lists)


@pytest.mark.parametrize("mass", [None, 4.0])
def test_similar_beds_with_other_numbers_of_grains_have_the_wanted_figures(mass):
    """Frequency goes with N^(-1/4) and damping with N^(3/4) at a load; a fixed mass changes the load."""
    before = DamperCandidate(4.0, 200, 0.3)
    target = DesignTarget(4.02, 0.09, mass=mass)
    stepped, promise = step_damper(target, DesignRound(before, PROMISE, (made_up_check(1, 4.0),)))
    grains, load, drag = (
        math.log(after / first)
        for first, after in (
            (before.grains, stepped.grains),
            (before.mass / before.cell_width_ratio, stepped.mass / stepped.cell_width_ratio),
            (before.drag, stepped.drag),
        )
    )
    assert (load == pytest.approx(0.0)) if mass is None else (stepped.mass == mass)
    # One grain is 0.5 % of them, and 0.2 % of the frequency.
    assert -0.25 * grains + 0.1 * load == pytest.approx(math.log(4.02 / 4.0), abs=1e-3)
    assert 0.75 * grains - 1.0 * load + drag == pytest.approx(math.log(0.09 / 0.08), abs=1e-6)
    assert promise.damping_ratio == pytest.approx(0.09)


def test_the_mean_of_steps_is_between_them_and_keeps_a_given_mass():
    one, two = DamperCandidate(4.0, 200, 0.3), DamperCandidate(4.0, 220, 0.2)
    mean = mean_damper([one, two])
    assert (mean.mass, mean.grains) == (4.0, round(math.sqrt(200 * 220)))
    assert mean.drag == pytest.approx(math.sqrt(0.3 * 0.2), rel=0.005)
    heavier = mean_damper([one, one._replace(mass=9.0)])
    assert (heavier.mass, heavier.drag) == pytest.approx((6.0, 0.3))


def settle_in_orders(monkeypatch, *frequencies):
    """Let the proposals swing with these frequencies [Hz] one after the other, the last from then on."""
    left = list(frequencies)

    def checks(_, seeds, *__):
        frequency = left.pop(0) if len(left) > 1 else left[0]
        return tuple(made_up_check(seed, frequency) for seed in seeds)

    monkeypatch.setattr("reduced_models.designs.design._run_checks", checks)


def test_discs_are_taken_within_three_per_cent_where_no_other_proposal_is_nearer(monkeypatch):
    settle_in_orders(monkeypatch, 3.9, 4.15)
    found = design(4.0, 0.08, magnets="cylinders", progress=False)
    assert found.frequency == pytest.approx(3.9)
    assert [round(made.mean_figure("frequency"), 2) for made in found.rounds] == [4.15, 4.15, 4.15, 3.9]
    assert any("-2.5 %" in note and "3 other proposals" in note for note in found.notes)


def test_discs_that_are_met_after_a_near_proposal_are_taken(monkeypatch):
    settle_in_orders(monkeypatch, 3.9, 4.15, 4.02)
    found = design(4.0, 0.08, magnets="cylinders", progress=False)
    assert found.frequency == pytest.approx(4.02)
    assert not found.notes


@pytest.mark.parametrize("wanted", [{"magnets": "dipoles"}, {"magnets": "cylinders"}])
def test_proposals_that_stay_off_are_refused(monkeypatch, wanted):
    off = 3.9 if wanted["magnets"] == "dipoles" else 3.87
    settle_in_orders(monkeypatch, off)
    with pytest.raises(DesignError, match="proposals missed"):
        design(4.0, 0.08, **wanted, progress=False)


def test_command_says_no_in_one_line(command):
    done = command("reduced_models", "design", "--frequency", "9", "--damping", "0.1")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "9 Hz" in done.stderr


@pytest.mark.long
@pytest.mark.parametrize(("frequency", "damping", "fixed"), TARGETS)
def test_designs_meet_their_targets_in_a_fresh_simulation(frequency, damping, fixed):
    found = design(frequency, damping, **fixed, progress=False)
    run = simulate(found.damper.scene(seed=11), progress=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        swing = fit(run.piston("release").with_time_from_zero(), law="polynomial-spring").at_rest
    assert 1.0 / swing.period == pytest.approx(frequency, rel=FREQUENCY_TOLERANCE)
    assert swing.damping_ratio == pytest.approx(damping, rel=DAMPING_TOLERANCE)
