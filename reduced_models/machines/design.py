"""Design a damper (bed, piston and drag) that minimises the vibration of a structure, by the identified law.

The structure that carries the damper is called the host. The module also exports the bed of a scene as a
force element between two bodies. The bed's force acts on the piston, and its reaction on the cell. The bed's
mass is not part of the element; `mass_matrix` gives the masses if grains follow the piston affinely.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from granular.effects.excitation import HostExcitation
from granular.effects.host_structure import Host
from granular.linear.equilibrium import equilibrium_from, settled_scene_positions_and_heights
from granular.response.linear_system import amplitudes_without_damper_and_with_tuned_mass, total_damper_mass
from granular.response.response import DURATION, FrequencyResponse, frequency_response
from granular.scene.named_scenes import damper, load_scene
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.errors import InputError
from reduced_models.falls.predicted_law import FEWEST, OutsideRangeWarning, PredictedLaw
from reduced_models.falls.workshop import workshop_sheet
from reduced_models.laws.annealing_bed import ANNEALING_BED
from reduced_models.machines.response import (
    ORDER,
    RANGE,
    CoupledSystem,
    PredictedResponse,
    solve_host_response,
)
from reduced_models.models.at_rest import AtRest
from reduced_models.models.export import write_code
from reduced_models.models.ports import ForcePort

if TYPE_CHECKING:
    from collections.abc import Iterator

    from granular.shared.html_pages import Page


HELPS = 0.9
"""Ratio of the peaks with and without the damper below which the damper is worthwhile."""
_COARSE = np.linspace(0.6, 1.3, 15)
"""Frequencies at which the response with a trial damper is solved, relative to the host's natural frequency.
"""
_DRAGS = (0.05, 0.1, 0.2, 0.3, 0.45, 0.65, 0.9)
_FRACTIONS = (0.6, 0.8, 1.0)
"""Trial masses of the piston, as fractions of the mass limit."""
_COUNTS = (276, 368, 460, 552, 736)
_HELD_STILL = {
    "effects.host": None,
    "protocol": [{"name": "drop", "kind": "free", "until": "rest", "tolerance": "1e-2 D"}],
}
"""Changes of a scene that hold the machine still and let the bed settle."""
_FILLED = 0.55
"""Maximum packing fraction: area of the grains divided by the area below the piston at equilibrium."""
POINTS, NEAR, MARGIN = 9, 0.6, 0.03
"""Number of simulated frequencies. They cover the range in which the law exceeds the fraction NEAR of its
peak, extended by the relative margin MARGIN. A host with a damper has two resonance peaks, and the law may be
wrong about which is higher.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class DamperDesign:
    """A damper designed for a host."""

    scene: Scene
    law: PredictedResponse
    alone: float  # [m]
    ideal: float  # [m]
    stroke: float  # [m]
    mass: float  # [kg]
    outside: str  # reason if the law is used outside its tested range; empty inside
    simulated: FrequencyResponse | None = None
    seconds: float = 0.0

    @property
    def peak(self) -> float:
        """Maximum displacement of the host according to the law [m]."""
        return self.law.peak

    @property
    def simulated_peak(self) -> float | None:
        """Maximum displacement of the host in the simulation [m]; None without a simulation."""
        return None if self.simulated is None else self.simulated.peak

    @property
    def reduction(self) -> float:
        """Relative reduction of the peak by the damper, from the simulation or, without one, from the law."""
        simulated = self.simulated_peak
        return 1.0 - (self.peak if simulated is None else simulated) / self.alone

    @property
    def is_worthwhile(self) -> bool:
        """True if the damper reduces the peak by a tenth or more."""
        return self.reduction > 1.0 - HELPS

    @property
    def verdict(self) -> str:
        """Sentences that describe the damper and its effect on the host."""
        drag, piston = self.scene.effects.drag, self.scene.piston
        assert piston is not None
        description = (
            f"{self.scene.grains.count} grains, a piston of {piston.mass:.3g} kg and a drag of "
            f"{0.0 if drag is None else drag.coefficient:.2g} kg/s"
        )
        figures = f"{1e3 * self.peak:.3g} mm at the peak by the law, "
        if self.simulated is not None:
            known = self.simulated.dataset.frequency.values
            figures += (
                f"{1e3 * self.simulated.peak:.3g} mm simulated at {len(known)} frequencies from "
                f"{known.min():.3g} to {known.max():.3g} Hz (in {self.seconds:.0f} s), "
            )
        figures += (
            f"{1e3 * self.alone:.3g} mm without a damper, {1e3 * self.ideal:.3g} mm with an ideal tuned "
            "mass damper of the same mass"
        )
        if self.outside:
            figures += f"; {self.outside}"
            if self.simulated is None:
                figures += ": simulate it"
        if not self.is_worthwhile:
            return (
                f"no damper is worthwhile: the best bed, {description}, hardly reduces the vibration: "
                f"{figures}"
            )
        return f"{description}, reduce the peak by {100.0 * self.reduction:.3g} %: {figures}"

    def workshop_sheet_page(self) -> Page:
        """Make a sheet for building the damper, after letting the bed settle with the machine held still."""
        scatter = [
            "Predicted by the law alone. The spread over packings is unknown, and in comparisons with "
            "simulations the error of the peak was up to 10 %; simulate=True adds a simulation."
        ]
        if self.simulated is not None:
            off = self.peak / self.simulated.peak - 1.0
            scatter = [
                f"Simulated for one packing: {1e3 * self.simulated.peak:.3g} mm at the peak; by the "
                f"law {1e3 * self.peak:.3g} mm ({100.0 * off:+.0f} %)."
            ]
        state = settled_scene_positions_and_heights(self.scene.replace(**_HELD_STILL))
        return workshop_sheet(
            self.scene,
            float(state[2][0]),
            lambda: equilibrium_from(*state),
            amplitude=self.stroke,
            title=f"Workshop sheet: damper of {self.mass:.3g} kg",
            lead=f"{self.verdict}.",
            scatter=scatter,
            notes=[self.outside] if self.outside else [],
        )

    def __str__(self) -> str:
        return self.verdict


def design_for(
    host: Host,
    excitation: HostExcitation,
    *,
    limit: float,
    magnets: str = "dipoles",
    simulate: bool | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    progress: bool = True,
) -> DamperDesign:
    """Design a damper of limited mass, like the packaged one, that minimises the peak of its host.

    The host is the structure that carries the damper; its peak is its maximum displacement.

    The damper has grains of 6 mm diameter in a cell 60 diameters wide. The number of grains, the piston's
    mass and the drag are optimised with the law, which does not include the spread over packings. If the
    piston's amplitude is outside `RANGE`, in which the law was compared with simulations, a warning is given
    and the damper is simulated at 9 frequencies about the peak.

    Parameters
    ----------
    host : Host
        Host of one body on a spring that carries the cell.
    excitation : HostExcitation
        Sinusoidal force [N] of any frequency.
    limit : float
        Maximum mass of piston and grains [kg].
    magnets : str
        ``"dipoles"``, or ``"cylinders"``: discs as in the packaged scene ``magnets``.
    simulate : bool, optional
        True to simulate the damper, False to use only the law. By default the damper is simulated only
        outside the law's range.
    out : str or Path, optional
        Directory for the simulations; the same call continues them.
    workers : int, optional
        Number of processes; by default the number of processors.
    progress : bool
        Show a progress bar on standard error, with the remaining time.

    Returns
    -------
    DamperDesign
        Damper, and the peaks of the host [m] with and without the damper.

    Raises
    ------
    InputError
        If the host is of another type, there is no force, or the limit leaves no mass for a piston.
    GranularError
        If a simulation failed.

    Warns
    -----
    OutsideRangeWarning
        If the law is outside of its range; the warning gives its prediction and the planned simulation.
    """
    if len(host.bodies) != 1 or host.bodies[0].stiffness <= 0.0:
        raise InputError("design_for needs a host with a single body on a spring; give such a host")
    if excitation.kind != "sine" or not excitation.force:
        raise InputError("design_for needs a sinusoidal force; give excitation.force in N")
    (body,) = host.bodies
    own = math.sqrt(body.stiffness / body.mass) / math.tau
    frequencies = [float(own * ratio) for ratio in _COARSE]
    tried = [
        (solve_host_response(CoupledSystem.from_host_scene(scene), frequencies, excitation.force), scene)
        for scene in _candidate_dampers(host, excitation, limit, magnets)
    ]
    if not tried:
        raise InputError(
            f"limit = {limit:g} kg leaves no mass for a piston on {FEWEST} or more grains; increase limit"
        )
    _, best = min(tried, key=lambda pair: pair[0].peak)
    fine = [float(own * ratio) for ratio in np.linspace(0.6, 1.4, 81)]
    response = solve_host_response(CoupledSystem.from_host_scene(best), fine, excitation.force)
    bare, dense = Host(bodies=host.bodies, excitation=excitation), own * np.linspace(0.6, 1.4, 801)
    alone, ideal = (
        amplitudes_without_damper_and_with_tuned_mass(best, bare, "force", excitation.force, dense)
        .max(axis=1)
        .tolist()
    )
    stroke = float(response.stroke[int(response.displacement.argmax())])
    outside = _outside_range_text(stroke / best.grains.species[0].diameter)
    proposal = DamperDesign(best, response, alone, ideal, stroke, total_damper_mass(best), outside)
    wanted = bool(outside) if simulate is None else simulate
    if outside:
        words = f"{outside}; it predicts {1e3 * proposal.peak:.3g} mm at the peak"
        if wanted:
            words += (
                f"; simulating {POINTS} frequencies of {DURATION:g} s with "
                f"{best.grains.count} grains (simulate=False skips this)"
            )
        warnings.warn(words, OutsideRangeWarning, stacklevel=2)
    if not wanted:
        return proposal
    started = time.perf_counter()
    simulated = frequency_response(
        best, _frequencies_near_peak(response), dt="auto*4", out=out, workers=workers, progress=progress
    )
    seconds = time.perf_counter() - started
    return dataclasses.replace(proposal, simulated=simulated, seconds=seconds)


def _frequencies_near_peak(response: PredictedResponse) -> list[float]:
    """Return frequencies [Hz] that cover the peak, even if the simulated peak is slightly shifted."""
    near = response.frequencies[response.displacement > NEAR * response.peak]
    low, high = (1.0 - MARGIN) * near.min(), (1.0 + MARGIN) * near.max()
    return [float(frequency) for frequency in np.linspace(low, high, POINTS)]


def _outside_range_text(stroke: float) -> str:
    if RANGE[0] <= stroke <= RANGE[1]:
        return ""
    beyond = "less" if stroke < RANGE[0] else "more"
    return (
        f"the piston's amplitude is {stroke:.2g} D by the law, {beyond} than the {RANGE[0]:g} to "
        f"{RANGE[1]:g} D for which it was compared with simulations"
    )


def _candidate_dampers(host: Host, excitation: HostExcitation, limit: float, magnets: str) -> Iterator[Scene]:
    start = load_scene("machine").replace(
        **{"effects.host": Host(bodies=host.bodies, excitation=excitation).to_plain()}
    )
    if magnets != "dipoles":
        discs = damper(magnets=magnets).to_plain()
        start = start.replace(**{"grains": discs["grains"], "effects.contact": discs["effects"]["contact"]})
    for count in _COUNTS:
        bed = float(start.replace(**{"grains.count": 1}).grains.masses().sum()) * count
        for fraction, drag in itertools.product(_FRACTIONS, _DRAGS):
            mass = fraction * (limit - bed)
            if not mass > 0.5:
                continue
            diameter = start.grains.species[0].diameter
            height = 16.0 * diameter * max(count / 368.0, 1.0)
            scene = start.replace(
                **{
                    "grains.count": count,
                    "piston.mass": mass,
                    "effects.drag.coefficient": drag,
                    "piston.height": height,
                    "arrangement.height": height - diameter,
                }
            )
            try:
                law = CoupledSystem.from_host_scene(scene)
            except InputError:  # the drag is above the range of the law
                continue
            filled = count * math.pi / 4.0 * diameter**2 / (law.rest * scene.cell.width)
            if law.rest < height and filled < _FILLED:
                yield scene


def export_bed(scene: Scene, path: str | Path, *, fmi: int = 2) -> str:
    """Write the bed of a scene as an element between two bodies, from the scene alone.

    The element's inputs are height [m] and velocity [m/s] of the piston relative to the cell; its output
    is the force of the bed on the piston [N]. It does not include the bed's mass.

    Parameters
    ----------
    scene : Scene
        Scene of a piston with a mass on magnets that are damped only by drag.
    path : str or Path
        File to write: ``.py``, ``.c`` (with its header), ``.m``, ``.mo`` or ``.fmu``.
    fmi : int
        Version of FMI of an ``.fmu``, 2 or 3.

    Returns
    -------
    str
        Language of the file.

    Raises
    ------
    InputError
        If the law of the bed is unknown, the ending is not supported, or the file cannot be written.

    Examples
    --------
    >>> from granular import load_scene
    >>> from reduced_models.machines import export_bed
    >>> export_bed(load_scene("damper"), "Bed.mo")
    'a Modelica model'
    """
    return write_code(bed_force_port(scene), Path(path), fmi)


def bed_force_port(scene: Scene) -> ForcePort:
    """Return a force element with the law of a scene's bed."""
    system = CoupledSystem.from_bed_scene(scene)
    load, oscillator = system.piston * system.gravity, system.small_oscillation
    values = {
        "lam": 0.5 * system.drag / system.moving,
        "weight": load / system.moving,
        "rest": system.rest,
        "power": system.power,
        "modulus": system.modulus,
        "strength": system.strength,
    }
    at_rest = AtRest(system.rest, math.tau / oscillator.omega, oscillator.lam / oscillator.omega, {})
    model = PredictedLaw(
        ANNEALING_BED,
        values,
        (system.rest, 0.0),
        at_rest,
        provenance={"data": f"none, from the scene {scene.name}"},
        hidden={"q": ORDER},
    )
    return ForcePort(model, system.moving, load)


def mass_matrix(system: CoupledSystem) -> Float[np.ndarray, "2 2"]:
    """Return the mass matrix [kg] for the host, and the piston relative to the cell."""
    # The bed counts by half in the coupling mass, as affine grains move half the piston's stroke on average.
    swing = system.piston + 0.5 * system.bed
    return np.array([[system.host + system.piston + system.bed, swing], [swing, system.moving]])
