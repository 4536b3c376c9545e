"""Engineering values of a law compared with textbooks.

Contributions to errors, printed digits, and tests of residuals.
"""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import t

from granular import PistonRecord
from granular.records.headings import COORDINATES
from granular.studies.packing_spread import ExpectedSpread, PackingSpread
from reduced_models import ReducedModel, fit, identify, load_model
from reduced_models.fitting.residual_diagnostics import (
    ResidualTests,
    count_release_transient_samples,
    diagnose_residuals,
    residual_tests,
)
from reduced_models.identification.measured_oscillation import compare_backbone_with_law
from reduced_models.laws.law import law_from_text
from reduced_models.models.at_rest import AtRest, EquivalentDamping
from reduced_models.models.printed_model import oscillation_quantities
from reduced_models.models.quantities import (
    QuantityWithError,
    add_step_and_packing_errors,
    decimal_places_of_interval,
    error_sources_text,
    format_fixed,
    format_interval,
)
from reduced_models.records.envelope import envelope
from tests.reduced_models.made import damped_cosine, moved, noise, noisy

SAVED = Path(__file__).parents[2] / "data" / "model.json"
INTERVALS = {"height": (0.0589, 0.0593), "period": (0.313, 0.3153)}


def test_figures_of_a_textbook_oscillator_and_their_errors_are_exact() -> None:
    """With 7.5 kg, 3000 N/m and 30 N s/m, omega is 20 rad/s and the damping ratio 0.1."""
    rest = AtRest(0.0591, 2.0 * math.pi / 20.0, 0.1, INTERVALS | {"damping_ratio": (0.09, 0.11)})
    model = dataclasses.replace(load_model(SAVED), at_rest=rest)
    known = {one.name: one for one in oscillation_quantities(model, 7.5)}
    period = 0.0036606  # relative error
    for name, value, error in (
        ("stiffness", 3000.0, 2 * period * 3000.0),
        ("damping", 30.0, 30.0 * math.hypot(0.1, period)),
        ("natural frequency", 20.0 / (2.0 * math.pi), period * 20.0 / (2.0 * math.pi)),
        ("damped frequency", 20.0 * math.sqrt(0.99) / (2 * math.pi), None),
        ("logarithmic decrement", 0.2 * math.pi / math.sqrt(0.99), None),
        ("quality factor", 5.0, 0.5),
    ):
        assert known[name].value == pytest.approx(value)
        assert error is None or known[name].total_error == pytest.approx(error, rel=1e-4)
    assert known["stiffness"].unit == "N/m"
    assert known["level of rest"].text_with_error == "59.10 ± 0.20 mm"
    assert known["damping ratio"].text_with_error == "10.0 ± 1.0 %"
    turning = dataclasses.replace(model, at_rest=dataclasses.replace(rest, coordinate_unit="rad"))
    angle = {one.name: one for one in oscillation_quantities(turning, None)}
    assert angle["level of rest"].unit == "°"
    assert not any("m" in one.unit for one in angle.values())
    assert (angle["stiffness"].unit, angle["damping"].unit) == ("1/s²", "1/s")
    assert oscillation_quantities(dataclasses.replace(model, at_rest=None), None) == ()


def test_dry_friction_is_given_as_a_force_and_damping_ratios_at_amplitudes() -> None:
    others = {"tenth_ratio": (0.12, 0.14), "friction": (0.12, 0.13)}
    equivalent = EquivalentDamping(0.005, 0.13, 0.125, others, own=True)
    intervals = INTERVALS | {"damping_ratio": (0.025, 0.027)}
    rest = AtRest(0.0591, 2.0 * math.pi / 20.0, 0.026, intervals, equivalent)
    model = dataclasses.replace(load_model(SAVED), at_rest=rest)
    known = {one.name: one for one in oscillation_quantities(model, 8.0)}
    ratios = ["damping ratio at 5 mm", "damping ratio at 1 mm"]
    assert list(known) == ["level of rest", "natural frequency", *ratios, "friction", "stiffness"]
    assert known[ratios[0]].value == pytest.approx(2.6)
    assert known[ratios[1]].text_with_error == "13.0 ± 1.0 %"
    assert (known["friction"].text_without_error, known["friction"].unit) == ("1.000 N", "N")
    for unit in COORDINATES:
        model = dataclasses.replace(model, at_rest=dataclasses.replace(rest, coordinate_unit=unit))
        (friction,) = [one for one in oscillation_quantities(model, None) if one.symbol == "F"]
        assert (friction.value, friction.unit) == (0.125, f"{unit}/s²")


def test_contributions_to_an_error_add_up_in_quadrature() -> None:
    """The contributions are the fit, the calibration, the time step, and the spread of three packings."""
    intervals = INTERVALS | {"damping_ratio": (0.09, 0.11)}
    rest = AtRest(0.0591, 0.31415, 0.1, intervals, calibration={"height": 0.0001})
    model = dataclasses.replace(load_model(SAVED), at_rest=rest)
    figures = oscillation_quantities(model, 7.5)
    level = figures[0]
    assert level.parts == pytest.approx({"fit": math.sqrt(0.03), "calibration": 0.1})
    assert level.total_error == pytest.approx(0.2)

    def moved(by: float) -> list[QuantityWithError]:
        return [one._replace(value=one.value + by) for one in figures]

    checked = add_step_and_packing_errors(figures, [0.4] * len(figures), moved(0.1), None, moved(-0.1))[0]
    start = math.sqrt(2.0) * 4.302653 * 0.1  # Student's factor for a further start, from three
    assert checked.parts == pytest.approx(level.parts | {"step": 0.4, "start": start})
    assert checked.total_error == pytest.approx(math.sqrt(0.2**2 + 0.4**2 + start**2))
    plain = checked.to_plain()
    assert set(plain) == {"value", "unit", "total_error", "parts", "packings"}
    assert (plain["packings"], level.to_plain()["packings"]) == ("3 packings", None)
    assert set(plain["parts"]) == {"fit", "step", "start", "calibration"}
    assert level.to_plain()["parts"]["step"] is None


def test_simulated_packings_are_pooled_with_tabulated_packings_of_the_same_quantity() -> None:
    """Three packings scatter by 0.3 %, the thirty tabulated packings by 0.2 %.

    They are not pooled for parameters, which the table lacks, nor if the three packings scatter by 10 %.
    """
    model = dataclasses.replace(
        load_model(SAVED), at_rest=AtRest(0.0591, 0.31415, 0.1, INTERVALS | {"damping_ratio": (0.09, 0.11)})
    )
    figures = [*oscillation_quantities(model, 7.5), QuantityWithError("k1", "k1", "1/s^2", 475.0, {})]
    spread = PackingSpread(*(ExpectedSpread(0.002, 29.0) for _ in range(3)), packings=30)

    def checked_with(by: float) -> dict[str, QuantityWithError]:
        others = (
            [one._replace(value=one.value * factor) for one in figures] for factor in (1.0 + by, 1.0 - by)
        )
        return {one.name: one for one in add_step_and_packing_errors(figures, None, *others, spread=spread)}

    checked = checked_with(0.003)
    factors = {"level of rest": 1.0, "natural frequency": 1.0, "damping ratio": 1.0, "stiffness": 2.0}
    factors["damping"] = math.sqrt(2.0)
    for name, factor in factors.items():
        expected = (2.0 * 0.003**2 + 29.0 * (factor * 0.002) ** 2) / 31.0
        width = t.ppf(0.975, 31.0) * math.sqrt(2.0 * expected) * checked[name].value
        assert checked[name].parts["start"] == pytest.approx(width)
    for item, by in ((checked["k1"], 0.003), (checked_with(0.1)["natural frequency"], 0.1)):
        assert item.parts["start"] == pytest.approx(math.sqrt(2.0) * 4.302653 * by * item.value)
        assert item.packings == "3 packings"
    assert "random packing (3 packings and a table of 30)" in error_sources_text(
        list(checked.values())[:2], 0.95
    )
    alone = add_step_and_packing_errors(figures[:1], None, figures[:1], seconds=12.34)
    assert "(2 packings; --packings: 12 s for each more)" in error_sources_text(alone, 0.95)


def test_a_damping_ratio_contradicted_by_the_peaks_of_the_record_is_not_shown() -> None:
    """For example, the peaks give 3 %, and the law gives 10 % for small oscillations."""
    time = np.linspace(0.0, 3.0, 2000)
    decay = np.exp(-0.6 * time) * np.cos(20.0 * time) + 1e-3 * np.sin(317.0 * time)
    seen = envelope(PistonRecord(time, 0.0591 + 1.2e-3 * decay)).peak_damping
    assert seen.mean == pytest.approx(0.03, rel=0.02)
    for ratio, consistent in ((0.1, False), (10.0, False), (-0.03, False), (0.028, True), (0.05, True)):
        intervals = INTERVALS | {"damping_ratio": (ratio - 1e-3, ratio + 1e-3)}
        peaks = seen if seen.contradicts(ratio) else None
        assert (peaks is None) == consistent
        rest = AtRest(0.0591, 2.0 * math.pi / 20.0, ratio, intervals, peaks=peaks)
        assert ("record's peaks" in str(rest)) == (not consistent)
        model = dataclasses.replace(load_model(SAVED), at_rest=rest)
        known = {one.name: one for one in oscillation_quantities(model, 8.0)}
        assert ("damping ratio" in known, "damping" in known) == (consistent, consistent)
        assert ("quality factor" in known) == consistent


def test_damping_by_friction_is_reported_at_measured_amplitudes(made: Callable[..., PistonRecord]) -> None:
    """Print-out, report and plain data are tested. For amplitudes outside the record no values are given."""
    found = identify(made("coulomb"), laws=["coulomb"], starts=2, progress=False)
    own = {size: found.own.figures[2 * place + 1].value for place, size in enumerate(found.own.amplitudes)}
    friction, omega = (
        found.model_of_figures.parameters["friction"],
        math.tau / found.model_of_figures.at_rest.period,
    )
    for amplitude, ratio in own.items():
        assert ratio == pytest.approx(200.0 * friction / (math.pi * omega**2 * amplitude), rel=0.1)
    assert found.own.law_agrees
    assert not any(one.name.startswith("damping ratio") for one in found.figures_to_print)
    for text in (str(found), found.printout()):
        assert "damping ratio" in text.lower()
        assert "friction" in text
        assert "1000" not in text
    assert found.to_plain()["figures"]["friction"]["value"] == pytest.approx(friction, rel=0.01)
    assert "of critical at " in str(found)


def test_the_first_caution_is_that_the_law_contradicts_the_record(made: Callable[..., PistonRecord]) -> None:
    """A dashpot is fitted to dry friction, for which the damping ratio grows as the amplitude falls."""
    found = identify(made("coulomb"), laws=["linear"], starts=2, progress=False)
    assert not found.own.law_agrees
    words = "the law, linear, contradicts the record: at "
    page = found.page().to_html()
    assert page.index("contradicts the record") < page.index("natural frequency")
    assert found.printout().splitlines()[1].startswith(f"caution: {words}")
    assert found.to_plain()["own"]["agrees"] is False


def test_frequency_and_damping_are_measured_from_a_driven_record() -> None:
    """Frequency and damping follow from the restoring force: the drive (from the law) minus acceleration."""
    time = np.linspace(0.0, 10.0, 2001)

    def push(t: Any) -> Any:
        return np.sin((14.0 + 0.3 * t) * t)

    swing = moved(lambda t, z, v: 0.5 * push(t) - 400.0 * z - 1.6 * v, time, 0.0)
    model = dataclasses.replace(
        load_model(SAVED),
        law=law_from_text("z'' + c*z' + k*z = b*push", ["push"]),
        parameters={"c": 1.6, "k": 400.0, "b": 0.5},
        initial=(0.0, 0.0),
    )
    found = compare_backbone_with_law(noisy(time, swing, 1e-7, extra={"push": push(time)}), model)
    assert found.record.method == "restoring force"
    assert found.law_agrees
    frequency, damping = found.quantities_at_shown_amplitude(0)
    assert frequency.value == pytest.approx(20.0 / math.tau, rel=0.01)
    assert damping.value == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize(
    ("value", "low", "high", "text"),
    [
        (59.1078561, 59.1077, 59.1080, "59.10786"),
        (3.4726, 3.2, 3.7, "3.47"),
        (12345.6, 12000.0, 12700.0, "12350"),
        (0.0361588, 0.0361, 0.0362, "0.036159"),
        (2.0, 2.0, 2.0, "2.0000000"),
        (0.0, 0.0, 0.0, "0.0000000"),
        (0.0, -1e-17, 1e-17, "0.0000000"),
        (0.0, -0.3, 0.3, "0.00"),
        (0.0, -math.inf, math.inf, "0.000"),
        (5.0, -math.inf, math.inf, "5.000"),
    ],
)
def test_the_number_of_printed_digits_depends_on_the_interval(
    value: float, low: float, high: float, text: str
) -> None:
    assert format_fixed(value, decimal_places_of_interval(value, low, high)) == text
    assert low <= float(text) <= high


@pytest.mark.parametrize(
    ("low", "high", "digits", "text"),
    [
        (3.34467811, 3.34467816, 7, "3.3446781 to 3.3446782"),
        (9.0, 11.000000000000002, 1, "9.0 to 11.0"),
        (0.06, 0.94, 1, "0.0 to 1.0"),
        (-0.06, 0.06, 1, "-0.1 to 0.1"),
        (12004.0, 12696.0, -1, "12000 to 12700"),
    ],
)
def test_a_printed_interval_contains_the_unrounded_interval(
    low: float, high: float, digits: int, text: str
) -> None:
    assert format_interval(low, high, digits) == text


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (lambda t: 0.0 * t, "rounding"),
        (lambda t: noise(len(t), 1e-5), "noise"),
        (lambda t: 1e-5 * np.cos(21.0 * t), "wrong: the residual oscillates with the motion"),
        (lambda t: 1e-5 * np.cos(42.0 * t), "wrong: the residual oscillates at twice the frequency"),
        (lambda t: 1e-5 * np.cos(2.0 * t), "not white"),
    ],
)
def test_small_structured_residuals_are_reported_as_a_wrong_law(
    error: Callable[[np.ndarray], np.ndarray], words: str, textbook: ReducedModel
) -> None:
    """Their amplitude is 1 % of the motion's, at the oscillation frequency or twice this frequency."""
    swing = damped_cosine(LONG_TIME, 1.2e-3, 0.05, 21.0)
    moved_record = PistonRecord(LONG_TIME, 0.059 + swing + error(LONG_TIME))
    followed = textbook.simulate_record(moved_record).height
    residuals = moved_record.height - followed
    seen = diagnose_residuals(LONG_TIME, residuals, np.gradient(swing, LONG_TIME), 2.0 * math.pi / 21.0)
    quality = dataclasses.replace(textbook.quality, whiteness=seen["whiteness"], signs=seen["signs"])
    model = dataclasses.replace(textbook, quality=quality)
    assert residual_tests(model, LONG_TIME, moved_record.height, followed).verdict.startswith(words)


LONG_TIME = np.linspace(0.0, 6.0, 2000)


@pytest.fixture(scope="module")
def textbook() -> ReducedModel:
    """Return the fit of a decay without noise."""
    swing = damped_cosine(LONG_TIME, 1.2e-3, 0.05, 21.0)
    return fit(PistonRecord(LONG_TIME, 0.059 + swing), "linear", starts=2)


def test_a_release_transient_is_distinguished_from_a_wrong_law() -> None:
    """The transient decays within a tenth of a second. A misfit would decay with the oscillation."""
    time = np.linspace(0.0, 4.0, 2001)
    noise = np.random.default_rng(0).normal(0.0, 1e-8, len(time))
    wave = 1e-5 * np.exp(-time / 0.015) * np.cos(300.0 * time)
    count = count_release_transient_samples(time, wave + noise, 0.29)
    assert 0.04 < time[count] < 0.15
    assert np.abs(wave[count:]).max() < 1e-6
    misfit = 1e-5 * np.exp(-0.8 * time) * np.cos(21.6 * time)
    assert count_release_transient_samples(time, misfit + noise, 0.29) == 0
    assert count_release_transient_samples(time, noise, 0.29) == 0
    assert count_release_transient_samples(time[:300], wave[:300], 0.29) == 0  # two periods are too few


@pytest.mark.parametrize(
    ("after", "words"),
    [(2e-4, "so the law holds there"), (2e-3, "wrong: the residual oscillates"), (1e-6, "rounding")],
)
def test_residuals_of_the_release_transient_do_not_count_against_the_law(after: float, words: str) -> None:
    tests = ResidualTests(1e-6, 0.01, 0.0, 0.0, 10.0, 1.0, transient=0.05, after=after)
    assert tests.verdict.startswith(f"{100 * after:.2g} % of the rms displacement after the first 50 ms")
    assert words in tests.verdict
    assert ("wrong" in tests.verdict) == (after == 2e-3)
