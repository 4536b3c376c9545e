"""Time derivatives of the states for SciPy's `solve_ivp`. The motion agrees with `simulate`."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from granular.shared.errors import InputError
from reduced_models import DiscoveryOptions, PistonRecord, ReducedModel, discover, load_model
from reduced_models.laws.law import law_from_text
from tests.reduced_models.models.test_exports import LAWS, SAVED, TIMES, model_of

DRIVE = 3.0 * np.sin(5.0 * TIMES)


def model_from_text(equation: str, parameters: dict[str, float], hidden: dict[str, float]) -> ReducedModel:
    """Return the model of a law given as text, released from rest at 1.5."""
    law = law_from_text(equation, ("push",))
    changes = {"law": law, "parameters": parameters, "hidden": hidden, "initial": (1.5, 0.0)}
    return dataclasses.replace(load_model(SAVED), **changes, at_rest=None, conventions={})


def assert_same_motion(model: ReducedModel, inputs: dict[str, np.ndarray]) -> None:
    functions = {name: CubicSpline(TIMES, values) for name, values in inputs.items()}
    expected = model.simulate(TIMES, inputs=inputs)
    state = model.initial_state
    found = solve_ivp(
        model.rhs, (0.0, 2.0), state, t_eval=TIMES, rtol=1e-10, atol=1e-12, max_step=0.01, args=(functions,)
    )
    assert found.success
    size = np.ptp(expected.height)
    np.testing.assert_allclose(found.y[0], expected.height, atol=1e-7 * size)
    np.testing.assert_allclose(found.y[1], expected.velocity, atol=1e-6 * np.ptp(expected.velocity))
    several = model.rhs(0.5, np.stack([state, 1.01 * state], axis=1), dict.fromkeys(inputs, 1.0))
    np.testing.assert_allclose(several[:, 0], model.rhs(0.5, state, dict.fromkeys(inputs, 1.0)))


@pytest.mark.parametrize("name", LAWS)
def test_rates_of_packaged_laws_integrated_by_scipy_give_the_simulated_motion(name: str) -> None:
    """Some laws have hidden states, or a coordinate that is linear in the height."""
    assert_same_motion(model_of(name), {})


@pytest.mark.parametrize(
    ("equation", "parameters", "hidden", "inputs"),
    [
        ("z'' + c*z' + k*z = sin(2*t)", {"c": 0.3, "k": 30.0}, {}, {}),
        ("z'' + c*z' + k*z = push", {"c": 0.3, "k": 30.0}, {}, {"push": DRIVE}),
        ("x'' = k*(y - x) - c*x'; y'' = k*(x - y) - y; height = x", {"k": 9.0, "c": 0.2}, {"y": 0.4}, {}),
        ("z'' + k*z + w = push; w' = z' - r*w", {"k": 20.0, "r": 2.0}, {"w": 0.1}, {"push": DRIVE}),
    ],
    ids=["drive in time", "input", "two coordinates", "hidden state and input"],
)
def test_states_and_inputs_of_the_rates_are_in_the_order_of_the_law(
    equation: str, parameters: dict[str, float], hidden: dict[str, float], inputs: dict[str, np.ndarray]
) -> None:
    assert_same_motion(model_from_text(equation, parameters, hidden), inputs)


def test_rates_of_a_discovered_model_give_the_simulated_motion() -> None:
    height = 0.1 + np.exp(-0.4 * TIMES) * np.cos(20.0 * TIMES)
    options = DiscoveryOptions(polish=1)
    model = discover(
        PistonRecord(TIMES, height), "sindy", library="physical", degree=1, options=options
    ).model
    assert_same_motion(model, {})


def test_rates_are_refused_for_missing_inputs_invalid_states_and_force_laws() -> None:
    driven = model_from_text("z'' + k*z = push", {"k": 20.0}, {})
    with pytest.raises(InputError, match=r"has the input 'push'.*args=\(inputs,\)"):
        driven.rhs(0.0, driven.initial_state)
    with pytest.raises(InputError, match="the state has 3 entries; give 2: height, velocity"):
        driven.rhs(0.0, np.zeros(3), {"push": 0.0})
    force = dataclasses.replace(driven, law=law_from_text("force = c*z' + k*z", ("force",)))
    with pytest.raises(InputError, match="force along a prescribed stroke, not a motion"):
        force.rhs(0.0, np.zeros(2))
    with pytest.raises(InputError, match="not a motion"):
        _ = force.initial_state
