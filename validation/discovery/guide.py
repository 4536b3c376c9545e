"""What the guide says of the benchmark: table and picture, made from the results file.

``python -m validation discovery --guide`` writes them anew; a test compares the table.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from validation.discovery.results import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).parents[2]
PAGE = "docs/guide/discovery.md"
PICTURE = "docs/images/discovery.png"
BEGIN = "<!-- made from validation/discovery/results.json -->"
END = "<!-- end -->"


def with_block(page: str, block: str) -> str:
    """A page with the text between the marks replaced."""
    before, _, rest = page.partition(BEGIN)
    return f"{before}{BEGIN}\n{block}\n{END}{rest.partition(END)[2]}"


def write_guide(results: Results, root: Path = ROOT) -> list[Path]:
    """Write table and picture below ``root``; their files."""
    from granular.render import save
    from validation.discovery.text import markdown

    page = root / PAGE
    text = page.read_text(encoding="utf-8")
    page.write_text(with_block(text, markdown(results)), encoding="utf-8")
    picture = root / PICTURE
    save(draw(results), picture, overwrite=True)
    return [page, picture]


def draw(results: Results) -> Figure:
    """Share of the runs that find each system at 1 % of noise, by method and library."""
    import numpy as np

    from granular.shared.plotting import COLOURS, READABLE, figure
    from validation.discovery.cases import LIBRARIES, METHODS
    from validation.discovery.systems import SYSTEMS
    from validation.discovery.text import SHOWN_NOISE

    places = np.arange(len(SYSTEMS))[::-1]
    with figure(1, 2, width=9.0, height=8.0, size=READABLE) as (drawing, axes):
        for ax, library in zip(axes, LIBRARIES, strict=True):
            for k, method in enumerate(METHODS):
                shares = [
                    results.rate(method, library, SHOWN_NOISE, [one.name]).share for one in SYSTEMS
                ]
                known = [0.0 if share is None else 100.0 * share for share in shares]
                ax.barh(places + 0.16 * (2.0 - k), known, 0.15, color=COLOURS[k], label=method)
            ax.set(xlabel="found [%]", xlim=(0.0, 104.0), yticks=places, yticklabels=[])
            ax.set_title(f"{library} library", fontsize=READABLE)
            ax.grid(visible=False, axis="y")
        axes[0].set_yticklabels([one.name for one in SYSTEMS])
        drawing.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return drawing
