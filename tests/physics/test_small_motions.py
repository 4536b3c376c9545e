"""Small motions of beds released near equilibrium or shaken, compared with linear theory."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

from granular import simulate
from granular.linear import Root, piston_roots, transmissibility
from granular.linear.equilibrium import Equilibrium
from tests.granular.linear.small_beds import D, at_rest, free_motion, moved, small_damper

LIFT = 1e-4 * D
"""Initial displacement [m]."""
EASED = 0.15
"""Time after which drag has damped the motion of the grains [s]."""

TWO = [{"name": "big", "diameter": "6 mm", "share": 0.6}, {"name": "small", "diameter": "5 mm", "share": 0.4}]
BODIES = [
    {"mass": 0.5, "stiffness": 600.0, "damping": 0.4},
    {"mass": 0.4, "stiffness": 900.0, "damping": 0.3},
]
OWN = {"energy": "a*q1*q2*exp(-r/l)/r", "a": "5e-5 J*m", "l": "4 mm"}
EDDY = {"conductivity": 59.6e6, "thickness": 1e-3, "distance": 4e-3}
CONTACT = {"modulus": "30 kPa", "restitution": 0.6}
SCENES: dict[str, dict[str, Any]] = {
    "dipoles": {},
    "discs": {"grains.magnets": "cylinders"},
    "two species that scatter": {"grains.species": TWO, "grains.spread": 0.1},
    "machine that carries the cell": {"effects.host": {"bodies": BODIES}},
    "piston on springs": {"effects.host": {"mount": "piston", "bodies": BODIES, "cell_mass": 0.3}},
    "mutual eddy currents": {"effects.eddy": EDDY, "effects.drag": None},
    "viscous contact": {
        "effects.contact": CONTACT,
        "cell.width": "6.6 D",
        "piston.height": "8 D",
        "arrangement.height": "7.8 D",
        "piston.mass": 3.0,
        "piston.drag": 0.5,
    },
    "cold bath": {"effects.bath": {"temperature": 0.0, "rate": 50.0}, "effects.drag": None},
    "own pair law": {"effects.pair_law": [OWN], "effects.dipole": None},
}
QUICK = ("dipoles",)
BY_VERLET = ("dipoles", "viscous contact", "cold bath")
"""Fourth-order methods do not support the last two; the first uses the compiled code of other tests."""


def quick_or_long(names: Any) -> list[Any]:
    return [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in names]


def released(name: str, rest: Equilibrium) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and displacements [m] of the piston after its release."""
    assert rest.piston_height is not None
    scene = moved(
        rest,
        **{
            "piston.height": rest.piston_height + LIFT,
            "protocol": [{"name": "release", "kind": "free", "duration": "0.8 s"}],
            "output": {"scalars": "1 ms", "frames": "0.1 s"},
        },
    )
    method = {} if name in BY_VERLET else {"method": "pefrl"}
    data = simulate(scene, dt="auto/4", progress=False, **method).dataset
    return data.time.values, data.piston_height.values - rest.piston_height


@pytest.mark.parametrize("name", quick_or_long(SCENES))
def test_motion_after_a_small_lift_agrees_with_the_sum_over_eigenvalues(name: str) -> None:
    rest = at_rest(small_damper(**SCENES[name]))
    assert rest.is_stable
    if name == "viscous contact":
        assert smallest_gap(rest) < -0.01 * D
    time, found = released(name, rest)
    start = np.zeros(rest.pencil.bed.size)
    start[rest.pencil.bed.piston] = LIFT
    wanted = free_motion(rest, start, time)
    assert rms(found - wanted) < 1e-3 * rms(wanted)
    first = piston_roots(rest)[0]
    if first.mass_fraction > 0.95 and name != "machine that carries the cell":
        frequency, damping_ratio = fitted(time[time > EASED], found[time > EASED], first)
        assert frequency == pytest.approx(first.frequency, rel=1e-4)
        assert damping_ratio == pytest.approx(first.damping_ratio, rel=1e-3)


def smallest_gap(rest: Equilibrium) -> float:
    places, count = rest.positions, len(rest.positions)
    distances = np.hypot(*(places[:, None] - places).T)[np.triu_indices(count, 1)]
    return float(distances.min()) - D


def fitted(time: np.ndarray, found: np.ndarray, near: Root) -> tuple[float, float]:
    """Return natural frequency [Hz] and damping ratio of the decaying cosine fitted to a motion."""

    def off(s: np.ndarray) -> np.ndarray:
        motions = np.exp(np.outer(time, [complex(*s)]))
        columns = np.hstack([motions.real, motions.imag])
        return np.asarray(columns @ np.linalg.lstsq(columns, found, rcond=None)[0] - found) / LIFT

    s = complex(*least_squares(off, [near.s.real, near.s.imag], x_scale=[0.1, 1.0], xtol=1e-12).x)
    return abs(s) / math.tau, -s.real / abs(s)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.long  # quick: the release, above, and shaken machines in plain Python
@pytest.mark.parametrize("frequency", [1.0, 3.0, 5.0, 5.8, 7.0, 9.0, 14.0, 25.0])
def test_response_of_a_shaken_bed_agrees_with_its_linear_transmissibility(frequency: float) -> None:
    rest = at_rest(small_damper())
    scene = moved(
        rest,
        **{
            "effects.shaking": {"amplitude": LIFT, "frequency": frequency},
            "protocol": [{"name": "shake", "kind": "free", "duration": "2 s"}],
            "output": {"scalars": "1 ms", "frames": "0.1 s"},
        },
    )
    data = simulate(scene, dt="auto/4", method="pefrl", progress=False).dataset
    time = data.time.values
    late = time > EASED
    # The forced response, and the piston's transient due to the start.
    phases = math.tau * frequency * time[late]
    own = np.exp(piston_roots(rest)[0].s * time[late])
    columns = np.stack([np.sin(phases), np.cos(phases), own.real, own.imag], axis=1)
    along = np.linalg.lstsq(columns, data.piston_height.values[late] - rest.piston_height, rcond=None)[0]
    wanted = transmissibility(rest, np.array([frequency]))[0]
    assert abs(1.0 + complex(along[0], along[1]) / LIFT - wanted) < 1e-3 * abs(wanted)
