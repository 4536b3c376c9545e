"""A design: the damper, and its oscillation by scaling laws and by simulations."""

from __future__ import annotations

import dataclasses
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.blocks import Heading, Picture, Printout, Table, format_number, make_cautions
from granular.shared.errors import InputError, quote
from granular.shared.files import write_json
from granular.shared.html_pages import Page
from granular.shared.plotting import COLOURS, GREY, figure
from granular.studies.packing_spread import NO_TABLE
from reduced_models.designs.damper import (
    ASPECT,
    COUNTS,
    DIAMETER,
    LARGEST_SHARE,
    DamperCandidate,
    PredictedOscillationFigures,
    check_above_zero,
    check_fraction,
)
from reduced_models.falls.workshop import workshop_sheet
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    LEVEL,
    QuantityWithError,
    caution_lines,
    packings_text,
    quantity_lines,
    wrap_words,
)
from reduced_models.records.sources import make_directory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from granular.studies.tolerances import Tolerances


class DesignTarget(NamedTuple):
    """Target frequency and damping of a damper, and its fixed parameters.

    Values are not checked here; `check_ranges` raises an error for a value out of range.

    Attributes
    ----------
    frequency : float
        Undamped frequency of small oscillations about equilibrium [Hz], above 0.
    damping : float
        Damping ratio, a fraction of critical damping, above 0.
    grains : int or None
        Number of grains, from 92 to 368; None if free.
    mass : float or None
        Mass of the piston [kg], above 0; None if free. At most one of ``grains`` and ``mass`` is fixed.
    small_share : float
        Fraction of small grains, with 0.6 times the diameter, from 0 to 0.5.
    magnets : str
        ``"dipoles"``, or ``"cylinders"``: discs.
    """

    frequency: float
    damping: float
    grains: int | None = None
    mass: float | None = None
    small_share: float = 0.0
    magnets: str = "dipoles"

    def check_ranges(self) -> None:
        """Raise an error for values out of range.

        A valid target may still be out of reach: see `propose_design`.

        Raises
        ------
        InputError
            If frequency, damping or mass is not a finite number above 0, grains and mass are both
            fixed, grains is not an integer from 92 to 368, the fraction of small grains is not from 0
            to 0.5, or ``magnets`` is unknown.
        """
        check_above_zero("frequency", self.frequency, "Hz")
        check_above_zero("damping", self.damping)
        if self.mass is not None:
            check_above_zero("mass", self.mass, "kg")
        if self.grains is not None and self.mass is not None:
            raise InputError(
                f"grains = {quote(self.grains)} and mass = {quote(self.mass)} together fix the frequency; "
                "give at most one of them"
            )
        low, high = COUNTS
        if self.grains is not None and not (isinstance(self.grains, Integral) and low <= self.grains <= high):
            raise InputError(f"grains = {quote(self.grains)}; give an integer from {low} to {high}")
        check_fraction("small_share", self.small_share, LARGEST_SHARE)
        if self.magnets not in ("dipoles", "cylinders"):
            raise InputError(f"magnets = {quote(self.magnets)}; give 'dipoles' or 'cylinders'")


FREQUENCY_TOLERANCE, DAMPING_TOLERANCE = 0.02, 0.05
"""Maximum relative errors of frequency and damping ratio in every check of a proposal."""
DISC_FREQUENCY_TOLERANCE = 0.03
"""Maximum relative error of the frequency for discs, accepted only if no proposal is closer. Beds of discs
settle into different orders: two similar proposals for 4 Hz have 3.90 and 4.09 Hz."""
_LISTS = ("times", "heights", "positions")
"""Fields of a check that are not shown in tables."""


class DesignCheck(NamedTuple):
    """A simulation of a proposal.

    Attributes
    ----------
    seed : int
        Seed of the random packing.
    rest_height, frequency, damping_ratio : float
        Equilibrium height [m], undamped frequency [Hz], fraction of critical damping.
    lam, k1, k2, k3 : float
        Coefficients, in SI units, of z'' + 2 lam z' + k1 (z - h) + k2 (z - h)^2 + k3 (z - h)^3 = 0 with
        the equilibrium height h.
    misfit : float
        Rms error of the law relative to the rms displacement.
    rest_gap, fall_gap : float
        Minimum distances of two grains: ``rest_gap`` at equilibrium, divided by their contact distance;
        ``fall_gap`` in the complete run, divided by the large diameter.
    ledger : float
        Error of the energy balance divided by the energy exchanged during the run.
    times, heights : list of float
        The motion after the release [s], [m].
    positions : list of pairs of float
        Positions of the grains at equilibrium [m].
    """

    seed: int
    rest_height: float
    frequency: float
    damping_ratio: float
    lam: float
    k1: float
    k2: float
    k3: float
    misfit: float
    rest_gap: float
    fall_gap: float
    ledger: float
    times: Sequence[float]
    heights: Sequence[float]
    positions: Sequence[Sequence[float]]

    def equilibrium(self, damper: DamperCandidate) -> Equilibrium:
        """Return the equilibrium closest to the settled state; raise an error if none is found."""
        return equilibrium_from(damper.scene(self.seed), np.array(self.positions), self.rest_height)


class DesignRound(NamedTuple):
    """A proposed damper, its oscillation by scaling laws, and its checks by simulation."""

    damper: DamperCandidate
    promised_figures: PredictedOscillationFigures
    checks: tuple[DesignCheck, ...]

    def mean_figure(self, name: str) -> float:
        """Mean of a quantity over the checks."""
        return sum(getattr(check, name) for check in self.checks) / len(self.checks)

    @property
    def logarithms_of_mean_figures(self) -> Float[np.ndarray, "3"]:
        """Logarithms of the mean equilibrium height [m], frequency [Hz] and damping ratio."""
        return np.log([self.mean_figure(name) for name in ("rest_height", "frequency", "damping_ratio")])

    def meets_target(self, target: DesignTarget) -> bool:
        """Return whether frequency and damping ratio are within the tolerances in all checks."""
        frequency = FREQUENCY_TOLERANCE if target.magnets == "dipoles" else DISC_FREQUENCY_TOLERANCE
        return all(
            abs(check.frequency / target.frequency - 1.0) <= frequency
            and abs(check.damping_ratio / target.damping - 1.0) <= DAMPING_TOLERANCE
            for check in self.checks
        )

    def largest_error_over_tolerance(self, target: DesignTarget) -> float:
        """Larger of two ratios: (error of mean frequency)/1 % and (error of mean damping ratio)/3 %."""
        return max(
            abs(self.mean_figure("frequency") / target.frequency - 1.0) / 0.01,
            abs(self.mean_figure("damping_ratio") / target.damping - 1.0) / 0.03,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """A damper designed for a target frequency and damping, with all simulated proposals."""

    target: DesignTarget
    rounds: tuple[DesignRound, ...]

    @property
    def damper(self) -> DamperCandidate:
        """Designed damper, with piston mass, number of grains, fraction of small grains, and drag."""
        return self.rounds[-1].damper

    @property
    def promised_figures(self) -> PredictedOscillationFigures:
        """Oscillation predicted by the scaling laws after correction by their errors in earlier falls."""
        return self.rounds[-1].promised_figures

    @property
    def checks(self) -> tuple[DesignCheck, ...]:
        """Results of the simulations of the damper."""
        return self.rounds[-1].checks

    @property
    def scene(self) -> Scene:
        """The scene of the first check."""
        return self.damper.scene(self.checks[0].seed)

    @property
    def frequency(self) -> float:
        """Undamped frequency of small oscillations [Hz], mean over the checks."""
        return self.rounds[-1].mean_figure("frequency")

    @property
    def damping_ratio(self) -> float:
        """Damping ratio, mean over the checks."""
        return self.rounds[-1].mean_figure("damping_ratio")

    @property
    def rest_height(self) -> float:
        """Equilibrium height [m], mean over the checks."""
        return self.rounds[-1].mean_figure("rest_height")

    def range_over_seeds(self, name: str) -> tuple[float, float]:
        """Return minimum and maximum of a quantity over the simulated packings of the designed damper."""
        values = [getattr(check, name) for check in self.checks]
        return min(values), max(values)

    @property
    def notes(self) -> tuple[str, ...]:
        """Cautions in plain words."""
        notes = []
        gap = min(check.fall_gap for check in self.checks)
        contact = 1.0 if self.target.small_share == 0.0 else ASPECT
        if gap < contact and self.target.magnets == "dipoles":
            notes.append(
                f"in the fall the minimum distance of two grains was {gap:.3g} of a grain's diameter, and "
                "the scene has no contact between grains; drop the piston from a lower height"
            )
        if min(check.rest_gap for check in self.checks) < 1.0:
            notes.append("grains touch at equilibrium; choose a lower frequency or fewer small grains")
        if self.rounds[-1].largest_error_over_tolerance(self.target) > 1.0:
            notes.append(
                f"the frequency is off by {_deviation_text(self.frequency, self.target.frequency)}, the "
                f"damping ratio by {_deviation_text(self.damping_ratio, self.target.damping)}, and "
                f"{len(self.rounds) - 1} other proposals were not closer, since beds settle into different "
                "orders"
            )
        return tuple(notes)

    @property
    def figures(self) -> tuple[QuantityWithError, ...]:
        """Natural frequency, damping ratio and equilibrium: means with the spread over packings."""
        named = (
            ("natural frequency", "f0", "Hz", "frequency", 1.0),
            (DAMPING_RATIO, "zeta", "%", "damping_ratio", 100.0),
            (LEVEL, "z0", "mm", "rest_height", 1e3),
        )
        count = len(self.checks)
        quantities = []
        for name, symbol, unit, key, scale in named:
            values = [scale * getattr(check, key) for check in self.checks]
            mean = QuantityWithError(name, symbol, unit, sum(values) / count, {})
            if count > 1:
                half_width = NO_TABLE.pool_with_values(values).half_width(count)
                mean = mean._replace(parts={"start": half_width}, packings=packings_text(count))
            quantities.append(mean)
        return tuple(quantities)

    def __str__(self) -> str:
        chosen, target = self.damper, self.target
        fraction = f" ({100.0 * chosen.small_share:.3g} % of them small)" if chosen.small_share else ""
        lines = wrap_words(
            f"design for f0 {target.frequency:g} Hz, zeta {100.0 * target.damping:g} %: {chosen.grains} "
            f"magnets{fraction}, piston {chosen.mass:.4g} kg, drag {chosen.drag:.4g} kg/s per magnet "
            f"(viscosity of the liquid {chosen.viscosity:.3g} Pa s, by Stokes)",
            "",
        )
        lines += quantity_lines(self.figures)
        lines += [
            f"  random packing {check.seed}: {check.frequency:.4g} Hz "
            f"({_deviation_text(check.frequency, target.frequency)}), {100.0 * check.damping_ratio:.3g} % "
            f"({_deviation_text(check.damping_ratio, target.damping)} from the target)"
            for check in self.checks
        ]
        lines.append(
            f"  by scaling laws: {self.promised_figures.frequency:.4g} Hz, "
            f"{100.0 * self.promised_figures.damping_ratio:.3g} %; dampers simulated: {len(self.rounds)}"
        )
        return "\n".join([*lines, *caution_lines(self.notes)])

    def to_plain(self) -> dict[str, Any]:
        """Return the design as plain data (numbers, texts, lists)."""
        return {
            "wish": self.target._asdict(),
            "damper": self.damper._asdict() | {"viscosity": self.damper.viscosity},
            "frequency": self.frequency,
            "damping_ratio": self.damping_ratio,
            "rest_height": self.rest_height,
            "rounds": [
                {
                    "damper": round_.damper._asdict(),
                    "promise": round_.promised_figures._asdict(),
                    "checks": [
                        {name: value for name, value in check._asdict().items() if name not in _LISTS}
                        for check in round_.checks
                    ],
                }
                for round_ in self.rounds
            ],
            "notes": list(self.notes),
        }

    def plot(self) -> Figure:
        """Draw the height of the piston [mm] against time [s] in the checks."""
        with figure(width=7.0, height=3.4) as (drawing, axes):
            for colour, check in zip(COLOURS, self.checks, strict=False):
                axes.plot(
                    check.times,
                    1e3 * np.array(check.heights),
                    color=colour,
                    linewidth=0.9,
                    label=f"random packing {check.seed}",
                )
            axes.axhline(1e3 * self.rest_height, color=GREY, linestyle=":")
            axes.set(xlabel="time [s]", ylabel="height of the piston [mm]")
            axes.legend()
            return drawing

    def page(self, of_parts: Tolerances | None = None) -> Page:
        """Make the report, with the effects of the parts' tolerances if ``of_parts`` is given."""
        from granular.studies.study_page import tolerance_blocks

        chosen, target = self.damper, self.target
        return Page(
            f"A damper with {target.frequency:g} Hz and damping ratio {target.damping:g}",
            f"A piston of {chosen.mass:.4g} kg on {chosen.grains} grains with a drag of "
            f"{chosen.drag:.4g} kg/s each: in simulations it oscillates at {self.frequency:.4g} Hz with a "
            f"damping ratio of {self.damping_ratio:.4g}.",
            [
                *make_cautions(self.notes),
                self._figure_table,
                self._construction_table,
                Picture(self.plot, "The simulated motions after a lift of 0.2 D."),
                *(() if of_parts is None else tolerance_blocks(of_parts)),
                Heading("The scene"),
                Printout(self.scene.to_toml()),
            ],
            result=self,
        )

    @property
    def _figure_table(self) -> Table:
        target = self.target
        shown = (self.promised_figures, *self.checks)
        rows = [
            (words, wanted, *(format_number(getattr(figures, name) / unit) for figures in shown))
            for words, wanted, name, unit in (
                ("undamped frequency [Hz]", format_number(target.frequency), "frequency", 1.0),
                ("damping ratio", format_number(target.damping), "damping_ratio", 1.0),
                ("equilibrium height [D]", "", "rest_height", DIAMETER),
            )
        ]
        rows += [
            (
                "minimum distance at equilibrium, divided by contact distance",
                "",
                "",
                *(format_number(c.rest_gap) for c in self.checks),
            ),
            (
                "relative error of the energy balance",
                "",
                "",
                *(format_number(c.ledger, 2) for c in self.checks),
            ),
        ]
        starts = (f"random packing {check.seed}" for check in self.checks)
        return Table(("", "wanted", "expected", *starts), rows)

    @property
    def _construction_table(self) -> Table:
        chosen = self.damper
        sizes = "grains of 6 and 3.6 mm" if chosen.small_share else "grains of 6 mm"
        return Table(
            ("number", "value", "unit"),
            [
                ("mass of the piston", format_number(chosen.mass), "kg"),
                (sizes, str(chosen.grains), ""),
                ("fraction of small grains", format_number(chosen.small_share), ""),
                ("width of the cell", format_number(self.scene.cell.width), "m"),
                ("drag of a large grain", format_number(chosen.drag), "kg/s"),
                ("viscosity of the liquid, by Stokes's law", format_number(chosen.viscosity, 3), "Pa s"),
            ],
        )

    def workshop_sheet_page(self) -> Page:
        """Make the workshop sheet for building the damper."""
        scatter = [
            f"{words}: {low:.4g} to {high:.4g}{unit}, random packings: {len(self.checks)}"
            for words, name, unit in (
                ("frequency", "frequency", " Hz"),
                ("damping ratio", "damping_ratio", ""),
                ("equilibrium height", "rest_height", " m"),
            )
            for low, high in [self.range_over_seeds(name)]
        ]
        return workshop_sheet(
            self.scene,
            self.rest_height,
            lambda: self.checks[0].equilibrium(self.damper),
            amplitude=0.2 * DIAMETER,
            title=f"Workshop sheet: {self.target.frequency:g} Hz, damping {self.target.damping:g}",
            lead=f"The piston oscillates at {self.frequency:.4g} Hz with a damping ratio of "
            f"{self.damping_ratio:.4g}; simulations: {len(self.checks)}.",
            scatter=scatter,
            notes=self.notes,
        )

    def save(self, out: str | Path) -> None:
        """Write report.html, workshop.html, design.json and scene.toml."""
        folder = make_directory(out)
        write_json(folder / "design.json", self.to_plain())
        self.scene.save(folder / "scene.toml")
        self.page().save(folder / "report.html")
        self.workshop_sheet_page().save(folder / "workshop.html")


def _deviation_text(value: float, wanted: float) -> str:
    return f"{100.0 * (value / wanted - 1.0):+.2g} %"
