"""Prediction of a fall from the scene: pressure of the crystal, the law, warnings and errors."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint

from granular import Scene, damper, load_scene, simulate
from granular.effects.dipole import discs_unless_dipoles
from granular.pairs.disc_law import disc_energy_and_force
from granular.schema.apparatus import Grains
from granular.schema.natural_units import Scales
from granular.shared.errors import InputError
from reduced_models import predict, valid_shaking_range, whole_fall
from reduced_models.falls.predicted_law import (
    POWER,
    PRESSURE,
    WEIGHT,
    OutsideRangeWarning,
    PredictedLaw,
    lattice_pressure,
    lattice_under_pressure,
    predict_bed_parameters,
)
from reduced_models.falls.unseen_fall_scores import fall_prediction_error
from reduced_models.laws.equation import compile_rates


def test_pressure_of_the_crystal_is_the_negative_derivative_of_its_lattice_energy_by_area() -> None:
    """The energy per grain is the sum of (1/8) F* D (D/r)^3 over all other grains at distances r."""
    cut = 400
    i, j = np.meshgrid(np.arange(-cut, cut + 1), np.arange(-cut, cut + 1))
    squares = (i * i + i * j + j * j).astype(float)
    inside = (squares > 0.0) & (squares < (0.8 * cut) ** 2)
    tail = 2.0 * math.pi / (math.sqrt(0.75) * 0.8 * cut)  # grains beyond the cut-off, as a continuum
    total = float((squares[inside] ** -1.5).sum()) + tail
    # The spacing a at density rho follows from (D/a)^2 = sqrt(3/4) rho.
    energy = 0.125 * total * 0.75**0.75
    assert 1.5 * energy == pytest.approx(PRESSURE, rel=3e-5)
    assert POWER == 1.5 + 1.0


def test_pressure_of_the_crystal_balances_the_piston_weight_at_equilibrium() -> None:
    """The bed is large enough to neglect the walls."""
    scene = damper(count=10**6, drag=1e-4)
    values = predict_bed_parameters(scene)
    scales, width = Scales.from_grains(scene.grains), scene.cell.width
    density = scene.grains.count * scales.length**2 / (width * values["rest"])
    pressure = PRESSURE * scales.force / scales.length * density**POWER
    weight = scene.piston.mass * 9.8 / width
    assert pressure == pytest.approx(weight, rel=0.12)  # walls and equilibrium are fitted to simulations
    # Weight and affine drag refer to the same moving mass.
    affine = 1e6 * 1e-4 / 6.0 / (scene.piston.mass * 9.8)
    assert values["lam"] / values["weight"] == pytest.approx(affine, rel=0.06)


def test_grains_add_a_third_of_their_mass_to_the_piston_and_less_if_drag_makes_them_lag() -> None:
    scene = damper(count=1000)
    mass = scene.piston.mass
    grains = 1000 * Scales.from_grains(scene.grains).mass / 3.0
    loose, damped = (predict_bed_parameters(damper(count=1000, drag=drag))["weight"] for drag in (1e-9, 0.2))
    assert loose == pytest.approx(WEIGHT * 9.8 * mass / (mass + grains), rel=1e-6)
    assert damped > loose


def test_predicted_fall_and_small_oscillations_agree_with_the_simulation() -> None:
    """The packaged damper falls from 20 D.

    The grains change the effective mass of the piston by at most 6 %.
    """
    assert predict_bed_parameters(damper())["weight"] == pytest.approx(9.8, rel=0.06)
    law = predict(damper())
    assert law.at_rest.height == pytest.approx(0.0591, rel=0.07)
    assert law.at_rest.period == pytest.approx(0.288, rel=0.05)
    motion = law.simulate(np.linspace(0.0, 30.0, 3001))
    assert motion.height[0] == 0.12
    assert motion.height[-1] == pytest.approx(law.at_rest.height, rel=0.02)


def test_a_mixture_of_equal_species_gives_the_law_of_a_single_species() -> None:
    plain = damper()
    (one,) = plain.grains.species
    halves = [{**one.to_plain(), "name": name, "share": 0.5} for name in ("a", "b")]
    mixed = plain.replace(**{"grains.species": halves})
    assert predict_bed_parameters(mixed) == pytest.approx(predict_bed_parameters(plain))


def test_a_bed_of_discs_has_a_higher_equilibrium_and_is_stiffer() -> None:
    """For the packaged damper with discs instead of dipoles, simulations give 63.5 mm instead of 59.1 mm.

    The period is 0.2845 s instead of 0.2880 s.
    """
    walls = {f"effects.walls.{side}.law": "experimental" for side in ("left", "right", "bottom", "top")}
    bed = damper().replace(**{"effects.contact": {"modulus": "1 GPa"}, **walls})
    rests = [predict(bed.replace(**{"grains.magnets": m})).at_rest for m in ("dipoles", "cylinders")]
    dipoles, discs = (rest for rest in rests if rest is not None)
    assert discs.height / dipoles.height == pytest.approx(1.074, abs=0.012)
    assert discs.period / dipoles.period == pytest.approx(0.988, abs=0.012)
    assert predict(bed).parameters == pytest.approx(predict(damper()).parameters)


FALLS = [(5.0, 18), (5.0, 20), (5.0, 24), (7.5, 18), (7.5, 20), (7.5, 24)]


@pytest.mark.long
@pytest.mark.parametrize(("mass", "height"), FALLS)
def test_simulated_falls_onto_discs_agree_with_the_prediction(mass: float, height: int) -> None:
    """Without a fit, the rms error over the whole fall is within 3 % of the drop."""
    stage = {"kind": "free", "name": "drop", "duration": 3.0}
    scene = damper(mass, drop=height, magnets="cylinders").replace(
        **{"output.record": None}, protocol=[stage]
    )
    fall, law = simulate(scene, dt="auto*2", progress=False).piston(), predict(scene)
    level = float(fall.height[-len(fall.height) // 10 :].mean())
    assert law.parameters["rest"] == pytest.approx(level, rel=0.02)
    assert fall_prediction_error(law, fall, level) < 0.03


def test_prediction_of_a_fall_warns_if_the_drag_is_above_the_tested_range() -> None:
    """The scene damper-source (De Paula's damper) has 1.23 times the drag at the limit."""
    assert predict_bed_parameters(damper(drag=1.0))["weight"] == pytest.approx(16.05, rel=1e-3)
    with pytest.warns(OutsideRangeWarning, match=r"'damper-source' .* 1\.23 times the limit"):
        predict(load_scene("damper-source"))


def followed(law: PredictedLaw) -> np.ndarray:
    """Return heights over two seconds of a fall from 20 D."""
    field = compile_rates(law.law.equation, (), "math")
    numbers = [law.parameters[name] for name in law.law.parameters]

    def rates(state: np.ndarray, _: float) -> tuple[float, float, float]:
        z, v, w = map(float, state)
        acceleration, stress = field(z, v, w, *numbers)
        return v, acceleration, stress

    found = odeint(rates, (0.12, 0.0, 0.0), np.linspace(0.0, 2.0, 801), rtol=1e-7, atol=1e-9)
    return np.asarray(found[:, 0])


def test_dry_friction_of_the_piston_is_included_in_the_predicted_fall() -> None:
    """At heights at which the net force on the piston is below the friction, the piston hardly creeps."""
    plain, rubbing = predict(damper()), predict(damper().replace(**{"piston.friction": 5.0}))
    assert rubbing.at_rest is None
    fraction = rubbing.parameters["friction"] / rubbing.parameters["weight"]
    assert fraction == pytest.approx(5.0 / (WEIGHT * 7.5 * 9.8))
    heights, freely = (followed(law) for law in (rubbing, plain))
    assert np.ptp(heights[600:]) < 0.05 * np.ptp(freely[600:])
    with pytest.raises(InputError, match="friction of the piston"):
        predict_bed_parameters(damper().replace(**{"piston.friction": 5.0}))


SLAB = {"law": "slab", "gap_start": 0.1, "gap_end": 0.12}
FORMULA = {"energy": "a*(l/w)**3", "a": "1 uJ", "l": "6 mm"}
HELD = {"protocol": [{"kind": "hold", "name": "a", "duration": 1.0}], "output.record": None}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"piston.mass": None} | HELD, "nothing falls"),
        ({"effects.gravity": None}, "nothing falls"),
        ({"effects.friction": True}, "has friction"),
        ({"effects.gravity.acceleration": 0.0}, "nothing falls"),
        ({"effects.walls.left": "none"}, r"has effects\.walls\.left = 'none', .* simulate the scene"),
        ({"effects.walls.bottom": "none"}, r"effects\.walls\.bottom = 'none'"),
        ({"effects.walls.bottom": SLAB}, r"bottom\.gap_start = 0\.1 m"),
        ({"effects.walls.left": FORMULA}, r"walls\.left\.law = 'formula'"),
        ({"pairs": {"method": "cut-off", "cut_off": "2 D"}}, r"pairs\.method = 'cut-off'"),
        ({"pairs": {"method": "verlet-list"}}, r"pairs\.method = 'verlet-list'"),
    ],
)
def test_prediction_for_scenes_without_a_known_law_is_refused(changes: dict[str, Any], said: str) -> None:
    scene = damper().replace(**changes)
    for known in (predict, whole_fall, valid_shaking_range):
        with pytest.raises(InputError, match=said):
            known(scene)


@pytest.mark.parametrize("law", ["infinite", {"law": "slab", "length": 1.0}])
def test_prediction_for_scenes_with_any_packaged_wall_law_is_accepted(law: Any) -> None:
    plain, other = predict(damper()), predict(damper().replace(**{"effects.walls.left": law}))
    assert other.parameters == plain.parameters


DISCS = {"grains.magnets": "cylinders", "effects.contact": {"modulus": "1 GPa"}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"grains.count": 92}, "92 grains"),
        ({"effects.drag.coefficient": 1.2}, "lags too far behind its piston"),
        ({"effects.drag.coefficient": 50.0}, "lags too far behind its piston"),
        ({"piston.mass": 0.5}, "increase piston.mass"),
        ({"effects.walls.left": {"law": "discs", "pitch": "9 mm"}, **DISCS}, "rows of touching discs"),
        ({"effects.walls.left": {"law": "discs", "pitch": "6 mm"}}, "on all sides of a bed of discs"),
    ],
)
def test_prediction_of_a_fall_warns_outside_the_tested_range(changes: dict[str, Any], said: str) -> None:
    scene = damper().replace(**changes)
    with pytest.raises(InputError, match=said):
        predict_bed_parameters(scene)
    with pytest.warns(OutsideRangeWarning, match=said):
        law = predict(scene)
    height = law.simulate(np.linspace(0.0, 0.5, 51)).height
    assert np.isfinite(height).all()
    assert (height[-1] - height[0]) * (law.parameters["rest"] - height[0]) > 0.0


UNLIKE = [
    {"name": "big", "diameter": 0.006, "share": 0.6},
    {"name": "small", "diameter": 0.0045, "share": 0.4, "thickness": 0.002},
]
ROWS = 26


def discs(**changes: Any) -> Grains:
    return damper(magnets="cylinders").replace(**changes).grains


def density(spacing: float) -> float:
    return 2.0 / math.sqrt(3.0) / spacing**2


def summed_pressure(grains: Grains, spacing: float) -> float:
    """Return the virial pressure of all lattice points within 25 spacings, with a continuum of dipoles
    beyond.
    """
    cut = 25.0
    i, j = np.mgrid[-40:41, -40:41]
    r = spacing * np.sqrt((i * i + i * j + j * j).astype(float).ravel())
    r = r[(r > 0.0) & (r <= cut * spacing)]
    known, weights = discs_unless_dipoles(grains, 0.006), grains.species_fractions() * grains.moment_ratios()
    beyond = 3.0 * density(spacing) * 2.0 * math.pi / (cut * spacing)
    total = 0.0
    for k, m in np.ndindex(len(known), len(known)):
        virial = float((r * disc_energy_and_force(r, known[k], known[m])[1]).sum()) + beyond
        total += weights[k] * weights[m] * virial
    return density(spacing) / 16.0 * total


@pytest.mark.parametrize("changes", [{}, {"grains.species": UNLIKE}])
@pytest.mark.parametrize("spacing", [1.01, 1.37])
def test_pressure_of_a_crystal_of_discs_equals_the_virial_sum_of_the_pair_law(
    changes: dict[str, Any], spacing: float
) -> None:
    grains = discs(**changes)
    found = lattice_pressure(grains, density(spacing))
    assert found == pytest.approx(summed_pressure(grains, spacing), rel=2e-3)  # truncation of the sum


def test_pressure_of_discs_tends_to_the_pressure_of_dipoles_at_large_spacing() -> None:
    """The relative excess over dipoles decreases with the square of the spacing."""
    excess = [
        lattice_pressure(discs(), density(a)) / lattice_pressure(damper().grains, density(a)) - 1.0
        for a in (10.0, 20.0)
    ]
    assert excess[0] / excess[1] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("magnets", ["dipoles", "cylinders"])
def test_lattice_spacing_found_for_a_pressure_gives_this_pressure(magnets: str) -> None:
    grains = damper().replace(**{"grains.magnets": magnets}).grains
    lattice = lattice_under_pressure(grains, 0.5)
    assert lattice_pressure(grains, lattice.density) == pytest.approx(0.5, rel=1e-6)
    powers = lattice.power, lattice_under_pressure(grains, 5e-6).power
    assert powers[1] == pytest.approx(POWER, abs=3e-3)
    assert lattice.relative_shear_modulus == pytest.approx((lattice.power / 2.0 - 1.0) / 0.25)
    assert (powers[0] > 2.65) == (magnets == "cylinders")


def test_prediction_for_a_piston_that_presses_discs_into_contact_is_refused() -> None:
    with pytest.raises(InputError, match=r"these discs touch.*smaller piston\.mass"):
        lattice_under_pressure(discs(), 5.0)


def crystal(spacing: float) -> Scene:
    """Return the scene of a periodic cell with displaced hexagonal rows of discs."""
    a = spacing * 0.006
    width, height = ROWS * a, ROWS * math.sqrt(0.75) * a
    rows, columns = np.divmod(np.arange(ROWS * ROWS), ROWS)
    places = a * np.stack([columns + 0.25 + 0.5 * (rows % 2), math.sqrt(0.75) * (rows + 0.5)], axis=1)
    places += np.random.default_rng(5).uniform(-0.02, 0.02, places.shape) * a
    species = [{"name": "disc", "diameter": "6 mm"}]
    return Scene.from_plain(
        {
            "name": "crystal",
            "grains": {"count": ROWS * ROWS, "species": species, "magnets": "cylinders"},
            "cell": {"width": width, "height": height, "sides": "periodic"},
            "effects": {"dipole": {}, "drag": {"coefficient": "0.5 kg/s"}},
            "pairs": {"method": "mesh", "tolerance": 1e-4},
            "arrangement": {"positions": places.tolist()},
            "protocol": [{"name": "rest", "kind": "hold", "duration": 0.2}],
        }
    )


def relaxed_energy(spacing: float) -> tuple[float, float]:
    """Return the energy [J] of a relaxed crystal, and the area of its cell [m^2]."""
    scene = crystal(spacing)
    assert scene.cell.height is not None
    energy = simulate(scene, progress=False).dataset["pair_energy"].values[-1]
    return float(energy), scene.cell.width * scene.cell.height


@pytest.mark.long
@pytest.mark.parametrize("spacing", [1.08, 1.37])
def test_pressure_of_a_crystal_of_discs_agrees_with_a_simulated_crystal(spacing: float) -> None:
    """The simulated pressure is the negative derivative of the energy by the area. Both agree to 0.1 %."""
    (low, small), (high, large) = (relaxed_energy(spacing * f) for f in (0.995, 1.005))
    simulated = (low - high) / (large - small)
    scales = Scales.from_grains(discs())
    expected = lattice_pressure(discs(), density(spacing)) * scales.force / scales.length
    assert simulated == pytest.approx(expected, rel=1e-3)
