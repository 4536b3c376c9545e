"""Statistics of a bed: histogram bins, numbers of modes, directions, correlations, temperatures and
biexponential fits.
"""

import math

import numpy as np
import pytest
from scipy.stats import pearsonr

from granular import load_scene
from granular.observables import (
    axial_order_parameter,
    biexponential_fit,
    configurational_temperature,
    dip_test,
    kinetic_temperature,
    knuth_histogram,
    pearson_correlation,
    per_frame,
    relative_force_fluctuation,
    spatial_correlation,
    voronoi_cells,
)
from granular.observables.forces import iterate_pair_forces, wall_branches_and_forces
from granular.observables.statistics import dip_statistic, knuth_bin_count
from granular.shared.errors import InputError

from .conftest import TWO_SPECIES, MakeRun, hexagonal


def knuth_posterior(values: np.ndarray, bins: int) -> float:
    """Return Knuth's log posterior of a number of bins, as in equation 4.33 of de Paula's thesis."""
    counts = np.histogram(values, bins)[0]
    n = len(values)
    return (
        n * math.log(bins)
        + math.lgamma(bins / 2)
        - bins * math.lgamma(1 / 2)
        - math.lgamma(n + bins / 2)
        + sum(math.lgamma(k + 1 / 2) for k in counts)
    )


@pytest.mark.parametrize("kind", ["normal", "two", "long-tailed", "few"])
def test_bin_count_by_knuths_rule_maximises_the_posterior(kind: str, random: np.random.Generator) -> None:
    values = {
        "normal": random.normal(size=400),
        "two": np.concatenate([random.normal(0, 1, 200), random.normal(9, 0.5, 200)]),
        "long-tailed": random.exponential(size=300) ** 2,
        "few": random.random(7),
    }[kind]
    posteriors = [knuth_posterior(values, bins) for bins in range(1, len(values) + 1)]
    assert knuth_bin_count(values) == int(np.argmax(posteriors)) + 1


def test_knuths_rule_gives_one_bin_for_uniform_values(random: np.random.Generator) -> None:
    assert knuth_bin_count(random.random(2000)) == 1


def test_histogram_density_integrates_to_one(random: np.random.Generator) -> None:
    values = np.append(random.normal(size=500), np.nan)
    found = knuth_histogram(values)
    assert found.counts.sum() == 500
    assert found.density @ np.diff(found.edges) == pytest.approx(1.0, rel=1e-12)
    same = knuth_histogram(np.full(4, 2.0))
    assert same.counts.tolist() == [4]
    assert same.edges[0] < 2.0 < same.edges[1]
    with pytest.raises(InputError, match="0 finite values"):
        knuth_histogram(np.array([np.nan]))


def test_relative_force_fluctuation_is_the_deviation_from_the_species_mean_over_this_mean() -> None:
    magnitudes = np.array([1.0, 3.0, np.nan, 10.0, 10.0, 0.0])
    species = np.array([0, 0, 0, 1, 1, 2])
    found = relative_force_fluctuation(magnitudes, species)
    np.testing.assert_allclose(found, [0.5, 0.5, np.nan, 0.0, 0.0, np.nan])


def test_interaction_forces_exclude_weight(make_run: MakeRun, random: np.random.Generator) -> None:
    """The weight of each species is subtracted; relative fluctuations refer to the remaining force."""
    changes = {"grains.species": TWO_SPECIES}
    magnetic = random.normal(size=(2, 40, 2))
    magnetic[1, 5] = np.nan
    run = make_run(random.random((2, 40, 2)) * 0.06, changes)
    masses = 7368.0 * np.pi * 0.003 * run.dataset["diameter"].values ** 2 / 4.0
    weight = np.stack([np.zeros(40), -9.8 * masses], axis=1)
    run = make_run(run.dataset["position"].values, changes, forces=magnetic + weight)
    np.testing.assert_allclose(per_frame(run, "interaction_force"), magnetic, rtol=0.0, atol=1e-12)

    owner = run.dataset["species"].values
    fluctuation = per_frame(run, "force_fluctuation").values
    inside = voronoi_cells(run.dataset["position"].values[0]).interior
    np.testing.assert_array_equal(np.isfinite(fluctuation[0]), inside)
    sizes = np.where(inside, np.linalg.norm(magnetic[0], axis=1), np.nan)
    np.testing.assert_allclose(fluctuation[0], relative_force_fluctuation(sizes, owner), rtol=1e-10)


def test_interaction_forces_exclude_the_inertial_force_in_a_shaken_cell(make_run: MakeRun) -> None:
    shaking = {"amplitude": "2 mm", "frequency": "3 Hz", "angle": 0.4}
    changes = {"effects.shaking": shaking, "effects.gravity": None}
    omega = 6.0 * np.pi
    mass = 7368.0 * np.pi * 0.003 * 0.006**2 / 4.0
    # The frames of the trajectory are at 0 s and 1 s; the cell oscillates as sin(w t).
    apparent = mass * 0.002 * omega**2 * np.sin(omega * np.arange(2.0))
    direction = np.array([np.cos(0.4), np.sin(0.4)])
    forces = np.ones((2, 9, 1)) * apparent[:, None, None] * direction
    run = make_run(np.zeros((2, 9, 2)), changes, forces=forces)
    np.testing.assert_allclose(per_frame(run, "interaction_force"), 0.0, atol=1e-15)


@pytest.mark.parametrize(("count", "strength"), [(3, 0.5), (12, 2.0), (200, 0.1), (200, 5.0)])
def test_pearson_correlation_and_its_p_value_agree_with_scipy(
    count: int, strength: float, random: np.random.Generator
) -> None:
    x = random.normal(size=count)
    y = strength * x + random.normal(size=count)
    found = pearson_correlation(np.append(x, np.nan), np.append(y, 1.0))
    wanted = pearsonr(x, y)
    assert found.coefficient == pytest.approx(wanted.statistic, rel=1e-12)
    assert found.p_value == pytest.approx(wanted.pvalue, rel=1e-8)
    assert found.samples == count


def test_pearson_correlation_is_minus_one_for_opposite_lines_and_nan_for_constant_samples() -> None:
    line = np.arange(5.0)
    assert pearson_correlation(line, -2.0 * line).coefficient == pytest.approx(-1.0)
    assert pearson_correlation(line, -2.0 * line).p_value == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(pearson_correlation(line, np.ones(5)).coefficient)
    with pytest.raises(InputError, match="needs 3 or more"):
        pearson_correlation(line[:2], line[:2])


def test_species_in_equilibrium_have_the_same_temperature(
    make_run: MakeRun, random: np.random.Generator
) -> None:
    """In a drifting gas, the mean of M v_x^2 is T for both species, with v_x relative to the drift."""
    changes = {"grains.species": TWO_SPECIES}
    run = make_run(np.zeros((1, 1000, 2)), changes)
    masses = 7368.0 * np.pi * 0.003 * run.dataset["diameter"].values ** 2 / 4.0
    wanted = 3e-7
    velocities = random.normal(size=(1, 1000, 2)) * np.sqrt(wanted / masses)[:, None] + [0.5, -2.0]
    velocities[0, 7] = np.nan
    run = make_run(np.zeros((1, 1000, 2)), changes, velocities=velocities)
    bed = per_frame(run, "temperature")
    # For 2 x 500 components each, the relative standard error is sqrt(2/1000) = 4.5 %; an omitted mass
    # changes the ratio of the species by 4.
    assert float(bed[0]) == pytest.approx(wanted, rel=0.1)
    np.testing.assert_allclose(per_frame(run, "species_temperature")[0], wanted, rtol=0.15)
    assert bed.attrs["units"] == "J"
    assert kinetic_temperature(velocities[0], masses) == pytest.approx(float(bed[0]))


def test_kinetic_temperature_of_two_grains_is_relative_to_their_mean_velocity() -> None:
    """Masses of 1 and 3 kg at 4 and 0 m/s have a mean velocity of 1 m/s and relative energies of 9/2
    and 3/2 J.
    """
    velocities = np.array([[4.0, 0.0], [0.0, 0.0], [np.nan, np.nan]])
    assert kinetic_temperature(velocities, np.array([1.0, 3.0, 5.0])) == pytest.approx(3.0)
    assert np.isnan(kinetic_temperature(velocities[2:], np.array([1.0])))
    with pytest.raises(InputError, match="not above 0 kg"):
        kinetic_temperature(velocities, np.zeros(3))


PUBLISHED = [
    (0.351254, -0.556311, 0.320667, 0.914147),
    (0.435046, 0.343908, 0.00168275, 5.41306),
    (0.328226, 0.322588, 0.00157644, 5.84935),
    (0.654726, 0.18066, 0.0190259, 2.42801),
]
"""A, l1, B, l2 of [D, Table 4.5]."""


@pytest.mark.parametrize("values", PUBLISHED)
@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_biexponential_fit_recovers_the_parameters_of_published_fits(
    values: tuple[float, ...], offset: float
) -> None:
    a, l1, b, l2 = values
    x = np.linspace(0.0, 1.0, 21) + offset
    y = a * np.exp(l1 * x) + b * np.exp(l2 * x)
    fit = biexponential_fit(x, y)
    np.testing.assert_allclose(fit.rates, [l1, l2], rtol=2e-4)
    np.testing.assert_allclose(fit.amplitudes, [a, b], rtol=2e-3)
    np.testing.assert_allclose(fit.values(x), y, rtol=1e-7)
    assert fit.residual < 1e-8 * y.max()


def test_confidence_intervals_of_a_biexponential_fit_have_their_nominal_coverage() -> None:
    """At least 13 of 16 intervals must contain the true value. 95 % of 16 is 15.2, with a standard
    deviation of 0.9.
    """
    truth = np.array([0.435046, 0.00168275, 0.343908, 5.41306])
    x = np.linspace(0.0, 1.0, 21)
    clean = np.exp(np.multiply.outer(x, truth[2:])) @ truth[:2]
    inside = np.zeros(4)
    for seed in range(16):
        noise = np.random.default_rng(seed).normal(0.0, 0.003, len(x))
        fit = biexponential_fit(x, clean + noise)
        ends = np.concatenate([fit.amplitude_intervals, fit.rate_intervals])
        inside += (ends[:, 0] <= truth) & (truth <= ends[:, 1])
    assert (inside >= 13).all()


def test_undetermined_rate_of_a_biexponential_fit_has_a_wide_confidence_interval() -> None:
    """The data have a single exponential, so that the second amplitude is zero and its rate is
    undetermined.
    """
    x = np.linspace(0.0, 1.0, 12)
    noise = np.random.default_rng(3).normal(0.0, 1e-3, len(x))
    fit = biexponential_fit(x, 2.0 * np.exp(0.8 * x) + noise)
    assert np.ptp(fit.rate_intervals, axis=1).max() > 3.0
    np.testing.assert_allclose(fit.values(x), 2.0 * np.exp(0.8 * x), atol=3e-3)


def test_biexponential_fit_refuses_invalid_samples() -> None:
    with pytest.raises(InputError, match="needs 5 or more"):
        biexponential_fit(np.arange(4.0), np.arange(4.0))
    with pytest.raises(InputError, match="finite"):
        biexponential_fit(np.arange(6.0), np.array([1.0, np.nan, 3.0, 4.0, 5.0, 6.0]))


def test_dip_test_distinguishes_bimodal_from_unimodal_values(random: np.random.Generator) -> None:
    one = random.normal(2.0, 0.3, 80)  # same size as below, so that the null distribution is simulated once
    two = np.concatenate([one[:40] - 0.6, one[40:] + 0.6])
    found = dip_test(two)
    assert found.p < 0.01
    assert dip_test(one).p > 0.1
    assert found.dip == pytest.approx(dip_test(10.0 * two - 3.0).dip, rel=1e-9)


def test_dip_of_two_point_masses_is_one_quarter() -> None:
    """Half of the values are at each of two points. The dip statistic then tends to 1/4 (Hartigan 1985)."""
    values = np.concatenate([np.linspace(0.0, 1e-6, 200), np.linspace(1.0, 1.0 + 1e-6, 200)])
    assert dip_statistic(values) == pytest.approx(0.25, abs=0.005)


def test_dip_test_rarely_rejects_uniform_values(random: np.random.Generator) -> None:
    p = np.array([dip_test(random.random(80)).p for _ in range(200)])
    assert 0.01 <= (p < 0.05).mean() <= 0.11


def test_dip_test_refuses_fewer_than_four_values() -> None:
    with pytest.raises(InputError, match="3 values; the dip test needs 4 or more"):
        dip_test(np.array([1.0, 2.0, np.nan, 3.0]))


def test_axial_and_polar_order_distinguish_opposite_from_similar_directions(
    random: np.random.Generator,
) -> None:
    """Vectors along a line in both directions have only axial order.

    Vectors in a fan also have polar order.
    """
    none = axial_order_parameter(random.normal(size=(400, 2)))
    assert min(none.polar_p, none.axial_p) > 0.01
    line = np.outer(random.choice([-1.0, 1.0], 400), [1.0, 2.0])
    found = axial_order_parameter(line)
    assert found.axial == pytest.approx(1.0)
    assert found.polar < 0.2
    assert found.axial_p < 1e-12
    assert axial_order_parameter(np.abs(line)).polar == pytest.approx(1.0)
    assert axial_order_parameter(np.array([[1.0, 0.0], [np.nan, 1.0], [0.0, 0.0]])).vectors == 1
    with pytest.raises(InputError, match="all vectors are 0"):
        axial_order_parameter(np.zeros((3, 2)))


def test_p_values_of_the_rayleigh_test_are_uniform_for_random_directions(random: np.random.Generator) -> None:
    p = np.array([axial_order_parameter(random.normal(size=(30, 2))).axial_p for _ in range(2000)])
    for level in (0.05, 0.3):
        assert (p < level).mean() == pytest.approx(level, abs=3.5 * np.sqrt(level / 2000))


def test_spatial_correlation_shows_stripes_and_vanishes_for_independent_values(
    random: np.random.Generator,
) -> None:
    """Values are equal within a stripe of two rows, and opposite in adjacent stripes."""
    positions = hexagonal(24, 24)
    edges = np.array([0.9, 1.1])
    rows = np.repeat(np.arange(24) % 2, 24)
    striped = spatial_correlation(positions, rows, edges)
    near = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    i, j = np.nonzero(np.triu((near > 0.9) & (near <= 1.1)))
    wanted = np.mean((rows[i] - 0.5) * (rows[j] - 0.5)) / 0.25
    assert striped.values[0] == pytest.approx(wanted)
    assert striped.pairs[0] == len(i)
    noise = spatial_correlation(positions, random.normal(size=576), edges).values[0]
    assert abs(noise) < 4.0 / np.sqrt(striped.pairs[0])
    with pytest.raises(InputError, match="all values are equal"):
        spatial_correlation(positions, np.ones(576), edges)


def test_configurational_temperature_of_a_run_is_the_same_as_computed_frame_by_frame(
    make_run: MakeRun,
) -> None:
    """Forces of dipoles and walls act on the grains."""
    frames = 0.012 * (hexagonal(6, 5) + 2.0) + np.random.default_rng(2).normal(scale=4e-4, size=(3, 30, 2))
    changes = {"effects.gravity": None, "effects.drag": None}
    scene = make_run(frames, changes).scene
    forces = np.zeros_like(frames)
    for total, places in zip(forces, frames, strict=True):
        for some in (*iterate_pair_forces(scene, places), wall_branches_and_forces(scene, places, 0.36)):
            total[some.grains] += some.forces.sum(axis=1)
    run = make_run(frames, changes, forces=forces)
    heights, forces = (run.dataset[name].values for name in ("frame_height", "force"))
    assert configurational_temperature(scene, frames, heights, forces) == pytest.approx(
        configurational_temperature(scene, frames, 0.36), rel=1e-12
    )
    with pytest.raises(InputError, match="0 frames"):
        configurational_temperature(scene, frames[:0], 0.36, forces[:0])
    with pytest.raises(InputError, match=r"piston_height has the shape \(2,\)"):
        configurational_temperature(scene, frames, np.ones(2))
    with pytest.raises(InputError, match="forces have the shape"):
        configurational_temperature(scene, frames, 0.36, forces[0])


def test_configurational_temperature_does_not_change_with_weight_and_is_refused_with_contacts() -> None:
    scene = load_scene("bed").replace(**{"grains.count": 2, "arrangement.height": "19 D"})
    places = 0.006 * np.array([[20.0, 9.0], [30.0, 9.0]])
    bare = scene.replace(**{"effects.gravity": None})
    frames, forces = places[None], np.ones((1, 2, 2))
    whole, part = (configurational_temperature(some, frames, forces=forces) for some in (scene, bare))
    assert whole == part > 0.0
    touching = scene.replace(**{"effects.contact": {"modulus": "1 GPa"}})
    with pytest.raises(InputError, match="dipoles and walls only"):
        configurational_temperature(touching, frames, forces=forces)
