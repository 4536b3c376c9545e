"""Equations for z(t) itself: elliptic motions among what a search proposes."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from scipy.special import ellipj

from reduced_models import HeightMap
from reduced_models.discovery import formula_of_time, pysr_search
from reduced_models.discovery.formula_of_time import elliptic_function_variants
from reduced_models.discovery.result import Discovery
from reduced_models.discovery.structure_proposals import SymbolicSearch

TIME = np.linspace(0.0, 20.0, 400)
T = sympy.Symbol("t", real=True)
SN, CN, DN = (sympy.Function(f"jacobi_{name}") for name in ("sn", "cn", "dn"))
COSINE = 1.1 * sympy.cos(0.9 * T)


def motion(function: int, phase: float = 0.0, decay: float = 0.0) -> np.ndarray:
    """1.2 sn, cn or dn of 1.1 t + phase for m = 0.6."""
    values = ellipj(1.1 * TIME + phase, 0.6)[function]
    return np.asarray(1.2 * np.exp(-decay * TIME) * values)


def found_in(
    z: np.ndarray, proposed: list[sympy.Expr], monkeypatch: pytest.MonkeyPatch, seed: int = 0
) -> Discovery:
    """What is chosen where a search proposes these, at 1 % noise."""
    monkeypatch.setattr(pysr_search, "search_expressions_with_pysr", lambda *_, **__: proposed)
    noise = np.random.default_rng(seed).normal(0.0, 0.01 * z.std(), len(z))
    return formula_of_time.discover_height_formulas(
        TIME, z + noise, SymbolicSearch("pysr", seed=seed), HeightMap()
    )


def numbers(found: Discovery) -> list[float]:
    return sorted(abs(float(one)) for one in found.best.expression.atoms(sympy.Float))


@pytest.mark.parametrize("place", range(3))
def test_an_elliptic_motion_is_chosen(place: int, monkeypatch: pytest.MonkeyPatch) -> None:
    exact = sympy.Float(1.2) * (SN, CN, DN)[place](1.1 * T + 0.4, sympy.Float(0.6))
    found = found_in(motion(place, 0.4), [COSINE, exact], monkeypatch)
    assert found.best.expression.has((SN, CN, DN)[place])
    assert found.best.error == pytest.approx(1.0, abs=0.2)
    assert numbers(found) == pytest.approx([0.4, 0.6, 1.1, 1.2], rel=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_a_motion_without_its_rate_is_polished_to_the_truth(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search finds the fewest nodes: five of them, with a rate of 1."""
    simple = sympy.Float(1.167) * CN(T, sympy.Float(0.392))
    found = found_in(motion(1), [COSINE, simple], monkeypatch, seed)
    assert numbers(found) == pytest.approx([0.6, 1.1, 1.2], rel=0.02)
    assert found.best.error < 1.1


def test_a_decay_stays_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    simple = sympy.Float(1.167) * sympy.exp(-0.03 * T) * CN(T, sympy.Float(0.392))
    found = found_in(motion(1, decay=0.03), [COSINE, simple], monkeypatch)
    assert numbers(found) == pytest.approx([0.03, 0.6, 1.1, 1.2], rel=0.03)


def test_a_cosine_stays_a_cosine(monkeypatch: pytest.MonkeyPatch) -> None:
    """An elliptic function that fits as well has more to say than the record."""
    z = np.asarray(1.2 * np.cos(1.1 * TIME))
    cosine = 1.1 * sympy.cos(1.08 * T)
    found = found_in(z, [cosine, sympy.Float(1.2) * CN(1.1 * T, sympy.Float(0.1))], monkeypatch)
    assert not found.best.expression.has(CN)


def test_only_calls_of_the_time_are_freed() -> None:
    assert elliptic_function_variants(COSINE) == [COSINE]
    nested = CN(sympy.sin(T), sympy.Float(0.4))
    assert elliptic_function_variants(nested) == [nested]
    twice = CN(T, sympy.Float(0.4)) * SN(T, sympy.Float(0.4))
    assert len(elliptic_function_variants(twice)) == 3
    assert len(elliptic_function_variants(twice)[2].atoms(sympy.Float)) == 6
