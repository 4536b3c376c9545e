"""De Paula's test of its method."""

from __future__ import annotations

from collections.abc import Sequence

from granular.shared.html import Page
from granular.shared.plotting import figure
from validation.parts import Plain
from validation.sections.common import WIDTH, Shown, legend, note_failures, sound, tabulate
from validation.source_experiment import COMPENSATED, PLAIN, PRINTED_PEAKS, SourceExperiment


def source_section(page: Page, results: Sequence[Plain]) -> None:
    """Errors over the step, and the peaks, with and without rounding."""
    page.section("De Paula's test of its method")
    note_failures(page, results)
    for one in map(SourceExperiment.from_plain, sound(results)):
        clean, plain = one.of(COMPENSATED)[-1], one.of(PLAIN)[-1]
        page.text(
            "A grain of 5 mm bounces for 2 s from 40 D [D, 2.3.4]. With compensated sums the error "
            f"against the exact height falls with the slope {one.slope(COMPENSATED):.4f}, to "
            f"{clean.error:.1e} m at a step of {clean.step:g} s. In the plain position form it is "
            f"{plain.error:.1e} m there, all but {clean.error:.0e} m of it rounding: what a plot "
            "of it shows below 1e-6 s is rounding. The greatest difference of two peaks is "
            f"{plain.peak_difference:.1e} m there (de Paula prints {PRINTED_PEAKS:g} m) and "
            f"{clean.peak_difference:.1e} m compensated. The toolkit's velocity form is the same "
            "sequence: its heights, compensated, differ from those of the position form by "
            f"{one.agreement():.1g} m at most."
        )
        page.text(
            "De Paula sees its points scatter about the line, and ascribes that to errors that "
            "are relative to the finest step. That alone makes a slope of "
            f"{one.slope_to_finest(COMPENSATED):.3f}, with points within "
            f"{one.scatter_to_finest(COMPENSATED):.0%} of the line, as the compensated sums show. "
            f"In the plain position form rounding makes it {one.slope_to_finest(PLAIN):.2f}, with "
            f"points off the line by up to {one.scatter_to_finest(PLAIN):.0%}."
        )
        with figure(width=WIDTH, height=5.2) as (drawing, axes):
            one.plot(axes)
            legend(axes, columns=1)
            page.figure(
                drawing,
                "Error of the height after 2 s: against the exact one (dots), and relative to the "
                "finest step (rings).",
            )
        with figure(2, 1, width=WIDTH, height=5.6) as (drawing, (above, below)):
            one.plot_path(above)
            one.plot_peaks(below)
            above.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
            below.legend(fontsize=8, loc="center right")
            page.figure(
                drawing,
                "Height over time at the finest step, and how far each peak is from the start's "
                "height.",
            )
        tabulate(page, one.table())


def _text(results: Sequence[Plain]) -> str:
    return "\n".join(SourceExperiment.from_plain(one).table().text() for one in results)


def _verdict(results: Sequence[Plain]) -> tuple[str, bool]:
    slopes = [SourceExperiment.from_plain(one).slope(COMPENSATED) for one in results]
    words = f"de Paula's test has the slope {', '.join(f'{one:.4f}' for one in slopes)}"
    return words, all(abs(one - 2.0) <= 0.01 for one in slopes)


SOURCE = Shown(_text, _verdict, source_section)
