"""`derive`: the piston's law from the equilibria and complex roots of its bed; nothing is fitted to a motion.

With the piston held at a height z, the bed pulls it down by F(z), and small motions about that have the
complex root s. Mass and damping follow from it by (M + m) s^2 + c s + F' = 0, so

    (M + m(z)) z'' + m'(z)/2 z'^2 + c(z) z' + F(z) = 0

has the exact root at rest, and loses energy by c alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from granular.linear.equilibrium import Equilibrium, equilibrium
from granular.linear.roots import MASS_FRACTION, Root, modal_coordinate, piston_roots, require_free_piston
from granular.protocol.stages import Lift
from granular.records.record import PistonRecord
from granular.run.trajectory import Trajectory, frame_heights
from granular.scene.scene import Scene
from granular.shared.errors import InputError, RecordError
from reduced_models.derived.polynomial_law import (
    HIGHEST_ORDER,
    HeldState,
    Instability,
    energy_backbone,
    follow_piston,
    held_state,
    polynomial_law,
)
from reduced_models.models.at_rest import AtRest
from reduced_models.models.model import ReducedModel
from reduced_models.models.quantities import Quality, format_percent
from reduced_models.records.backbone import Backbone
from reduced_models.records.envelope import find_extremes
from reduced_models.records.sources import open_source

REACH = 0.2
"""Range to both sides of the equilibrium [D], if the scene has no lift."""

STEP = 0.025
"""Longest step of the piston [D]."""

FEWEST_STEPS = 4
"""Fewest steps to each side."""

CYCLES = 10
"""Cycles of a run that the law is compared with, from the second extreme."""

FRACTIONS = (1.0, 0.5, 0.1)
"""Amplitudes of the printed backbone, over the shorter side of the range."""

REARRANGED = 0.5
"""Displacement of a grain [D] from which on a state is of another packing, and has no part of its roots."""

NAMED = 8
"""Most grains of an instability that are printed."""

GRADUAL = 1e-9
"""Drop of the force over the piston's weight, below which it is rounding."""


class MotionError(NamedTuple):
    """Error of a law's motion from a run's second extreme.

    Attributes
    ----------
    relative : float
        Rms difference of the heights over the run's rms displacement from the law's equilibrium.
    mean_shift : float
        Mean height of the law's motion less that of the run's [m].
    rms : float
        Rms difference of the heights [m].
    samples : int
        Samples compared.
    """

    relative: float
    mean_shift: float
    rms: float
    samples: int


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class DerivedModel(ReducedModel):
    """A law from a bed's equilibria and roots; `ReducedModel` has all other attributes and the methods.

    A file keeps the law and the print-out; the attributes below are those of `derive` alone.

    Attributes
    ----------
    states : tuple of HeldState
        Height [m], force F [N], stiffness dF/dz [N/m], mass M + m [kg], damping c [N s/m] and root [1/s] at
        each height, the lowest first.
    instabilities : tuple of Instability
        Instabilities that end the range below or above.
    error : MotionError or None
        Error against a run; None if it was compared with none.
    """

    states: tuple[HeldState, ...] = ()
    instabilities: tuple[Instability, ...] = ()
    error: MotionError | None = None

    def backbone(self, amplitudes: Sequence[float]) -> Backbone:
        """Frequency and damping ratio over amplitude, by the energy of the undamped cycle and its loss.

        Parameters
        ----------
        amplitudes : sequence of float
            Half distances of the two extremes of a cycle, above 0 [m].

        Returns
        -------
        Backbone
            Angular frequency [rad/s] and damping ratio of a cycle of each amplitude, as (n,) arrays.

        Raises
        ------
        InputError
            If an amplitude is not above zero, or the force does not pull back from its cycle's extremes.
        """
        return energy_backbone(self.parameters, amplitudes)


def derive(
    source: Scene | Trajectory | str | Path,
    reach: float | None = None,
    *,
    order: int | None = None,
    against: Trajectory | PistonRecord | str | Path | None = None,
) -> DerivedModel:
    """Derive the law of a piston on its bed from equilibria and complex roots, without a fit.

    The piston is held at heights about its equilibrium, up to the first instability on each side, if there is
    one. The law is (M + m) z'' + m'/2 z'^2 + c z' + F = 0 with polynomials F, m and c of the height, over the
    mass M + m at equilibrium. Drives, thermal motion and dry friction of the scene are not in it.

    Parameters
    ----------
    source : Scene, Trajectory, str or Path
        A run, or its directory, whose last frame is taken for the settled bed; or a scene, whose protocol is
        run up to the first rest.
    reach : float, optional
        Range to both sides of the equilibrium [m]; without, the scene's lift, or 0.2 D.
    order : int, optional
        Order of F, from 1 to 9; m and c have one less. Without, the lowest for a residual of 1e-5.
    against : Trajectory, PistonRecord, str or Path, optional
        Free oscillation that the law is compared with, from its second extreme on over ten cycles; without,
        the release of a run that is the source.

    Returns
    -------
    DerivedModel
        Model whose motion starts at the run's release, if the source has one: as the projection of its state
        on the root, or as it is if grains have rearranged since. Otherwise at rest at the top of the range.

    Raises
    ------
    InputError
        If the bed has no free piston, no equilibrium or no oscillation, or a machine carries it, the reach is
        not above 0 and below the piston's height, the order is another one, nothing is left of the range, or
        no polynomial of any order follows mass, damping and force there within a hundredth.
    RecordError
        If ``against`` has fewer than two extremes.

    Examples
    --------
    >>> from granular import damper
    >>> from reduced_models import derive
    >>> model = derive(damper(count=48, drop=24.0), reach=1e-4)  # [m]
    >>> model.law.name, bool(abs(model.states[-1].force) > 0.0)
    ('derived', True)
    """
    opened = open_source(source) if isinstance(source, str | Path) else source
    if not isinstance(opened, Scene | Trajectory):
        raise InputError(f"{type(opened).__name__} is no bed; give a scene or a run")
    rest = equilibrium(opened)
    bed, piston = rest.pencil.bed, require_free_piston(rest)
    if bed.machine is not None:
        raise InputError("a piston on a machine has no law of its height alone; take effects.host away")
    if reach is None:
        lifts = [abs(stage.by) for stage in rest.scene.protocol if isinstance(stage, Lift)]
        reach = lifts[-1] if lifts else REACH * bed.length
    height = float(rest.pencil.at[piston])
    if not 0.0 < reach < height:
        raise InputError(f"reach = {reach:g} m; give a number above 0 and below the piston's {height:.4g} m")
    if order is not None and not 1 <= order <= HIGHEST_ORDER:
        raise InputError(f"order = {order}; give a number from 1 to {HIGHEST_ORDER}")
    root = piston_roots(rest)[0]
    count = max(FEWEST_STEPS, math.ceil(reach / (STEP * bed.length)))
    below, above = (
        follow_piston(rest.pencil, piston, root.s, side * reach / count, count) for side in (-1.0, 1.0)
    )
    states = (*reversed(below[0]), held_state(rest.pencil, piston, root.s), *above[0])
    instabilities = tuple(end for _, end in (below, above) if end is not None)
    if len(states) < 3:
        raise InputError(f"the bed is not stable {1e3 * reach / count:.2g} mm off; give a smaller reach")
    small = {"height": height, "period": 1.0 / root.frequency, "damping_ratio": root.damping_ratio}
    law, values, accuracy = polynomial_law(states, len(below[0]), order)
    model = DerivedModel(
        law=law,
        parameters=values,
        intervals=_exact(values),
        confidence=0.95,
        initial=(states[-1].height, 0.0),
        at_rest=AtRest(height, small["period"], small["damping_ratio"], _exact(small)),
        quality=Quality(0.0, 0.0, None, (), 0, 0, 0, 0.0),
        domain={"height": (states[0].height, states[-1].height)},
        notes=_notes(rest, root, instabilities),
        states=states,
        instabilities=instabilities,
    )
    record = _open_motion(against)
    if isinstance(opened, Trajectory) and (release := _release(opened)) is not None:
        model = dataclasses.replace(model, initial=_projected_start(opened, release, rest, root))
        record = record or opened.piston(release)
    if record is not None:
        error = motion_error(model, record)
        quality = dataclasses.replace(
            model.quality, residual=error.rms, relative=error.relative, samples=error.samples
        )
        model = dataclasses.replace(model, error=error, quality=quality)
    low, high = (1e3 * end for end in model.domain["height"])
    ending = "" if instabilities else ", without an instability"
    lines = [
        f"derived from the scene {rest.scene.name}: nothing is fitted to a motion",
        f"piston held at {len(states)} heights, from {low:.5g} to {high:.5g} mm{ending}",
        f"polynomials: {accuracy}; mass that moves {states[len(below[0])].mass:.5g} kg",
        f"backbone: {_backbone_text(model)}",
    ]
    if model.error is not None:
        lines.append(
            f"against the run, {CYCLES} cycles from the second extreme: error "
            f"{format_percent(model.error.relative)} of the rms displacement, mean shift "
            f"{1e6 * model.error.mean_shift:.2g} um"
        )
    data = f"equilibria and roots of the scene {rest.scene.name}"
    return dataclasses.replace(model, provenance={"data": data, "record": "\n".join(lines)})


def _open_motion(against: Trajectory | PistonRecord | str | Path | None) -> PistonRecord | None:
    opened = open_source(against) if isinstance(against, str | Path) else against
    if isinstance(opened, Scene):
        raise InputError(f"the scene {opened.name} has no motion; run it, and give the run's directory")
    return opened.piston() if isinstance(opened, Trajectory) else opened


def motion_error(model: ReducedModel, record: PistonRecord) -> MotionError:
    """Compare a model with a free oscillation from its second extreme on, over ten cycles."""
    extremes, rest = find_extremes(record), model.at_rest
    if rest is None or len(extremes) < 2:
        raise RecordError(f"{len(extremes)} extremes of the height are seen; give a free oscillation")
    start, height = float(extremes.time[1]), float(extremes.height[1])
    chosen = (record.time > start) & (record.time <= start + CYCLES * rest.period)
    seen = record.height[chosen]
    difference = model.simulate(np.append(start, record.time[chosen]), height, 0.0).height[1:] - seen
    rms = float(np.sqrt((difference**2).mean()))
    displacement = float(np.sqrt(((seen - rest.height) ** 2).mean()))
    return MotionError(rms / displacement, float(difference.mean()), rms, len(seen))


def _release(run: Trajectory) -> str | None:
    """Name of the stage of a run behind its last lift, if it has one."""
    lifts = [stage.name for stage in run.scene.protocol if isinstance(stage, Lift)]
    names = [stage.name for stage in run.stages]
    behind = names[names.index(lifts[-1]) + 1 :] if lifts and lifts[-1] in names else []
    return behind[0] if behind else None


def _projected_start(run: Trajectory, stage: str, rest: Equilibrium, root: Root) -> tuple[float, float]:
    """Height [m] and velocity [m/s] at the start of a stage, of the motion by the root alone."""
    bed, data, start = rest.pencil.bed, run.dataset, run.stage(stage).start
    piston = require_free_piston(rest)
    frame = int(np.searchsorted(data["frame_time"].values, start + 1e-9, side="right")) - 1
    record = run.piston(stage)
    assert record.velocity is not None
    heights = frame_heights(run.scene, data)[frame]
    heights[0] = record.height[0]
    away = bed.coordinates(data["position"].values[frame], heights) - rest.pencil.at
    if np.abs(away).max() > REARRANGED * bed.length:
        return float(record.height[0]), float(record.velocity[0])
    velocity = np.zeros(bed.size)
    velocity[: 2 * bed.grains] = data["velocity"].values[frame].T.ravel()
    velocity[piston] = record.velocity[0]
    part = modal_coordinate(rest.pencil, root, away, velocity)
    return float(rest.pencil.at[piston] + 2.0 * part.real), 2.0 * (part * root.s).real


def _exact(values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Intervals of values that have no error."""
    return {name: (value, value) for name, value in values.items()}


def _notes(rest: Equilibrium, root: Root, instabilities: Sequence[Instability]) -> tuple[str, ...]:
    notes = []
    if root.mass_fraction < 1.0 - MASS_FRACTION:
        part = f"{100.0 * root.mass_fraction:.2g} %"
        notes.append(f"the law has {part} of the piston's small motions; other modes have the rest")
    for end in instabilities:
        grains = f"{', '.join(map(str, end.grains[:NAMED]))}{' ...' * (len(end.grains) > NAMED)}"
        drops = abs(end.force_drop) > GRADUAL * rest.pencil.bed.weight
        how = f"its force on the piston drops by {end.force_drop:.3g} N" if drops else "gradually"
        notes.append(
            f"the range ends at {1e3 * end.height:.5g} mm, where the bed loses its equilibrium: grains "
            f"{grains} rearrange, {how}"
        )
    if rest.pencil.bed.scene is not rest.scene:
        notes.append("the scene's drive, heat and dry friction are not in the law")
    return tuple(notes)


def _backbone_text(model: DerivedModel) -> str:
    assert model.at_rest is not None
    reach = min(abs(end - model.at_rest.height) for end in model.domain["height"])
    curve = model.backbone([fraction * reach for fraction in FRACTIONS])
    return "; ".join(
        f"{frequency / math.tau:.5g} Hz and {100.0 * ratio:.4g} % at {1e3 * amplitude:.3g} mm"
        for amplitude, frequency, ratio in zip(
            curve.amplitude, curve.frequency, curve.damping_ratio, strict=True
        )
    )
