"""Figures of a whole fall from the scene alone, in milliseconds.

The law of a fall is multiplied by the mass that moves, m = WEIGHT M g/weight (`theory`), to tell
where the energy goes: the piston's drop M g (height - rest) and what it does against the bed. Of
grains without friction all of it leaves as drag. The fraction of grains that follow the piston
affinely is m 2 lam z'^2; the work of the shear stress, -m weight (rest/z)^power w z', is what
grains lose beyond that, as they rearrange.
"""

from __future__ import annotations

import math
import warnings
from numbers import Real
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.falls.lattice_pressure import touching_lattice_density
from reduced_models.falls.predicted_law import (
    LAW,
    OutsideRangeWarning,
    accelerated_mass,
    affine_drag,
    mass_and_gravity,
    predict_bed_parameters,
)
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.solution import solve_law

if TYPE_CHECKING:
    from granular.scene.scene import Scene

SETTLED = 0.05
"""Share of the drop: a piston has settled that stays within this distance of its level of rest."""
TOUCHING = 1.05
"""Least height, over that of a lattice of discs that touch, to which falls were compared with the law:
from 1.09 on it is within 3 % of the drop, at 1.02 and 0.89 it is 5 and 8 % off."""
DURATION = 3.0
"""Duration of a fall [s], times the fourth root of the grains over 368, as its period goes."""
SAMPLES = 3001


class FallSummary(NamedTuple):
    """Figures of a fall that begins at rest.

    Attributes
    ----------
    height, rest : float
        Of the start, and where it ends [m].
    settling_time : float
        From which on the piston stays within 5 % of the drop about its level of rest [s]; infinite
        where the fall is not followed for so long.
    greatest_force : float
        Of the bed on the piston [N].
    deepest : float
        Least height of the piston [m].
    affine_loss : float
        Energy that the drag of grains takes that follow the piston affinely [J].
    excess_loss : float
        Energy lost beyond that, by grains that rearrange [J].
    simulated : FallSummary or None
        The same of a simulation, where one was run.
    """

    height: float
    rest: float
    settling_time: float
    greatest_force: float
    deepest: float
    affine_loss: float
    excess_loss: float
    simulated: FallSummary | None = None

    @property
    def loss_over_affine(self) -> float:
        """Energy lost over that lost by grains that follow the piston affinely, without unit."""
        return 1.0 + self.excess_loss / self.affine_loss

    def __str__(self) -> str:
        settled = (
            f"settles in {self.settling_time:.3g} s"
            if math.isfinite(self.settling_time)
            else "does not settle in the time that is followed"
        )
        text = (
            f"falls from {1e3 * self.height:.4g} mm to rest at {1e3 * self.rest:.4g} mm, and "
            f"{settled}\n"
            f"deepest at {1e3 * self.deepest:.4g} mm, greatest force {self.greatest_force:.4g} N\n"
            f"lost to drag: {self.affine_loss:.4g} J as of affine motion, and "
            f"{self.excess_loss:.4g} J as grains rearrange"
        )
        simulated = self.simulated
        return text if simulated is None else f"by the law: {text}\nsimulated: {simulated}"


def whole_fall(
    scene: Scene, height: float | None = None, *, simulate: bool | None = None, progress: bool = True
) -> FallSummary:
    """Return figures of a fall by the law of `predict`, and simulate it where the law is uncertain.

    The fall begins at rest, and is followed for 3 s (N/368)^(1/4), N the number of grains.

    Parameters
    ----------
    scene : Scene
        Scene of a bed below a falling piston without friction.
    height : float, optional
        Height of the start [m], finite and above the level of rest; that of the scene's piston if
        not given.
    simulate : bool, optional
        Simulate the fall always, or never; if not given, where the law is outside its range, as
        warnings say.
    progress : bool
        Show a progress bar of the simulation on standard error, with the time that is left.

    Returns
    -------
    FallSummary
        Heights of start and rest and the least one [m], settling time [s] (infinite where it does
        not settle while it is followed), greatest force [N] and energies lost [J]; and the same of
        the simulation, where one was run.

    Raises
    ------
    InputError
        If the scene has no piston with a mass under gravity, no dipoles or discs, friction of the
        piston, or effects other than dipoles or discs, walls, gravity, drag and contact; if it has
        walls or a cut-off that `predict` refuses; if its piston presses discs together at rest; or
        if the height is no finite number above the level of rest.
    RunError
        If the simulation cannot be trusted any more.

    Warns
    -----
    OutsideRangeWarning
        With too few grains for what was measured, rows of discs that do not touch, more drag over
        the piston's mass than was compared with falls, or a fall that presses discs together.
    """
    if height is not None and not isinstance(height, Real):
        raise InputError(f"height = {quote(height)}; give a number [m]")
    with warnings.catch_warnings(record=True, action="always") as caught:
        values = predict_bed_parameters(scene, refuse_outside_range=False)
    for warning in caught:
        warnings.warn(warning.message, stacklevel=2)
    outside = any(warning.category is OutsideRangeWarning for warning in caught)
    result = _summarise_fall_by_law(scene, values, height)
    if pressed := _touching_discs_text(scene, result.deepest):
        outside = True
        warnings.warn(pressed, OutsideRangeWarning, stacklevel=2)
    if not (outside if simulate is None else simulate):
        return result
    return result._replace(simulated=_summarise_simulated_fall(scene, result.height, progress))


def _summarise_fall_by_law(scene: Scene, values: dict[str, float], height: float | None) -> FallSummary:
    from scipy.integrate import simpson

    piston, (mass, gravity) = scene.piston, mass_and_gravity(scene)
    assert piston is not None
    start = piston.height if height is None else float(height)
    if not values["rest"] < start < math.inf:
        raise InputError(
            f"the fall begins at {start:g} m, not above the level of rest, {values['rest']:g} m; "
            "give a greater height"
        )
    times = np.linspace(0.0, _fall_duration(scene), SAMPLES)
    numbers = [values[name] for name in LAW.parameters]
    z, v, w = solve_law(LAW, times, start, 0.0, numbers, start - values["rest"]).states.T
    acceleration = np.asarray(compile_rates(LAW.equation, (), "numpy")(z, v, w, *numbers)[0])
    force = mass * (gravity + acceleration)
    stress = values["weight"] * (values["rest"] / z) ** values["power"] * w
    powers = np.stack([2.0 * values["lam"] * v**2, -stress * v])
    losses = accelerated_mass(scene, values) * simpson(powers, x=times)
    return _summary(times, z, force, values["rest"], losses)


def _touching_discs_text(scene: Scene, deepest: float) -> str:
    """Say that a fall presses discs together, which the law does not know; empty where it does not."""
    grains = scene.grains
    touching = (
        grains.count * grains.species[0].diameter ** 2 / (scene.cell.width * touching_lattice_density(grains))
    )
    if grains.magnets == "dipoles" or deepest > TOUCHING * touching:
        return ""
    return (
        f"the piston falls to {1e3 * deepest:.4g} mm by the law, where discs of {quote(scene.name)} touch "
        f"(a lattice of them at {1e3 * touching:.4g} mm); simulate the fall, or let it begin lower"
    )


def _fall_duration(scene: Scene) -> float:
    return DURATION * (scene.grains.count / 368) ** 0.25


def _summary(
    times: np.ndarray, z: np.ndarray, force: np.ndarray, rest: float, losses: np.ndarray
) -> FallSummary:
    outside = np.flatnonzero(np.abs(z - rest) > SETTLED * (z[0] - rest))
    settled = math.inf if outside[-1] + 1 == len(times) else float(times[outside[-1] + 1])
    affine, excess = losses.tolist()
    return FallSummary(float(z[0]), rest, settled, float(force.max()), float(z.min()), affine, excess)


def _summarise_simulated_fall(scene: Scene, start: float, progress: bool) -> FallSummary:
    """Figures of the same fall in a simulation, which takes its last tenth for rest."""
    from granular import simulate

    diameter = scene.grains.species[0].diameter
    run = simulate(
        scene.replace(
            **{
                "piston.height": start,
                "arrangement.height": start - diameter,
                "output.record": None,
                "protocol": [{"kind": "free", "name": "drop", "duration": _fall_duration(scene)}],
            }
        ),
        dt="auto*2",
        progress=progress,
    )
    motion = run.piston()
    assert motion.velocity is not None
    assert motion.force is not None
    affine = affine_drag(scene) * float(np.trapezoid(motion.velocity**2, motion.time))
    losses = [name for name in ("drag_loss", "contact_loss") if name in run.dataset]
    lost = sum(float(run.dataset[name].values[-1]) for name in losses)
    rest = float(motion.height[-len(motion.height) // 10 :].mean())
    return _summary(motion.time, motion.height, motion.force, rest, np.array([affine, lost - affine]))
