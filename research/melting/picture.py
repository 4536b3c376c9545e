"""Picture for the guide with order, exponents and moduli of the layers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from granular.observables.moduli import crystal_moduli, lattice_spacing
from research.melting.results import MeltingResults
from research.melting.transitions import HEXATIC_EXPONENT, BootstrapInterval

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_layers_and_transitions(results: MeltingResults) -> Figure:
    """Draw g6 of all layers, their exponents and moduli over Gamma, and the Lindemann parameter."""
    import numpy as np
    from matplotlib import colormaps

    from granular.shared.plotting import READABLE, figure

    layers, orders = results.layers, results.orders
    gammas = [item.gamma for item in orders]
    shades = colormaps["viridis"](np.linspace(0.0, 0.9, len(layers)))
    with figure(2, 2, width=11.0, height=8.6, size=READABLE) as (drawing, axes):
        for item, shade in zip(layers, shades, strict=True):
            g6 = np.mean(item["g6"], axis=0)
            axes[0, 0].plot(item["r"], g6, color=shade)
            axes[0, 1].plot(item["lags"], item["lindemann"], color=shade, label=f"{item['gamma']:g}")
        r = np.array([4.0, 16.0])
        axes[0, 0].plot(r, 0.5 * (r / r[0]) ** -HEXATIC_EXPONENT, "k--", linewidth=1.0)
        axes[0, 0].set(
            xscale="log", yscale="log", xlim=(1.0, None), ylim=(0.01, 1.0), xlabel="r/a", ylabel="g6"
        )
        axes[0, 1].legend(title="Γ", ncol=3, loc="upper left", fontsize="x-small")
        axes[0, 1].axhline(0.033, color="k", linestyle="--", linewidth=1.0)
        axes[0, 1].set(
            xscale="log", yscale="log", ylim=(0.01, 3e3), xlabel="time [units]", ylabel="Lindemann parameter"
        )
        shown = [k for k, item in enumerate(orders) if math.isfinite(item.exponent.value)]
        _draw_points_with_intervals(
            axes[1, 0], [gammas[k] for k in shown], [orders[k].exponent for k in shown], 1.0
        )
        axes[1, 0].axhline(HEXATIC_EXPONENT, color="k", linestyle="--", linewidth=1.0)
        axes[1, 0].set(xlabel="Γ", ylabel="η6", yscale="log", ylim=(4e-3, 5.0))
        scale = 1.0 / (16.0 * math.pi)
        _draw_points_with_intervals(axes[1, 1], gammas, [item.modulus for item in orders], scale)
        axes[1, 1].axhline(1.0, color="k", linestyle="--", linewidth=1.0)
        cold = crystal_moduli(1.0, 1.0).young_modulus * lattice_spacing(1.0) ** 2 / math.pi**1.5
        ends = np.array([gammas[0], gammas[-1]])
        axes[1, 1].plot(ends, scale * cold * ends, "k:", linewidth=1.0, label="crystal at rest")
        axes[1, 1].set(xlabel="Γ", ylabel="K/16π")
        axes[1, 1].legend(fontsize="small")
    return drawing


def _draw_points_with_intervals(
    ax: object, gammas: list[float], values: list[BootstrapInterval], scale: float
) -> None:
    middle = [scale * item.value for item in values]
    below = [max(0.0, scale * (item.value - item.low)) for item in values]
    above = [max(0.0, scale * (item.high - item.value)) for item in values]
    ax.errorbar(gammas, middle, [below, above], fmt="o", markersize=5, capsize=3)  # type: ignore[attr-defined]
