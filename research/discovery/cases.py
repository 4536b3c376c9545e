"""The cases of the benchmark, and their measurement."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.shared.errors import GranularError
from reduced_models.laws.law import HeightLine
from research.discovery.judging import score_law
from research.discovery.peers import find_law_with_pyoperon, find_law_with_pysindy
from research.discovery.systems import INPUT, SYSTEMS, System, make_noisy_record, system_named

if TYPE_CHECKING:
    import sympy

    from granular.records.record import PistonRecord

NOISES = (0.001, 0.01, 0.03, 0.1)
"""Standard deviations of the noise, divided by the standard deviation of the motion."""
SEEDS = 5
OURS = "discover"
SINDY, OPERON = PEERS = ("PySINDy", "pyoperon")
"""Peers set up as their guides recommend."""
SINDY_TUNED, OPERON_TUNED = TUNED = ("PySINDy, tuned", "pyoperon, tuned")
"""Peers with a smoothing window tuned on these records."""
METHODS = (OURS, *PEERS, *TUNED)
LIBRARIES = ("named", "default")


class DiscoveryCase(NamedTuple):
    """One search for a law.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    system : str
    library : str
        ``"named"``: the library that contains the law's terms; ``"default"``: the default library.
    noise : float
    seed : int
        Seed of the noise, and of the search.
    """

    method: str
    system: str
    library: str
    noise: float
    seed: int

    @property
    def key(self) -> str:
        """Name of the case's file."""
        words = (self.method, self.system, self.library, f"{self.noise:g}", f"{self.seed}")
        return "-".join(word.replace(" ", "_").replace(",", "") for word in words)


def all_cases(
    systems: Sequence[str] = (), noises: Sequence[float] = NOISES, seeds: int = SEEDS
) -> list[DiscoveryCase]:
    """Return all cases: first those with 1 % of noise, then the others by seed and increasing noise."""
    names = [item.name for item in SYSTEMS if not systems or item.name in systems]
    first = [(noise, seed) for noise in noises if noise == 0.01 for seed in range(seeds)]
    others = [(noise, seed) for seed in range(seeds) for noise in sorted(noises) if noise != 0.01]
    return [
        DiscoveryCase(method, name, library, noise, seed)
        for noise, seed in (*first, *others)
        for library in LIBRARIES
        for name in names
        for method in METHODS
    ]


def run_case(case: DiscoveryCase) -> dict[str, Any]:
    """Return the outcome of a case: score, equation and processor time, or the reason for no law.

    An unexpected error of a search is reported, and counted as a crash.
    """
    system = system_named(case.system)
    record = make_noisy_record(system, case.noise, case.seed)
    begun = time.process_time()
    result: dict[str, Any] = {**case._asdict(), "exact": False, "usable": False, "error": None}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # doubtful results are counted here
            law, line = _law_and_line_by_method(case, system, record)
    except GranularError as error:
        seconds = time.process_time() - begun
        return result | {"seconds": seconds, "equation": "", "failure": str(error)}
    except Exception as error:
        seconds = time.process_time() - begun
        return result | {"seconds": seconds, "equation": "", "crash": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - begun
    judged = score_law(law, system, line)
    return result | {
        "exact": judged.exact,
        "usable": judged.is_usable,
        "error": judged.error,
        "seconds": seconds,
        "equation": equation_text(law, line),
    }


def _law_and_line_by_method(
    case: DiscoveryCase, system: System, record: PistonRecord
) -> tuple[sympy.Expr, HeightLine]:
    named = case.library == "named"
    tuned = case.method in TUNED
    if case.method in (SINDY, SINDY_TUNED):
        return find_law_with_pysindy(record, system, named, tuned), HeightLine()
    if case.method in (OPERON, OPERON_TUNED):
        return find_law_with_pyoperon(record, system, named, case.seed, tuned), HeightLine()
    from reduced_models.discovery.discover import discover

    column = INPUT if system.driven else None
    if named:
        result = discover(record, library=system.library, input=column, seed=case.seed)
    else:
        result = discover(record, input=column, seed=case.seed)
    return result.expression, result.line


def equation_text(law: sympy.Expr, line: HeightLine) -> str:
    import sympy

    from reduced_models.discovery.terms import expression_text

    numbers = {item: sympy.Float(item, 4) for item in law.atoms(sympy.Float)}
    text = f"z'' = {expression_text(law.xreplace(numbers))}"
    return text if line == HeightLine() else f"{text}; {line.text}"
