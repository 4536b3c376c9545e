"""Exponents, moduli and the two transitions of a melting layer, with intervals over blocks of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from research.melting.displacements import melting_modulus_from_modes
from research.melting.scenes import make_layer

HEXATIC_EXPONENT = 0.25
"""eta6 at the unbinding of disclinations (Nelson and Halperin, Phys. Rev. B 19, 2457, 1979)."""

CRYSTAL_MODULUS = 16.0 * math.pi
"""K at the unbinding of dislocations (same source)."""

LINDEMANN = 0.033
"""Dynamic Lindemann parameter of a crystal of dipoles at melting (Zahn and Maret, Phys. Rev. Lett.
85, 3656, 2000)."""

FITTED = (4.0, 0.5)
"""g6 is fitted from this number of spacings up to this fraction of half the cell: beyond it, periodic images
increase g6."""

DRAWS = 400
"""Number of bootstrap samples of the blocks of time."""


class BootstrapInterval(NamedTuple):
    """A value with the central 95 % of the values from resampled blocks of time.

    Attributes
    ----------
    value, low, high : float
    """

    value: float
    low: float
    high: float


class LayerOrder(NamedTuple):
    """Order of a layer.

    Attributes
    ----------
    gamma : float
    exponent : Interval
        eta6: minus the slope of ln g6 over ln r.
    algebraic : float
        Residual of that line over the residual of a line in r (exponential decay): below 1 if the power law
        fits better.
    modulus : Interval
        K; 0 if the crystal is lost.
    plateau : float
        Limit of the Lindemann parameter without exchange of grains; NaN if the crystal is lost.
    lindemann : float
        Dynamic Lindemann parameter at the longest lag.
    growth : float
        Slope of its logarithm over the logarithm of the lag, for the longer half of the lags: near 0 in a
        crystal.
    translation : float
        Translational order.
    order : float
        Root of the mean square of the mean psi6.
    defects : float
        Fraction of the grains without six neighbours.
    """

    gamma: float
    exponent: BootstrapInterval
    algebraic: float
    modulus: BootstrapInterval
    plateau: float
    lindemann: float
    growth: float
    translation: float
    order: float
    defects: float


LOST = 0.3
"""Minimum translational order of a crystal: at melting it scales as (L/a)^(-1/6) or more (Nelson and
Halperin), 0.5 for 64 columns, and without a crystal as N^(-1/2), 0.016."""


def layer_order_from_figures(figures: dict[str, Any]) -> LayerOrder:
    """Return the order of a layer from its figures, with intervals."""
    blocks = np.array(figures["g6"])
    r = np.array(figures["r"])
    along, across = np.array(figures["along"]), np.array(figures["across"])
    full = round(math.sqrt(figures["grains"]))
    item = make_layer(figures["gamma"], full)
    vectors = np.array(figures["waves"]) / item.spacing
    a2 = item.spacing**2

    def melting_modulus_of_blocks(chosen: np.ndarray) -> float:
        if np.mean(np.array(figures["translation"])[chosen]) < LOST:
            return 0.0
        one_way, other = (values[chosen].mean(axis=0) * a2 for values in (along, across))
        return melting_modulus_from_modes(item, one_way, other, vectors)

    lags, gammas = np.log(figures["lags"]), np.log(figures["lindemann"])
    translation = float(np.mean(figures["translation"]))
    late = lags >= np.median(lags)
    return LayerOrder(
        gamma=figures["gamma"],
        exponent=_block_bootstrap_interval(
            lambda chosen: power_law_exponent_eta6(r, blocks[chosen].mean(axis=0)), len(blocks)
        ),
        algebraic=_power_law_over_exponential_residual(r, blocks.mean(axis=0)),
        modulus=_block_bootstrap_interval(melting_modulus_of_blocks, len(along)),
        plateau=figures["plateau"] if translation >= LOST else math.nan,
        lindemann=figures["lindemann"][-1],
        growth=float(np.polyfit(lags[late], gammas[late], 1)[0]),
        translation=translation,
        order=math.sqrt(float(np.mean(figures["order"]))),
        defects=float(np.mean(figures["defects"])),
    )


def _bins_with_positive_correlation(r: np.ndarray, g6: np.ndarray) -> np.ndarray:
    """Return the bins to be fitted, as long as g6 is positive."""
    good = (r >= FITTED[0]) & (r <= FITTED[1] * r[-1])
    bad = np.flatnonzero(good & (g6 <= 0.0))
    if len(bad):
        good[bad[0] :] = False
    return good


def power_law_exponent_eta6(r: np.ndarray, g6: np.ndarray) -> float:
    """Return eta6 of g6 ~ r^-eta6; infinite if g6 vanishes within three bins."""
    good = _bins_with_positive_correlation(r, g6)
    if good.sum() < 3:
        return math.inf
    return -float(np.polyfit(np.log(r[good]), np.log(g6[good]), 1)[0])


def _power_law_over_exponential_residual(r: np.ndarray, g6: np.ndarray) -> float:
    good = _bins_with_positive_correlation(r, g6)
    if good.sum() < 4:
        return math.nan
    power, exponential = (_residual_of_line_fit(x, np.log(g6[good])) for x in (np.log(r[good]), r[good]))
    return power / exponential if exponential > 0.0 else math.nan


def _residual_of_line_fit(x: np.ndarray, y: np.ndarray) -> float:
    """Return the root of the summed squared residuals of a line."""
    return float(np.linalg.norm(y - np.polyval(np.polyfit(x, y, 1), x)))


def _block_bootstrap_interval(measure: Callable[[np.ndarray], float], blocks: int) -> BootstrapInterval:
    random = np.random.default_rng(1)
    drawn = [measure(random.integers(0, blocks, blocks)) for _ in range(DRAWS)]
    low, high = np.quantile(drawn, (0.025, 0.975))
    return BootstrapInterval(measure(np.arange(blocks)), float(low), float(high))


def gamma_of_crossing_with_interval(
    gammas: Sequence[float], values: Sequence[BootstrapInterval], wanted: float, *, rising: bool
) -> BootstrapInterval | None:
    """Return Gamma at which a quantity crosses a value, by linear interpolation; None without a crossing.

    The interval's ends are the crossings of the ends of the quantity's intervals.

    Parameters
    ----------
    gammas : sequence of float
        In rising order.
    values : sequence of Interval
    wanted : float
    rising : bool
        True if the quantity rises with Gamma.
    """
    result = [
        _gamma_of_crossing(gammas, [getattr(item, end) for item in values], wanted, rising)
        for end in ("value", "low", "high")
    ]
    if result[0] is None:
        return None
    low, high = (math.nan if item is None else item for item in result[1:])
    return BootstrapInterval(result[0], min(low, high), max(low, high))


def _gamma_of_crossing(
    gammas: Sequence[float], values: Sequence[float], wanted: float, rising: bool
) -> float | None:
    sign = 1.0 if rising else -1.0
    above = [sign * (value - wanted) for value in values]
    for k in reversed(range(len(gammas) - 1)):
        # From the ordered side: the first layer that has lost the order.
        if above[k] < 0.0 <= above[k + 1]:
            fraction = -above[k] / (above[k + 1] - above[k]) if math.isfinite(above[k]) else 1.0
            return gammas[k] + fraction * (gammas[k + 1] - gammas[k])
    return None


class MeltingTransitions(NamedTuple):
    """Both transitions of a study; None for a transition that is not reached.

    Attributes
    ----------
    hexatic : Interval or None
        Gamma at eta6 = 1/4: the layer is liquid below it.
    crystal : Interval or None
        Gamma at K = 16 pi: the layer is hexatic below it.
    lindemann : float or None
        Gamma at which the plateau of the dynamic Lindemann parameter is 0.033.
    kept : float or None
        Lowest Gamma of a crystalline layer.
    lost : float or None
        Highest Gamma of a layer without a crystal.
    """

    hexatic: BootstrapInterval | None
    crystal: BootstrapInterval | None
    lindemann: float | None
    kept: float | None
    lost: float | None


def find_transitions(layers: Sequence[LayerOrder]) -> MeltingTransitions:
    """Return both transitions, from layers in rising order of Gamma."""
    gammas = [item.gamma for item in layers]
    return MeltingTransitions(
        gamma_of_crossing_with_interval(
            gammas, [item.exponent for item in layers], HEXATIC_EXPONENT, rising=False
        ),
        gamma_of_crossing_with_interval(
            gammas, [item.modulus for item in layers], CRYSTAL_MODULUS, rising=True
        ),
        _gamma_of_crossing(
            gammas, [_plateau_or_infinity(item.plateau) for item in layers], LINDEMANN, rising=False
        ),
        min((item.gamma for item in layers if item.translation >= LOST), default=None),
        max((item.gamma for item in layers if item.translation < LOST), default=None),
    )


def _plateau_or_infinity(value: float) -> float:
    """Return a plateau, or infinity if the crystal is lost."""
    return math.inf if math.isnan(value) else value
