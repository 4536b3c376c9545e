"""The result of an identification, with its verdict, print-out, report and files."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.records.record import PistonRecord
from granular.shared.blocks import Block, Caution, Heading, Items, Table, Text, blocks_text, make_cautions
from granular.shared.errors import format_factor
from granular.shared.files import make_directory, write_text
from granular.shared.html_pages import Page, page_footer
from reduced_models.falls.unseen_fall_scores import DropScores, format_percent_of_drop
from reduced_models.fitting.residual_diagnostics import ResidualTests
from reduced_models.identification import page, pictures
from reduced_models.identification.comparison_table import FREQUENCY, Comparison, DerivedOscillation
from reduced_models.identification.elliptic_averaging import (
    EllipticAveraging,
    EllipticMotion,
    InitialEllipticMotion,
    average_elliptically,
    solve_elliptic_motion,
)
from reduced_models.identification.measured_oscillation import BackboneComparedWithLaw
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.duffing import DUFFING
from reduced_models.models.model import ReducedModel
from reduced_models.models.observed import force_cycle_lines
from reduced_models.models.quantities import (
    DAMPING_RATIO,
    LEVEL,
    QuantityWithError,
    caution_lines,
    quantity_lines,
    record_title_and_property_lines,
    wrap_words,
)
from reduced_models.records.sources import describe_record, time_step_text

if TYPE_CHECKING:
    from granular.linear import MotionFriction
    from granular.run.trajectory import Trajectory
    from granular.studies.tolerances import Tolerances

LINES = 24
"""Maximum number of printed lines before the path of the report, so that everything fits on a screen."""
_FEWEST = 3
"""Minimum number of printed lines for laws, and also minimum number for cautions."""


@dataclasses.dataclass(frozen=True, eq=False)
class Identification:
    """Laws of a motion with their test errors, and frequency, damping and equilibrium of the best law.

    Attributes
    ----------
    record : PistonRecord
    models : tuple of ReducedModel
        One model for each fitted law, in the given order.
    comparison : Comparison
        Table of the laws, and the verdict.
    run : Trajectory or None
        The run, for a simulated record.
    figures : tuple of QuantityWithError
        Equilibrium height, and frequency, damping and stiffness of the oscillation about it, with errors.
    figures_law : str
        The law whose fit gives ``figures``.
    notes : tuple of str
        Cautions about the run, its checks and unused columns.
    seconds : mapping of str to float
        Wall time [s] of each part of the job.
    mass : float or None
        Moving mass [kg], if known.
    left_out : tuple of str
        Laws that were not fitted, each with the reason.
    residuals : mapping of str to ResidualTests
        Tests of the residual of each law.
    advice : tuple of str
        Suggestions if even the best law is poor.
    lift : PistonRecord or None
        The held-out higher lift.
    falls : DropScores or None
        Laws of the whole fall, tested on held-out falls.
    own : BackboneComparedWithLaw or None
        Frequency and damping against amplitude measured from the record (model-free).
    friction : MotionFriction or None
        Dry friction along the piston's motion, from the bed at its first equilibrium; None if the scene
        has no friction.
    of_parts : Tolerances or None
        Standard deviations of frequency, damping and equilibrium due to the tolerances of parts, if
        given.
    """

    record: PistonRecord
    models: tuple[ReducedModel, ...]
    comparison: Comparison
    run: Trajectory | None
    figures: tuple[QuantityWithError, ...]
    figures_law: str
    notes: tuple[str, ...]
    seconds: Mapping[str, float]
    mass: float | None = None
    left_out: tuple[str, ...] = ()
    residuals: Mapping[str, ResidualTests] = dataclasses.field(default_factory=dict)
    advice: tuple[str, ...] = ()
    lift: PistonRecord | None = None
    falls: DropScores | None = None
    own: BackboneComparedWithLaw | None = None
    parameters: tuple[QuantityWithError, ...] = ()  # of the best law, with the errors from further runs
    derived: DerivedOscillation | None = None  # small oscillations of a simulated bed, derived without a fit
    no_own: str = ""
    friction: MotionFriction | None = None
    of_parts: Tolerances | None = None

    @property
    def best(self) -> ReducedModel:
        """Model of the best law of the comparison."""
        first = self.comparison.rows[0].name
        return next(model for model in self.models if model.law.name == first)

    @property
    def model_of_figures(self) -> ReducedModel:
        """Model that gives ``figures``: the best model with an equilibrium."""
        return next((model for model in self.models if model.law.name == self.figures_law), self.best)

    @property
    def elliptic_motion(self) -> EllipticMotion | None:
        """Elliptic motion of the best law, or of an equally good Duffing law; None if neither has one."""
        return None if self._initial_elliptic_motion is None else self._initial_elliptic_motion.motion

    @functools.cached_property
    def _initial_elliptic_motion(self) -> InitialEllipticMotion | None:
        duration = float(self.record.time[-1] - self.record.time[0])
        models = (self.best, self.comparison.model_tied_with_best(DUFFING.name))
        solved = (solve_elliptic_motion(model, duration) for model in models if model is not None)
        return next((motion for motion in solved if motion is not None), None)

    @functools.cached_property
    def elliptic_averaging(self) -> EllipticAveraging | None:
        """Elliptic averaging, if the best law is the Duffing or the Van der Pol-like law."""
        return average_elliptically(self.best, self.record.time)

    def figure(self, name: str) -> QuantityWithError | None:
        """Return the quantity in ``figures`` with a given name; None if there is none."""
        return next((figure for figure in self.figures if figure.name == name), None)

    @property
    def figures_to_print(self) -> tuple[QuantityWithError, ...]:
        """Quantities to print; the law's damping ratios at amplitudes are omitted if they were measured."""
        if self.own is None:
            return self.figures
        return tuple(figure for figure in self.figures if not figure.name.startswith(f"{DAMPING_RATIO} at "))

    @property
    def verdict(self) -> str:
        """Sentences of the verdict: held-out falls, the comparison, the held-out lift and the residuals."""
        return " ".join([*self._falls_verdict, self.verdict_without_falls])

    @property
    def _falls_verdict(self) -> list[str]:
        return [] if self.falls is None else [self.falls.verdict]

    @property
    def verdict_without_falls(self) -> str:
        """Sentences of the verdict without falls: the comparison, the held-out lift and the residuals."""
        words = [self.comparison.verdict]
        if self._initial_elliptic_motion is not None:
            words.append(self._initial_elliptic_motion.text)
        if self.lift is not None:
            words.append(higher_lift_verdict(self.comparison))
        tests = self.residuals.get(self.best.law.name)
        if tests is not None and tests.has_structure:
            words.append(
                f"The residual of {self.best.law.name} is {100 * tests.relative:.2g} % "
                f"{self.best.error_reference_text} ({tests.verdict})."
            )
        return " ".join(words)

    def to_plain(self) -> dict[str, Any]:
        """Return results, verdict and models as plain data."""
        return {
            "verdict": self.verdict,
            "best": self.best.law.name,
            "elliptic": None if self.elliptic_motion is None else self.elliptic_motion._asdict(),
            "averaging": None if self.elliptic_averaging is None else self.elliptic_averaging._asdict(),
            "comparison": self.comparison.to_plain(),
            "models": [model.to_plain() for model in self.models],
            "own": None if self.own is None else self.own.to_plain(),
            "figures": {figure.name: figure.to_plain() for figure in self.figures_to_print},
            "figures_law": self.figures_law,
            "notes": list(self.notes),
            "time_step": None if self.run is None else time_step_text(self.run),
            "seconds": dict(self.seconds),
            "mass": self.mass,
            "left_out": list(self.left_out),
            "residuals": {name: figure.to_plain() for name, figure in self.residuals.items()},
            "advice": list(self.advice),
            "falls": None if self.falls is None else self.falls.to_plain(),
            "derived": None if self.derived is None else self.derived._asdict(),
            "friction": None if self.friction is None else self.friction.to_plain(),
            "of_parts": None if self.of_parts is None else self.of_parts.to_plain(),
        }

    @property
    def line_before_checks(self) -> str:
        """Rounded equilibrium, frequency and damping ratio, for display before their errors are known."""
        level, frequency = self.figure(LEVEL), self.figure("natural frequency")
        ratio = next((item for item in self.figures if item.name.startswith(DAMPING_RATIO)), None)
        words = [
            *([] if level is None else [f"equilibrium {level.value:.3g} {level.unit}"]),
            *([] if frequency is None else [f"{frequency.value:.3g} Hz"]),
            *([] if ratio is None else [f"{ratio.value:.2g} % of critical"]),
        ]
        return f"{', '.join(words)}; uncertainties follow"

    def printout(self, most: int | None = LINES) -> str:
        """Record, results, model and cautions as text of at most ``most`` lines; None sets no limit."""
        model, contradiction = self.best, []
        if self.own is not None and not self.own.law_agrees:
            contradiction = wrap_words(f"caution: {self.own.agreement_text}", "", "  ")
        start = [*record_title_and_property_lines(self._record_texts), *contradiction]
        amplitude = f"not measurable from peaks: {self.no_own}" if self.own is None else self.own.range_text
        figures = quantity_lines(self.figures, self.mass, model.confidence, amplitude)
        if model.law.prescribed:
            figures = force_cycle_lines(model)
        start += figures or [f"  no oscillation about an equilibrium: {model.no_swing}"]
        for words in self._derived_texts:
            start += [part for line in words.splitlines() for part in wrap_words(line, "")]
        end = model.equation_lines(self.parameters or None)
        end += [f"  {words}" for words in model.mode_texts]
        if self.elliptic_motion is not None:
            end += wrap_words(f"initial motion {self.elliptic_motion.text()}, m = k^2")
        end += self._fall_lines
        free = None if most is None else max(most - len(start) - len(end), 2 * _FEWEST)
        said = caution_lines(self.cautions, None if free is None else max(_FEWEST, free - 2 * _FEWEST))
        laws = self.comparison.law_lines(
            ["3x higher lift"] if self.lift is not None else (),
            None if free is None else max(2, free - len(said) - 2),
        )
        return "\n".join([*start, *laws, *end, *said])

    @property
    def _derived_texts(self) -> list[str]:
        """State the values derived from the bed's stiffness and load without a fit."""
        texts = [] if self.friction is None else [str(self.friction)]
        if self.derived is not None:
            texts.append(f"  derived without a fit: {self.derived.text(self.figures)}")
        return texts + ([] if self.of_parts is None else [f"  {self.of_parts.summary}"])

    @property
    def _record_texts(self) -> list[str]:
        rest = self.best.at_rest
        return describe_record(self.record, None if rest is None else rest.period)

    @property
    def _fall_lines(self) -> list[str]:
        """State the error of the best law on held-out falls."""
        if self.falls is None or self.falls.best.model is None:
            return []
        height, best = 1e3 * float(self.falls.record.height[0]), self.falls.best
        error, count = format_percent_of_drop(best.median_error), len(self.falls.labels)
        words = f"whole fall from {height:.0f} mm: {best.name}, error {error} of the drop"
        return wrap_words(f"{words} (median of {count} others)", "")

    @property
    def cautions(self) -> tuple[str, ...]:
        """Cautions, the most serious first."""
        words = [*self.notes, *self.best.cautions, *self.advice]
        if self.figures and self.figures_law != self.best.law.name:
            words.append(f"frequency, damping and stiffness come from {self.figures_law}")
        return tuple(dict.fromkeys(words))

    def __str__(self) -> str:
        return f"{self.printout(None)}\n{blocks_text(self._detail_blocks())}"

    def page(self) -> Page:
        """Make the report: results and equation, the record, then the details."""
        title = self._record_texts[0]
        name = f"The equation of {title.partition(':')[0]}"
        return Page(name, title, tuple(self._page_blocks()), page_footer(page.LIBRARIES), self)

    def _page_blocks(self) -> Iterator[Block]:
        if self.own is not None and not self.own.law_agrees:
            yield Caution(f"{page.capitalise(self.own.agreement_text)}.")
        yield from page.answer_blocks(self.figures, self.best, self.mass, self.parameters)
        for words in (*self.best.mode_texts, *self._derived_texts):
            yield Text(f"{page.capitalise(' '.join(words.split()))}.")
        yield from make_cautions(
            f"{page.capitalise(words)}." for words in (*self.cautions, *self._record_texts[1:])
        )
        yield from map(Text, self._falls_verdict)
        yield from self._detail_blocks()

    def _detail_blocks(self) -> Iterator[Block]:
        """Blocks after the results and the equation."""
        if self.own is not None:
            yield from self.own.blocks()
        if self.of_parts is not None:
            from granular.studies.study_page import tolerance_blocks

            yield from tolerance_blocks(self.of_parts)
        averaging = "" if self.elliptic_averaging is None else self.elliptic_averaging.text
        yield from page.oscillation_section(
            self.figures_to_print, self.model_of_figures, self.mass, averaging
        )
        yield from pictures.record_section(self.record, self.best)
        if self.falls is not None:
            yield Heading("The whole fall")
            if self.falls.best.model is not None:
                yield from page.equation_blocks(self.falls.best.model)
            yield from pictures.falls_section(self.falls)
        yield Heading("Choice of the law")
        yield Text(self.verdict_without_falls)
        yield from pictures.comparison_section(self.comparison)
        if self.left_out:
            yield Text("Laws that were not fitted:")
            yield Items([f"{page.capitalise(words)}." for words in self.left_out])
        if self.lift is not None:
            yield from pictures.higher_lift_section(self.lift, self.comparison)
        yield from page.residual_tests_section(
            self.residuals, self.record.measured, self.record.coordinate_unit
        )
        for model in self.models:
            yield from page.law_section(model, " (best)" if model is self.best else "")
        yield from pictures.fits_section(self.record, self.models, self.best)
        yield from pictures.phase_portrait_section(self.record, self.best)
        if self.run is not None:
            yield from pictures.simulation_run_sections(self.run, self.figure(FREQUENCY))
        yield from page.record_source_section(self.record.source)
        yield Heading("Computing time")
        yield Table(("part", "seconds"), [(k, f"{v:.2f}") for k, v in self.seconds.items()])

    def save(self, out: str | Path) -> None:
        """Write report.html, record.csv, models/, and model.json and equations.txt of the best model."""
        out = Path(out)
        make_directory(out / "models")
        self.record.to_csv(out / "record.csv")
        self.best.save(out / "model.json")
        write_text(out / "equations.txt", self.best.text)
        for index, model in enumerate(self.models):
            # A law given as an equation has its text as a name, which cannot be a file name.
            name = model.law.name if model.law.name in LAWS else f"own-{index + 1}"
            model.save(out / "models" / f"{name}.json")
        if self.falls is not None and self.falls.best.model is not None:
            self.falls.record.to_csv(out / "fall.csv")
            self.falls.best.model.save(out / "fall.json")
        self.page().save(out / "report.html")


def higher_lift_verdict(table: Comparison) -> str:
    """State which law best predicts the held-out higher lift, and how much worse the others are."""
    (best, name), *others = table.ranking_on_last_record()
    if math.isinf(best.relative):
        return "All laws diverge for the held-out lift, which is three times as high as the scene's lift."
    words = (
        f"The held-out lift (three times the scene's lift) is predicted best by {name}, with an error of "
        f"{100 * best.relative:.2g} % of its rms displacement"
    )
    if others:
        worse = [
            f"{other} is {format_factor(score.relative / max(best.relative, 1e-300))} times worse"
            if math.isfinite(score.relative)
            else f"{other} diverges"
            for score, other in others
        ]
        words += "; " + ", ".join(worse)
    return words + "."
