"""Start values for laws given as text are as good as for named laws.

Starts derived from one another are not counted separately.
"""

import dataclasses

import numpy as np
import pytest

from granular import PistonRecord
from reduced_models import FitOptions, ReducedModel, fit
from reduced_models.fitting.natural_sizes import natural_sizes
from reduced_models.laws.law import law_from_text
from reduced_models.records.first_guesses import FirstGuesses
from tests.reduced_models.made import damped_cosine, made_stroke, moved, noise, noisy

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

DUFFING = "z'' + 2*a*z' + b*(z - c) + d*(z - c)**3 = 0"
OSCILLATOR = "z'' + 2*a*z' + b*(z - c) = 0"
TIME = np.linspace(0.0, 2.0, 400)


def decay() -> PistonRecord:
    return noisy(TIME, 0.06 + damped_cosine(TIME), 1e-5)


def driven() -> PistonRecord:
    """Return the motion of a driven Duffing oscillator, which no free oscillator follows."""
    time = np.linspace(0.0, 60.0, 2000)
    height = moved(lambda t, z, v: -z - 0.5 * z**3 - 0.15 * v + 0.6 * np.cos(1.3 * t), time, rtol=1e-8)
    return noisy(time, height, 0.01 * height.std())


def beats() -> PistonRecord:
    """Return the sum of two modes, where a Duffing oscillator has one."""
    time = np.linspace(0.0, 40.0, 2000)
    height = np.exp(-0.05 * time) * (np.cos(2.0 * time) + 0.8 * np.cos(3.1 * time + 1.0))
    return PistonRecord(time, height + noise(2000, 0.01))


@pytest.mark.long
@pytest.mark.parametrize("record", [driven, beats])
def test_fit_of_a_law_given_as_text_reaches_the_optimum_of_the_named_law(record: object) -> None:
    """The law is wrong for this record, so that a fit to its accelerations leads to another minimum."""
    given = record()  # type: ignore[operator]
    named, written = fit(given, "duffing"), fit(given, DUFFING)
    assert named.quality.relative > 0.1
    assert written.quality.relative < 1.01 * named.quality.relative


def test_start_values_for_a_motion_follow_from_the_dimensions_of_parameters() -> None:
    sizes = natural_sizes(law_from_text(DUFFING).parsed_equation, 0.01, 0.5, {})
    assert sizes == pytest.approx({"a": 50.0, "b": 2500.0, "c": 0.01, "d": 2.5e7})


def search_line(model: ReducedModel) -> str:
    (line,) = (text.strip() for text in str(model).splitlines() if text.startswith("  search: "))
    return line


def test_starts_derived_from_one_another_count_once_if_their_fits_agree() -> None:
    named = fit(decay(), "linear", starts=4)
    assert named.quality.independent == named.quality.converged
    assert search_line(named).startswith(f"search: {named.quality.converged} of 4 starts end here, and")
    written = fit(decay(), OSCILLATOR, starts=4)
    assert written.quality.independent is not None
    assert written.quality.independent >= 2  # the fit to accelerations, and draws of natural size
    values = {"a": 0.8, "b": 475.0, "c": 0.06}
    near = fit(decay(), OSCILLATOR, starts=4, parameters=values)
    assert (near.quality.converged, near.quality.independent) == (4, 1)
    assert "4 of 4 starts end here (all near one estimate)" in search_line(near)
    assert ReducedModel.from_plain(near.to_plain()).quality.independent == 1


def test_starts_along_a_stroke_count_as_independent_only_if_parameters_were_drawn_at_random() -> None:
    """Parameters of a linear law follow from linear least squares; the creep speed is drawn at random."""
    truth = {"c": 80.0, "k": 900.0, "friction": 5.0, "creep": 0.01, "zero": 0.5}
    record = made_stroke("viscous-coulomb", truth, 0.01, 1.5, 0.01, np.random.default_rng(1)).first(500)
    force = FitOptions(measured="force")
    linear = fit(record, "linear", starts=4, test_fraction=0.0, options=force)
    assert linear.quality.independent == 1
    drawn = fit(record, "viscous-coulomb", starts=4, test_fraction=0.0, options=force)
    assert drawn.quality.independent == drawn.quality.converged > 1


def test_a_fit_reached_from_only_one_of_several_starts_causes_a_warning() -> None:
    def start(_: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
        stiffness = np.where(np.arange(count) == 3, 475.0, -1e7 * random.uniform(1.0, 2.0, count))
        return {"a": np.full(count, 0.8), "b": stiffness, "c": np.full(count, 0.06)}

    law = dataclasses.replace(law_from_text(OSCILLATOR), start=start)
    with pytest.warns(UserWarning, match="only 1 of 8 random starts led to this fit"):
        model = fit(decay(), law, starts=8)
    assert (model.quality.converged, model.quality.independent) == (1, 1)
    assert search_line(model).startswith("search: 1 of 8 starts end here")
