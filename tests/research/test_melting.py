"""Measures of melting, on synthetic layers with known answers."""

import math

import numpy as np
import pytest

from research.melting.__main__ import CAMPAIGN
from research.melting.displacements import (
    assign_grains_to_sites,
    dynamic_lindemann_parameter,
    lindemann_plateau,
    longitudinal_and_transverse_mode_squares,
    melting_modulus_from_modes,
    wave_vectors_of_cell,
)
from research.melting.neighbours import (
    bond_correlation_sums_and_counts,
    local_psi6,
    nearest_image_displacements,
    periodic_voronoi_neighbours,
)
from research.melting.results import MeltingResults
from research.melting.scenes import make_layer
from research.melting.text import table_text
from research.melting.transitions import (
    BootstrapInterval,
    gamma_of_crossing_with_interval,
    layer_order_from_figures,
    power_law_exponent_eta6,
)

COLUMNS = 16


def crystal() -> tuple[np.ndarray, tuple[float, float], float]:
    """Return lattice sites [m], the sides of the cell and the lattice spacing."""
    one = make_layer(100.0, COLUMNS)
    periods = one.scene.cell.periods
    assert periods is not None
    return one.scene.initial_positions_and_velocities()[0], periods, one.spacing


def test_every_grain_of_a_periodic_crystal_has_six_neighbours() -> None:
    sites, periods, a = crystal()
    elsewhere = sites + np.random.default_rng(0).integers(-2, 3, sites.shape) * periods
    found = periodic_voronoi_neighbours(elsewhere, periods)
    assert (found.sides == 6).all()
    np.testing.assert_allclose(np.hypot(*found.way.T), a, rtol=1e-9)
    order = local_psi6(found)
    np.testing.assert_allclose(abs(order.mean()), 1.0, atol=1e-12)


def test_neighbours_and_bond_order_agree_with_freud() -> None:
    freud = pytest.importorskip("freud")
    _, periods, _ = crystal()
    places = np.random.default_rng(3).uniform(0.0, periods, (COLUMNS**2, 2))
    box = freud.box.Box(*periods, is2D=True)
    system = (box, np.column_stack([places - np.array(periods) / 2.0, 0.0 * places[:, 0]]))
    judge, hexatic = freud.locality.Voronoi(), freud.order.Hexatic(k=6)
    judge.compute(system)
    hexatic.compute(system, neighbors=judge.nlist)
    found = periodic_voronoi_neighbours(places, periods)
    ours = set(zip(found.first.tolist(), found.second.tolist(), strict=True))
    # Except for sides shorter than a rounding error.
    assert len(ours ^ {(int(i), int(j)) for i, j in np.asarray(judge.nlist)}) <= 2
    off = np.abs(local_psi6(found) - hexatic.particle_order)
    assert np.median(off) < 1e-5
    assert (off < 1e-4).mean() > 0.98


def test_bond_order_correlation_of_a_synthetic_hexatic_decays_with_its_exponent() -> None:
    """The order is exp(i theta), where theta is a sum of waves of mean square 1/q^2."""
    sites, periods, a = crystal()
    sites = np.concatenate([sites, sites + np.array([periods[0], 0.0])])
    periods = (2.0 * periods[0], periods[1])
    random = np.random.default_rng(1)
    vectors = wave_vectors_of_cell(periods, math.pi / a)
    edges = np.arange(0.5, 8.0, 0.5) * a
    totals, strength = np.zeros((2, len(edges) - 1)), 0.1
    squares = np.zeros(len(edges) - 1)
    for _ in range(60):
        sizes = random.normal(size=(2, len(vectors)))
        sizes *= np.sqrt(strength) * 2.0 * math.pi / np.hypot(*vectors.T) / math.sqrt(periods[0] * periods[1])
        phase = sites @ vectors.T
        theta = np.cos(phase) @ sizes[0] + np.sin(phase) @ sizes[1]
        totals += bond_correlation_sums_and_counts(
            sites, np.exp(1j * theta), periods, edges, np.arange(0, 512, 4)
        )
    # <exp(i dtheta)> of these normal numbers, by their exact variances.
    r = (edges[1:] + edges[:-1]) / 2.0
    angles = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    variances = strength * (2.0 * math.pi) ** 2 / (periods[0] * periods[1])
    for k, radius in enumerate(r):
        ways = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        fraction = (1.0 - np.cos(ways @ vectors.T)) / (vectors**2).sum(axis=1)
        squares[k] = np.exp(-variances * fraction.sum(axis=1)).mean()
    found = totals[0] / np.maximum(totals[1], 1.0)
    far = r > 2.5 * a  # at shorter distances sites have few distinct distances
    np.testing.assert_allclose(found[far], squares[far], atol=0.03)


def test_correlation_exponent_is_exact_for_a_power_law_and_infinite_for_lost_order() -> None:
    r = np.arange(0.75, 30.0, 0.5)
    assert power_law_exponent_eta6(r, 0.7 * r**-0.25) == pytest.approx(0.25)
    assert power_law_exponent_eta6(r, np.exp(-r) - 0.01) == math.inf


def test_moduli_are_recovered_from_thermal_displacements_by_equipartition() -> None:
    """Displacements are drawn at random from the elastic energy of the crystal, and give its modulus K."""
    from granular.observables.moduli import crystal_moduli, melting_theory_modulus

    one = make_layer(100.0, COLUMNS)
    sites, periods, _ = crystal()
    at_rest = crystal_moduli(one.density, one.strength)
    wanted = melting_theory_modulus(at_rest, one.density, one.temperature)
    vectors = wave_vectors_of_cell(periods, 1.0 / one.spacing)
    q, random = np.hypot(*vectors.T), np.random.default_rng(0)
    frames = np.repeat(sites[None], 1000, axis=0)
    along = vectors / q[:, None]
    for way, stiffness in (
        (along, at_rest.bulk + at_rest.shear),
        (along[:, ::-1] * [-1.0, 1.0], at_rest.shear),
    ):
        width = np.sqrt(2.0 * one.temperature * one.density / stiffness / q**2 / len(sites))
        sizes = random.normal(size=(2, 1000, len(q))) * width
        phase = sites @ vectors.T
        for size, wave in zip(sizes, (np.cos(phase), np.sin(phase)), strict=True):
            frames = frames + np.einsum("fm,nm,mk->fnk", size, wave, way)
    spacing = one.spacing
    places = frames + np.array([0.3, 0.1]) * spacing  # the crystal has moved
    modes = longitudinal_and_transverse_mode_squares(
        [assign_grains_to_sites(x, sites, periods, spacing) for x in places], sites, vectors
    )
    found = melting_modulus_from_modes(one, *(mode.mean(axis=0) for mode in modes), vectors)
    assert found == pytest.approx(wanted, rel=0.05)


def test_lindemann_parameter_of_independent_grains_has_its_exact_value() -> None:
    """<|du_i - du_j|^2> = 8 s^2 after any time if positions are independent in each frame."""
    sites, periods, a = crystal()
    random = np.random.default_rng(2)
    frames = sites + 0.05 * a * random.normal(size=(40, *sites.shape))
    found = dynamic_lindemann_parameter(frames, periods, a, np.array([1, 5, 20]))
    np.testing.assert_allclose(found, 8.0 * 0.05**2 / 2.0, rtol=0.05)


def test_exchanged_grains_are_assigned_to_their_present_sites() -> None:
    """The test has two exchanged grains, a shifted lattice, and positions outside the cell."""
    sites, periods, a = crystal()
    random = np.random.default_rng(4)
    order = random.permutation(len(sites))
    moved = 0.03 * a * random.normal(size=sites.shape)
    turns = random.integers(-2, 3, sites.shape) * periods
    places = sites[order] + moved + turns + np.array([0.4, -0.2]) * a
    found = assign_grains_to_sites(places, sites, periods, a)
    shift = np.median(found.moved - moved, axis=0)
    # The position of the lattice is known up to a lattice vector.
    assert len(np.unique(found.site)) == len(sites)
    np.testing.assert_allclose(found.moved - moved - shift, 0.0, atol=1e-9 * a)
    assert abs(shift).max() < 0.01 * a
    wanted = math.exp(-((2.0 * math.pi * 0.03) ** 2) * 2.0 / 3.0)
    assert found.order == pytest.approx(wanted, abs=0.01)
    assert lindemann_plateau([found], sites, periods, a) == pytest.approx(4.0 * 0.03**2, rel=0.1)
    gas = assign_grains_to_sites(random.uniform(0.0, periods, sites.shape), sites, periods, a)
    assert gas.order < 0.2


def test_displacements_are_taken_to_the_nearest_image() -> None:
    ways = nearest_image_displacements(np.array([[0.9, -0.6], [0.4, 1.1]]), (1.0, 1.0))
    np.testing.assert_allclose(ways, [[-0.1, 0.4], [0.4, 0.1]])


def test_a_transition_temperature_is_interpolated_between_simulated_layers_or_reported_as_missing() -> None:
    values = [BootstrapInterval(v, v - 0.1, v + 0.1) for v in (2.0, 0.5, 0.1)]
    found = gamma_of_crossing_with_interval([60.0, 62.0, 64.0], values, 0.25, rising=False)
    assert found.value == pytest.approx(62.0 + 2.0 * 0.25 / 0.4)
    assert found.low < found.value < found.high
    assert gamma_of_crossing_with_interval([60.0, 62.0], values[:2], 0.25, rising=False) is None


def test_guide_agrees_with_the_results_on_melting() -> None:
    results = CAMPAIGN.read_committed_results()
    assert results.layers
    assert CAMPAIGN.outdated_blocks(results) == []
    assert CAMPAIGN.outdated_blocks(results._replace(layers=results.layers[1:])) == [
        "docs/results/melting-and-disorder.md: table"
    ]


def test_missing_results_on_melting_are_reported() -> None:
    assert "no results" in table_text(MeltingResults({}, ()))
    with pytest.raises(KeyError):
        layer_order_from_figures({})
