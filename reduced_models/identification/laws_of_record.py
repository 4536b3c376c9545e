"""The laws of a record, fitted and compared, with notes and advice on what to try next."""

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
    driven_law,
    unused_columns,
)
from reduced_models.identification.comparison import compare, law_name, merge_comparisons
from reduced_models.identification.comparison_table import FREQUENCY, Comparison
from reduced_models.identification.elliptic_averaging import well_quantities
from reduced_models.identification.measured_swing import MeasuredSwing, measure_swing
from reduced_models.identification.result import Identification
from reduced_models.identification.scene_checks import friction_of
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel
from reduced_models.models.printed_model import swing_quantities
from reduced_models.models.quantities import QuantityWithError
from reduced_models.records.sensor_artefacts import keep_text, spike_mask, with_note
from reduced_models.records.sources import incomplete_run_notes

if TYPE_CHECKING:
    from granular.linear import MotionFriction
    from granular.run.trajectory import Trajectory

GLANCED = "sindy"
"""Method of a discovery that nobody asked for: it needs nothing beyond what a fit needs."""
POOR = 0.05
"""Held-out error, in rms swings, from which a law is poor where the noise is less than that."""
LEAVES = 0.1
"""Held-out error, in rms swings, from which a law is discovered where the known ones leave more."""
_NOISE_TIMES = 3.0
_OPEN = 2.5e-3  # relative error of a frequency that is noted: 5 % of noise on 8 samples a cycle leaves less
_USEFUL_TURNS = 4.0  # periods of a record, below which it says little of a law


class Stopwatch:
    """Wall time of the parts of a job."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the time since the last lap to a part."""
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
    """Laws of a record, fitted and compared; arguments as of `identify`."""
    friction = None if run is None else friction_of(run)
    along_stroke = record.measured == "force"
    wanted, left_out, glanced = _laws_to_fit(record, laws, drive, friction)
    discovery = discovery or glanced
    clock.lap("a glance at the laws")
    words = spent_budget_text(budget)
    with time_budget(budget, words):
        comparison = None
        if discovery is None:
            record, comparison = _compare_without_spikes(record, run, wanted, starts)
            clock.lap("fits and comparison")
            least = max(LEAVES, _NOISE_TIMES * comparison.noise)
            if laws is None and not along_stroke and comparison.rows[0].error > least:
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
                if comparison is None and not isinstance(cause, TimeBudgetError):  # what was asked for
                    raise
                left_out += (f"discovery by {discovery}: {cause}",)
            clock.lap(f"discovery by {discovery}")
        if comparison is None:
            record, comparison = _compare_without_spikes(record, run, wanted, starts)
            clock.lap("fits and comparison")
    names = [law_name(law) for law in wanted]
    sound = [row for row in comparison.rows if row.models]
    models = tuple(row.models[0] for row in sorted(sound, key=lambda row: names.index(row.name)))
    best = comparison.best
    shown = next((model_ for model_ in (best, *models) if model_.at_rest is not None), best)
    figures = swing_quantities(shown, mass)
    own, no_own = measure_own_swing(record, best)
    if run is None and (wells := well_quantities(best)):
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
        notes=_collect_notes(record, run, comparison, models)
        + (_frequency_error_notes(figures) if run is None and not best.notes else ()),
        seconds=dict(clock.seconds),
        mass=mass,
        friction=friction,
        left_out=left_out,
        residuals={
            model.law.name: residual_tests(model, record.time, record.signal, model.simulate_signal(record))
            for model in models
        },
        advice=_suggest_next_steps(comparison, models, record, run, discovery),
    )


def _laws_to_fit(
    record: PistonRecord, laws: Sequence[str | Law] | None, drive: str | None, friction: MotionFriction | None
) -> tuple[list[Any], tuple[str, ...], str | None]:
    """Laws to fit, why others are not, and the method of a discovery that a glance calls for."""
    if laws is not None:
        if drive is None:
            return list(laws), (), None
        driven = {name: driven_law(LAWS[name], record, drive) for name in LAWS if name in laws}
        return [driven.get(law, law) if isinstance(law, str) else law for law in laws], (), None
    if record.measured == "force":
        fitting = candidate_force_laws([record])
        others = (law for law in FORCE_LAWS.working().values() if law not in fitting)
        return fitting, tuple(f"{law.name} was not fitted: it is of heights above 0" for law in others), None
    chosen = choose_candidate_laws(record, drive, friction)
    # Noise that was integrated is no measure of what terms leave.
    discovers = chosen.screening.other_terms_fit_better and record.measured == "height"
    return list(chosen.laws), chosen.exclusion_texts, GLANCED if discovers else None


def measure_own_swing(record: PistonRecord, model: ReducedModel) -> tuple[MeasuredSwing | None, str]:
    """Frequency and damping of the record itself, or why it does not tell them."""
    if record.measured == "force":
        return None, "the record prescribes the motion"
    try:
        return measure_swing(record, model), ""
    except GranularError as error:
        return None, str(error)


def _compare_without_spikes(
    record: PistonRecord, run: Trajectory | None, laws: Sequence[Any], starts: int
) -> tuple[PistonRecord, Comparison]:
    """Comparison of laws, again without the spikes of a record if that can be finished within the budget."""
    comparison = compare(record, laws, starts=starts)
    if run is not None or record.measured == "force":
        return record, comparison
    spikes = spike_mask(record, comparison.best.simulate_record(record).height)
    if not spikes.any():
        return record, comparison
    words = (
        f"single samples that stand far off the fitted motion (spikes: {int(spikes.sum())}, the first at "
        f"{record.time[np.argmax(spikes)]:.4g} s)"
    )
    sound = with_note(record.select(~spikes), f"{words} are left out; {keep_text(record)}")
    done = {row.name for row in comparison.rows if row.models}
    try:
        second = compare(sound, laws, starts=starts)
        complete = done <= {row.name for row in second.rows if row.models}
    except InputError:  # no law, as the budget is spent
        complete = False
    if not complete:
        second = comparison
        reason = "not all laws could be fitted without them within the budget; raise --budget"
        sound = with_note(record, f"{words} stay: {reason}")
    assert sound.source is not None
    warnings.warn(sound.source.notes[-1], RecordWarning, stacklevel=4)
    return sound, second


def _collect_notes(
    record: PistonRecord, run: Trajectory | None, comparison: Comparison, models: Sequence[ReducedModel]
) -> tuple[str, ...]:
    """Doubts about a run, fits that failed, and columns that were not used."""
    notes = [] if run is None else list(incomplete_run_notes(run))
    notes += [f"the fit of {row.name} failed: {row.failure}" for row in comparison.rows if row.failure]
    if run is None:
        notes += [
            f"the column {sanitize(name)} was not used; as a drive of all laws: "
            f"{sanitize(drive_option_text(name))}"
            for name in unused_columns(record, [model.law for model in models])
        ]
    return tuple(notes)


def _frequency_error_notes(figures: Sequence[QuantityWithError]) -> tuple[str, ...]:
    """Doubt of a frequency that a record tells worse than is usual in a laboratory."""
    figure = next((item for item in figures if item.name == FREQUENCY), None)
    if figure is None or not figure.value or not _OPEN < figure.total_error / figure.value < math.inf:
        return ()
    return (
        f"noise and few swings leave the natural frequency uncertain by "
        f"{100.0 * figure.total_error / figure.value:.2g} %; "
        "record a larger motion, more swings, or more samples of each",
    )


def _suggest_next_steps(
    comparison: Comparison,
    models: Sequence[ReducedModel],
    record: PistonRecord,
    run: Trajectory | None,
    discovery: str | None,
) -> tuple[str, ...]:
    """Sentences on what to try, the most promising first; nothing where the best law is good."""
    best = comparison.rows[0]
    if best.error < max(POOR, _NOISE_TIMES * comparison.noise):
        return ()
    words = [
        f"even the best law, {best.name}, misses what it has not seen by "
        f"{100 * best.error:.3g} % of the swing"
    ]
    columns = unused_columns(record, [model.law for model in models])
    if run is None and columns:
        words.append(f"drive the laws by a column that was not used: {drive_option_text(columns[0])}")
    if record.measured == "force":
        words.append("write down a law of your own: --law \"force = c*z' + k*z + friction*tanh(z'/creep)\"")
        return tuple(words)
    if comparison.best.at_rest is not None:
        turns = float(record.time[-1] - record.time[0]) / comparison.best.at_rest.period
        if turns < _USEFUL_TURNS:
            words.append(f"record longer: {turns:.2g} periods say little of a law")
    words.append(
        "look at the record (granular-damper look FILE) and leave out its first moments, "
        "or what lies in the noise: --between T:T"
    )
    if discovery is None:
        words.append("let a law be discovered: --discover sindy")
    words += [
        "try a law with memory, as hysteresis has: --law bouc-wen, or --law rubbing-bed",
        "write down a law of your own: --law \"z'' + c*z' + k*(z - r)**3 = 0\"",
    ]
    return tuple(words)
