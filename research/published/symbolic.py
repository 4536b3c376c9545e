"""Symbolic regression of a motion z(t), as de Paula tries it with PySR [D, 5.2.1]."""

from __future__ import annotations

import numpy as np

SAMPLES = 600
GENERATIONS = 200
SYMBOLS = "add,sub,mul,div,sin,cos,exp,constant,variable"
"""Functions of de Paula's demonstration, whose printed result uses cos, exp, - and /."""


def fit_oscillation_by_symbolic_regression(total_duration: float) -> dict[str, float]:
    """Fit z(t) = cos(t - 0.0996) exp(0.0503 (0.0996 - t)) by symbolic regression.

    Parameters
    ----------
    span : float
        Length of the record, in de Paula's unit of time.

    Returns
    -------
    dict
        ``misfit``: residual of the expression over the rms of the motion; ``length``: its number of symbols.
    """
    from pyoperon.sklearn import SymbolicRegressor

    t = np.linspace(0.0, total_duration, SAMPLES)
    z = np.cos(t - 0.0996) * np.exp(0.0503 * (0.0996 - t))
    search = SymbolicRegressor(
        allowed_symbols=SYMBOLS,
        generations=GENERATIONS,
        population_size=1000,
        max_length=30,
        optimizer_iterations=10,
        random_state=1,
        n_threads=1,
        max_evaluations=500_000,
    )
    search.fit(t[:, None], z)
    left = z - search.predict(t[:, None])
    return {
        "misfit": float(np.sqrt(np.mean(left**2) / np.mean(z**2))),
        "length": float(len(search.model_.Nodes)),
    }
