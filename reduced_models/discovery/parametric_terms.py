"""Terms with unknown parameters, such as d in ``max(0, z - d)`` or w in ``sin(w*t)``.

Linear least squares cannot find a parameter inside a function. The parameter is therefore varied until the
term, together with all terms of the library, has the smallest residual: first on a grid over the scales of
the motion, then by refinement. For the frequency of a drive, the grid covers the peaks in the spectra of the
motion and of the library's residual. A fit of the solved differential equation then gives the final value and
its interval. The information criterion counts each such parameter like a coefficient.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular import formulas
from granular.formulas import algebra
from granular.shared.errors import InputError, quote
from reduced_models.discovery.result import CandidateEquation
from reduced_models.discovery.subset_selection import normalised_columns_and_lengths
from reduced_models.discovery.term_libraries import term_fault_text
from reduced_models.discovery.terms import (
    INPUT,
    AnyTerm,
    CustomTerm,
    expression_with_symbols_and_their_numbers,
    motion_symbols,
    parse_term_expressions,
    sort_terms,
    terms_with_coefficients,
)
from reduced_models.discovery.weak_form import SmoothedMotion, WeakForm
from reduced_models.laws.law import refuse_suspicious_parameter_name
from reduced_models.records.first_guesses import spectral_peak_frequencies
from reduced_models.records.inputs import TIME

if TYPE_CHECKING:
    import sympy

_HEIGHTS, _SIZES = 41, 25  # grid points: heights, and sizes of either sign over four decades
_DRAWS = 3000  # random points for several parameters together
_ROUNDS = 3
_SPANNED = 1e-8  # a column with a smaller relative part outside the library counts as dependent
_DIGITS = 9
_ABOUT_PEAK = np.linspace(-1.0, 1.0, 17)  # frequencies to try near a peak, in the spectrum's resolution


class OpenTerms(NamedTuple):
    """Terms that contain unknown parameters (templates), and the names of these parameters."""

    templates: tuple[sympy.Expr, ...] = ()
    names: tuple[str, ...] = ()


@dataclasses.dataclass
class ParametricTerms:
    """Terms with parameter values, and the templates (terms with symbols) from which they come."""

    templates_by_term: dict[AnyTerm, tuple[sympy.Expr, Mapping[str, float]]] = dataclasses.field(
        default_factory=dict
    )

    def fit_open_terms(
        self, open_terms: OpenTerms, weak: WeakForm, library: Sequence[AnyTerm], near: Sequence[AnyTerm] = ()
    ) -> list[AnyTerm]:
        """Find the parameters with the smallest residual, starting from terms ``near``; return the terms."""
        # One parameter is tried on a grid over the scales of the motion, several at random points of
        # their grids, because the residual has many local minima; then each is refined by itself (Brent's
        # bounded minimisation). Whitening uses the noise of z'' alone: the coefficients are not known yet.
        if not open_terms.names:
            return []
        residual = _LibraryResidual(weak, library, open_terms)
        choices = [_trial_parameter_values(residual, name) for name in open_terms.names]
        if near:
            known = self.templates_by_term[near[0]][1]
            best = np.array([known[name] for name in open_terms.names])
        elif len(choices) == 1:
            best = _best_trial_without_poles(residual, choices[0][:, None])
        else:
            random = np.random.default_rng(0)
            trials = np.stack([random.choice(values, _DRAWS) for values in choices], axis=1)
            best = _best_trial_without_poles(residual, trials)
        for _, k in itertools.product(range(_ROUNDS if len(best) > 1 else 1), range(len(best))):
            best = _refine_parameter(residual, best, k, choices[k])
        values = dict(zip(open_terms.names, best.tolist(), strict=True))
        terms = [self._make_and_store_term(template, values) for template in open_terms.templates]
        return [term for term in terms if term is not None]

    def fit_drives(
        self,
        drives: Sequence[OpenTerms],
        weak: WeakForm,
        library: Sequence[AnyTerm],
        first: Sequence[Sequence[AnyTerm]] = (),
    ) -> list[Sequence[AnyTerm]]:
        """Fit the drives not yet in ``first``, then refine each frequency with the others fixed."""
        terms = list(first)
        for drive in drives[len(first) :]:
            terms.append(self.fit_open_terms(drive, weak, [*library, *itertools.chain(*terms)]))
        for _, k in itertools.product(range(_ROUNDS if first or len(drives) > 1 else 0), range(len(drives))):
            others = itertools.chain(*terms[:k], *terms[k + 1 :])
            terms[k] = self.fit_open_terms(drives[k], weak, [*library, *others], terms[k])
        return terms

    def _make_and_store_term(self, template: sympy.Expr, values: Mapping[str, float]) -> AnyTerm | None:
        """Insert parameter values into a template; store the template under the resulting term."""
        term = term_with_values(template, values)
        if term is not None:
            inner = {str(symbol) for symbol in template.free_symbols}
            self.templates_by_term[term] = (
                template,
                {name: value for name, value in values.items() if name in inner},
            )
        return term

    def expression_with_symbols_and_values(
        self, candidate: CandidateEquation
    ) -> tuple[sympy.Expr, dict[str, float]]:
        """Return the expression with symbols for coefficients (c0, ...) and parameters, and their values."""
        import sympy

        terms = candidate.terms or {}
        if not any(term in self.templates_by_term for term in terms):
            return expression_with_symbols_and_their_numbers(candidate.expression)
        parts, values = [], dict[str, float]()
        for k, term in enumerate(sort_terms(terms)):
            template, inner = self.templates_by_term.get(term, (term.expression, {}))
            parts.append(sympy.Symbol(f"c{k}") * template)
            values |= {f"c{k}": terms[term]} | dict(inner)
        return sympy.Add(*parts), values

    def expression_with_fitted_values(
        self, candidate: CandidateEquation, template: sympy.Expr, numbers: Mapping[str, float]
    ) -> sympy.Expr:
        """Put fitted values into the expression of `expression_with_symbols_and_values`."""
        import sympy

        inner = self.nonlinear_parameter_names(candidate)
        for term in candidate.terms or {} if inner else {}:
            if term in self.templates_by_term:
                self._make_and_store_term(
                    self.templates_by_term[term][0], {name: numbers[name] for name in inner}
                )
        return template.xreplace(
            {
                sympy.Symbol(name): _exact_rational(value) if name in inner else sympy.Float(value)
                for name, value in numbers.items()
            }
        )

    def nonlinear_parameter_names(self, candidate: CandidateEquation) -> set[str]:
        """Return the names of the nonlinear parameters in the terms of a candidate."""
        if not self.templates_by_term:
            return set()
        terms = [term for term in candidate.terms or () if term in self.templates_by_term]
        return {name for term in terms for name in self.templates_by_term[term][1]}

    def candidates_with_chosen_values(
        self, candidates: Sequence[CandidateEquation], chosen: CandidateEquation
    ) -> list[CandidateEquation]:
        """Replace the nonlinear parameters of candidates by the values in the chosen candidate."""
        chosen_term_by_template = {
            self.templates_by_term[term][0]: term
            for term in chosen.terms or {}
            if term in self.templates_by_term
        }
        replacements = {
            term.expression: chosen_term_by_template[template].expression
            for term, (template, _) in self.templates_by_term.items()
            if template in chosen_term_by_template
        }
        return [
            dataclasses.replace(item, expression=item.expression.xreplace(replacements))
            for item in candidates
        ]


def term_with_values(template: sympy.Expr, values: Mapping[str, float]) -> AnyTerm | None:
    """Insert parameter values into a template; return None if the result is not one real term."""
    import sympy

    exact = {sympy.Symbol(name): _exact_rational(value) for name, value in values.items()}
    expression = template.xreplace(exact)
    if expression.has(sympy.zoo, sympy.nan, sympy.I):
        return None
    terms = terms_with_coefficients(expression)
    only = next(iter(terms)) if terms and len(terms) == 1 else None
    return only if isinstance(only, CustomTerm) else None


def _exact_rational(value: float) -> sympy.Rational:
    """Return a parameter as an exact rational, so that equal terms compare and hash equal."""
    import sympy

    return sympy.Rational(f"{value:.{_DIGITS}g}")


def split_constant_and_open_terms(
    texts: Sequence[str], column: str | None, columns: Sequence[str]
) -> tuple[list[str], OpenTerms]:
    """Separate a user's terms into terms without and with unknown parameters."""
    known = {"z", "z'", TIME, *(() if column is None else (INPUT, column))}
    plain, opened, names = list[str](), list[str](), dict[str, None]()
    for text in texts:
        free = _unknown_parameter_names(text, known)
        if not free:
            plain.append(text)
            continue
        for name in free:
            if name in (INPUT, "v") or (name[0] == "c" and name[1:].isdigit()):
                raise InputError(
                    f"the term {quote(text)} contains the reserved name {name}; give the parameter another "
                    "name"
                )
            refuse_suspicious_parameter_name(f"the term {quote(text)}", name, columns)
        opened.append(text)
        names |= dict.fromkeys(free)
    expressions = parse_term_expressions(opened, column, tuple(names))
    return plain, OpenTerms(tuple(expressions), tuple(names))


def _unknown_parameter_names(text: str, known: set[str]) -> list[str]:
    """List unknown parameters in a term; the list is empty if the term is constant or cannot be read."""
    try:
        written = [name.text for name in formulas.variable_names(formulas.parse(text))]
    except (formulas.FormulaError, TypeError, AttributeError):
        return []  # `parse_term_expressions` reports it
    free = [name for name in dict.fromkeys(written) if name not in known and "'" not in name]
    return free if known & {*written} else []


class _LibraryResidual:
    """Residual of a library's fit to the weak form, and its decrease by further terms."""

    def __init__(self, weak: WeakForm, library: Sequence[AnyTerm], open_terms: OpenTerms) -> None:
        import sympy

        self.weak, self.library, self.open_terms = weak, library, open_terms
        self.whitening = weak.whitening_matrix((), np.zeros(0))
        target = self.whitening @ weak.target
        columns = np.zeros((len(target), 0))
        if library:
            columns, _ = normalised_columns_and_lengths(self.whitening @ weak.term_integral_matrix(library))
        vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        self.basis = vectors[:, sizes > 1e-10 * sizes.max(initial=0.0)]
        self.target = target - self.basis @ (self.basis.T @ target)
        symbols, speed = [sympy.Symbol(name) for name in open_terms.names], motion_symbols()[1]
        with_speed = any(template.has(speed) for template in open_terms.templates)
        self.compiled = None
        if not with_speed:  # then their integrals follow from their values, without algebra for each trial
            self.compiled = algebra.compile_expressions((*motion_symbols(), *symbols), open_terms.templates)

    def term_integral_matrix(self, values: np.ndarray) -> np.ndarray:
        """Integrals (r, k) of the terms at parameter values (k,); an array (r, 0) if any term is invalid."""
        if self.compiled is None:
            terms = self.terms_with_parameter_values(values)
            return self.weak.term_integral_matrix(terms) if terms else np.zeros((len(self.weak.target), 0))
        integrals = []
        for part in self.weak.parts:
            arguments = (0.0 if item is None else item for item in part.motion.recorded_state)
            columns = np.broadcast_arrays(*self.compiled(*arguments, *values), part.motion.z)[:-1]
            integrals.append(part.bump @ np.stack(columns, axis=1))
        return np.concatenate(integrals)

    def terms_with_parameter_values(self, values: np.ndarray) -> list[AnyTerm]:
        """Return the terms at parameter values (k,); an empty list if any term is invalid."""
        numbers = dict(zip(self.open_terms.names, values.tolist(), strict=True))
        terms = [term_with_values(template, numbers) for template in self.open_terms.templates]
        return [] if None in terms else [term for term in terms if term is not None]

    def residual_sum_of_squares(self, values: np.ndarray) -> float:
        """Return the residual sum of squares; infinite for invalid or linearly dependent terms."""
        with np.errstate(all="ignore"):
            columns = self.whitening @ self.term_integral_matrix(values)
        if not columns.size or not np.isfinite(columns).all():
            return math.inf
        sizes = np.linalg.norm(columns, axis=0)
        columns = columns - self.basis @ (self.basis.T @ columns)
        if not (np.linalg.norm(columns, axis=0) > _SPANNED * sizes).all():
            return math.inf
        columns, _ = normalised_columns_and_lengths(columns)
        residual = self.target - columns @ np.linalg.lstsq(columns, self.target, rcond=1e-10)[0]
        return float(residual @ residual)

    def has_terms_without_faults(self, values: np.ndarray) -> bool:
        """Return whether the terms at values (k,) are free of poles and other faults along the motions."""
        terms = self.terms_with_parameter_values(values)
        return bool(terms) and not any(
            term_fault_text(motion, term) for motion in self.weak.motions for term in terms
        )


def _best_trial_without_poles(residual: _LibraryResidual, trials: np.ndarray) -> np.ndarray:
    """Return the values (k,) with the smallest residual among those trials (s, k) that have no pole."""
    squares = np.array([residual.residual_sum_of_squares(row) for row in trials])
    for index in np.argsort(squares, kind="stable")[: np.isfinite(squares).sum()]:
        if residual.has_terms_without_faults(trials[index]):
            return np.asarray(trials[index])
    raise InputError(
        f"no values of {', '.join(residual.open_terms.names)} make "
        f"{quote(', '.join(map(str, residual.open_terms.templates)))} finite along the record and "
        "linearly independent of the library; use other terms"
    )


def _trial_parameter_values(residual: _LibraryResidual, name: str) -> np.ndarray:
    """Return trial values: heights within the motion, multiples of its amplitude and speed, and inverses."""
    motions = residual.weak.motions
    if name in _drive_frequency_names(residual.open_terms):
        return _trial_angular_frequencies(max(motions, key=lambda motion: motion.time[-1]), residual.library)
    z = np.concatenate([motion.z for motion in motions])
    speed = np.concatenate([motion.velocity for motion in motions]).std()
    decades = np.geomspace(1e-2, 1e2, _SIZES)
    heights = np.linspace(z.min(), z.max(), _HEIGHTS + 2)[1:-1]
    sizes = np.concatenate([unit * decades for unit in (z.std(), 1.0 / z.std(), speed, 1.0 / speed)])
    return np.unique(np.concatenate([heights, sizes, -sizes]))


def _drive_frequency_names(open_terms: OpenTerms) -> set[str]:
    """Return the names of angular frequencies: factors of the time in sines and cosines."""
    import sympy

    time = motion_symbols()[3]
    waves = [wave for item in open_terms.templates for wave in item.atoms(sympy.sin, sympy.cos)]
    return {str(wave.args[0].diff(time)) for wave in waves}


def _trial_angular_frequencies(motion: SmoothedMotion, library: Sequence[AnyTerm]) -> np.ndarray:
    """Return angular frequencies [rad/s] near spectral peaks of the motion and of the residual of z''."""
    residual = motion.acceleration
    if library:
        columns, _ = normalised_columns_and_lengths(
            np.stack([term.values(motion.smooth_state) for term in library], axis=1)
        )
        residual = residual - columns @ np.linalg.lstsq(columns, residual, rcond=1e-10)[0]
    peaks = np.concatenate(
        [spectral_peak_frequencies(motion.time, values) for values in (residual, motion.z)]
    )
    frequencies = peaks[:, None] + 2.0 * math.pi / motion.time[-1] * _ABOUT_PEAK
    return np.unique(frequencies[frequencies > 0.0])


def _refine_parameter(residual: _LibraryResidual, best: np.ndarray, k: int, grid: np.ndarray) -> np.ndarray:
    """Move parameter k to the minimum of the residual between neighbouring grid points; return all values."""
    from scipy.optimize import minimize_scalar

    index = int(np.searchsorted(grid, best[k]))
    low, high = grid[max(index - 1, 0)], grid[min(index + 1, len(grid) - 1)]

    def values_with_parameter_at(value: float) -> np.ndarray:
        return np.concatenate([best[:k], [value], best[k + 1 :]])

    def residual_sum_of_squares_at(value: float) -> float:
        value_or_infinity = residual.residual_sum_of_squares(values_with_parameter_at(value))
        return value_or_infinity if math.isfinite(value_or_infinity) else 1e300

    solution = minimize_scalar(
        residual_sum_of_squares_at,
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-6 * (high - low)},
    )
    better = solution.fun < residual_sum_of_squares_at(best[k]) and residual.has_terms_without_faults(
        values_with_parameter_at(solution.x)
    )
    return values_with_parameter_at(float(solution.x)) if better else best
