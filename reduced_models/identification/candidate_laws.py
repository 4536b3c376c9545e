"""The laws that an identification compares where nobody names any."""

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
from reduced_models.discovery.subset_selection import score_subsets
from reduced_models.discovery.terms import Term, physical_library_terms
from reduced_models.discovery.weak_form import WeakForm, estimate_motion, normalising_line, weak_form
from reduced_models.laws.catalogue import LAWS, law_named
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.force_laws import FORCE_LAWS
from reduced_models.laws.law import HeightLine, Law
from reduced_models.laws.rubbing_bed import RUBBING_BED, rubbing_bed_near
from reduced_models.records.derivatives import fit_local_cubics, noise_level
from reduced_models.records.first_guesses import FirstGuesses, first_guesses
from reduced_models.records.inputs import column_names, input_column

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
"""Laws that can win on a free swing; the others of the package are special cases or have memory."""
_NODES_A_PERIOD = 32
_LEAST_STROKE, _NOISES = 0.02, 10.0
"""Strokes between turning points that are looked at, over the largest one and over the noise."""
_FASTER = 0.9
"""Time of the last of them over the first one: a bed without friction changes it by 1 % at 1 D."""
REFERENCE = "linear"
"""Is fitted in any case: what a better law is better than."""
LIKELY = (REFERENCE, "polynomial-spring")
"""Laws that a glance leaves of the packaged damper's motion."""
_SPREAD = 1.5  # of the logarithm of a gain's start values


class CandidateLaws(NamedTuple):
    """Laws to fit, and why others are not fitted."""

    laws: tuple[Law, ...]
    screening: LawScreening
    contains_zero: bool = False

    @property
    def exclusion_texts(self) -> tuple[str, ...]:
        """Sentences, one a law that is not fitted, with its misfit over the least one."""
        least, fitted = max(self.screening.least_misfit, 1.0), {law.name for law in self.laws}
        texts = []
        for name, misfit in self.screening.misfits.items():
            excess = format_factor(misfit / least)
            why = f"at a glance it leaves {excess} times what the best law leaves (limit {HOPELESS:g})"
            if misfit / least > _BEYOND_WORDS:
                why = f"it cannot describe {'heights about zero' if self.contains_zero else 'such a motion'}"
            if name not in fitted:
                texts.append(f"{name} was not fitted: {why}; --law {name} fits it all the same")
        return tuple(texts)


def choose_candidate_laws(
    record: PistonRecord, drive: str | None = None, known: MotionFriction | None = None
) -> CandidateLaws:
    """Laws that can win on a record, driven by one of its columns where that is named; known dry friction."""
    laws = tuple(LAWS[name] for name in CANDIDATES)
    if drive is not None:
        return CandidateLaws(tuple(driven_law(law, record, drive) for law in laws), LawScreening({}, 1.0))
    screening = screen_laws_by_weak_form(record, laws)
    saved = tuple(law for law in laws if law.name == REFERENCE or not screening.is_hopeless(law.name))
    if known is not None or frequency_rises(record):
        saved = (*saved, RUBBING_BED if known is None else rubbing_bed_near(known))
    return CandidateLaws(saved, screening, bool(record.height.min() <= 0.0 <= record.height.max()))


def candidate_force_laws(records: Sequence[PistonRecord]) -> list[Law]:
    """Laws of the package for a force on prescribed strokes, those of heights above 0 where all are."""
    above = all(record.height.min() > 0.0 for record in records)
    return [law for law in FORCE_LAWS.working().values() if above or not law.given]


def frequency_rises(record: PistonRecord) -> bool:
    """Return whether a free motion oscillates faster by a tenth or more as it dies, as if grains stick."""
    try:
        guess = first_guesses(record.time, record.height)
        count = int(_NODES_A_PERIOD * float(np.ptp(record.time)) / guess.shortest_cycle_period)
        nodes = np.linspace(record.time[0], record.time[-1], max(count, _NODES_A_PERIOD))
        z, speed, _, time = fit_local_cubics(record.time, record.height, guess.shortest_cycle_period, nodes)
    except GranularError:
        return False
    turns = np.flatnonzero(speed[:-1] * speed[1:] < 0.0)
    # The first one ends what a release stirs up; small ones are noise.
    strokes, times = np.abs(np.diff(z[turns])), np.diff(time[turns])
    small = strokes < max(
        _LEAST_STROKE * strokes.max(initial=0.0), _NOISES * noise_level(record.height, record.time)
    )
    if small.any():
        times = times[: int(np.argmax(small))]
    return len(times) > 1 and bool(times[-1] < _FASTER * times[0])


def driven_law(law: Law, record: PistonRecord, drive: str) -> Law:
    """Law of the package with a column of a record, times a gain that is fitted, added to z''."""
    there = column_names(record)
    if drive not in there:
        others = ", ".join(map(quote, there)) or "none"
        raise InputError(f"the record has no column {quote(drive)}; further columns: {others}")
    if not _can_name_input(drive, law):
        raise InputError(f"the column {quote(drive)} cannot be named in an equation; rename it, such as to u")
    size = float(np.abs(input_column(record, drive)).max())
    if not size > 0.0:
        raise InputError(f"the column {quote(drive)} is zero everywhere; it drives nothing")
    own, gain = law_named(law.name).start, "gain"

    def start(guesses: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
        assert own is not None
        draws = own(guesses, random, count)
        # In the coordinate of the law's text.
        strength = guesses.amplitude * guesses.frequency**2 / (size * draws.get("scale", 1.0))
        logarithm = random.uniform(-2.0 * _SPREAD, 0.0, count)
        sign = np.where(random.uniform(size=count) < 0.5, -1.0, 1.0)
        return {**draws, gain: sign * strength * np.exp(logarithm)}

    return dataclasses.replace(
        law,
        name=f"{law.name}, driven by {drive}",
        equation=law.equation.replace("z''", f"(z'' - {gain}*{drive})"),
        start=start,
        inputs=(drive,),
        units={**law.units},
    )


def _can_name_input(column: str, law: Law) -> bool:
    return column.isidentifier() and column not in (*law.parameters, "gain", "z", "t", "pi", "e")


def drive_option_text(column: str) -> str:
    """Options of the command line by which a column drives all laws."""
    if all(_can_name_input(column, LAWS[name]) for name in CANDIDATES):
        return f"--input {column}"
    if {",", "="} & set(column):
        return "rename it in the file, then --input NAME"
    return f"--columns {shlex.quote(f'drive={column}')} --input drive"


def unused_columns(record: PistonRecord, laws: Sequence[Law]) -> tuple[str, ...]:
    """Columns that change in the course of the record, may drive a law, and are named by none."""
    named = {name for law in laws for name in (*law.inputs, *law.observations)}
    return tuple(
        name
        for name in column_names(record)
        if name not in named
        and not is_derived_from_motion(name)
        and math.isfinite(spread := float(np.ptp(input_column(record, name))))
        and spread > 0.0
    )


HOPELESS = 4.0
"""Misfit, over the least one, beyond which a law is left out."""
CLEARLY_LESS = 0.7
"""Misfit of all terms of a library, over that of the best law, below which discovery may help."""
_BEYOND_WORDS = 1e6  # a misfit by which a law is not defined there
_STARTS = 4
_LINEAR = (Term(0), Term(1), Term(0, 1, True))
_DEGREE = 3  # of the library
_EVALUATIONS = 60
_LARGEST = 1e12  # of a rate, in amplitudes: more is as hopeless
_FEWEST_ROWS = 12  # integrals beyond a law's parameters, that say something


@dataclasses.dataclass(frozen=True)
class LawScreening:
    """Misfits of some laws at a glance."""

    misfits: Mapping[str, float]  # in standard deviations of the noise: 1 if the law holds
    library_misfit: float  # of all terms of a discovery together

    @property
    def least_misfit(self) -> float:
        """Least misfit of the laws, in noise levels, without unit; infinite where none was screened."""
        return min(self.misfits.values(), default=math.inf)

    def is_hopeless(self, name: str) -> bool:
        """Return whether a law cannot win."""
        return self.misfits.get(name, 0.0) > HOPELESS * max(self.least_misfit, 1.0)

    @property
    def other_terms_fit_better(self) -> bool:
        """True where all terms of a discovery's library fit the record clearly better than any law."""
        return max(self.library_misfit, 1.0) < CLEARLY_LESS * self.least_misfit < math.inf


def screen_laws_by_weak_form(record: PistonRecord, laws: Sequence[Law]) -> LawScreening:
    """Fit laws without hidden states and inputs to the weak form; of others it says nothing."""
    # Bumps leave sums over the samples (Messenger & Bortz 2021, doi:10.1137/20M1343166): a second for all
    # laws, when a fit through the differential equation takes ten.
    try:
        guess = first_guesses(record.time, record.height)
        line = normalising_line([record])
        weak = weak_form(estimate_motion(record, line))
        # The noise of the integrals is that which the linear law makes of the record's.
        _, scorer = score_subsets(
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
    """Misfit of a law that is fitted to the integrals; infinite where that fails."""
    from scipy.optimize import least_squares

    (part,) = weak.parts
    # The law holds for the height, and the integrals are of the displacement in amplitudes.
    z, v = line.height(part.motion.z), line.scale * part.motion.velocity
    field = compile_rates(law.equation, (), "numpy")
    target = whitening @ weak.target
    if law.start is None or len(target) < len(law.parameters) + _FEWEST_ROWS:
        return math.inf
    starts = law.start(guess, np.random.default_rng(0), _STARTS)
    bump = part.bump  # sparse, so it comes first: next to it the whitening is small
    logarithmic = np.array([name in law.positive for name in law.parameters])
    least = math.inf
    for start in np.stack([starts[name] for name in law.parameters], axis=1):
        units = np.where(np.abs(start) > 0.0, start, 1.0)

        def left(x: np.ndarray, units: np.ndarray = units) -> np.ndarray:
            values = units * np.where(logarithmic, np.exp(np.clip(x, -50.0, 50.0)), 1.0 + x)
            with np.errstate(all="ignore"):
                rates = np.nan_to_num(field(z, v, *values)[0] / line.scale, nan=_LARGEST)
            limited = np.broadcast_to(np.clip(rates, -_LARGEST, _LARGEST), z.shape)
            return np.asarray(target - whitening @ (bump @ limited))

        result = least_squares(left, np.zeros(len(units)), x_scale="jac", max_nfev=_EVALUATIONS)
        freedom = max(1, len(target) - len(units))
        least = min(least, math.sqrt(float(result.fun @ result.fun) / freedom))
    return least
