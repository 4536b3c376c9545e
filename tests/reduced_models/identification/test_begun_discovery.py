"""Laws that identify tries by itself: dry friction with drag, and a discovery where the known ones fail."""

from __future__ import annotations

import math
import types
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import fit, identify
from reduced_models.discovery import discover as discovery
from reduced_models.identification import laws_of_record as identification
from reduced_models.identification.candidate_laws import CandidateLaws, LawScreening, choose_candidate_laws
from reduced_models.laws import LAWS
from reduced_models.laws.law import Law

TRUE = "z'' + c*abs(z')*z' + w*z + b*z**3 = 0"


def slide() -> PistonRecord:
    """Slide on a spring with dry friction of 0.15 m/s^2 and 1 % of critical damping, at 2 Hz."""
    time, omega = np.linspace(0.0, 3.5, 700), 4.0 * math.pi

    def rates(_: float, state: np.ndarray) -> tuple[float, float]:
        z, v = state
        return v, -(omega**2) * z - 0.02 * omega * v - 0.15 * math.tanh(v / 1e-4)

    motion = solve_ivp(rates, (0.0, 3.5), (0.02, 0.0), "LSODA", time, rtol=1e-8, atol=1e-10).y[0]
    noise = np.random.default_rng(0).normal(0.0, 2e-5, len(time))
    return PistonRecord(time, 0.05 + motion + noise)


def test_dry_friction_with_drag_is_tried() -> None:
    screening = choose_candidate_laws(slide()).screening
    assert min(screening.misfits, key=screening.misfits.__getitem__) == "viscous-coulomb"


@pytest.mark.long
def test_dry_friction_with_drag_is_identified() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(slide(), progress=False)
    assert found.best.law.name == "viscous-coulomb"
    assert found.best.parameters["friction"] == pytest.approx(0.15, rel=0.01)
    assert found.best.parameters["omega"] == pytest.approx(4.0 * math.pi, rel=1e-3)


@pytest.fixture
def poor(monkeypatch: pytest.MonkeyPatch) -> PistonRecord:
    """Record that no known law but one that is hardly right is tried on, and no library explains better."""
    chosen = CandidateLaws((LAWS["linear"],), LawScreening({}, 1.0))
    monkeypatch.setattr(identification, "choose_candidate_laws", lambda *_: chosen)
    time = np.linspace(0.0, 20.0, 1000)
    motion = solve_ivp(
        lambda _, y: (y[1], -0.1 * abs(y[1]) * y[1] - 4.0 * y[0] - 3.0 * y[0] ** 3),
        (0.0, 20.0),
        (1.0, 0.0),
        t_eval=time,
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    return PistonRecord(time, motion + np.random.default_rng(0).normal(0.0, 1e-3, len(time)))


def test_a_discovery_is_begun_where_the_best_law_leaves_more_than_a_tenth(
    poor: PistonRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = Law("found", TRUE)
    model = fit(poor, law, starts=2, parameters={"c": 0.1, "w": 4.0, "b": 3.0})
    monkeypatch.setattr(discovery, "discover", lambda *_, **__: types.SimpleNamespace(model=model))
    found = identify(poor, progress=False, starts=2)
    assert [row.name for row in found.comparison.rows] == ["found", "linear"]
    assert found.comparison.rows[1].error > 0.1
    assert {one.law.name for one in found.models} == {"found", "linear"}
    assert found.advice == ()


def test_a_discovery_that_fails_is_said_and_stops_nothing(
    poor: PistonRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise InputError("no terms")

    monkeypatch.setattr(discovery, "discover", fail)
    found = identify(poor, progress=False, starts=2)
    assert found.best.law.name == "linear"
    assert any(words.startswith("discovery by sindy: no terms") for words in found.left_out)
    with pytest.raises(InputError, match="no terms"):
        identify(poor, progress=False, starts=2, discovery="sindy")
