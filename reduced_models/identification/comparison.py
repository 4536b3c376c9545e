"""Comparison of laws on held-out data.

Laws are simulated over held-out cycles of each record and over held-out records, and ranked by the errors
of these predictions. Among laws whose errors exceed the smallest one by at most its standard error, the
simplest is chosen; laws of the package precede user-defined ones. If the errors are at the noise level, only
laws with similar values of the Bayesian information criterion are considered (BIC; Schwarz 1978,
doi:10.1214/aos/1176344136).
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, InputError, format_factor, quote
from reduced_models.fitting.fit import fit, resolve_law
from reduced_models.fitting.fit_data import RecordLike, list_of_records
from reduced_models.fitting.parameter import (
    Parameter,
    Parameters,
    check_parameter_names,
    fixed_height_map_parameters,
    has_value_per_record,
    parameters_by_name,
)
from reduced_models.fitting.problem import STARTS, TEST_FRACTION, check_fit_options
from reduced_models.fitting.roll_out import RollOut, roll_out
from reduced_models.fitting.start_values import StartDrawsNearValues
from reduced_models.identification.comparison_table import (
    NOISE_TIE,
    TIE,
    Comparison,
    ComparisonRow,
    largest_tied_error,
    root_mean_square,
)
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel
from reduced_models.models.quantities import Quality, format_percent

STRONG = 6.0
"""Difference of two laws' BIC above which the evidence is strong (Kass & Raftery 1995,
doi:10.1080/01621459.1995.10476572); laws with a smaller difference are equivalent."""
# Twice the difference of two log-likelihoods below which the data cannot distinguish two laws: the threshold
# of "very strong" evidence (Kass & Raftery 1995, doi:10.1080/01621459.1995.10476572).
CLEAR = 10.0
_MINIMUM_RESIDUAL = 1e-7  # relative to the rms displacement; smaller residuals count as equal
_NO_BETTER = 0.9


def compare(
    record: RecordLike | Sequence[RecordLike],
    laws: str | Law | ReducedModel | Sequence[str | Law | ReducedModel],
    test_fraction: float = TEST_FRACTION,
    test_records: Sequence[RecordLike] = (),
    *,
    parameters: Parameters | None = None,
    starts: int = STARTS,
) -> Comparison:
    """Compare laws on held-out data.

    Among laws within one standard error of the best, the simplest is chosen (Breiman et al. 1984,
    Classification and Regression Trees, ch. 3.4). If the errors are at the noise level, the Bayesian
    information criterion decides (Schwarz 1978, doi:10.1214/aos/1176344136).

    Parameters
    ----------
    record : PistonRecord, table (pandas, xarray, mapping), path, (time, height), or a list of these
        Records to train on, times [s] and heights [m].
    laws : str, Law or ReducedModel, or a sequence of them
        Names, equations, laws, models, or results of `discover`. The law of a model is fitted again; if
        it has no rule for start values, the fit starts near the model's parameters.
    test_fraction : float
        Fraction of each record's complete cycles that is held out, from 0 to 0.9, as in `fit`. With 0
        and no ``test_records``, laws are ranked by the residuals of their fits.
    test_records : sequence of records
        Whole records, in the forms of ``record``, held out of all fits. Each is predicted from the
        initial state estimated from its first period.
    parameters : mapping of str to Parameter, float or str, optional
        Values and limits of parameters by name, as in `fit`, for the laws that have them. Parameters
        with a separate value for each record cannot be combined with ``test_records``.
    starts : int
        Number of random starts of each fit, from 1 to 10000.

    Returns
    -------
    Comparison
        Table of the laws, best first, with a verdict; errors are relative to the rms displacement,
        without unit. A law that could not be fitted or cannot follow a held-out record comes last,
        with the reason.

    Raises
    ------
    InputError
        If no record or law is given, a law's name is unknown, an argument is out of range, a result of
        `discover` has no model, the laws describe different columns, no law has a given parameter, a
        parameter with a separate value for each record is combined with ``test_records``, or no law can
        be fitted, for example because records are too short or nothing moves.
    RecordError
        If a table is not a record, or a record holds no heights.

    Examples
    --------
    >>> import numpy as np
    >>> from reduced_models import PistonRecord
    >>> time = np.linspace(0.0, 2.0, 2000)
    >>> record = PistonRecord(time, 0.06 + 1e-3 * np.exp(-0.8 * time) * np.cos(21.8 * time))
    >>> from reduced_models import compare
    >>> compare(record, ["linear", "quadratic-drag"]).rows[0].name
    'linear'
    """
    records = list_of_records(record)
    check_fit_options(starts, test_fraction)
    if isinstance(laws, str | Law | ReducedModel) or (laws and not isinstance(laws, Iterable)):
        laws = [laws]
    test_records = list_of_records(test_records) if len(test_records) else ()
    if not laws:
        raise InputError("the argument laws is empty; give one or more laws")
    known = parameters_by_name(parameters)
    if test_records and any(map(has_value_per_record, known.values())):
        raise InputError(
            "a parameter with a separate value for each record has no value for the test_records; remove "
            "test_records or this parameter"
        )
    chosen = [_law_and_height_map_parameters(law, records[0], tuple(known)) for law in laws]
    check_parameter_names(known, [*dict.fromkeys(name for law, _ in chosen for name in law.parameters)])
    _check_same_columns([law for law, _ in chosen], records[0])
    rows = [
        _fit_law_and_make_row(*entry, records, test_fraction, test_records, known, starts) for entry in chosen
    ]
    sound = [row for row in rows if not row.failure]
    if not sound:
        raise InputError(f"no law could be fitted; the fit of {rows[0].name} failed: {rows[0].failure}")
    return _rank_comparison_rows(rows, sound)


def compare_on_further_records(table: Comparison, test_records: Sequence[PistonRecord]) -> Comparison:
    """Rank the fitted models again, with predictions of further held-out records."""
    # A law that diverges within the first period, which determines the initial state, cannot predict.
    rows = []
    for row in table.rows:
        if row.failure:
            continue
        roll_outs = list(row.records)
        for record in test_records:
            try:
                roll_outs.append(roll_out(row.models[0], record))
            except InputError:
                roll_outs.append(RollOut(record.first(2), math.inf, math.inf, 1.0))
        error, spread = _total_test_error_and_standard_error(row.models, roll_outs)
        rows.append(dataclasses.replace(row, records=tuple(roll_outs), error=error, standard_error=spread))
    return _rank_comparison_rows([*rows, *(row for row in table.rows if row.failure)], rows)


def _total_test_error_and_standard_error(
    models: Sequence[ReducedModel], roll_outs: Sequence[RollOut]
) -> tuple[float, float]:
    """Return the test error and its standard error; without held-out data, the fits' residual and 0."""
    qualities = _qualities_of_observations(models)
    parts = [(quality.test_error, quality.test_standard_error) for quality in qualities]
    parts += [(candidate.relative, candidate.standard_error) for candidate in roll_outs]
    known = [(value, spread or 0.0) for value, spread in parts if value is not None]
    if not known:
        return root_mean_square([quality.relative for quality in qualities]), 0.0
    error = root_mean_square([value for value, _ in known])
    if not 0.0 < error < math.inf:
        return error, 0.0
    return error, math.hypot(*(value * spread for value, spread in known)) / (len(known) * error)


def _qualities_of_observations(models: Sequence[ReducedModel]) -> list[Quality]:
    """List the fit qualities of all models, one for each column that a model describes."""
    return [quality for model in models for quality in (model.quality, *model.qualities.values())]


def law_name(law: str | Law | ReducedModel) -> str:
    """Name under which `compare` lists a law."""
    if isinstance(law, ReducedModel):
        return law.law.name
    if isinstance(law, Law):
        return law.name
    return " ".join(law.split())


def _check_same_columns(laws: Sequence[Law], record: PistonRecord) -> None:
    """Raise an error if the laws describe different columns of the record."""
    columns = {law.name: sorted(law.observations or (record.measured,)) for law in laws}
    if len(set(map(tuple, columns.values()))) > 1:
        listed = "; ".join(f"{name}: {', '.join(seen)}" for name, seen in columns.items())
        raise InputError(
            f"the laws describe different columns of the record ({listed}); compare laws of the same columns"
        )


def _law_and_height_map_parameters(
    law: Any, record: PistonRecord, declared: Sequence[str]
) -> tuple[Law, dict[str, Parameter]]:
    """Return a law, and fixed parameters: the coefficients of a model's linear relation of height to z."""
    if isinstance(law, str | Law):
        return resolve_law(law, record, declared), {}
    model = law if isinstance(law, ReducedModel) else getattr(law, "model", None)
    if not isinstance(model, ReducedModel):
        raise InputError(f"law = {quote(law)} cannot be compared; give a name, an equation, a Law or a model")
    given = fixed_height_map_parameters(model)
    if model.law.start is not None:
        return model.law, given
    return dataclasses.replace(model.law, start=StartDrawsNearValues(model.all_parameters)), given


def _fit_law_and_make_row(
    law: Law,
    given: Mapping[str, Parameter],
    records: Sequence[PistonRecord],
    test_fraction: float,
    test_records: Sequence[PistonRecord],
    parameters: Mapping[str, Parameter],
    starts: int,
) -> ComparisonRow:
    known = dict(given) | {name: item for name, item in parameters.items() if name in law.parameters}
    try:
        with warnings.catch_warnings(action="ignore"):  # the models keep their notes
            models = fit(records, law, parameters=known, starts=starts, test_fraction=test_fraction)
        roll_outs = tuple(roll_out(models[0], value) for value in test_records)
    except GranularError as cause:
        return ComparisonRow(law.name, failure=str(cause))
    stretches = tuple(model.quality.test_error for model in models if model.quality.test_error is not None)
    held = [name for name, (low, high) in models[0].intervals.items() if low == high]
    count = sum(name not in held for name in law.parameters)
    own = sum(has_value_per_record(item) and not item.fixed for item in known.values())
    count += own * (len(records) - 1)
    error, spread = _total_test_error_and_standard_error(models, roll_outs)
    return ComparisonRow(law.name, models, count, stretches, roll_outs, error, standard_error=spread)


def _rank_comparison_rows(rows: Sequence[ComparisonRow], sound: Sequence[ComparisonRow]) -> Comparison:
    correlation = min(max(model.quality.correlation for model in row.models) for row in sound)
    scored = [_add_information_criteria(row, correlation) for row in sound]
    noise = root_mean_square(
        [
            quality.noise * quality.relative / max(quality.residual, 1e-300)
            for quality in _qualities_of_observations(scored[0].models)
        ]
    )
    smallest, limit = min(row.error for row in scored), largest_tied_error(scored, noise)
    # If all laws diverge, only the residuals of their fits can rank them.
    at_noise = smallest <= NOISE_TIE * noise or math.isinf(smallest)
    tied = sort_simplest_known_law_first([row for row in scored if row.error <= limit], at_noise=at_noise)
    worse = sorted((row for row in scored if row.error > limit), key=lambda row: row.error)
    at_rest = _test_error_of_motionless_piston(scored[0])
    verdict = _ranking_text(tied, worse, at_rest, at_noise=at_noise)
    failed = [row for row in rows if row.failure]
    for row in failed:
        verdict += f" {row.name} could not be fitted."
    return Comparison((*tied, *worse, *failed), verdict, noise, at_rest)


def sort_simplest_known_law_first(tied: Sequence[ComparisonRow], *, at_noise: bool) -> list[ComparisonRow]:
    """Sort laws that predict equally well, the simplest first; ``at_noise`` moves laws of high BIC down."""
    lowest_bic = min(row.bic for row in tied)
    known = list(LAWS)

    def rank(row: ComparisonRow) -> tuple[bool, int, int]:
        is_known = row.name in known
        return (not is_known, row.parameters, known.index(row.name) if is_known else 0)

    equivalent = [row for row in tied if not at_noise or row.bic <= lowest_bic + STRONG]
    equivalent.sort(key=lambda row: (rank(row)[:2], row.error))
    closest = [row for row in equivalent if row.error <= (1.0 + TIE) * equivalent[0].error]
    first = min(closest, key=rank)
    others = sorted((row for row in tied if row not in equivalent), key=lambda row: row.bic)
    return [first, *(row for row in equivalent if row is not first), *others]


def merge_comparisons(*tables: Comparison) -> Comparison:
    """Merge comparisons of laws fitted to the same records, and rank all laws together."""
    rows = [row for table in tables for row in table.rows]
    return _rank_comparison_rows(rows, [row for row in rows if not row.failure])


def _add_information_criteria(row: ComparisonRow, correlation: float) -> ComparisonRow:
    """Add information criteria to a row; ``correlation`` is the correlation time of residuals in samples."""
    samples = [model.quality.samples for model in row.models]
    squares = sum(
        count
        * max(
            model.quality.residual,
            _MINIMUM_RESIDUAL * (model.quality.residual / max(model.quality.relative, 1e-300)),
        )
        ** 2
        for count, model in zip(samples, row.models, strict=True)
    )
    count = sum(samples) / correlation
    free = row.parameters + 2 * len(row.models)
    deviance = count * math.log(squares / sum(samples))
    return dataclasses.replace(
        row, deviance=deviance, aic=deviance + 2.0 * free, bic=deviance + math.log(count) * free
    )


def _test_error_of_motionless_piston(row: ComparisonRow) -> float:
    errors = [
        quality.test_error_at_rest
        for quality in _qualities_of_observations(row.models)
        if quality.test_error_at_rest is not None
    ]
    errors += [record.at_rest for record in row.records]
    return root_mean_square(errors) if errors else 1.0


def _ranking_text(
    tied: Sequence[ComparisonRow], worse: Sequence[ComparisonRow], at_rest: float, *, at_noise: bool
) -> str:
    best = tied[0]
    baseline = "constant force" if best.models[0].law.prescribed else "motionless piston"
    words = (
        f"{best.name} is first: its error on held-out data is {format_percent(best.error)} "
        f"{best.models[0].error_reference_text} ({baseline}: {format_percent(at_rest)})"
    )
    if best.error > _NO_BETTER * at_rest:
        words += f", not smaller than for a {baseline}, so only the residuals of the fits can rank the laws"
    for row in tied[1:]:
        words += f"; {_tie_text(row, best, at_noise=at_noise)}"
    for row in worse:
        if math.isinf(row.error):
            words += f"; {row.name} diverges"
        else:
            words += f"; {row.name} is {format_factor(row.error / max(best.error, 1e-300), 3)} times worse"
    return words + "."


def _tie_text(row: ComparisonRow, best: ComparisonRow, *, at_noise: bool) -> str:
    """Describe a law that predicts as well as the first law."""
    extra = row.parameters - best.parameters
    more = f"{extra} more parameter{'s' * (extra != 1)}"
    if not at_noise:
        words = f"{row.name} ({format_percent(row.error)}) is not better by more than one standard error"
        return words + (f" despite its {more}" if extra > 0 else "")
    gain = row.deviance - best.deviance
    if abs(gain) < CLEAR:
        words = f"the data cannot distinguish {row.name} from {best.name} ({format_percent(row.error)})"
        return words + (f", although {row.name} has {more}" if extra > 0 else "")
    if gain > 0.0:
        return f"{row.name} predicts equally well, but fits the whole record less closely"
    return f"{row.name} does not predict better despite its {more}"
