"""Two other tools, PySINDy and pyoperon, with the settings of their guides and with tuned settings.

PySINDy's practical tips (https://pysindy.readthedocs.io/en/latest/tips.html) recommend to smooth a noisy
record before differencing, to begin with the default optimizer and to scan its threshold. Its feature
overview scores laws on held-out parts of the record. pyoperon's examples
(https://github.com/heal-research/pyoperon, example/) give settings of the search and an estimate of the
uncertainty, but no method for derivatives. pyoperon therefore gets z' and z'' from PySINDy's smoothed
differences. With the tuned settings of both tools the smoothing window is tuned on these records; pyoperon
then also gets the noise of z'', and may divide.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.formulas import algebra, parse
from granular.records.record import PistonRecord
from reduced_models.discovery.term_libraries import library_terms
from reduced_models.discovery.terms import AnyTerm, TermArguments, linear_combination, state_symbols
from reduced_models.records.first_guesses import first_guesses
from research.discovery.systems import INPUT, System

if TYPE_CHECKING:
    import sympy

_WINDOW = 11
_THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.2)
_OBJECTIVES = ("r2", "length")
PYSINDY = {
    "differentiation": "SmoothedFiniteDifference with defaults, Savitzky-Golay of order 3",
    "window in samples": _WINDOW,
    "optimizer": "STLSQ, alpha 0.05",
    "thresholds": _THRESHOLDS,
    "threshold chosen by": "score of z'' on the last quarter, after a fit to the rest",
    "default library": "PolynomialLibrary, degree 3",
}
"""Settings of PySINDy."""
TUNED_PERIODS = 0.2
"""Tuned window of the smoothing, the best of 0.1, 0.2 and 0.3 periods."""
PYOPERON = {
    "allowed_symbols": "add,sub,mul,aq,sin,constant,variable",
    "offspring_generator": "basic",
    "reinserter": "keep-best",
    "initialization_method": "btc",
    "objectives": _OBJECTIVES,
    "optimizer_iterations": 10,
    "max_length": 50,
    "max_evaluations": 100_000,
    "epsilon": 1e-3,
    "smoothing": "as for PySINDy",
    "uncertainty": "error of a random forest on its training data",
    "model": "of minimum description length, chosen by pyoperon",
}
"""Settings of pyoperon."""
PYOPERON_TUNED = PYOPERON | {
    "allowed_symbols": "add,sub,mul,div,constant,variable",
    "smoothing": f"as for the tuned PySINDy, {TUNED_PERIODS:g} periods",
    "uncertainty": "the noise of z''",
}
"""Tuned settings of pyoperon."""
_WORDS = ("smoothing", "uncertainty", "model")
FUNCTIONS = {"trigonometric": "sin,cos", "contact": "fmax", "rational": "pow", "dry friction": "abs"}
"""Further functions of pyoperon with the named library."""
_HELD_OUT = 0.25


def find_law_with_pysindy(record: PistonRecord, system: System, named: bool, tuned: bool) -> sympy.Expr:
    """Return the law found by PySINDy, with the terms of the named library or with polynomials.

    ``tuned`` selects the tuned window.

    Raises
    ------
    InputError
        If it finds no law.
    """
    import pysindy

    samples = choose_smoothing_window(record) if tuned else _WINDOW
    z, v, _ = smooth_and_differentiate(record, samples)
    states = np.stack([z, v], axis=1)
    drive = record.extra[INPUT][:, None] if system.driven else None
    terms = library_terms(system.library, (), 3, INPUT if system.driven else None)
    split = round((1.0 - _HELD_OUT) * len(z))

    def fit_sindy(threshold: float, rows: slice) -> Any:
        library = (
            _custom_pysindy_library(terms, system.driven) if named else pysindy.PolynomialLibrary(degree=3)
        )
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=0.05),
            feature_library=library,
            differentiation_method=_smoothed_difference_method(samples),
        )
        inputs = None if drive is None else drive[rows]
        return model.fit(states[rows], t=record.time[rows], u=inputs)

    def held_out_score(threshold: float) -> float:
        model = fit_sindy(threshold, slice(0, split))
        inputs = None if drive is None else drive[split:]
        return float(model.score(states[split:], t=record.time[split:], u=inputs))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the warning that a high threshold removes all terms
        best = max(_THRESHOLDS, key=held_out_score)
        model = fit_sindy(best, slice(None))
    row = np.asarray(model.coefficients())[1]
    if named:
        kept = [(term, float(value)) for term, value in zip(terms, row, strict=True) if value]
        return linear_combination([term for term, _ in kept], [value for _, value in kept])
    return _polynomial_of_sindy_row(model, row)


def _smoothed_difference_method(samples: int) -> Any:
    import pysindy

    settings = {"window_length": samples, "polyorder": 3}
    return pysindy.SmoothedFiniteDifference(smoother_kws=settings)


def choose_smoothing_window(record: PistonRecord) -> int:
    """Return the number of samples of the tuned window, an odd number."""
    period = first_guesses(record.time, record.height).period
    samples = TUNED_PERIODS * period / float(np.diff(record.time).mean())
    return max(5, 2 * math.floor(samples / 2.0) + 1)


def smooth_and_differentiate(record: PistonRecord, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return z, z' and z'' (n,) each, by successive smoothed differences of PySINDy."""
    first = _smoothed_difference_method(samples)
    v = first._differentiate(record.height[:, None], record.time)
    z = first.smoothed_x_[:, 0]
    a = _smoothed_difference_method(samples)._differentiate(v, record.time)
    return np.asarray(z), np.asarray(v)[:, 0], np.asarray(a)[:, 0]


def _custom_pysindy_library(terms: tuple[AnyTerm, ...], driven: bool) -> Any:
    import pysindy

    def make_column_function(term: AnyTerm) -> Any:
        if driven:
            return lambda z, v, u: term.values(TermArguments(np.asarray(z), np.asarray(v), np.asarray(u)))
        return lambda z, v: term.values(TermArguments(np.asarray(z), np.asarray(v)))

    return pysindy.CustomLibrary([make_column_function(term) for term in terms], interaction_only=True)


def _polynomial_of_sindy_row(model: Any, row: np.ndarray) -> sympy.Expr:
    import sympy

    powers = model.feature_library.powers_
    return sympy.Add(
        *(
            sympy.Float(value)
            * sympy.prod(item ** int(n) for item, n in zip(state_symbols(), entry, strict=False))
            for value, entry in zip(row, powers, strict=True)
            if value
        )
    )


def find_law_with_pyoperon(
    record: PistonRecord, system: System, named: bool, seed: int, tuned: bool
) -> sympy.Expr:
    """Return the law found by pyoperon for the smoothed z'', with the functions of a named library.

    ``tuned`` selects the tuned window, and passes the noise to pyoperon.

    Raises
    ------
    InputError
        If it finds no finite law.
    """
    import sympy
    from pyoperon.sklearn import SymbolicRegressor

    z, v, a = smooth_and_differentiate(record, choose_smoothing_window(record) if tuned else _WINDOW)
    inputs = {"z": z, "v": v, "speed": np.abs(v), "direction": np.sign(v)}
    if system.driven:
        inputs["u"] = record.extra[INPUT]
    own = PYOPERON_TUNED if tuned else PYOPERON
    settings = {name: value for name, value in own.items() if name not in _WORDS}
    if named and system.library in FUNCTIONS:
        symbols_more = f"{settings['allowed_symbols']},{FUNCTIONS[system.library]}"
        settings["allowed_symbols"] = ",".join(dict.fromkeys(symbols_more.split(",")))
    settings["objectives"] = list(_OBJECTIVES)
    samples = np.stack(list(inputs.values()), axis=1)
    error = _noise_from_fourth_differences(a) if tuned else _uncertainty_from_random_forest(samples, a, seed)
    search = SymbolicRegressor(**settings, n_threads=1, random_state=seed + 1, uncertainty=[error]).fit(
        samples, a
    )
    text = search.get_model_string(search.model_, 12, list(inputs))
    _, slope, _ = state_symbols()
    named_symbols = {item.name: item for item in state_symbols()} | {
        "speed": sympy.Abs(slope),
        "direction": sympy.sign(slope),
    }
    return algebra.sympy_expression(parse(text, multiplied=False), named_symbols)


def _noise_from_fourth_differences(values: np.ndarray) -> float:
    """Return the noise of samples, from their fourth differences."""
    return float((np.diff(values, 4) / math.sqrt(70.0)).std())


def _uncertainty_from_random_forest(samples: np.ndarray, target: np.ndarray, seed: int) -> float:
    """Estimate the uncertainty as in pyoperon's example."""
    from sklearn.ensemble import RandomForestRegressor

    forest = RandomForestRegressor(n_estimators=100, random_state=seed).fit(samples, target)
    return float(np.sqrt(((forest.predict(samples) - target) ** 2).mean()))
