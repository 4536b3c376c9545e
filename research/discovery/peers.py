"""Two peers, set up as their own guides do, and with help: PySINDy and pyoperon.

PySINDy's practical tips (https://pysindy.readthedocs.io/en/latest/tips.html) smooth a noisy record
before it is differenced, begin with the default optimizer and scan its threshold; its feature
overview judges by parts of the record that were not fitted. pyoperon's examples
(https://github.com/heal-research/pyoperon, example/) give the search's settings and say how its
uncertainty is estimated; of derivatives they say nothing, so it is handed z' and z'' from PySINDy's
smoothed differences. A second row of each has a window of smoothing that was tried out on these
very records; there pyoperon is told the noise of z'' as well, and divides.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from granular.formulas import algebra, parse
from granular.records.record import PistonRecord
from reduced_models.discovery.term_libraries import library_terms
from reduced_models.discovery.terms import AnyTerm, MotionState, linear_combination, state_symbols
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
"""Window of the smoothing that was tried out, the best of 0.1, 0.2 and 0.3 periods."""
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
"""The same with help."""
_WORDS = ("smoothing", "uncertainty", "model")
FUNCTIONS = {"trigonometric": "sin,cos", "contact": "fmax", "rational": "pow", "dry friction": "abs"}
"""What pyoperon is given more where the library is named."""
_HELD_OUT = 0.25


def pysindy_law(record: PistonRecord, system: System, named: bool, tuned: bool) -> sympy.Expr:
    """The law that PySINDy finds, with the terms of the named library or with polynomials.

    ``tuned`` has the window that was tried out.

    Raises
    ------
    InputError
        If it finds none.
    """
    import pysindy

    samples = tuned_window(record) if tuned else _WINDOW
    z, v, _ = smoothed(record, samples)
    states = np.stack([z, v], axis=1)
    drive = record.extra[INPUT][:, None] if system.driven else None
    terms = library_terms(system.library, (), 3, INPUT if system.driven else None)
    split = round((1.0 - _HELD_OUT) * len(z))

    def fitted(threshold: float, rows: slice) -> Any:
        library = _library(terms, system.driven) if named else pysindy.PolynomialLibrary(degree=3)
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=0.05),
            feature_library=library,
            differentiation_method=_difference(samples),
        )
        inputs = None if drive is None else drive[rows]
        return model.fit(states[rows], t=record.time[rows], u=inputs)

    def score(threshold: float) -> float:
        model = fitted(threshold, slice(0, split))
        inputs = None if drive is None else drive[split:]
        return float(model.score(states[split:], t=record.time[split:], u=inputs))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a high threshold leaves nothing
        best = max(_THRESHOLDS, key=score)
        model = fitted(best, slice(None))
    row = np.asarray(model.coefficients())[1]
    if named:
        kept = [(term, float(value)) for term, value in zip(terms, row, strict=True) if value]
        return linear_combination([term for term, _ in kept], [value for _, value in kept])
    return _polynomial(model, row)


def _difference(samples: int) -> Any:
    import pysindy

    settings = {"window_length": samples, "polyorder": 3}
    return pysindy.SmoothedFiniteDifference(smoother_kws=settings)


def tuned_window(record: PistonRecord) -> int:
    """Samples of the window that was tried out, an odd number."""
    period = first_guesses(record.time, record.height).period
    samples = TUNED_PERIODS * period / float(np.diff(record.time).mean())
    return max(5, 2 * math.floor(samples / 2.0) + 1)


def smoothed(record: PistonRecord, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Z, z' and z'' (n,) each, by PySINDy's smoothed differences, one after the other."""
    first = _difference(samples)
    v = first._differentiate(record.height[:, None], record.time)
    z = first.smoothed_x_[:, 0]
    a = _difference(samples)._differentiate(v, record.time)
    return np.asarray(z), np.asarray(v)[:, 0], np.asarray(a)[:, 0]


def _library(terms: tuple[AnyTerm, ...], driven: bool) -> Any:
    import pysindy

    def column(term: AnyTerm) -> Any:
        if driven:
            return lambda z, v, u: term.values(MotionState(np.asarray(z), np.asarray(v), np.asarray(u)))
        return lambda z, v: term.values(MotionState(np.asarray(z), np.asarray(v)))

    return pysindy.CustomLibrary([column(term) for term in terms], interaction_only=True)


def _polynomial(model: Any, row: np.ndarray) -> sympy.Expr:
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


def pyoperon_law(record: PistonRecord, system: System, named: bool, seed: int, tuned: bool) -> sympy.Expr:
    """The law that pyoperon finds for the smoothed z'', with the functions of a named library.

    ``tuned`` has the window that was tried out, and is told the noise.

    Raises
    ------
    InputError
        If it finds none that is finite.
    """
    import sympy
    from pyoperon.sklearn import SymbolicRegressor

    z, v, a = smoothed(record, tuned_window(record) if tuned else _WINDOW)
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
    error = _roughness(a) if tuned else _forest_error(samples, a, seed)
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


def _roughness(values: np.ndarray) -> float:
    """The noise of samples, from their fourth differences."""
    return float((np.diff(values, 4) / math.sqrt(70.0)).std())


def _forest_error(samples: np.ndarray, target: np.ndarray, seed: int) -> float:
    """How pyoperon's example estimates the uncertainty."""
    from sklearn.ensemble import RandomForestRegressor

    forest = RandomForestRegressor(n_estimators=100, random_state=seed).fit(samples, target)
    return float(np.sqrt(((forest.predict(samples) - target) ** 2).mean()))
