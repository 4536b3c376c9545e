"""Start values of fits along a stroke: from dimensional analysis, and from simpler laws contained in
the law.
"""

import dataclasses

import numpy as np
import pytest

from granular import PistonRecord
from granular.shared.errors import InputError
from reduced_models import FitOptions, fit
from reduced_models.fitting.natural_sizes import natural_sizes
from reduced_models.fitting.stroke_starts import nested_laws
from reduced_models.laws import FORCE_LAWS
from reduced_models.laws.law import law_from_text
from tests.reduced_models.made import assert_found, made_stroke

SLIP = "w' = rho*(z' - sigma*Abs(z')*Abs(w)*w + (sigma - 1)*z'*w**2)"


def test_start_values_of_parameters_are_derived_from_their_dimensions() -> None:
    law = law_from_text(f"force = (c + d*I)*z' + k*z + f*w + zero; {SLIP}", ("I",))
    sizes = natural_sizes(law.parsed_equation, 0.01, 0.5, {"force": 100.0, "I": 2.0})
    expected = {"c": 200.0, "d": 100.0, "k": 1e4, "f": 100.0, "rho": 100.0, "sigma": 1.0, "w": 1.0}
    assert {name: sizes[name] for name in expected} == pytest.approx(expected)
    for packaged in FORCE_LAWS.values():
        found = natural_sizes(packaged.parsed_equation, 0.01, 0.5, {"force": 100.0})
        assert set(found) == {*packaged.parameters, *packaged.hidden}


def test_the_simpler_law_without_the_input_is_fitted_first_for_start_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = []

    def noted(problem: object) -> object:
        seen.append(nested_laws(problem))  # type: ignore[arg-type]
        return seen[-1]

    monkeypatch.setattr("reduced_models.fitting.search.nested_laws", noted)
    random = np.random.default_rng(1)
    record = made_stroke("linear", {"c": 80.0, "k": 900.0, "zero": 0.5}, 0.01, 1.5, 0.01, random).first(500)
    current = 1.0 + 0.5 * np.sin(3.0 * record.time)
    driven = dataclasses.replace(record, extra={**record.extra, "I": current}, measured="force")
    model = fit(driven, "force = (c + d*u)*z' + k*z + zero; u' = (I - u)/lag", starts=4, test_fraction=0.0)
    first, second = (stage.held for stage in seen[0])
    assert set(first) == {"d", "lag"}
    assert first["d"] == 0.0
    assert set(second) == {"lag"}
    assert model.parameters["k"] == pytest.approx(900.0, rel=0.05)


def test_a_shock_absorber_with_different_blow_off_speeds_is_fitted() -> None:
    truth = {
        "c_up": 300.0,
        "d_up": 60.0,
        "open_up": 0.04,
        "c_down": 900.0,
        "d_down": 200.0,
        "open_down": 0.03,
    }
    random = np.random.default_rng(2)
    record = made_stroke("two-slope-damper", {**truth, "k": 100.0, "zero": 1.0}, 0.01, 1.5, 0.01, random)
    assert_found(fit(record, "two-slope-damper", options=FitOptions(measured="force")), truth)


def test_laws_that_require_positive_heights_are_refused_on_a_stroke_about_zero() -> None:
    time = np.linspace(0.0, 4.0, 400)
    record = PistonRecord(time, 0.01 * np.sin(6.0 * time), force=np.cos(6.0 * time))
    with pytest.raises(InputError, match=r"heights above 0, but the stroke goes down to -0\.01 m"):
        fit(record, "elastoplastic-bed", options=FitOptions(measured="force"))


def test_an_equation_may_contain_the_rate_of_a_hidden_state() -> None:
    written = law_from_text("force = c*y'; y' = (z - y)/tau").parsed_equation
    spelled_out = law_from_text("force = c*(z - y)/tau; y' = (z - y)/tau").parsed_equation
    assert (written.observations["force"] - spelled_out.observations["force"]).simplify() == 0
    with pytest.raises(InputError, match="depends on itself"):
        _ = law_from_text("force = c*y'; y' = z - y'").parameters
