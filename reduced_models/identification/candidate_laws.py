"""The laws that an identification compares by default."""

from __future__ import annotations

import dataclasses
import math
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.records.headings import is_derived_from_motion
from granular.records.record import PistonRecord
from granular.shared.errors import GranularError, InputError, format_factor, quote
from reduced_models.discovery.subset_selection import score_subsets_and_make_scorer
from reduced_models.discovery.terms import Term, physical_library_terms
from reduced_models.discovery.weak_form import (
    WeakForm,
    estimate_smoothed_motion,
    make_weak_form,
    normalising_height_line,
)
from reduced_models.laws.catalogue import LAWS, law_named
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import HeightLine, Law
from reduced_models.laws.rubbing_bed import RUBBING_BED, rubbing_bed_with_starts_near
from reduced_models.records.derivatives import fit_local_cubics, noise_standard_deviation
from reduced_models.records.first_guesses import FirstGuesses, first_guesses
from reduced_models.records.inputs import input_column, input_column_names

if TYPE_CHECKING:
    from granular.linear import MotionFriction

CANDIDATES = (
    "linear",
    "van-der-pol-like",
    "polynomial-spring",
    "power-law-spring",
    "quadratic-drag",
    "coulomb",
    "viscous-coulomb",
    "duffing",
)
"""Laws fitted to a free decay by default; the other packaged laws are special cases or have memory."""
_NODES_A_PERIOD = 32
_LEAST_STROKE, _NOISES = 0.02, 10.0
"""A stroke, from one turning point to the next, counts if it exceeds the first number times the largest
stroke and the second number times the noise."""
_FASTER = 0.9
"""The frequency counts as rising if the duration of the last stroke, divided by the duration of the first, is
below this. Without friction in the bed, the durations differ by only 1 % if the amplitude is one
grain diameter."""
REFERENCE = "linear"
"""Law that is always fitted, for comparison with the others."""
LIKELY = (REFERENCE, "polynomial-spring")
"""Laws that pass the screening for the packaged scene ``damper``; their fits are compiled in advance."""
_SPREAD = 1.5  # standard deviation of the logarithm of a gain's start values


class CandidateLaws(NamedTuple):
    """Laws to fit, and the screening that excluded the others."""

    laws: tuple[Law, ...]
    screening: LawScreening
    contains_zero: bool = False

    @property
    def exclusion_texts(self) -> tuple[str, ...]:
        """For each law that is not fitted, one sentence with the reason."""
        smallest, fitted = max(self.screening.smallest_misfit, 1.0), {law.name for law in self.laws}
        texts = []
        for name, misfit in self.screening.misfits.items():
            excess = format_factor(misfit / smallest)
            why = f"its residual in a quick test is {excess} times the best law's (limit {HOPELESS:g})"
            if misfit / smallest > _UNDEFINED_MISFIT:
                motion = "heights that reach zero" if self.contains_zero else "this motion"
                why = f"it is undefined for {motion}"
            if name not in fitted:
                texts.append(f"{name} was not fitted: {why}; --law {name} fits it anyway")
        return tuple(texts)


def choose_candidate_laws(
    record: PistonRecord, drive: str | None = None, known: MotionFriction | None = None
) -> CandidateLaws:
    """Choose laws to fit to a record; ``known`` is the dry friction if it is known from the scene."""
    laws = tuple(LAWS[name] for name in CANDIDATES)
    if drive is not None:
        return CandidateLaws(
            tuple(law_driven_by_column(law, record, drive) for law in laws), LawScreening({}, 1.0)
        )
    screening = screen_laws_by_weak_form(record, laws)
    saved = tuple(law for law in laws if law.name == REFERENCE or not screening.is_hopeless(law.name))
    if known is not None or does_frequency_rise(record):
        saved = (*saved, RUBBING_BED if known is None else rubbing_bed_with_starts_near(known))
    return CandidateLaws(saved, screening, bool(record.height.min() <= 0.0 <= record.height.max()))


def candidate_force_laws(records: Sequence[PistonRecord]) -> list[Law]:
    """Return laws for the force on a prescribed stroke; if a height is <= 0, only laws that allow this."""
    above = all(record.height.min() > 0.0 for record in records)
    return [law for law in FORCE_LAWS.usable_parts().values() if above or not law.given]


def does_frequency_rise(record: PistonRecord) -> bool:
    """Return whether the frequency of a free decay rises by more than a tenth, as it does if grains stick."""
    try:
        guess = first_guesses(record.time, record.height)
        count = int(_NODES_A_PERIOD * float(np.ptp(record.time)) / guess.shortest_cycle_period)
        nodes = np.linspace(record.time[0], record.time[-1], max(count, _NODES_A_PERIOD))
        z, speed, _, time = fit_local_cubics(record.time, record.height, guess.shortest_cycle_period, nodes)
    except GranularError:
        return False
    turns = np.flatnonzero(speed[:-1] * speed[1:] < 0.0)
    # The first stroke contains the transient of the release; the smallest ones are noise.
    strokes, times = np.abs(np.diff(z[turns])), np.diff(time[turns])
    small = strokes < max(
        _LEAST_STROKE * strokes.max(initial=0.0),
        _NOISES * noise_standard_deviation(record.height, record.time),
    )
    if small.any():
        times = times[: int(np.argmax(small))]
    return len(times) > 1 and bool(times[-1] < _FASTER * times[0])


def law_driven_by_column(law: Law, record: PistonRecord, drive: str) -> Law:
    """Add the record's column ``drive``, multiplied by a gain to be fitted, as a driving term to a law."""
    there = input_column_names(record)
    if drive not in there:
        others = ", ".join(map(quote, there)) or "none"
        raise InputError(f"the record has no column {quote(drive)}; columns that can be a drive: {others}")
    if not _can_be_input_name(drive, law):
        raise InputError(
            f"the column name {quote(drive)} cannot be used in an equation; rename the column, e.g. to u"
        )
    size = float(np.abs(input_column(record, drive)).max())
    if not size > 0.0:
        raise InputError(
            f"the column {quote(drive)} is zero everywhere and cannot drive a motion; give another column"
        )
    own, gain = law_named(law.name).start, "gain"

    def draw_start_values(
        guesses: FirstGuesses, random: np.random.Generator, count: int
    ) -> dict[str, np.ndarray]:
        assert own is not None
        draws = own(guesses, random, count)
        # In the coordinate used by the law's text.
        strength = guesses.amplitude * guesses.frequency**2 / (size * draws.get("scale", 1.0))
        logarithm = random.uniform(-2.0 * _SPREAD, 0.0, count)
        sign = np.where(random.uniform(size=count) < 0.5, -1.0, 1.0)
        return {**draws, gain: sign * strength * np.exp(logarithm)}

    return dataclasses.replace(
        law,
        name=f"{law.name}, driven by {drive}",
        equation=law.equation.replace("z''", f"(z'' - {gain}*{drive})"),
        start=draw_start_values,
        inputs=(drive,),
        units={**law.units},
    )


def _can_be_input_name(column: str, law: Law) -> bool:
    return column.isidentifier() and column not in (*law.parameters, "gain", "z", "t", "pi", "e")


def drive_option_text(column: str) -> str:
    """Return the command-line options that make a column of the record the drive of all laws."""
    if all(_can_be_input_name(column, LAWS[name]) for name in CANDIDATES):
        return f"--input {column}"
    if {",", "="} & set(column):
        return "rename it in the file, then pass --input NAME"
    return f"--columns {shlex.quote(f'drive={column}')} --input drive"


def unused_drive_columns(record: PistonRecord, laws: Sequence[Law]) -> tuple[str, ...]:
    """Return the columns that vary, could drive a law, and are not used by any of the laws."""
    named = {name for law in laws for name in (*law.inputs, *law.observations)}
    return tuple(
        name
        for name in input_column_names(record)
        if name not in named
        and not is_derived_from_motion(name)
        and math.isfinite(spread := float(np.ptp(input_column(record, name))))
        and spread > 0.0
    )


HOPELESS = 4.0
"""A law is excluded if its misfit is larger than this multiple of the smallest misfit."""
CLEARLY_LESS = 0.7
"""An equation is discovered if the misfit of all library terms together is below this fraction of the best
law's misfit."""
_UNDEFINED_MISFIT = 1e6  # a law with a larger misfit is not defined along the motion
_STARTS = 4
_LINEAR = (Term(0), Term(1), Term(0, 1, True))
_DEGREE = 3  # degree of the library
_EVALUATIONS = 60
_MAXIMUM_RATE = 1e12  # in amplitudes; larger rates are clipped
_MINIMUM_EXTRA_ROWS = 12  # integrals in excess of a law's parameters for a meaningful misfit


@dataclasses.dataclass(frozen=True)
class LawScreening:
    """Misfits of laws, computed from integrals of the motion (weak form) without solving the laws."""

    misfits: Mapping[str, float]  # in standard deviations of the noise: 1 for the true law
    library_misfit: float  # misfit of all terms of discovery's library together

    @property
    def smallest_misfit(self) -> float:
        """Smallest misfit of the laws, relative to the noise; infinite if no law was screened."""
        return min(self.misfits.values(), default=math.inf)

    def is_hopeless(self, name: str) -> bool:
        """Return whether a law's misfit is so large that the law cannot be the best."""
        return self.misfits.get(name, 0.0) > HOPELESS * max(self.smallest_misfit, 1.0)

    @property
    def other_terms_fit_better(self) -> bool:
        """True if a sum of all library terms fits the record clearly better than any law."""
        return max(self.library_misfit, 1.0) < CLEARLY_LESS * self.smallest_misfit < math.inf


def screen_laws_by_weak_form(record: PistonRecord, laws: Sequence[Law]) -> LawScreening:
    """Fit all laws without hidden states or inputs in weak form, and return their misfits."""
    # The weak form needs only sums over samples (Messenger & Bortz 2021, doi:10.1137/20M1343166): one second
    # for all laws, against ten for one fit through the differential equation.
    try:
        guess = first_guesses(record.time, record.height)
        line = normalising_height_line([record])
        weak = make_weak_form(estimate_smoothed_motion(record, line))
        # The noise of the integrals follows from the record's noise by the linear law.
        _, scorer = score_subsets_and_make_scorer(
            weak, physical_library_terms(_DEGREE), _LINEAR, [np.arange(len(_LINEAR))[None]]
        )
    except (GranularError, np.linalg.LinAlgError):
        return LawScreening({}, math.inf)
    misfits = {}
    for law in laws:
        if not law.hidden and not law.inputs:
            misfit = _law_misfit(law, weak, scorer.whitening, guess, line)
            if math.isfinite(misfit):
                misfits[law.name] = misfit
    return LawScreening(misfits, math.sqrt(scorer.excess))


def _law_misfit(
    law: Law, weak: WeakForm, whitening: np.ndarray, guess: FirstGuesses, line: HeightLine
) -> float:
    """Return the misfit of a law fitted to the integrals of the weak form; infinite if the fit fails."""
    from scipy.optimize import least_squares

    (part,) = weak.parts
    # The law uses the height, the integrals use the displacement in amplitudes.
    z, v = line.height(part.motion.z), line.scale * part.motion.velocity
    field = compile_rates(law.equation, (), "numpy")
    target = whitening @ weak.target
    if law.start is None or len(target) < len(law.parameters) + _MINIMUM_EXTRA_ROWS:
        return math.inf
    starts = law.start(guess, np.random.default_rng(0), _STARTS)
    bump = part.bump  # applied first because it is sparse; the whitening matrix is small
    logarithmic = np.array([name in law.positive for name in law.parameters])
    smallest_misfit = math.inf
    for start in np.stack([starts[name] for name in law.parameters], axis=1):
        units = np.where(np.abs(start) > 0.0, start, 1.0)

        def residuals(x: np.ndarray, units: np.ndarray = units) -> np.ndarray:
            values = units * np.where(logarithmic, np.exp(np.clip(x, -50.0, 50.0)), 1.0 + x)
            with np.errstate(all="ignore"):
                rates = np.nan_to_num(field(z, v, *values)[0] / line.scale, nan=_MAXIMUM_RATE)
            limited = np.broadcast_to(np.clip(rates, -_MAXIMUM_RATE, _MAXIMUM_RATE), z.shape)
            return np.asarray(target - whitening @ (bump @ limited))

        result = least_squares(residuals, np.zeros(len(units)), x_scale="jac", max_nfev=_EVALUATIONS)
        freedom = max(1, len(target) - len(units))
        smallest_misfit = min(smallest_misfit, math.sqrt(float(result.fun @ result.fun) / freedom))
    return smallest_misfit
