"""Newton's steps of a damper's numbers along the slopes of its settled bed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from granular.linear import piston_roots, slopes
from granular.linear.equilibrium import equilibrium_from
from granular.shared.errors import InputError
from reduced_models.designs.damper import HIGHEST, LOWEST, DamperCandidate
from reduced_models.designs.maps import PredictedFigures
from reduced_models.designs.proposal import DesignTarget
from reduced_models.designs.result import DesignRound

STEPPED = ("piston.mass", "effects.drag.coefficient")
"""Numbers of a scene that go with the slopes of a bed."""
USUAL = np.array([[-0.35, 0.11, -1.09], [0.0, 0.0, 1.0]])
"""Slopes of rest, frequency and damping ratio by these numbers, of the packaged damper: for beds without an
equilibrium nearby."""
LONGEST = 0.1
"""Longest step of the logarithm of mass or number of grains: a settled bed of 92 grains has no equilibrium
nearby at an eighth more remanence."""
STRAIGHT = 0.02
"""Step up to which slopes hold: that of frequency by mass changes by 0.15 over a fifth more mass, so this is
1.5e-4 of the frequency."""
MOST_STEPS = 3
BY_GRAINS = np.array([0.5, -0.25, 0.75])
"""Powers of rest, frequency and damping ratio in the number of grains, for similar beds with the same drag of
a grain below pistons of the same mass per width."""


def step_damper(target: DesignTarget, made: DesignRound) -> tuple[DamperCandidate, PredictedFigures]:
    """Step a checked damper to the target by the slopes of its first bed; also give its promised figures."""
    if target.mass is None and (target.grains is not None or made.damper.grains == HIGHEST[1]):
        candidate, figures = _step_mass(target, made)
        if (
            target.grains is not None
            or LOWEST[0] <= candidate.mass / candidate.cell_width_ratio <= HIGHEST[0]
        ):
            return candidate, _promise(made, figures)
    candidate, figures = _step_grains(target, made)
    return candidate, _promise(made, figures)


def mean_damper(dampers: Sequence[DamperCandidate]) -> DamperCandidate:
    """Return the geometric mean of mass per width, number of grains and drag."""
    logarithms = [
        np.log([damper.mass / damper.cell_width_ratio, damper.grains, damper.drag / damper.grains**-0.75])
        for damper in dampers
    ]
    load, grains, drag = np.exp(np.mean(logarithms, axis=0)).tolist()
    mean = dampers[-1]._replace(grains=round(grains))
    mass = mean.mass if len({damper.mass for damper in dampers}) == 1 else load * mean.cell_width_ratio
    return mean._replace(mass=mass, drag=drag * mean.grains**-0.75)


def _step_mass(target: DesignTarget, made: DesignRound) -> tuple[DamperCandidate, np.ndarray]:
    """Newton's method in mass and drag: each step leads to the equilibrium of the same bed nearby."""
    check, candidate = made.checks[0], made.damper
    figures, by_numbers = _mean_logarithms(made), _slopes_by_numbers(made)
    offset = figures - np.log([check.rest_height, check.frequency, check.damping_ratio])
    positions, height = np.array(check.positions), check.rest_height
    for _ in range(MOST_STEPS):
        change = _solve(_logarithmic_miss(target, figures), by_numbers)
        candidate = candidate._replace(
            mass=candidate.mass * math.exp(change[0]), drag=candidate.drag * math.exp(change[1])
        )
        figures = figures + change @ by_numbers
        if abs(change[0]) <= STRAIGHT:
            break
        try:
            rest = equilibrium_from(candidate.scene(check.seed), positions, height)
            root = piston_roots(rest)[0]
        except InputError:  # the bed rearranges on the way
            break
        assert rest.piston_height is not None
        positions, height = rest.positions, rest.piston_height
        figures = offset + np.log([height, root.frequency, root.damping_ratio])
        by_numbers = slopes(rest, STEPPED, root).values
    return candidate, figures


def _step_grains(target: DesignTarget, made: DesignRound) -> tuple[DamperCandidate, np.ndarray]:
    """Step number of grains and drag, below the same mass if it is given, else the same mass per width."""
    before, by_numbers = made.damper, _slopes_by_numbers(made)
    by_numbers[0] = BY_GRAINS if target.mass is None else BY_GRAINS - 0.5 * by_numbers[0]
    miss = _logarithmic_miss(target, _mean_logarithms(made))
    wanted = before.grains * math.exp(_solve(miss, by_numbers)[0])
    count = round(min(max(wanted, LOWEST[1]), HIGHEST[1]))
    change = _with_drag(miss, by_numbers, math.log(count / before.grains))
    candidate = before._replace(grains=count, drag=before.drag * math.exp(change[1]))
    if target.mass is None:
        candidate = candidate._replace(
            mass=before.mass * candidate.cell_width_ratio / before.cell_width_ratio
        )
    return candidate, _mean_logarithms(made) + change @ by_numbers


def _slopes_by_numbers(made: DesignRound) -> np.ndarray:
    known = made.checks[0].slopes
    return np.array([known[key] for key in STEPPED]) if known else USUAL.copy()


def _mean_logarithms(made: DesignRound) -> np.ndarray:
    return np.log([made.mean_figure(name) for name in ("rest_height", "frequency", "damping_ratio")])


def _logarithmic_miss(target: DesignTarget, figures: np.ndarray) -> np.ndarray:
    return np.asarray(np.log([target.frequency, target.damping]) - figures[1:])


def _solve(miss: np.ndarray, by_numbers: np.ndarray) -> np.ndarray:
    """Find the changes of two logarithms that make up for a miss, the first of at most `LONGEST`."""
    first = np.linalg.solve(by_numbers[:, 1:].T, miss)[0]
    return _with_drag(miss, by_numbers, min(max(first, -LONGEST), LONGEST))


def _with_drag(miss: np.ndarray, by_numbers: np.ndarray, first: float) -> np.ndarray:
    """Join a change of the first logarithm to that of drag which meets the damping ratio."""
    return np.array([first, (miss[1] - by_numbers[0, 2] * first) / by_numbers[1, 2]])


def _promise(made: DesignRound, figures: np.ndarray) -> PredictedFigures:
    """Figures of a stepped damper; its spring bends over its height as that of the bed before."""
    check = made.checks[0]
    height, frequency, ratio = np.exp(figures).tolist()
    k1, shrunk = (2.0 * math.pi * frequency) ** 2, check.rest_height / height
    return PredictedFigures(
        rest_height=height,
        frequency=frequency,
        damping_ratio=ratio,
        lam=ratio * math.sqrt(k1),
        k1=k1,
        k2=check.k2 * k1 / check.k1 * shrunk,
        k3=check.k3 * k1 / check.k1 * shrunk**2,
    )
