"""Discovery with memory: hidden states along a record, and laws that hold one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from granular import PistonRecord, damper, simulate
from granular.shared.errors import GranularError, InputError
from reduced_models import discover
from reduced_models.__main__ import main
from reduced_models.discovery.hidden_states import HIDDEN_STATES, HiddenState
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.equation import compile_rates

LAW = LAWS["elastoplastic-bed"]
TRUE = {"lam": 0.8, "weight": 9.8, "rest": 0.06, "power": 2.5, "modulus": 0.33, "strength": 0.04}
MASS = 7.5


def forced(noise: float, modulus: float = TRUE["modulus"]) -> PistonRecord:
    """Force of a bed under two prescribed sines, with a fraction of noise."""
    time = np.linspace(0.0, 2.0, 800)
    values = [(TRUE | {"modulus": modulus})[name] for name in LAW.parameters]
    field = compile_rates(LAW.equation, (), "numpy")

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = 9.0, 23.0
        z = 0.06 - 0.012 * np.sin(a * t) - 0.004 * np.sin(b * t)
        return z, -0.012 * a * np.cos(a * t) - 0.004 * b * np.cos(b * t)

    w = solve_ivp(
        lambda t, state: [field(*motion(t), state[0], *values)[1]],
        (0.0, 2.0),
        [0.0],
        "LSODA",
        time,
        rtol=1e-8,
        atol=1e-10,
    ).y[0]
    z, v = motion(time)
    force = MASS * (9.8 + np.asarray(field(z, v, w, *values)[0]))
    random = np.random.default_rng(1)
    force += noise * force.std() * random.normal(size=len(time))
    return PistonRecord(time, z + 1e-7 * random.normal(size=len(time)), force=force)


@pytest.mark.parametrize("state", [one for one in HIDDEN_STATES if len(one.scales) == 1])
def test_hidden_states_are_those_of_their_rates(state: HiddenState) -> None:
    time = np.linspace(0.0, 2.0, 4000)
    z, speed = 0.06 - 0.02 * np.sin(9.0 * time), 9.0
    rates = {
        "yielding strain": lambda w, v, h: -(v + abs(v) * abs(w) * w / 0.1**2) / h,
        "strain that yields as in Dahl's model": lambda w, v, h: -(v + abs(v) * w / 0.1) / h,
        "relaxing strain": lambda w, v, h: -v / h - w / 0.1,
    }[state.name]
    exact = solve_ivp(
        lambda t, w: [rates(w[0], -0.02 * speed * np.cos(speed * t), 0.06 - 0.02 * np.sin(speed * t))],
        (0.0, 2.0),
        [0.0],
        "LSODA",
        time,
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    found = state.values_along_motion(time, z, np.array([[0.1]]))[0]
    np.testing.assert_allclose(found, exact, atol=1e-4)


def test_a_bed_that_yields_is_found_in_its_force() -> None:
    """Pressure, drag and shear stress, and the strain at which it yields."""
    found = discover(forced(0.01), "sindy", library="memory", target="force")
    best = found.best
    assert best.hidden_state is not None
    assert best.hidden_state.kind.name == "yielding strain"
    assert best.hidden_state.scales[0] == pytest.approx(TRUE["strength"] / TRUE["modulus"], rel=0.05)
    assert best.terms is not None
    values = {term.text: value for term, value in best.terms.items()}
    assert set(values) == {"z**(-5/2)", "u/z**(5/2)", "z'"}
    assert values["u/z**(5/2)"] / values["z**(-5/2)"] == pytest.approx(TRUE["modulus"], rel=0.05)
    assert values["z'"] == pytest.approx(-2.0 * TRUE["lam"] * MASS, rel=0.05)
    assert "w' = -(z' + Abs(z')*Abs(w)*w/0.1" in best.text
    assert best.text.startswith("force = ")


@pytest.mark.long  # quick: the bed that has one
def test_a_force_without_memory_is_said_to_have_none() -> None:
    found = discover(forced(0.01, modulus=1e-9), "sindy", library="memory", target="force")
    assert found.best.hidden_state is None
    assert "the law has no memory" in found.notes[0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"input": "force"}, "not driven"),
        ({"library": ["memory", "rational"]}, "goes with no other"),
        ({"terms": ["q*z"]}, "names q"),
    ],
)
def test_what_memory_cannot_do_is_refused(changes: dict[str, Any], said: str) -> None:
    options: dict[str, Any] = {"method": "sindy", "library": "memory"} | changes
    with pytest.raises(InputError, match=said):
        discover(forced(0.01), **options)


def test_records_without_force_or_below_the_floor_are_refused() -> None:
    record = forced(0.01)
    with pytest.raises(GranularError, match="needs a measured force"):
        discover(PistonRecord(record.time, record.height), "sindy", library="memory", target="force")
    with pytest.raises(InputError, match="above the floor"):
        discover(PistonRecord(record.time, record.height - 0.06), "sindy", library="memory")


@pytest.mark.long  # quick: the same structure in a force
def test_a_fall_tells_the_law_of_its_bed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the command line: from 20 D with noise; fitted through its equation, it is the law."""
    time = np.linspace(0.0, 1.5, 500)
    values = [TRUE[name] for name in LAW.parameters]
    field = compile_rates(LAW.equation, (), "numpy")
    fall = solve_ivp(
        lambda _, y: [y[1], *field(*y, *values)],
        (0.0, 1.5),
        [0.12, 0.0, 0.0],
        "LSODA",
        time,
        rtol=1e-9,
        atol=1e-11,
    ).y[0]
    noise = np.random.default_rng(0).normal(0.0, 5e-5, len(time))
    PistonRecord(time, fall + noise).to_csv(tmp_path / "fall.csv")
    main(["discover", str(tmp_path / "fall.csv"), "--library", "memory", "--method", "sindy", "--json"])
    found = json.loads(capsys.readouterr().out)
    numbers = found["model"]["parameters"]
    assert numbers["yielding"] == pytest.approx(TRUE["strength"] / TRUE["modulus"], rel=0.05)
    best = found["candidates"][found["chosen"]]["equation"]
    assert "w/z**(5/2)" in best
    assert best.count("z'") == 4  # z'', one term with the speed, and two in the rate


@pytest.mark.long
def test_simulated_falls_show_the_structure_of_the_law() -> None:
    """On the front of their forces; the drag is that of grains that follow the piston affinely."""

    def fall(height: float) -> PistonRecord:
        stage = {"kind": "free", "name": "drop", "duration": 3.0}
        changes = {
            "piston.height": f"{height} D",
            "arrangement.height": f"{height - 1.0} D",
            "protocol": [stage],
            "output.record": "drop",
        }
        return simulate(damper().replace(**changes), dt="auto*2", progress=False).piston()

    found = discover([fall(20.0), fall(28.0)], "sindy", library="memory", target="force")
    assert found.best.hidden_state is not None
    assert found.best.hidden_state.kind.name == "yielding strain"
    law = {"z**(-5/2)", "u/z**(5/2)", "z'"}
    same = [
        one.terms
        for one in found.candidates
        if one.terms is not None and {term.text for term in one.terms} == law
    ]
    values = {term.text: value for term, value in same[0].items()}
    assert values["z'"] == pytest.approx(-368 * 0.1 / 3.0, rel=0.1)
    assert 0.2 < values["u/z**(5/2)"] / values["z**(-5/2)"] < 0.45
