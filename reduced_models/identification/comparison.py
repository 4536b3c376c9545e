"""`compare`: which law do the data speak for, and can they tell?

Laws are ranked by their errors on what they have not seen: roll-outs over the held-out end of each
record, and over held-out records. Laws whose errors are alike, or all down at the noise, are told
apart by the Bayesian information criterion of their fits (Schwarz 1978,
doi:10.1214/aos/1176344136), which favours fewer parameters.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.run.record import PistonRecord
from granular.shared.errors import GranularError, InputError
from granular.shared.html import number
from reduced_models.fitting.fitting import fit, law_of
from reduced_models.fitting.options import HOLDOUT, STARTS, check_options, records_of
from reduced_models.fitting.start_values import starts_near
from reduced_models.laws.height_map import HeightMap
from reduced_models.laws.law import Law
from reduced_models.models.model import ReducedModel
from reduced_models.models.roll_out import RollOut, roll_out

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TIE = 0.05
"""Held-out errors closer than this fraction are alike."""
NOISE_TIE = 1.25
"""Held-out errors below so many noise levels are alike."""
CLEAR = 10.0
"""Twice the difference of two log-likelihoods below which the data cannot tell two laws apart."""
_LEAST = 1e-7  # of the swing: residuals below it are equal
_NO_BETTER = 0.9


@dataclasses.dataclass(frozen=True, eq=False)
class Row:
    """One law.

    Attributes
    ----------
    name : str
    models : tuple of ReducedModel
        One a record; empty where the fit failed.
    parameters : int
        Free numbers of the law and its map, the initial states not counted.
    stretches : tuple of float
        Error of the roll-out over each record's held-out end, in rms swings of the record; infinite
        where it blows up. Empty without a hold-out.
    records : tuple of RollOut
        One a held-out record.
    error : float
        Root mean square of all held-out errors; the residual of the fit without any.
    deviance, aic, bic : float
        n log of the mean squared residual of the fit to all of the records (n the number of
        independent samples), and with twice, or log n times, the number of parameters added.
    failure : str
        Why there is no model; empty where there is one.
    """

    name: str
    models: tuple[ReducedModel, ...] = ()
    parameters: int = 0
    stretches: tuple[float, ...] = ()
    records: tuple[RollOut, ...] = ()
    error: float = math.inf
    deviance: float = math.inf
    aic: float = math.inf
    bic: float = math.inf
    failure: str = ""

    @property
    def blow_ups(self) -> int:
        """Held-out stretches and records over which the law blows up."""
        errors = (*self.stretches, *(one.relative for one in self.records))
        return sum(math.isinf(error) for error in errors)

    def to_plain(self) -> dict[str, Any]:
        """The row as plain data."""
        return {
            "law": self.name,
            "parameters": self.parameters,
            "held_out_error": self.error,
            "stretches": list(self.stretches),
            "records": [one.relative for one in self.records],
            "aic": self.aic,
            "bic": self.bic,
            "blow_ups": self.blow_ups,
            "failure": self.failure,
            "values": [dict(model.parameters) for model in self.models],
        }


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """Laws on the same data, the best first.

    Attributes
    ----------
    rows : tuple of Row
    verdict : str
        In plain words.
    noise : float
        White noise of the records, in rms swings.
    at_rest : float
        Held-out error of a piston that stays at rest.
    """

    rows: tuple[Row, ...]
    verdict: str
    noise: float
    at_rest: float

    @property
    def best(self) -> ReducedModel:
        """The model of the law that is first, for the first record."""
        return self.rows[0].models[0]

    @property
    def header(self) -> tuple[str, ...]:
        """Of `cells`."""
        held = len(self.rows[0].records)
        return (
            "law", "parameters", "held-out stretch", *(f"record {k + 1}" for k in range(held)),
            "AIC", "BIC", "blow-ups",
        )  # fmt: skip

    def cells(self) -> list[tuple[str, ...]]:
        """The table as texts: errors in per cent of the rms swing, AIC and BIC above the least."""
        aic, bic = min(row.aic for row in self.rows), min(row.bic for row in self.rows)
        lines = []
        for row in self.rows:
            if row.failure:
                empty = [""] * (len(self.header) - 2)
                lines.append((row.name, row.failure, *empty))
                continue
            stretch = _percent(_pooled(row.stretches)) if row.stretches else "-"
            records = [_percent(one.relative) for one in row.records]
            lines.append(
                (row.name, str(row.parameters), stretch, *records, f"{row.aic - aic:+.1f}",
                 f"{row.bic - bic:+.1f}", str(row.blow_ups))
            )  # fmt: skip
        return lines

    @property
    def table(self) -> str:
        """The table for people, without the verdict."""
        rows = [self.header, *self.cells()]
        sound = [row for row in rows if row[-1]]
        widths = [max(len(row[k]) for row in sound) for k in range(len(self.header))]
        widths[0] = max(len(row[0]) for row in rows)
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return "\n".join(lines)

    def __str__(self) -> str:
        return f"{self.table}\n\n{self.verdict}"

    def to_plain(self) -> dict[str, Any]:
        """Table and verdict as plain data."""
        return {
            "verdict": self.verdict,
            "best": self.rows[0].name,
            "noise": self.noise,
            "at_rest": self.at_rest,
            "rows": [row.to_plain() for row in self.rows],
        }

    def plot(self) -> Figure:
        """Held-out errors of the laws, beside the noise and a piston at rest."""
        from granular.shared.plotting import COLOURS, GREY, READABLE, figure, plain_label

        sound = [row for row in self.rows if not row.failure][::-1]
        with figure(height=1.8 + 0.45 * len(sound), size=READABLE) as (drawing, axes):
            greatest = max(
                [self.at_rest, *(row.error for row in sound if math.isfinite(row.error))]
            )
            names = [row.name if len(row.name) < 30 else f"{row.name[:29]}…" for row in sound]
            values = [min(100.0 * row.error, 1e3 * greatest) for row in sound]
            # By place, since names that are cut may be alike.
            axes.barh(range(len(sound)), values, color=COLOURS[0])
            axes.set_yticks(range(len(sound)), [plain_label(name) for name in names])
            for level, words, style in (
                (self.at_rest, "a piston at rest", "--"),
                (self.noise, "noise", ":"),
            ):
                if level > 1e-3 * min(row.error for row in sound):
                    axes.axvline(100.0 * level, color=GREY, linestyle=style, label=words)
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter("{x:g}")  # powers would be too small on a phone
            axes.set_xlabel("held-out error [% of the rms swing]")
            axes.grid(visible=False, axis="y")
            drawing.legend(loc="outside upper right", ncols=2)
            return drawing


def compare(
    record: PistonRecord | Sequence[PistonRecord],
    laws: str | Law | ReducedModel | Sequence[str | Law | ReducedModel],
    holdout: float = HOLDOUT,
    held_out: Sequence[PistonRecord] = (),
    *,
    own: Sequence[str] = (),
    starts: int = STARTS,
) -> Comparison:
    """Compare laws on held-out data.

    Parameters
    ----------
    record : PistonRecord, or a sequence of them
        To train on.
    laws : str, Law or ReducedModel, or a sequence of them
        Names, equations, laws, or models whose structure is fitted again, from their parameters;
        also what `discover` gives, for its model.
    holdout : float
        Fraction of each record, at its end, that is held out.
    held_out : sequence of PistonRecord
        Whole records that no fit sees; each is predicted from an initial state that its first
        period tells.
    own : sequence of str
        Parameters that each record has for itself, for the laws that have them. Not together with
        held-out records, which would have none.
    starts : int
        Random starts of each fit.

    Raises
    ------
    InputError
        If there is no law, an argument is out of its range, or no law can be fitted.
    RecordError
        If a record is too short or does not move.
    """
    records = records_of(record)
    check_options(starts, holdout)
    laws = [laws] if isinstance(laws, str | Law | ReducedModel) else laws
    if not laws:
        raise InputError("laws is empty; name at least one")
    if own and held_out:
        raise InputError("own parameters do not carry over to held-out records; leave one of them")
    chosen = [_entry(law, records[0]) for law in laws]
    rows = [_row(entry, records, holdout, held_out, own, starts) for entry in chosen]
    sound = [row for row in rows if not row.failure]
    if not sound:
        raise InputError(f"no law could be fitted; {rows[0].name}: {rows[0].failure}")
    return _ranked(rows, sound)


def judged_on(table: Comparison, held_out: Sequence[PistonRecord]) -> Comparison:
    """A comparison whose models are judged on further records that no fit has seen.

    Each is predicted from an initial state that its first period tells; a law that cannot be is one
    that blows up there.
    """
    rows = [_further(row, held_out) for row in table.rows if not row.failure]
    return _ranked([*rows, *(row for row in table.rows if row.failure)], rows)


def _further(row: Row, held_out: Sequence[PistonRecord]) -> Row:
    judged = list(row.records)
    for record in held_out:
        try:
            judged.append(roll_out(row.models[0], record))
        except InputError:
            judged.append(RollOut(record.first(2), math.inf, math.inf, 1.0))
    errors = [*row.stretches, *(one.relative for one in judged)]
    return dataclasses.replace(row, records=tuple(judged), error=_pooled(errors))


class _Entry(NamedTuple):
    """A law to compare, and the map that it was given, if any."""

    law: Law
    map: HeightMap | None


def law_name(law: str | Law | ReducedModel) -> str:
    """The name under which `compare` lists a law."""
    if isinstance(law, ReducedModel):
        return law.law.name
    if isinstance(law, Law):
        return law.name
    return " ".join(law.split())


def _entry(law: Any, record: PistonRecord) -> _Entry:
    if isinstance(law, str | Law):
        return _Entry(law_of(law, record), None)
    model: ReducedModel = law if isinstance(law, ReducedModel) else law.model
    if model.law.start is not None:
        return _Entry(model.law, model.map)
    return _Entry(
        dataclasses.replace(model.law, start=starts_near(dict(model.parameters))), model.map
    )


def _row(
    entry: _Entry,
    records: Sequence[PistonRecord],
    holdout: float,
    held_out: Sequence[PistonRecord],
    own: Sequence[str],
    starts: int,
) -> Row:
    law, given = entry
    private = [name for name in own if name in law.parameters]
    how: Any = {} if given is None or given.fitted else {"map": given}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the models keep their notes
            models = fit(records, law, holdout=holdout, own=private, starts=starts, **how)
        judged = tuple(roll_out(models[0], each) for each in held_out)
    except GranularError as cause:
        return Row(law.name, failure=str(cause))
    stretches = tuple(
        model.quality.holdout for model in models if model.quality.holdout is not None
    )
    count = len(law.parameters) + (2 if models[0].map.fitted else 0)
    count += len(private) * (len(records) - 1)
    errors = [*stretches, *(one.relative for one in judged)]
    error = _pooled(errors) if errors else _pooled([model.quality.relative for model in models])
    return Row(law.name, models, count, stretches, judged, error)


def _pooled(errors: Sequence[float]) -> float:
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


def _ranked(rows: Sequence[Row], sound: Sequence[Row]) -> Comparison:
    correlation = min(_correlation(row) for row in sound)
    scored = [_scored(row, correlation) for row in sound]
    noise = _pooled([_noise(model) for model in scored[0].models])
    least = min(row.error for row in scored)
    limit = max((1.0 + TIE) * least, NOISE_TIE * noise)
    alike = sorted((row for row in scored if row.error <= limit), key=lambda row: row.bic)
    worse = sorted((row for row in scored if row.error > limit), key=lambda row: row.error)
    if not alike:  # every law blows up
        alike, worse = sorted(worse, key=lambda row: row.bic), []
    at_rest = _at_rest(scored[0])
    verdict = _verdict(alike, worse, at_rest)
    failed = [row for row in rows if row.failure]
    for row in failed:
        verdict += f" {row.name} could not be fitted."
    return Comparison((*alike, *worse, *failed), verdict, noise, at_rest)


def _correlation(row: Row) -> float:
    return max(model.quality.correlation for model in row.models)


def _noise(model: ReducedModel) -> float:
    return model.quality.noise * model.quality.relative / max(model.quality.residual, 1e-300)


def _scored(row: Row, correlation: float) -> Row:
    """A row with its information criteria, for samples that follow each other so far."""
    samples = [model.quality.samples for model in row.models]
    squares = sum(
        count * max(model.quality.residual, _LEAST * _swing(model)) ** 2
        for count, model in zip(samples, row.models, strict=True)
    )
    count = sum(samples) / correlation
    free = row.parameters + 2 * len(row.models)
    deviance = count * math.log(squares / sum(samples))
    return dataclasses.replace(
        row,
        deviance=deviance,
        aic=deviance + 2.0 * free,
        bic=deviance + math.log(count) * free,
    )


def _swing(model: ReducedModel) -> float:
    """Rms swing of a model's record."""
    return model.quality.residual / max(model.quality.relative, 1e-300)


def _at_rest(row: Row) -> float:
    errors = [
        model.quality.holdout_at_rest
        for model in row.models
        if model.quality.holdout_at_rest is not None
    ]
    errors += [one.at_rest for one in row.records]
    return _pooled(errors) if errors else 1.0


def _percent(share: float) -> str:
    return "blows up" if math.isinf(share) else f"{number(100.0 * share, 3)} %"


def _verdict(alike: Sequence[Row], worse: Sequence[Row], at_rest: float) -> str:
    best = alike[0]
    words = (
        f"{best.name} is first: it predicts the held-out data to {_percent(best.error)} of the rms "
        f"swing (a piston that stays at rest: {_percent(at_rest)})"
    )
    if best.error > _NO_BETTER * at_rest:
        words += ", no better than rest, so these data do not judge the laws"
    for row in alike[1:]:
        gain = row.deviance - best.deviance
        if abs(gain) < CLEAR:
            words += f"; the data cannot tell {row.name} from it ({_percent(row.error)})"
            if row.parameters > best.parameters:
                words += f", which has {row.parameters - best.parameters} more parameters"
        elif gain > 0.0:
            words += f"; {row.name} predicts as well, but describes the whole record less closely"
        else:
            extra = row.parameters - best.parameters
            words += f"; {row.name} predicts no better for its {extra} more parameters"
    for row in worse:
        if math.isinf(row.error):
            words += f"; {row.name} blows up"
        else:
            words += f"; {row.name} is {row.error / max(best.error, 1e-300):.3g} times worse"
    return words + "."
