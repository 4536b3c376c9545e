"""Picture for the guide with the fraction of runs that find the law of each system."""

from __future__ import annotations

from typing import TYPE_CHECKING

from research.discovery.results import DiscoveryResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_found_fractions(results: DiscoveryResults) -> Figure:
    """Draw the fraction of runs that find each system at 1 % of noise, by method and library."""
    import numpy as np

    from granular.shared.plotting import COLOURS, READABLE, figure
    from research.discovery.cases import LIBRARIES, METHODS
    from research.discovery.systems import SYSTEMS
    from research.discovery.text import SHOWN_NOISE

    places = np.arange(len(SYSTEMS))[::-1]
    with figure(1, 2, width=9.0, height=8.0, size=READABLE) as (drawing, axes):
        for ax, library in zip(axes, LIBRARIES, strict=True):
            for k, method in enumerate(METHODS):
                shares = [
                    results.rate_of_method(method, library, SHOWN_NOISE, [item.name]).found_fraction
                    for item in SYSTEMS
                ]
                known = [0.0 if fraction is None else 100.0 * fraction for fraction in shares]
                ax.barh(places + 0.16 * (2.0 - k), known, 0.15, color=COLOURS[k], label=method)
            ax.set(xlabel="found [%]", xlim=(0.0, 104.0), yticks=places, yticklabels=[])
            ax.set_title(f"{library} library", fontsize=READABLE)
            ax.grid(visible=False, axis="y")
        axes[0].set_yticklabels([item.name for item in SYSTEMS])
        drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return drawing
