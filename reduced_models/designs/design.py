"""`design`: a damper for a wanted frequency and damping, checked by simulation.

The maps propose; fresh simulations of the proposal, from random starts that the study did not use,
say what it does. Where they differ from the target by more than is allowed, the next one aims as
far to the other side (a secant step with the slopes of the maps). So does one more where all are allowed but
their mean is off by more than half of that: a polynomial over the whole box is off by 2 to 4 % in parts of
it, always to the same side, at 368 grains without small ones among others. Some numbers of grains come to
rest in one order or another, by their start, with dampings that differ by a fifth: where the starts
disagree by more than is allowed, another number of grains is tried.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import Executor
from numbers import Integral
from pathlib import Path

import numpy as np

from granular.run.plan import SCATTER, plan
from granular.scene.published_beds import damper
from granular.shared.errors import GranularError, InputError, StoreError
from granular.shared.message_text import quote
from granular.studies.executors import case_executor
from granular.studies.sweep import sweep
from reduced_models.designs.damper import DamperCandidate
from reduced_models.designs.maps import DamperMaps, damper_maps
from reduced_models.designs.proposal import (
    DesignTarget,
    damper_for_target,
    propose_design,
    targets_by_grain_count,
)
from reduced_models.designs.result import (
    DAMPING_TOLERANCE,
    FREQUENCY_TOLERANCE,
    Design,
    DesignCheck,
    DesignRound,
)
from reduced_models.designs.study import check_workers, figures_of_design_check, measure_design_check

DISC_FREQUENCY_TOLERANCE = 0.03
"""Taken for discs where `CENTRING` further proposals are no nearer: their beds come to rest in one order or
another, and of two neighbouring proposals for 4 Hz one swings with 3.90 and the other with 4.09 Hz."""
CENTRED, CENTRING = 0.5, 3
"""Fraction of these that the mean of the checks may be off by, without one more correction; and the
proposals of one number of grains after which it may."""
SEEDS = (2, 3, 4)
"""Random starts of the checks; the study took the first."""
CORRECTIONS = 5
"""Proposals with the same number of grains, or the same mass."""
STEEPEST = 4.0
"""The frequency may follow the maps so many times as fast, or as slowly."""
MOST = 8
"""Proposals in all."""


class DesignError(GranularError, RuntimeError):
    """The simulations of all proposals missed the target."""

    def __init__(self, message: str, design: Design | None) -> None:
        super().__init__(message)
        self.design = design


def design(
    frequency: float,
    damping: float,
    *,
    grains: int | None = None,
    mass: float | None = None,
    small_share: float = 0.0,
    magnets: str = "dipoles",
    seeds: Sequence[int] = SEEDS,
    maps: DamperMaps | None = None,
    out: str | Path | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> Design:
    """Design a magnetic granular damper whose piston swings as wanted.

    The maps propose a damper, simulations check it, and secant steps correct the proposal, up to
    eight proposals in all.

    Parameters
    ----------
    frequency : float
        Frequency of the undamped small swing about rest [Hz], above 0; that of the damped one is
        sqrt(1 - damping^2) of it.
    damping : float
        Damping ratio, a fraction of critical damping, above 0.
    grains : int, optional
        Number of grains, from 92 to 368. If neither it nor ``mass`` is given: 368, the published
        number, if that does, and else fewer, the nearest that do.
    mass : float, optional
        Mass of the piston [kg], where the load is given; the number of grains is free then.
    small_share : float
        Fraction of grains with 0.6 of the diameter, from 0 to 0.5, which makes the bed softer: the
        piston rests lower, and swings faster.
    magnets : str
        ``"dipoles"``, or ``"cylinders"``: discs as in the packaged scene ``magnets``, for which
        theory turns the maps of dipoles into proposals.
    seeds : sequence of int
        Random starts of the checks, integers from 0 on, each of which must meet the target.
    maps : DamperMaps, optional
        Maps of a study of one's own; `damper_maps` if not given.
    out : str or Path, optional
        Directory for simulations, scene.toml, design.json and report.html; called again, what was
        simulated is used again. Nothing is written if not given.
    executor : concurrent.futures.Executor, optional
        Where the cases run, as in `granular.sweep`.
    workers : int, optional
        Number of processes, from 1 on; as many as there are processors, but no more than
        ``seeds``, if not given.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    Design
        Damper within 2 % of the frequency and 5 % of the damping ratio in every check, with all
        proposals and their simulations; discs within 3 % where three more proposals are no nearer.

    Raises
    ------
    InputError
        If an argument is out of its range, ``grains`` and ``mass`` are both given, ``seeds`` is
        empty or holds something else than integers from 0 on, or the target lies outside the maps;
        the message tells what can be had.
    StoreError
        If ``out`` cannot be made or written to.
    DesignError
        If the proposals missed the target, or a simulation failed before one met it; its ``design``
        holds all proposals that were simulated, and is None where the first one failed.
    KeyboardInterrupt
        On Ctrl-C; ``out`` keeps what was simulated.

    Warns
    -----
    UserWarning
        Once for each proposal whose simulations warned, as `granular.sweep` does.
    """
    target = DesignTarget(frequency, damping, grains, mass, small_share, magnets)
    if not isinstance(seeds, Sequence | np.ndarray) or any(
        not isinstance(seed, Integral) or seed < 0 for seed in seeds
    ):
        raise InputError(f"seeds = {quote(seeds)}; give integers from 0 on")
    if not len(seeds):
        raise InputError("seeds is empty; give at least one random start")
    check_workers(workers)
    chosen = damper_maps() if maps is None else maps
    propose_design(chosen, target)  # refuses what the maps do not hold, before anything is simulated
    with case_executor(executor, min(len(seeds), workers or os.cpu_count() or 1)) as pool:
        return _search_damper(target, chosen, seeds, out, pool, progress)


def _search_damper(
    target: DesignTarget,
    chosen: DamperMaps,
    seeds: Sequence[int],
    out: str | Path | None,
    executor: Executor,
    progress: bool,
) -> Design:
    """Proposals, each checked and the next one corrected by it, until a target is met."""
    rounds: list[DesignRound] = []
    near: Design | None = None
    most = MOST
    targets = targets_by_grain_count(target)
    for target_ in targets:
        aim = _aim_for_next_grain_count(target, rounds)
        first = len(rounds)
        met: Design | None = None
        for _ in range(CORRECTIONS):
            candidate = damper_for_target(chosen, target_, aim)
            if candidate is None or len(rounds) == most:
                break
            try:
                checks = _run_checks(candidate, seeds, out, executor, progress)
            except StoreError:
                raise
            except GranularError as error:
                if met is not None or near is not None:
                    break
                raise DesignError(str(error), Design(target, tuple(rounds)) if rounds else None) from None
            rounds.append(DesignRound(candidate, chosen.predict(candidate), checks))
            result = Design(target, tuple(rounds))
            if result.meets_target(FREQUENCY_TOLERANCE, DAMPING_TOLERANCE):
                met = result
                if met.means_meet_target(CENTRED * FREQUENCY_TOLERANCE, CENTRED * DAMPING_TOLERANCE):
                    break
            elif near is None and _is_near_wanted_frequency(result):
                near, most = result, min(most, len(rounds) + CENTRING)
            if met is not None and len(rounds) - first >= CENTRING:
                break
            if (
                met is None
                and len(targets) > 1
                and not result.seeds_agree(FREQUENCY_TOLERANCE, DAMPING_TOLERANCE)
            ):
                break
            aim = _corrected_target(target, rounds[first:])
        near = met or near
        if met is not None or len(rounds) == most:
            break
    if near is None:
        raise DesignError(_miss_text(result), result)
    best = near.rounds[-1]
    chosen_design = Design(target, (*(other for other in rounds if other is not best), best))
    if out is not None:
        chosen_design.save(out, chosen)
    return chosen_design


def _is_near_wanted_frequency(result: Design) -> bool:
    """Return true for discs whose checks lie within the wider tolerance of their frequency."""
    return result.target.magnets != "dipoles" and result.meets_target(
        DISC_FREQUENCY_TOLERANCE, DAMPING_TOLERANCE
    )


def _aim_for_next_grain_count(target: DesignTarget, rounds: Sequence[DesignRound]) -> tuple[float, float]:
    """Frequency and damping ratio to aim at with another number of grains: the maps err there alike."""
    return (
        target.frequency * math.exp(-_mean_logarithmic_map_error(rounds, "frequency")),
        target.damping * math.exp(-_mean_logarithmic_map_error(rounds, "damping_ratio")),
    )


def _mean_logarithmic_map_error(rounds: Sequence[DesignRound], name: str) -> float:
    """Mean of the logarithm of a measured figure over the promised one."""
    errors = [math.log(made.mean_figure(name) / getattr(made.promised_figures, name)) for made in rounds]
    return sum(errors) / len(errors) if errors else 0.0


def _corrected_target(target: DesignTarget, rounds: Sequence[DesignRound]) -> tuple[float, float]:
    """Frequency and damping ratio to aim at in the maps next."""
    # Damping goes with the drag: its error in the maps is the mean over the rounds, as starts scatter by
    # more. The frequency takes a secant step on logarithms, since a bed that falls into another order changes
    # faster or more slowly than the maps.
    last = rounds[-1]
    aim = last.promised_figures.frequency
    if abs(last.mean_figure("frequency") / target.frequency - 1.0) > CENTRED * FREQUENCY_TOLERANCE:
        aim *= (target.frequency / last.mean_figure("frequency")) ** (
            1.0 / _slope_of_measured_by_promised_frequency(rounds)
        )
    return aim, target.damping * math.exp(-_mean_logarithmic_map_error(rounds, "damping_ratio"))


def _slope_of_measured_by_promised_frequency(rounds: Sequence[DesignRound]) -> float:
    """Slope of the measured frequency by the promised one; 1 where it was hardly moved."""
    if len(rounds) < 2:
        return 1.0
    before, last = rounds[-2:]
    promised = math.log(last.promised_figures.frequency / before.promised_figures.frequency)
    measured = math.log(last.mean_figure("frequency") / before.mean_figure("frequency"))
    if abs(promised) < FREQUENCY_TOLERANCE or measured * promised <= 0.0:
        return 1.0
    return min(max(measured / promised, 1.0 / STEEPEST), STEEPEST)


def _run_checks(
    candidate: DamperCandidate,
    seeds: Sequence[int],
    out: str | Path | None,
    executor: Executor,
    progress: bool,
) -> tuple[DesignCheck, ...]:
    plans = [plan(candidate.scene(seed), accuracy=SCATTER, runs=len(seeds)) for seed in seeds]
    study = sweep(
        damper(),
        cases=[chosen.scene.to_plain() for chosen in plans],
        measure=measure_design_check,
        dt=plans[0].dt,
        out=out,
        executor=executor,
        progress=progress,
    )
    checks = []
    for seed, outcome in zip(seeds, study.outcomes, strict=True):
        figures = {} if outcome["error"] is not None else figures_of_design_check(outcome["figures"])
        if not math.isfinite(figures.get("frequency", math.nan)):
            cause = outcome["error"] or "the motion has no level of rest"
            raise GranularError(
                f"the simulation of {candidate.mass:.4g} kg on {candidate.grains} grains with a "
                f"drag of {candidate.drag:.4g} kg/s failed: {cause}"
            )
        checks.append(DesignCheck(seed, **figures))
    return tuple(checks)


def _miss_text(attempt: Design) -> str:
    low, high = attempt.range_over_seeds("damping_ratio")
    target = attempt.target
    if target.mass is not None:
        remedy = "give another mass, or leave it free"
    elif target.grains is not None:
        remedy = "give another number of grains, or leave it free"
    else:
        remedy = "ask for a heavier damping, or another frequency"
    return (
        f"{len(attempt.rounds)} proposals missed the wish; the last has "
        f"{attempt.frequency:.4g} Hz for {target.frequency:g} Hz and a damping ratio of "
        f"{low:.3g} to {high:.3g}, by the random start, for {target.damping:g}: {remedy}"
    )
