"""Trend of an energy: a statistical test, not a bound.

The energy error of a symplectic method swings with the motion, for ever, and rounding lets it
wander like a random walk (Hairer, McLachlan and Razakarivony 2008, doi:10.1007/s10543-008-0170-3);
neither is a trend. The series is cut into blocks and each block averaged, which takes out the
swing; their borders are spread unevenly (by the golden ratio), so that a swing cannot keep step
with them and pass for something slow. Then a trend is claimed only if it stands out against both
kinds of noise:

- stationary noise: a straight line by least squares through the block means, its variance enlarged
  by (1 + a)/(1 - a) for the autocorrelation a of the residuals, a corrected for its bias
  (2 + 4 a)/n (Kendall 1954, doi:10.1093/biomet/41.3-4.403);
- a random walk: the mean of the steps from block to block against their scatter (Student's t), its
  variance enlarged by 3/2, since averaging correlates neighbouring steps by 1/4 (Working 1960,
  doi:10.2307/1907574).

The p-value is the greater of the two, an intersection-union test (Berger 1982,
doi:10.1080/00401706.1982.10487790), so it is not smaller than it should be under either.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.shared.errors import InputError

# Leaves thirty degrees of freedom to the line. More blocks hold fewer periods each, and the oscillation stays
# in their means; fewer see less of a trend (8 at least).
BLOCKS = 32
# One run in a hundred that has no trend is said to have one.
SIGNIFICANCE = 0.01
# The variance grows by (1 + a)/(1 - a), here 39 times; at a = 1 no trend would ever be seen.
_GREATEST_CORRELATION = 0.95
# Multiples of it, modulo 1, fill the interval most evenly, so that no period keeps step with the borders.
_GOLDEN = 0.6180339887498949
# Averaging leaves 2/3 of the variance of a random walk's steps (Working 1960).
_WORKING = 1.5


@dataclasses.dataclass(frozen=True)
class EnergyTrend:
    """The trend of a series."""

    rate: float  # [unit/s]
    interval: tuple[float, float]  # [unit/s]
    p_stationary: float  # of such a slope without a trend, in stationary noise
    p_walk: float  # and in a random walk
    swing: float  # standard deviation about the line [unit]
    duration: float  # [s]

    @property
    def p_value(self) -> float:
        """Probability of such a slope without a trend, the greater of both tests' p-values."""
        return max(self.p_stationary, self.p_walk)

    @property
    def total_drift(self) -> float:
        """Change of the energy along the fitted line over the whole series, in the energy's unit."""
        return self.rate * self.duration

    def verdict(self, significance: float = SIGNIFICANCE) -> str:
        """``"gains"``, ``"loses"``, or ``"none"`` where no trend is seen."""
        if self.p_value > significance:
            return "none"
        return "gains" if self.rate > 0.0 else "loses"


def energy_trend(time: np.ndarray, energy: np.ndarray, blocks: int = BLOCKS) -> EnergyTrend:
    """Test the energy of a run for a trend, against stationary noise and against a random walk.

    A straight line through block means, its variance enlarged for autocorrelation (bias: Kendall 1954,
    doi:10.1093/biomet/41.3-4.403), and Student's t of the steps between them, enlarged for the averaging
    (Working 1960, doi:10.2307/1907574). The p-value is the greater one of both tests
    (intersection-union test; Berger 1982, doi:10.1080/00401706.1982.10487790).

    Parameters
    ----------
    time : float (n,)
        Equidistant times [s], increasing; first and last count.
    energy : float (n,)
        Energy, or its error, in any unit. A block should hold a period of its swing or more.
    blocks : int
        Number of block means that the test is made of, from 8 on.

    Returns
    -------
    EnergyTrend
        Slope over the run with its 99 % interval [unit/s], p-values, and the deviation about the line.

    Raises
    ------
    InputError
        If there are fewer than four samples a block, fewer than eight blocks, not as many times as
        energies, an energy that is not finite, or times that do not increase.
    """
    energy = np.asarray(energy, dtype=float)
    if energy.ndim != 1 or blocks < 8 or len(energy) < 4 * blocks or len(time) != len(energy):
        raise InputError(
            f"{energy.size} samples at {len(time)} times in {blocks} blocks; at least 8 blocks and "
            "4 samples a block are needed: record more often, or run longer"
        )
    if not np.isfinite(energy).all():
        raise InputError("the energy holds a value that is not finite; a failed run has no trend")
    edges = _block_edges(len(energy), blocks)
    means = np.add.reduceat(energy, edges[:-1]) / np.diff(edges)
    duration = float(time[-1] - time[0])
    if not 0.0 < duration < np.inf:
        raise InputError(f"times from {time[0]:g} s to {time[-1]:g} s; give increasing ones")
    positions = 0.5 * (edges[1:] + edges[:-1] - 1) * duration / (len(energy) - 1)
    return _fit_trend(positions, means, duration, _deviation_about_line(energy))


def _block_edges(length: int, blocks: int) -> np.ndarray:
    """Borders of the blocks (blocks + 1,), each inner one up to a quarter block out of place."""
    inner = np.arange(1, blocks)
    shift = 0.5 * (np.modf(inner * _GOLDEN)[0] - 0.5)
    edges = np.round((inner + shift) * length / blocks).astype(int)
    return np.concatenate([[0], edges, [length]])


def _deviation_about_line(series: np.ndarray) -> float:
    index = np.arange(len(series))
    line = np.polynomial.Polynomial.fit(index, series, 1)
    return float((series - line(index)).std())


def _fit_trend(positions: np.ndarray, means: np.ndarray, duration: float, swing: float) -> EnergyTrend:
    from scipy import stats

    count = len(means)
    away = positions - positions.mean()
    slope = float(away @ means / (away @ away))
    rest = means - means.mean() - slope * away
    error = float(np.sqrt(rest @ rest / (count - 2) / (away @ away) * _variance_inflation(rest)))
    rates = np.diff(means) * (count - 1) / (positions[-1] - positions[0])
    walk = float(rates.mean())
    walk_error = float(rates.std(ddof=1) * np.sqrt(_WORKING / (count - 1)))
    margin = float(stats.t.ppf(0.995, count - 2)) * max(error, walk_error)
    return EnergyTrend(
        rate=slope,
        interval=(slope - margin, slope + margin),
        p_stationary=_two_sided_p_value(slope, error, count - 2),
        p_walk=_two_sided_p_value(walk, walk_error, count - 2),
        swing=swing,
        duration=duration,
    )


def _variance_inflation(rest: np.ndarray) -> float:
    """Factor of the slope's variance, for first-order autocorrelation of the residuals."""
    power = float(rest @ rest)
    if power == 0.0:
        return 1.0
    correlation = float(rest[1:] @ rest[:-1]) / power
    correlation += (2.0 + 4.0 * max(correlation, 0.0)) / len(rest)
    correlation = min(max(correlation, 0.0), _GREATEST_CORRELATION)
    return (1.0 + correlation) / (1.0 - correlation)


def _two_sided_p_value(value: float, error: float, freedom: int) -> float:
    from scipy import stats

    if error == 0.0:
        return 1.0 if value == 0.0 else 0.0
    return float(2.0 * stats.t.sf(abs(value) / error, freedom))
