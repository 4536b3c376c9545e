"""Figures of a record that tell simulations apart, smooth in what is simulated.

Heights of two beds at the same instant differ by their phase after a few swings; the level of rest,
period and damping ratio of the same law, fitted to both, do not. Matching them is indirect
inference (Gourieroux, Monfort, Renault 1993, doi:10.1002/jae.3950080507).
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np

from granular.run.record import PistonRecord
from granular.shared.errors import RecordError
from reduced_models.fitting.fitting import fit
from reduced_models.laws.law import Law
from reduced_models.records.first_guesses import noise_level

LAW = "polynomial-spring"
STARTS = 8
_POOR = 0.5
_ONE_SIGMA = math.erf(math.sqrt(0.5))


class Features(NamedTuple):
    """Figures of a record, all above 0.

    Attributes
    ----------
    names : tuple of str
        ``height`` at rest [m], ``period`` of the small swing [s], ``damping_ratio``, and
        ``force``, the mean force of the grains on the piston [N].
    values : float64 (d,)
    errors : float64 (d,)
        Standard errors of their logarithms, from the residuals of the fit (and, of the force, from
        its white noise).
    notes : tuple of str
        What is to be doubted in the fit.
    """

    names: tuple[str, ...]
    values: np.ndarray
    errors: np.ndarray
    notes: tuple[str, ...]


def features(record: PistonRecord, law: str | Law = LAW, *, force: bool = False) -> Features:
    """The figures of a record.

    Parameters
    ----------
    record : PistonRecord
        The motion of a piston that swings about rest.
    law : str or Law
        That is fitted to it; one with inputs where the record is driven.
    force : bool
        Whether the mean force counts.

    Raises
    ------
    InputError
        As `fit`; a `RecordError` where a figure is not above 0, the law has no level of rest, or
        it leaves more than half of the swing unexplained.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = fit(record, law, holdout=0.0, starts=STARTS, confidence=_ONE_SIGMA)
    if model.quality.relative > _POOR:
        raise RecordError(
            f"the law {model.law.name!r} leaves {100.0 * model.quality.relative:.3g} % of the "
            f"record's rms swing unexplained, {100.0 * _POOR:g} % is the limit; give a record that "
            "swings about rest and settles, or another law"
        )
    if model.at_rest is None:
        raise RecordError(
            f"the law {model.law.name!r} finds no level of rest in the record; give a record that "
            "swings about rest, or another law"
        )
    names = list(model.at_rest.intervals)
    values = [getattr(model.at_rest, name) for name in names]
    errors = [0.5 * (high - low) for low, high in model.at_rest.intervals.values()]
    if force:
        if record.force is None:
            raise RecordError("the record has no column 'force'")
        names.append("force")
        level, error = _mean_force(record.time, record.force)
        values.append(level)
        errors.append(error)
    for name, value in zip(names, values, strict=True):
        if not value > 0.0:
            raise RecordError(
                f"the record's {name.replace('_', ' ')} is {value:.3g}; it must be above 0: give a "
                "record that comes to rest"
            )
    relative = np.array(errors) / np.array(values)
    return Features(tuple(names), np.array(values), relative, model.notes)


def _mean_force(time: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """Mean and its standard error, under a window that hides where the swing is cut off."""
    phase = (time - time[0]) / (time[-1] - time[0])
    weight = np.sin(math.pi * phase) ** 2 * np.gradient(time)
    weight /= weight.sum()
    return float(weight @ force), noise_level(force, time) * float(np.sqrt((weight**2).sum()))
