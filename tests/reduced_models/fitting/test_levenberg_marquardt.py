"""The search for the smallest sum of squares, on problems with known solutions."""

import numpy as np
import pytest

from reduced_models.fitting.levenberg_marquardt import (
    Normal,
    NormalPrior,
    SearchBounds,
    levenberg_marquardt_vectors_and_costs,
)

MATRIX = np.array([[2.0, 0.6], [0.6, 1.0]])
BEST = np.array([1.5, -0.5])
NONE = NormalPrior(np.zeros(2), samples=100.0)


def linear(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal equations of linear residuals that vanish at `BEST`."""
    off = theta - BEST
    gradient = off @ MATRIX
    return (off * gradient).sum(axis=1), gradient, np.tile(MATRIX, (len(theta), 1, 1))


def test_least_squares_search_reaches_the_minimum_from_every_starting_point(
    random: np.random.Generator,
) -> None:
    theta, cost = levenberg_marquardt_vectors_and_costs(linear, random.uniform(-3.0, 3.0, (6, 2)), NONE)
    np.testing.assert_allclose(theta, np.tile(BEST, (6, 1)), atol=1e-6)
    assert cost.max() < 1e-12


@pytest.mark.parametrize(("entry", "other"), [(0, 1), (1, 0)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_parameter_at_its_bound_stays_there(entry: int, other: int, side: float) -> None:
    """The other parameter takes the best value for this bound."""
    bound = BEST[entry] - side
    low, high = np.full(2, -np.inf), np.full(2, np.inf)
    (high if side > 0.0 else low)[entry] = bound
    start = np.tile(BEST, (3, 1))
    start[:, entry] -= side * np.array([1.0, 1.5, 2.0])
    theta, _ = levenberg_marquardt_vectors_and_costs(linear, start, NONE, bounds=SearchBounds(low, high))
    adjacent = BEST[other] + MATRIX[0, 1] / MATRIX[other, other] * side
    np.testing.assert_allclose(theta[:, entry], bound)
    np.testing.assert_allclose(theta[:, other], adjacent, atol=1e-4)


def test_a_strong_prior_holds_a_parameter_near_its_start_value() -> None:
    """In one almost undamped step this parameter stays, and the other adapts."""
    start = np.array([[0.0, 0.0]])
    held = NormalPrior(np.array([1e9, 0.0]), samples=1.0)
    theta, _ = levenberg_marquardt_vectors_and_costs(linear, start, held, trials=1, damping=1e-6)
    assert theta[0] == pytest.approx([0.0, BEST[1] + 0.6 * BEST[0]], abs=1e-4)


def watched(places: list[float], normal: Normal) -> Normal:
    """Return the function of the normal equations, extended to append each evaluated point to a list."""

    def noted(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        places.append(float(theta[0, 0]))
        return normal(theta)

    return noted


def test_levenberg_marquardt_damping_rises_tenfold_after_a_step_without_gain() -> None:
    """The search starts at the minimum, and ends after three failed steps."""
    places: list[float] = []

    def start_is_best(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        return 1.0 + np.abs(theta[:, 0]), np.ones((1, 1)), np.ones((1, 1, 1))

    theta, _ = levenberg_marquardt_vectors_and_costs(
        watched(places, start_is_best), np.zeros((1, 1)), NormalPrior(np.zeros(1), 1.0), damping=0.01
    )
    assert theta[0, 0] == 0.0
    assert places == pytest.approx([0.0, -1.0 / 1.01, -1.0 / 1.1, -1.0 / 2.0])


def test_levenberg_marquardt_damping_falls_to_a_tenth_after_a_successful_step() -> None:
    places: list[float] = []

    def falls(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        return np.exp(theta[:, 0]), np.ones((1, 1)), np.ones((1, 1, 1))

    levenberg_marquardt_vectors_and_costs(
        watched(places, falls), np.zeros((1, 1)), NormalPrior(np.zeros(1), 1.0), damping=1.0, trials=3
    )
    assert np.diff(places) == pytest.approx([-1.0 / 2.0, -1.0 / 1.1, -1.0 / 1.01])


def test_the_search_ends_if_an_undamped_step_predicts_a_negligible_gain() -> None:
    """No step is tried if its predicted gain is below the tolerance."""
    places: list[float] = []

    def flat(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        off = theta[:, 0] - 1.0
        return 1e10 + off**2, off[:, None], np.ones((1, 1, 1))

    levenberg_marquardt_vectors_and_costs(
        watched(places, flat), np.array([[0.0]]), NormalPrior(np.zeros(1), 1.0), damping=1e-6
    )
    assert places == [0.0]
