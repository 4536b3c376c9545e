"""Laws fitted to a record and compared, with notes and advice on next steps."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, InputError, RecordWarning, TimeBudgetError, sanitize
from reduced_models.fitting.levenberg_marquardt import spent_budget_text, time_budget
from reduced_models.fitting.residual_diagnostics import residual_tests
from reduced_models.identification.candidate_laws import (
    candidate_force_laws,
    choose_candidate_laws,
    drive_option_text,
    law_driven_by_column,
    unused_drive_columns,
)
from reduced_models.identification.comparison import compare, law_name, merge_comparisons
from reduced_models.identification.comparison_table import FREQUENCY, Comparison
from reduced_models.identification.elliptic_averaging import two_well_quantities
from reduced_models.identification.measured_oscillation import (
    BackboneComparedWithLaw,
    compare_backbone_with_law,
)
from reduced_models.identification.result import Identification
from reduced_models.identification.scene_checks import dry_friction_of_run
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel
from reduced_models.models.printed_model import oscillation_quantities
from reduced_models.models.quantities import QuantityWithError
from reduced_models.records.sensor_artefacts import keep_samples_text, record_with_note, spike_mask
from reduced_models.records.sources import incomplete_run_notes

if TYPE_CHECKING:
    from granular.linear import MotionFriction
    from granular.run.trajectory import Trajectory

GLANCED = "sindy"
"""Method of discovery if the user has not given one; it needs no further package."""
POOR = 0.05
"""Held-out error, relative to the rms displacement, above which a law is poor, if the noise is smaller."""
LEAVES = 0.1
"""Held-out error of the best law, relative to the rms displacement, above which discovery is used."""
_NOISE_TIMES = 3.0
# A larger relative error of the frequency causes a note; 5 % noise with 8 samples per cycle gives less.
_NOTED_FREQUENCY_ERROR = 2.5e-3
_MINIMUM_PERIODS = 4.0  # number of periods: a shorter record hardly determines a law


class Stopwatch:
    """Stopwatch for the wall times of the parts of a job."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the wall time since the last call to the part ``name``."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now


def compare_laws_of_record(
    record: PistonRecord,
    run: Trajectory | None,
    laws: Sequence[str | Law] | None,
    discovery: str | None,
    drive: str | None,
    mass: float | None,
    starts: int,
    budget: float,
    clock: Stopwatch,
) -> Identification:
    """Fit laws to a record and compare them; for arguments see `identify`."""
    friction = None if run is None else dry_friction_of_run(run)
    along_stroke = record.measured == "force"
    wanted, left_out, glanced = _laws_exclusions_and_discovery_method(record, laws, drive, friction)
    discovery = discovery or glanced
    clock.lap("screening of the laws")
    words = spent_budget_text(budget)
    with time_budget(budget, words):
        comparison = None
        if discovery is None:
            record, comparison = _record_and_comparison_without_spikes(record, run, wanted, starts)
            clock.lap("fits and comparison")
            limit = max(LEAVES, _NOISE_TIMES * comparison.noise)
            if laws is None and not along_stroke and comparison.rows[0].error > limit:
                discovery = GLANCED
        if discovery is not None:
            from reduced_models.discovery.discover import discover

            try:
                with time_budget(0.5 * budget, words):
                    discovered = discover(
                        record,
                        method=cast("Any", discovery),
                        input=drive,
                        target="force" if along_stroke else "acceleration",
                    )
                    wanted.append(discovered.model)
                if comparison is not None:
                    comparison = merge_comparisons(comparison, compare(record, wanted[-1], starts=starts))
            except InputError as cause:
                if comparison is None and not isinstance(cause, TimeBudgetError):  # the user requested it
                    raise
                left_out += (f"discovery by {discovery}: {cause}",)
            clock.lap(f"discovery by {discovery}")
        if comparison is None:
            record, comparison = _record_and_comparison_without_spikes(record, run, wanted, starts)
            clock.lap("fits and comparison")
    names = [law_name(law) for law in wanted]
    sound = [row for row in comparison.rows if row.models]
    models = tuple(row.models[0] for row in sorted(sound, key=lambda row: names.index(row.name)))
    best = comparison.best
    shown = next((model_ for model_ in (best, *models) if model_.at_rest is not None), best)
    figures = oscillation_quantities(shown, mass)
    own, no_own = backbone_compared_with_law_or_reason(record, best)
    if run is None and (wells := two_well_quantities(best)):
        shown, figures = best, wells
    return Identification(
        record=record,
        models=models,
        comparison=comparison,
        run=run,
        figures=figures,
        figures_law=shown.law.name,
        own=own,
        no_own=no_own,
        notes=_notes_on_incomplete_comparison(record, run, comparison, models)
        + (_frequency_error_notes(figures) if run is None and not best.notes else ()),
        seconds=dict(clock.seconds),
        mass=mass,
        friction=friction,
        left_out=left_out,
        residuals={
            model.law.name: residual_tests(model, record.time, record.signal, model.simulate_signal(record))
            for model in models
        },
        advice=_next_step_suggestions(comparison, models, record, run, discovery),
    )


def _laws_exclusions_and_discovery_method(
    record: PistonRecord, laws: Sequence[str | Law] | None, drive: str | None, friction: MotionFriction | None
) -> tuple[list[Any], tuple[str, ...], str | None]:
    """Return laws to fit, reasons for excluding others, and a discovery method if discovery may help."""
    if laws is not None:
        if drive is None:
            return list(laws), (), None
        driven = {name: law_driven_by_column(LAWS[name], record, drive) for name in LAWS if name in laws}
        return [driven.get(law, law) if isinstance(law, str) else law for law in laws], (), None
    if record.measured == "force":
        fitting = candidate_force_laws([record])
        others = (law for law in FORCE_LAWS.usable_parts().values() if law not in fitting)
        return fitting, tuple(f"{law.name} was not fitted: it needs heights > 0" for law in others), None
    chosen = choose_candidate_laws(record, drive, friction)
    # Residuals cannot be compared with integrated noise.
    discovers = chosen.screening.other_terms_fit_better and record.measured == "height"
    return list(chosen.laws), chosen.exclusion_texts, GLANCED if discovers else None


def backbone_compared_with_law_or_reason(
    record: PistonRecord, model: ReducedModel
) -> tuple[BackboneComparedWithLaw | None, str]:
    """Return frequency and damping measured from the record, or the reason why they cannot be measured."""
    if record.measured == "force":
        return None, "the motion is prescribed"
    try:
        return compare_backbone_with_law(record, model), ""
    except GranularError as error:
        return None, str(error)


def _record_and_comparison_without_spikes(
    record: PistonRecord, run: Trajectory | None, laws: Sequence[Any], starts: int
) -> tuple[PistonRecord, Comparison]:
    """Compare laws; repeat without spikes if the budget allows. Return the record used, and the table."""
    comparison = compare(record, laws, starts=starts)
    if run is not None or record.measured == "force":
        return record, comparison
    spikes = spike_mask(record, comparison.best.simulate_record(record).height)
    if not spikes.any():
        return record, comparison
    words = (
        f"single samples far from the fitted motion (spikes: {int(spikes.sum())}, the first at "
        f"{record.time[np.argmax(spikes)]:.4g} s)"
    )
    sound = record_with_note(record.select(~spikes), f"{words} are excluded; {keep_samples_text(record)}")
    done = {row.name for row in comparison.rows if row.models}
    try:
        second = compare(sound, laws, starts=starts)
        complete = done <= {row.name for row in second.rows if row.models}
    except InputError:  # no law was fitted because the budget is spent
        complete = False
    if not complete:
        second = comparison
        reason = "without them, not all laws could be fitted within the time budget; raise --budget"
        sound = record_with_note(record, f"{words} are kept: {reason}")
    assert sound.source is not None
    warnings.warn(sound.source.notes[-1], RecordWarning, stacklevel=4)
    return sound, second


def _notes_on_incomplete_comparison(
    record: PistonRecord, run: Trajectory | None, comparison: Comparison, models: Sequence[ReducedModel]
) -> tuple[str, ...]:
    """Collect notes on an interrupted run, failed fits, and unused columns."""
    notes = [] if run is None else list(incomplete_run_notes(run))
    notes += [f"the fit of {row.name} failed: {row.failure}" for row in comparison.rows if row.failure]
    if run is None:
        notes += [
            f"the column {sanitize(name)} was not used; to make it the drive of all laws: "
            f"{sanitize(drive_option_text(name))}"
            for name in unused_drive_columns(record, [model.law for model in models])
        ]
    return tuple(notes)


def _frequency_error_notes(figures: Sequence[QuantityWithError]) -> tuple[str, ...]:
    """Return a note if the relative error of the natural frequency exceeds a limit."""
    figure = next((item for item in figures if item.name == FREQUENCY), None)
    if (
        figure is None
        or not figure.value
        or not _NOTED_FREQUENCY_ERROR < figure.total_error / figure.value < math.inf
    ):
        return ()
    return (
        f"noise and too few cycles make the natural frequency uncertain by "
        f"{100.0 * figure.total_error / figure.value:.2g} %; "
        "record a larger motion, more cycles, or more samples per cycle",
    )


def _next_step_suggestions(
    comparison: Comparison,
    models: Sequence[ReducedModel],
    record: PistonRecord,
    run: Trajectory | None,
    discovery: str | None,
) -> tuple[str, ...]:
    """Suggest next steps, the most promising first, if even the best law is poor."""
    best = comparison.rows[0]
    if best.error < max(POOR, _NOISE_TIMES * comparison.noise):
        return ()
    words = [
        f"even the best law, {best.name}, has a prediction error on held-out data of "
        f"{100 * best.error:.3g} % of the rms displacement"
    ]
    columns = unused_drive_columns(record, [model.law for model in models])
    if run is None and columns:
        words.append(f"drive the laws by an unused column: {drive_option_text(columns[0])}")
    if record.measured == "force":
        words.append('discover a law with memory: discover(record, target="force", library="memory")')
        words.append("give a custom law: --law \"force = c*z' + k*z + friction*tanh(z'/creep)\"")
        return tuple(words)
    if comparison.best.at_rest is not None:
        turns = float(record.time[-1] - record.time[0]) / comparison.best.at_rest.period
        if turns < _MINIMUM_PERIODS:
            words.append(f"record longer: {turns:.2g} periods hardly determine a law")
    words.append(
        "look at the record (granular-damper look FILE) and exclude its start, "
        "or the part in which noise exceeds the motion: --between T:T"
    )
    if discovery is None:
        words.append("discover a law: --discover sindy")
    words += [
        "try a law with memory (hysteresis): --law bouc-wen, or --law rubbing-bed",
        "give a custom law: --law \"z'' + c*z' + k*(z - r)**3 = 0\"",
    ]
    return tuple(words)
