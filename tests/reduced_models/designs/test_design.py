"""Design of a damper for given frequency and damping: proposals, corrections, errors, and checks by
simulation.
"""

import json
import math
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from granular import simulate
from granular.linear import piston_roots
from granular.shared.errors import InputError, StoreError
from granular.studies.tolerances import read_part_tolerances, tolerances_at
from reduced_models import DamperCandidate, DesignTarget, design, fit, propose_design
from reduced_models.designs.damper import (
    COUNTS,
    DIAMETER,
    LOADS,
    POWERS,
    logarithms_of_figures_by_scaling_laws,
    predicted_figures_from_logarithms,
)
from reduced_models.designs.design import (
    HEAVY,
    MOST,
    DesignError,
    _damper_interpolated_to_target,
    damper_by_scaling_laws,
    figures_of_design_check,
    measure_design_check,
    minimum_and_maximum_reachable_frequency,
)
from reduced_models.designs.result import DAMPING_TOLERANCE, FREQUENCY_TOLERANCE, DesignCheck, DesignRound
from tests.granular.linear.small_beds import at_rest, small_damper

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

TARGETS = [
    (2.9, 0.05, {}),
    (3.3, 0.1, {}),
    (3.5, 0.2, {}),
    (4.2, 0.15, {}),
    (4.8, 0.2, {}),
    (3.4, 0.12, {"mass": 5.0}),
    (4.4, 0.12, {"grains": 184, "small_share": 0.5}),
]


@pytest.mark.parametrize(
    ("magnets", "height", "frequency", "damping_ratio"),
    [("dipoles", 0.05911, 3.4726, 0.03615), ("cylinders", 0.0636, 3.29, None)],
)
def test_packaged_dampers_agree_with_the_scaling_laws(magnets, height, frequency, damping_ratio):
    """Expected values for dipoles are computed at equilibrium. For discs they are means of two simulated
    falls between walls of discs.
    """
    expected = predicted_figures_from_logarithms(
        logarithms_of_figures_by_scaling_laws(DamperCandidate(7.5, 368, 0.1, magnets=magnets))
    )
    assert expected.rest_height == pytest.approx(height, rel=0.01)
    assert expected.frequency == pytest.approx(frequency, rel=0.01)
    if damping_ratio is not None:
        assert expected.damping_ratio == pytest.approx(damping_ratio, rel=0.04)
    assert expected.k1 == pytest.approx((2.0 * math.pi * expected.frequency) ** 2)


@given(
    st.floats(LOADS[0], HEAVY),
    st.integers(*COUNTS),
    st.floats(0.03, 0.25),
    st.floats(0.0, 0.5),
    st.sampled_from(["dipoles", "cylinders"]),
    st.sampled_from(["grains", "mass", None]),
)
def test_proposed_dampers_meet_the_target_according_to_the_scaling_laws(
    load, grains, damping, small_share, magnets, fixed
):
    """No target requires a piston so heavy that it would press 92 grains into contact."""
    one = DamperCandidate(load * math.sqrt(grains / 368), grains, 0.1, small_share, magnets)
    one = one._replace(
        drag=0.1 * (damping / math.exp(logarithms_of_figures_by_scaling_laws(one)[2])) ** (1.0 / POWERS[2, 2])
    )
    frequency = math.exp(logarithms_of_figures_by_scaling_laws(one)[1])
    given_ = {} if fixed is None else {fixed: getattr(one, fixed)}
    target = DesignTarget(frequency, damping, small_share=small_share, magnets=magnets, **given_)
    made = propose_design(target)
    expected = predicted_figures_from_logarithms(logarithms_of_figures_by_scaling_laws(made))
    # The number of grains is rounded: half a grain in 92 is 0.13 % of the frequency.
    assert expected.frequency == pytest.approx(frequency, rel=2e-3)
    assert expected.damping_ratio == pytest.approx(damping, rel=1e-9)
    assert all(getattr(made, name) == value for name, value in given_.items())


def test_a_design_uses_the_published_number_of_grains_if_possible():
    assert propose_design(DesignTarget(3.3, 0.1)).grains == 368
    assert propose_design(DesignTarget(4.8, 0.1)).grains < 368


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"frequency": 1.0, "damping": 0.1}, "Hz: give a frequency in this range"),
        ({"frequency": 3.3, "damping": 0.9}, "damping = 0.9"),
        ({"frequency": 4.8, "damping": 0.1, "grains": 368}, "leave grains and mass free"),
        ({"frequency": 3.3, "damping": 0.1, "mass": 50.0}, "mass = 50 kg"),
        ({"frequency": 3.3, "damping": 0.1, "grains": 5000}, "integer from 92 to 368"),
        ({"frequency": 3.3, "damping": 0.1, "grains": 200, "mass": 5.0}, "give at most one of them"),
        ({"frequency": -3.3, "damping": 0.1}, "frequency = -3.3"),
        ({"frequency": 3.3, "damping": float("nan")}, "damping = nan"),
        ({"frequency": None, "damping": 0.1}, "frequency = None"),
        ({"frequency": 3.3, "damping": 0.1, "small_share": 0.8}, "small_share = 0.8"),
        ({"frequency": 3.3, "damping": 0.1, "magnets": "cubes"}, "magnets = 'cubes'"),
        ({"frequency": 3.3, "damping": 0.1, "seeds": (-1,)}, "give integers >= 0"),
        ({"frequency": 3.3, "damping": 0.1, "workers": 0}, "workers = 0; give an integer >= 1"),
    ],
)
def test_errors_of_a_design_give_the_value_its_limit_and_a_remedy(wish, words):
    with pytest.raises(InputError) as caught:
        design(**wish, progress=False)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fixed", [{}, {"grains": 200}, {"mass": 4.0}, {"small_share": 0.5}])
def test_frequencies_within_the_range_reported_in_an_error_can_be_designed(fixed):
    with pytest.raises(InputError) as caught:
        propose_design(DesignTarget(9.0, 0.1, **fixed))
    low, high = (float(text) for text in str(caught.value).split("reach ")[1].split(" Hz")[0].split(" to "))
    assert minimum_and_maximum_reachable_frequency(DesignTarget(9.0, 0.1, **fixed)) == pytest.approx(
        (low, high), rel=5e-3
    )
    for frequency in (low, high):
        # A rounded limit may be slightly out of range.
        propose_design(DesignTarget(frequency + 0.01 * (1 if frequency == low else -1), 0.1, **fixed))
    with pytest.raises(InputError):
        propose_design(DesignTarget(1.05 * high, 0.1, **fixed))


@pytest.mark.parametrize("wrong", [{"mass": 0.0}, {"grains": -3}, {"drag": np.nan}, {"small_share": 1.5}])
def test_design_parameters_out_of_range_are_refused(wrong):
    candidate = DamperCandidate(7.5, 368, 0.1)._replace(**wrong)
    for act in (candidate.scene, lambda: logarithms_of_figures_by_scaling_laws(candidate)):
        with pytest.raises(InputError, match=f"{next(iter(wrong))} = "):
            act()


def test_an_unwritable_directory_for_a_design_is_reported(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StoreError):
        design(3.5, 0.05, out=tmp_path / "file", progress=False)


def test_a_design_meets_its_target_and_is_saved(tmp_path):
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


def test_frequency_and_damping_from_a_check_by_simulation_agree_with_the_eigenvalue():
    """Simulated values are fitted to the motion after a lift by 0.2 D, although the bed is not fully at rest
    before the lift. The eigenvalue is computed at equilibrium.
    """
    damper = DamperCandidate(3.0, 92, 0.3)
    run = simulate(damper.scene(5), progress=False)
    check = DesignCheck(5, **figures_of_design_check(measure_design_check(run)))
    rest = check.equilibrium(damper)
    root = piston_roots(rest)[0]
    assert (check.frequency, check.damping_ratio) == pytest.approx(
        (root.frequency, root.damping_ratio), rel=1e-3
    )
    assert check.rest_height == pytest.approx(rest.piston_height, abs=1e-2 * DIAMETER)


def make_check(seed, frequency, damping_ratio=0.08, rest_height=1.0):
    figures = {"rest_height": rest_height, "frequency": frequency, "damping_ratio": damping_ratio}
    figures |= dict.fromkeys(("lam", "k2", "k3", "misfit", "ledger"), 0.0)
    figures |= dict.fromkeys(("rest_gap", "fall_gap", "k1"), 1.0)
    return DesignCheck(seed, **figures, times=[], heights=[], positions=[])


@given(
    st.sampled_from([{}, {"mass": 5.0}, {"grains": 300}]),
    st.tuples(*[st.floats(-0.03, 0.03)] * 2, st.floats(-0.15, 0.15)),
)
def test_known_errors_of_the_scaling_laws_are_corrected(fixed, errors):
    target = DesignTarget(3.4, 0.1, **fixed)
    made = damper_by_scaling_laws(target, np.array(errors))
    # The number of grains is rounded.
    assert np.exp(logarithms_of_figures_by_scaling_laws(made) + errors)[1:] == pytest.approx(
        [3.4, 0.1], rel=1e-3
    )
    assert all(getattr(made, name) == value for name, value in fixed.items())


def test_large_errors_of_the_scaling_laws_are_corrected_in_the_search(monkeypatch):
    """The simulated frequency differs by a few per cent and depends less on the mass than in the scaling
    laws.

    The damping ratio differs by a third.
    """

    def checks(damper, seeds, *_):
        errors = np.array([0.0, 0.05 - 0.06 * math.log(damper.mass), 0.3])
        figures = logarithms_of_figures_by_scaling_laws(damper) + errors
        return tuple(make_check(seed, *np.exp(figures[1:]), math.exp(figures[0])) for seed in seeds)

    monkeypatch.setattr("reduced_models.designs.design._simulate_checks", checks)
    made = design(3.1, 0.1, grains=368, progress=False)
    assert made.rounds[-1].largest_error_over_tolerance(made.target) <= 1.0
    assert len(made.rounds) == 3


def test_a_target_frequency_at_which_the_simulated_one_jumps_is_found_by_interpolation(monkeypatch):
    """Small beds settle into different numbers of rows, so that the frequency jumps with the mass."""
    rows = 8.3 * math.sqrt(130 / 368)  # the jump is near this mass of the piston [kg]

    def checks(candidate, seeds, *_):
        height, frequency, ratio = np.exp(logarithms_of_figures_by_scaling_laws(candidate)).tolist()
        frequency *= 1.0 + 0.06 * math.tanh(20.0 * math.log(candidate.mass / rows))
        return tuple(make_check(seed, frequency, ratio, height) for seed in seeds)

    monkeypatch.setattr("reduced_models.designs.design._simulate_checks", checks)
    found = design(4.6, 0.1, progress=False)
    assert found.frequency == pytest.approx(4.6, rel=0.01)
    assert found.damping_ratio == pytest.approx(0.1, rel=0.03)
    assert len(found.rounds) <= 6


def settle_in_orders(monkeypatch, *frequencies):
    """Give successive proposals these frequencies [Hz], and all further ones the last frequency."""
    left = list(frequencies)

    def checks(_, seeds, *__):
        frequency = left.pop(0) if len(left) > 1 else left[0]
        return tuple(make_check(seed, frequency) for seed in seeds)

    monkeypatch.setattr("reduced_models.designs.design._simulate_checks", checks)


def test_a_design_with_discs_within_three_per_cent_of_the_target_is_accepted_if_none_is_closer(monkeypatch):
    settle_in_orders(monkeypatch, 3.9, 4.15)
    found = design(4.0, 0.08, magnets="cylinders", progress=False)
    assert found.frequency == pytest.approx(3.9)
    assert [round(made.mean_figure("frequency"), 2) for made in found.rounds] == [*[4.15] * (MOST - 1), 3.9]
    assert any("-2.5 %" in note and f"{MOST - 1} other proposals" in note for note in found.notes)


def test_a_later_design_with_discs_that_is_closer_to_the_target_replaces_an_earlier_one(monkeypatch):
    """The seeds are given as an array, and stored as a list of integers."""
    settle_in_orders(monkeypatch, 3.9, 4.15, 4.02)
    found = design(4.0, 0.08, magnets="cylinders", seeds=np.array([2, 3]), progress=False)
    assert found.frequency == pytest.approx(4.02)
    assert not found.notes
    (first, *_) = json.loads(json.dumps(found.to_plain()))["rounds"]
    assert [check["seed"] for check in first["checks"]] == [2, 3]


def test_interpolation_between_proposed_dampers_keeps_a_given_piston_mass():
    target = DesignTarget(3.4, 0.08, mass=4.1)
    rounds = [
        DesignRound(DamperCandidate(4.1, grains, 0.2), None, (make_check(2, frequency),))
        for grains, frequency in ((200, 3.6), (300, 3.1))
    ]
    between = _damper_interpolated_to_target(target, rounds)
    assert between.mass == 4.1
    assert 200 < between.grains < 300


def test_page_of_a_design_shows_the_tolerances_of_parts(monkeypatch):
    settle_in_orders(monkeypatch, 4.0)
    found = design(4.0, 0.08, progress=False)
    rest = at_rest(small_damper())
    of_parts = tolerances_at([rest], read_part_tolerances(rest.scene, {"piston.mass": "1%"}))
    plain, page = found.page().to_html(), found.page(of_parts).to_html()
    assert page.count("<svg") == plain.count("<svg") + 1
    assert "Largest causes: of rest piston.mass ± " in page
    assert "In other sections, ± has the same meaning" in page


@pytest.mark.parametrize(("magnets", "off"), [("dipoles", 3.9), ("cylinders", 3.87)])
def test_a_design_that_misses_the_target_raises_an_error(monkeypatch, magnets, off):
    settle_in_orders(monkeypatch, off)
    with pytest.raises(DesignError, match="proposals missed"):
        design(4.0, 0.08, magnets=magnets, progress=False)


def test_command_design_prints_the_tolerances_of_parts(monkeypatch, command):
    bed = SimpleNamespace(equilibrium=lambda _: at_rest(small_damper()))

    class Fake(SimpleNamespace):
        def __str__(self):
            return "a design"

    fake = Fake(damper=None, checks=(bed, bed), to_plain=lambda: {"mass": 7.5})
    monkeypatch.setattr("reduced_models.designs.design.design", lambda *args, **options: fake)
    words = ("reduced_models", "design", "--frequency", "3.3", "--damping", "0.1", "--quiet")
    shown = command(*words, "--part", "piston.mass=1%").stdout
    assert shown.startswith("a design\n")
    assert "0.3 kg ± 1 %" in shown
    assert "of the parts: rest ±" in shown
    plain = json.loads(command(*words, "--json", "--part", "piston.mass=1%").stdout)
    assert plain["mass"] == 7.5
    assert plain["of_parts"]["totals"]["rest"] == pytest.approx(0.0036, rel=0.01)  # slope -0.361
    assert "of the parts" not in command(*words).stdout
    wrong = command(*words, "--part", "piston.colour=1%").stderr
    assert "'piston.colour' is not a numeric key of a part" in wrong
    # Both grain sizes of a mixture are parts of the design, but not of the bed above.
    both = command(*words, "--small-share", "0.3", "--part", "grains.species.1.diameter=1%").stderr
    assert "not a numeric key of a part of the scene 'damper'" in both


@pytest.mark.long
@pytest.mark.parametrize(("frequency", "damping", "fixed"), TARGETS)
def test_designs_meet_their_targets_in_a_simulation_from_another_random_start(frequency, damping, fixed):
    found = design(frequency, damping, **fixed, progress=False)
    run = simulate(found.damper.scene(seed=11), progress=False)
    swing = fit(run.piston("release").with_time_from_zero(), law="polynomial-spring").at_rest
    assert 1.0 / swing.period == pytest.approx(frequency, rel=FREQUENCY_TOLERANCE)
    assert swing.damping_ratio == pytest.approx(damping, rel=DAMPING_TOLERANCE)
