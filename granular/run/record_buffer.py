"""Records and frames that a run has made and not yet written, with the stage of each record."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from granular.effects.effect import Effect
from granular.engine.columns import column_names
from granular.engine.far_field_forces import force_with_far_field
from granular.kernel_data.constants import Constants
from granular.kernel_data.state import HEIGHT, State
from granular.run.dataset_variables import (
    FRAME_HEIGHT,
    FRAME_TIME,
    STAGE,
    TIME,
    DatasetVariable,
    grain_field_variables,
    scalar_variables,
)
from granular.scene.scene import Scene
from granular.schema.natural_units import Scales

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclasses.dataclass
class RecordBuffer:
    """Records and frames in natural units, in the order of time."""

    count: int
    effects: tuple[Effect, ...] = ()
    rows: list[np.ndarray] = dataclasses.field(default_factory=list)
    stages: list[np.ndarray] = dataclasses.field(default_factory=list)
    frames: list[dict[str, np.ndarray]] = dataclasses.field(default_factory=list)

    def add_records(self, rows: Float[np.ndarray, "r columns"], stage: int) -> None:
        """Append records of one stage."""
        self.rows.append(rows.copy())
        self.stages.append(np.full(len(rows), stage, dtype=np.int64))

    def add_frame(self, time: float, state: State, constants: Constants) -> None:
        """Append a frame: positions, velocities, forces and the effects' values of all grains; time [tau]."""
        frame = {
            "frame_time": np.array(time),
            "frame_height": state.piston[HEIGHT].copy(),
            "position": self._grain_field(state, constants.grains, state.x, state.y),
            "velocity": self._grain_field(state, constants.grains, state.vx, state.vy),
            "force": self._grain_field(state, constants.grains, *force_with_far_field(state)),
        }
        for effect, law in zip(self.effects, constants.acting.laws, strict=True):
            for name, values in effect.grain_record_values(law, state).items():
                frame[name] = self._grain_field(state, constants.grains, values)[:, 0]
        self.frames.append(frame)

    def _grain_field(self, state: State, present: int, *components: np.ndarray) -> np.ndarray:
        # NaN: a grain that has left the cell has no position.
        field = np.full((self.count, len(components)), np.nan)
        field[state.label[:present]] = np.stack([component[:present] for component in components], axis=1)
        return field

    def record_and_frame_counts(self) -> tuple[int, int]:
        """Count the records and the frames that are held: a tuple of two integers."""
        return sum(map(len, self.rows)), len(self.frames)

    def clear(self) -> None:
        """Forget all records and frames."""
        for buffer in (self.rows, self.stages, self.frames):
            buffer.clear()

    def variables_in_si(self, scene: Scene) -> Iterator[tuple[DatasetVariable, np.ndarray]]:
        """Iterate over the scene's variables, with all values that are held converted to SI."""
        own = sum(len(effect.extra_records) for effect in self.effects)
        columns = column_names(len(self.effects), own, len(scene.cell.lines))
        scales = Scales.from_grains(scene.grains)
        rows = np.concatenate([np.empty((0, len(columns))), *self.rows])
        for variable in (TIME, *scalar_variables(scene)):
            first, *others = (rows[:, columns.index(word)] for word in variable.column.split(" + "))
            values = sum(others, start=first)
            yield variable, values * getattr(scales, variable.scale) if variable.scale else values
        yield STAGE, np.concatenate([np.empty(0, dtype=np.int64), *self.stages])
        sizes = {"frame": len(self.frames), "grain": self.count, "axis": 2}
        for variable in (FRAME_TIME, FRAME_HEIGHT, *grain_field_variables(scene)):
            values = np.array([frame[variable.name] for frame in self.frames])
            shape = [sizes[dim] for dim in variable.dims]
            yield variable, values.reshape(shape) * getattr(scales, variable.scale)
