"""Further runs of a scene that begin where its bed is at rest, and the figures of small motions there."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from reduced_models.models.quantities import DAMPING_RATIO, LEVEL, QuantityWithError
from reduced_models.records.sources import RECORD, piston_record_columns

if TYPE_CHECKING:
    from granular.linear.equilibrium import Equilibrium
    from granular.run.trajectory import Trajectory
    from granular.scene.scene import Scene

COARSE_REST = 0.01
"""Rest [D] at which the fall of a further start ends. From 1e-4 to 0.1 D three starts of the packaged damper
have the same equilibrium to 1e-9; they fall for 9 s instead of 15 s at 0.01 D."""

FREQUENCY = "natural frequency"
_DERIVED = (
    ("frequency", FREQUENCY, "f0", "Hz", 1.0),
    ("damping_ratio", DAMPING_RATIO, "zeta", "%", 100.0),
    ("level", LEVEL, "z0", "mm", 1e3),
)


@dataclasses.dataclass(frozen=True)
class RecordsOfRest:
    """Records of a further run: a bed that has come to rest is released from its equilibrium.

    The stages of the release are plain data, as of a scene.
    """

    release: tuple[Mapping[str, Any], ...]
    keep_measure_name: ClassVar[str] = "reduced_models.identification:records_of_rest#1"

    def __call__(self, run: Trajectory) -> Mapping[str, Any]:
        """Return the records of `piston_record_columns`."""
        if not self.release or len(run.scene.protocol) > 1 or not is_rest(run.scene, 0):
            return piston_record_columns(run)
        from granular import equilibrium
        from granular.run.simulation import simulate

        changes = release_from(equilibrium(run), self.release)
        after = simulate(
            run.scene.replace(**changes), run.settings()["dt"], method=run.method, progress=False
        )
        return {**piston_record_columns(run), RECORD: piston_record_columns(after)[RECORD]}


def release_from(rest: Equilibrium, stages: tuple[Mapping[str, Any], ...]) -> dict[str, Any]:
    """Return the changes of a scene that begin its run at an equilibrium."""
    return {
        "arrangement.positions": rest.positions.tolist(),
        "piston.height": rest.piston_height,
        "protocol": list(stages),
    }


def is_rest(scene: Scene, index: int) -> bool:
    """Return whether a stage leaves the piston free until it rests."""
    from granular.protocol.free_piston_stages import Free

    stage = scene.protocol[index]
    return isinstance(stage, Free) and stage.until == "rest"


def release_stages(scene: Scene) -> tuple[Mapping[str, Any], ...]:
    """Stages behind the rest that a scene begins with, as plain data; none where a run decides the rest."""
    from granular.linear.bed_forces import rubs_dry

    moves = {"host", "shaking", "bath"} & {effect.key for effect in scene.effects.acting}
    names = [stage.name for stage in scene.protocol]
    if moves or rubs_dry(scene) or len(names) < 2 or not is_rest(scene, 0):
        return ()
    if scene.output.record not in names[1:]:
        return ()
    return tuple(scene.to_plain()["protocol"][1:])


def rest_of(run: Trajectory) -> Equilibrium:
    """Equilibrium next to the end of a run's first stage."""
    from granular.linear.equilibrium import equilibrium_from

    times = run.dataset["frame_time"].values
    frame = int(np.argmin(np.abs(times - run.stages[0].end)))
    height = float(run.dataset["frame_height"].values[frame])
    return equilibrium_from(run.scene, run.dataset["position"].values[frame], height)


class DerivedFigures(NamedTuple):
    """Figures of small motions, derived from the stiffness of the bed at rest."""

    level: float  # [m]
    frequency: float  # [Hz]
    damping_ratio: float
    step_error: float  # largest relative error, of frequency or damping ratio, that the run's time step makes

    def text(self, figures: Sequence[QuantityWithError]) -> str:
        """Figures in words, each with the relative difference of the fitted one, beyond its error or not."""
        fitted = {figure.name: figure for figure in figures}
        words, differences = [], []
        for field, name, symbol, unit, factor in _DERIVED:
            value, figure = factor * getattr(self, field), fitted.get(name)
            words.append(f"{symbol} {value:.5g} {unit}")
            if figure is not None and figure.unit == unit:
                difference = figure.value - value
                error = math.hypot(figure.parts.get("fit", 0.0), figure.parts.get("step", 0.0))
                beyond = " beyond its error" if abs(difference) > error else ""
                differences.append(f"{100.0 * difference / value:+.1g} %{beyond}")
        return ", ".join(words) + (f" (fit {', '.join(differences)})" if differences else "")


def derive_figures(run: Trajectory, rest: Equilibrium) -> DerivedFigures:
    """Derive the figures of a bed's small motions, and the error of the run's time step in them."""
    from granular.linear import piston_roots, root_of_steps

    exact = piston_roots(rest)[0]
    root = root_of_steps(rest, exact, run.settings()["longest_step"], run.method)
    errors = [abs(root) / abs(exact.s) - 1.0]
    if exact.damping_ratio > 0.0:
        errors.append(-root.real / abs(root) / exact.damping_ratio - 1.0)
    assert rest.piston_height is not None
    return DerivedFigures(rest.piston_height, exact.frequency, exact.damping_ratio, max(map(abs, errors)))
