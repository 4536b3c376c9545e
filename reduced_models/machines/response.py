"""Differential equations of a bed coupled to its host, the structure that carries the damper.

The force of the bed follows the law of the annealing bed.

Let X be the displacement of the host, W = X' the velocity of host and cell, and z the piston's height in the
cell. Grains at height y that follow the piston affinely have the velocity W + z' y/z. With the masses M_h of
the host, M of the piston and m of the bed, the equations of motion of the whole system and of z are

    (M_h + M + m) W' + (M + m/2) z'' = -k X - c W + F sin(omega t),
    (M + m/2) W' + M_z z'' = M g ((rest/z)^power (1 + w) - 1) - N gamma z'/3,

with the host's stiffness k and damping c, and the drag gamma of each of the N grains. The law
(`reduced_models.laws.annealing_bed`) has the hidden states w and q; q enters through the equation of w. The
modulus and strength of the law were fitted to falls and oscillations of the packaged damper. Affine grains
add m/3 to the mass M_z that moves relative to the cell; the lag of the bed subtracts nearly as much. M_z,
the power and the equilibrium height follow from the scene (`reduced_models.falls.predicted_law`). Nothing is
fitted to a machine.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from granular.compiled import Array, compiled, entry
from granular.response.report_page import PredictedResponseForPage, response_page
from granular.response.response import FrequencyResponse
from granular.scene.scene import Scene
from granular.shared.array_types import Complex, Float
from granular.shared.blocks import Table, format_number
from granular.shared.errors import InputError, quote
from granular.shared.html_pages import Page
from reduced_models.falls.predicted_law import (
    POWER,
    ROWS,
    OutsideRangeWarning,
    affine_drag_coefficient,
    has_walls_of_touching_discs,
    lattice_under_piston_weight,
    piston_mass_and_gravity,
    predict_bed_parameters,
    predicted_moving_mass,
)
from reduced_models.laws.annealing_bed import HARDENING, MODULUS, PLASTIC, STIFFENING, STRENGTH, TIME

RANGE = (0.5, 2.0)
"""Range of the piston's amplitude relative to the cell [D]. In this range the peak of the packaged machine by
the law is within 10 % of the simulated peak; outside, the error is 20 %. The command
`python docs/pictures.py machine-law` shows the comparison."""
# The relative phase error of the classical Runge-Kutta method is (2 pi/64)^4/120 = 8e-7.
STEPS_A_PERIOD = 64
ORDER = 0.5
"""Initial order of the bed: the hidden state q of the law."""
SETTLING, MEASURED = 14.0, 0.4
"""Duration [s] of a sinusoidal drive; the amplitude is measured in this final fraction of the duration."""


class LinearOscillator(NamedTuple):
    """A linear law, z'' + 2 lam z' + omega^2 (z - rest) = 0."""

    omega: float  # [rad/s]
    lam: float  # [1/s]


class CoupledSystem(NamedTuple):
    """Parameters of the equation, in SI units."""

    host: float  # M_h [kg]
    stiffness: float  # k [N/m]
    damping: float  # c [N s/m]
    piston: float  # M [kg]
    bed: float  # m [kg]
    moving: float  # M_z [kg]
    drag: float  # N gamma/3 plus the piston's drag [N s/m]
    gravity: float  # [m/s^2]
    rest: float  # [m]
    modulus: float = MODULUS
    strength: float = STRENGTH
    power: float = POWER

    @classmethod
    def from_host_scene(cls, scene: Scene) -> CoupledSystem:
        """Return the parameters for a scene with a host that carries the cell."""
        host = scene.effects.host
        if host is None or host.mount != "cell" or len(host.bodies) != 1 or host.pistons or host.springs:
            raise InputError(
                "the law needs a host with a single body that carries the cell, but the scene "
                f"{quote(scene.name)} has none; give the scene such a host"
            )
        (body,) = host.bodies
        return cls.from_bed_scene(scene)._replace(
            host=body.mass, stiffness=body.stiffness, damping=body.damping
        )

    @classmethod
    def from_bed_scene(cls, scene: Scene) -> CoupledSystem:
        """Return the parameters for a scene's bed in a cell that does not move."""
        still = scene.replace(**{"effects.host": "none"})
        parameters, (mass, gravity) = predict_bed_parameters(still), piston_mass_and_gravity(still)
        lattice = lattice_under_piston_weight(still)
        softer, factor, _ = ROWS if has_walls_of_touching_discs(still) else (0.0, 1.0, 1.0)
        return cls(
            host=math.inf,
            stiffness=0.0,
            damping=0.0,
            piston=mass,
            bed=float(scene.grains.masses().sum()),
            moving=predicted_moving_mass(still, parameters),
            drag=affine_drag_coefficient(scene),
            gravity=gravity,
            rest=parameters["rest"],
            modulus=factor * MODULUS * lattice.relative_shear_modulus,
            power=lattice.power + softer,
        )

    @property
    def small_oscillation(self) -> LinearOscillator:
        """Small oscillation of the piston on an ordered bed in a fixed cell, according to the law."""
        stiffness = self.power + self.modulus * (1.0 + STIFFENING)
        spring = self.piston * self.gravity / self.rest * stiffness
        return LinearOscillator(math.sqrt(spring / self.moving), 0.5 * self.drag / self.moving)

    def linear_response(self, frequencies: Sequence[float], force: float) -> Complex[np.ndarray, "f"]:
        """Return the displacement (f,) [m] of the host with a linear law for the bed, at frequencies [Hz]."""
        omega = math.tau * np.asarray(frequencies, dtype=np.float64)
        own = self.stiffness + 1j * omega * self.damping
        own = own - omega**2 * (self.host + self.piston + self.bed)
        linear = self.small_oscillation
        bed = self.moving * (linear.omega**2 + 2j * omega * linear.lam - omega**2)
        coupled = self.piston + 0.5 * self.bed
        return np.asarray(force / (own - (omega**2 * coupled) ** 2 / bed))


@compiled
def _fill_state_rates(law: CoupledSystem, force: float, state: Array, rates: Array) -> None:
    x, speed, z, v, w, q = state[0], state[1], state[2], state[3], state[4], state[5]
    total, swing = law.host + law.piston + law.bed, law.piston + 0.5 * law.bed
    first = force - law.stiffness * x - law.damping * speed
    lift = (law.rest / z) ** law.power * (1.0 + w) - 1.0
    second = law.piston * law.gravity * lift - law.drag * v
    determinant = total * law.moving - swing * swing
    rates[0], rates[2] = speed, v
    rates[1] = (law.moving * first - swing * second) / determinant
    rates[3] = (total * second - swing * first) / determinant
    yields = law.strength * (1.0 + HARDENING * q)
    plastic = abs(v) * (w / yields) ** 4
    rates[4] = -law.modulus * (1.0 + STIFFENING * q) / z * (v + math.copysign(plastic, w))
    rates[5] = (1.0 - q) / TIME - q * plastic / (PLASTIC * z)


@entry
def fill_state_rates(
    law: CoupledSystem, force: float, state: Float[Array, "6"], rates: Float[Array, "6"]
) -> None:
    """Compute the rates of the state X, X', z, z', w and q [m, m/s] under a force [N]."""
    _fill_state_rates(law, force, state, rates)


@entry
def simulate_squared_amplitudes(
    law: CoupledSystem, force: float, omega: float, steps: int, last: int
) -> Float[Array, "2"]:
    """Return squared amplitudes [m^2] of host and piston in the last steps, by a Runge-Kutta method."""
    h = 2.0 * math.pi / omega / STEPS_A_PERIOD
    state, middle = np.zeros(6), np.zeros(6)
    state[2], state[5] = law.rest, ORDER
    slopes, sums = np.zeros((4, 6)), np.zeros(4)
    for n in range(steps):
        t = n * h
        _fill_state_rates(law, force * math.sin(omega * t), state, slopes[0])
        for stage in range(1, 4):
            part = h if stage == 3 else 0.5 * h
            for k in range(6):
                middle[k] = state[k] + part * slopes[stage - 1, k]
            _fill_state_rates(law, force * math.sin(omega * (t + part)), middle, slopes[stage])
        for k in range(6):
            state[k] += h / 6.0 * (slopes[0, k] + 2.0 * slopes[1, k] + 2.0 * slopes[2, k] + slopes[3, k])
        if n >= steps - last:
            sine, cosine = math.sin(omega * (t + h)), math.cos(omega * (t + h))
            sums[0] += 2.0 / last * state[0] * sine
            sums[1] += 2.0 / last * state[0] * cosine
            sums[2] += 2.0 / last * (state[2] - law.rest) * sine
            sums[3] += 2.0 / last * (state[2] - law.rest) * cosine
    squares = np.zeros(2)
    squares[0] = sums[0] * sums[0] + sums[1] * sums[1]
    squares[1] = sums[2] * sums[2] + sums[3] * sums[3]
    return squares


@dataclasses.dataclass(frozen=True, eq=False)
class PredictedResponse:
    """The response of a host according to the law."""

    frequencies: Float[np.ndarray, "f"]  # [Hz]
    displacement: Float[np.ndarray, "f"]  # amplitude of the host [m]
    stroke: Float[np.ndarray, "f"]  # amplitude of the piston over the cell [m]
    linear: Float[np.ndarray, "f"]  # amplitude of the host by the linearised law [m]
    outside: bool  # the stroke at the peak is outside `RANGE`

    @property
    def peak(self) -> float:
        """Maximum displacement [m]."""
        return float(self.displacement.max())


def predicted_response(
    scene: Scene, frequencies: Sequence[float], force: float | None = None
) -> PredictedResponse:
    """Solve the response of a scene's host by the law alone, in milliseconds per frequency.

    Parameters
    ----------
    scene : Scene
        Scene with a shaken host.
    frequencies : sequence of float
        Frequencies of the force [Hz].
    force : float, optional
        Amplitude of the force [N]; by default the scene's.

    Returns
    -------
    PredictedResponse
        Amplitudes [m] of host and piston at each frequency.

    Raises
    ------
    InputError
        If the scene's host is not one body that carries the cell, the law of its bed is unknown, or
        there is no force.

    Warns
    -----
    OutsideRangeWarning
        If the piston's amplitude at the peak is outside `RANGE`.
    """
    host = scene.effects.host
    law = CoupledSystem.from_host_scene(scene)
    if force is None and host is not None and host.excitation is not None:
        force = host.excitation.force
    if force is None:
        raise InputError("no force acts on the host; give force [N]")
    response = solve_host_response(law, frequencies, force)
    diameter = scene.grains.species[0].diameter
    stroke = float(response.stroke[int(response.displacement.argmax())]) / diameter
    outside = not RANGE[0] <= stroke <= RANGE[1]
    if outside:
        warnings.warn(
            f"the piston's amplitude relative to the cell is {stroke:.2g} D at the peak; the law is valid "
            f"for {RANGE[0]:g} to {RANGE[1]:g} D, so simulate the scene",
            OutsideRangeWarning,
            stacklevel=2,
        )
    return dataclasses.replace(response, outside=outside)


def solve_host_response(law: CoupledSystem, frequencies: Sequence[float], force: float) -> PredictedResponse:
    """Solve a host's response for given parameters of the law; ``frequencies`` are in Hz, ``force`` in N."""
    pairs = []
    for frequency in frequencies:
        periods = max(math.ceil(SETTLING * frequency), 10)
        last = max(math.floor(MEASURED * SETTLING * frequency), 4)
        pairs.append(
            simulate_squared_amplitudes(
                law, force, math.tau * frequency, periods * STEPS_A_PERIOD, last * STEPS_A_PERIOD
            )
        )
    swing, stroke = np.sqrt(np.array(pairs)).T
    linear = np.abs(law.linear_response(frequencies, force))
    return PredictedResponse(np.array(frequencies), swing, stroke, linear, False)


POINTS = 201
"""Number of frequencies at which the law is solved for each force."""


@dataclasses.dataclass(frozen=True)
class PeakComparison:
    """Maximum displacements at one force in one frequency range, from the simulation and from the law."""

    force: float  # [N]
    simulated: float  # [m]
    law: float  # [m]
    linear: float  # [m]
    outside: str

    @property
    def law_peak_error(self) -> float:
        """Relative error of the law's peak."""
        return self.law / self.simulated - 1.0

    @property
    def linear_peak_error(self) -> float:
        """Relative error of the linearised law's peak."""
        return self.linear / self.simulated - 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class ResponseComparison:
    """Response curves of the law, compared with a simulated response."""

    peaks: tuple[PeakComparison, ...]
    frequencies: Float[np.ndarray, "f"]  # [Hz]
    law: dict[float, np.ndarray]  # [m]
    linear: dict[float, np.ndarray]  # [m]

    @property
    def peak_table(self) -> Table:
        """Table of the peaks."""
        return Table(_HEAD, _peak_table_cells(self.peaks))


_HEAD = ("force [N]", "simulated [mm]", "law [mm]", "error [%]", "linear [mm]", "error [%]")


def compare_response(response: FrequencyResponse) -> ResponseComparison:
    """Solve the law for the scene, the forces and the frequency range of a response.

    Parameters
    ----------
    response : FrequencyResponse
        Simulated response of a shaken machine.

    Returns
    -------
    ResponseComparison
        Peaks [m] of law and simulation at each amplitude of the force [N], and curves of the law against
        frequency [Hz]. `reduced_models.falls.predicted_law` describes the law.

    Raises
    ------
    InputError
        If the law is unknown for the scene (see `CoupledSystem.from_host_scene`), or no force shakes it.
    """
    data = response.dataset
    if response.quantity != "force":
        raise InputError(
            f"the base of the machine is shaken by its {response.quantity}, but the "
            "law is solved for a force on the machine: simulate a force (--force)"
        )
    dense = np.linspace(float(data.frequency.min()), float(data.frequency.max()), POINTS)
    peaks, law, linear = [], {}, {}
    for force in data.amplitude.values.tolist():
        with warnings.catch_warnings(record=True, action="always", category=OutsideRangeWarning) as caught:
            predicted = predicted_response(response.scene, dense.tolist(), force)
        outside = [str(warning.message) for warning in caught if warning.category is OutsideRangeWarning]
        law[force], linear[force] = predicted.displacement, predicted.linear
        simulated = float(data.displacement.sel(amplitude=force).max())
        peaks.append(
            PeakComparison(force, simulated, predicted.peak, float(predicted.linear.max()), "".join(outside))
        )
    return ResponseComparison(tuple(peaks), dense, law, linear)


def response_page_comparison_and_reason(
    response: FrequencyResponse,
) -> tuple[Page, ResponseComparison | None, str]:
    """Return a response's page, the comparison with the law, and the reason if there is no comparison."""
    try:
        law = compare_response(response)
    except InputError as error:
        why = f"The simulation is shown without a law: {error}."
        return response_page(response, missing=why), None, why
    return response_page(response, _predicted_response_for_page(law)), law, ""


def _predicted_response_for_page(comparison: ResponseComparison) -> PredictedResponseForPage:
    notes = [f"Under {peak.force:g} N {peak.outside}." for peak in comparison.peaks if peak.outside]
    return PredictedResponseForPage(
        title="The law in place of the bed",
        words=(
            "The law is the ordinary differential equation of the annealing bed on this machine; "
            "nothing in it is fitted to a machine. 'Linear' is its small-amplitude limit, in which the bed "
            "does not yield. Errors are relative errors of the maximum displacement between the lowest "
            "and the highest frequency above; if few frequencies were "
            "simulated, their maximum may miss the peak."
        ),
        header=_HEAD,
        rows=_peak_table_cells(comparison.peaks),
        frequencies=comparison.frequencies,
        curves={"law": comparison.law, "linear law": comparison.linear},
        notes=notes,
    )


def _peak_table_cells(peaks: Sequence[PeakComparison]) -> list[tuple[str, ...]]:
    return [
        (
            f"{peak.force:g}",
            format_number(1e3 * peak.simulated, 3),
            format_number(1e3 * peak.law, 3),
            f"{100.0 * peak.law_peak_error:+.0f}",
            format_number(1e3 * peak.linear, 3),
            f"{100.0 * peak.linear_peak_error:+.0f}",
        )
        for peak in peaks
    ]
