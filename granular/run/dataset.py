"""Variables of a run's dataset, and the buffer that collects their values."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from granular.effects.effect import Effect, RecordedVariable
from granular.engine.columns import column_names, numbered_column_name
from granular.engine.forces import force_components_with_far_field
from granular.kernel_data.state import HEIGHT, Constants, State
from granular.scene.scene import Scene
from granular.schema.cell import CELL
from granular.schema.field_kinds import FieldError
from granular.schema.natural_units import Scales
from granular.shared.array_types import Float
from granular.shared.errors import quote


@dataclasses.dataclass(frozen=True)
class DatasetVariable:
    """One variable of the dataset."""

    name: str
    unit: str
    meaning: str
    column: str = ""
    scale: str = ""
    dims: tuple[str, ...] = ("time",)

    def attributes(self) -> dict[str, Any]:
        """Return the variable's attributes in xarray and Zarr: its SI unit and its meaning."""
        return {"units": self.unit, "long_name": self.meaning}


TIME = DatasetVariable("time", "s", "time", "time", "time")
_PISTON = (
    DatasetVariable("piston_height", "m", "height of the piston", "height", "length"),
    DatasetVariable("piston_velocity", "m/s", "velocity of the piston", "velocity", "velocity"),
)
_LIFT = DatasetVariable("piston_force", "N", "force of the grains on the piston, upwards", "upward", "force")
_KINETIC = DatasetVariable("kinetic_energy", "J", "kinetic energy of the grains", "kinetic", "energy")
_PAIR = DatasetVariable("pair_energy", "J", "energy of the magnetic pairs", "pair", "energy")
_PISTON_ENERGY = DatasetVariable(
    "piston_energy", "J", "kinetic and potential energy of the piston", "piston", "energy"
)
_PISTON_LOSS = DatasetVariable(
    "piston_loss", "J", "energy lost to the piston's friction and drag", "piston_loss", "energy"
)
_COUNT = DatasetVariable("grain_count", "1", "number of grains in the cell", "grains")
_WORK = DatasetVariable("work", "J", "work done from outside through the piston", "work", "energy")
_STATE = (
    DatasetVariable("closest_distance", "m", "minimum distance of two grains", "closest", "length"),
    DatasetVariable("greatest_speed", "m/s", "maximum speed of a grain", "fastest", "velocity"),
    DatasetVariable("stiffest_mode", "rad/s", "upper bound of the highest frequency", "stiffest", "rate"),
)

COORDINATES = (
    *("frame", "grain", "axis", "species", "diameter"),
    *("departure_grain", "departure_time", "departure_position"),
)
"""Reserved names: the coordinates, and the variables that describe grains that have left the cell."""
STAGE = DatasetVariable("stage", "1", "index of the stage in the protocol")
FRAME_TIME = DatasetVariable("frame_time", "s", "time of the frame", scale="time", dims=("frame",))
GRAIN_FIELDS = (
    DatasetVariable("position", "m", "positions", "", "length", ("frame", "grain", "axis")),
    DatasetVariable("velocity", "m/s", "velocities", "", "velocity", ("frame", "grain", "axis")),
    DatasetVariable("force", "N", "magnetic, weight and contact", "", "force", ("frame", "grain", "axis")),
)
FRAME_HEIGHT = DatasetVariable(
    "frame_height", "m", "height of the piston at the frame", "", "length", ("frame",)
)


def scalar_variables(scene: Scene) -> tuple[DatasetVariable, ...]:
    """List the scalar variables that a run of a scene records, given the scene's effects and parts."""
    effects, piston, walls = scene.effects, scene.piston, scene.effects.walls
    laws = list(enumerate(effects.in_loop_order))
    custom_records = [record for _, law in laws for record in law.extra_records]
    return (
        *(_PISTON if piston else ()),
        *(() if walls is None else _side_force_variables(scene)),
        _KINETIC,
        *([_PAIR] if effects.dipole else ()),
        *_variables_of_summed_records(
            (numbered_column_name("energy", k), law.energy_record) for k, law in laws[::-1]
        ),
        *([_PISTON_ENERGY] if piston and piston.mass is not None else ()),
        *_variables_of_summed_records((numbered_column_name("loss", k), law.loss_record) for k, law in laws),
        *([_PISTON_LOSS] if piston and (piston.drag or piston.friction) else ()),
        *([_WORK] if piston or effects.shaking or effects.host else ()),
        *(
            _dataset_variable_of_record(record, numbered_column_name("own", k))
            for k, record in enumerate(custom_records)
        ),
        *([_COUNT] if walls and walls.has_gap else ()),
        *(variable for variable in _STATE if variable.column != "closest" or effects.dipole),
    )


def _side_force_variables(scene: Scene) -> Iterator[DatasetVariable]:
    """List the variables for the forces on the walls of the cell and on the piston."""
    walled = {name for name, _ in scene.effects.walls.sides_with_walls} if scene.effects.walls else set()
    for index, line in enumerate(scene.cell.lines):
        if line.body == CELL and line.name in walled:
            meaning = f"force of the grains on the {line.name} wall"
            yield DatasetVariable(
                f"{line.name}_force", "N", meaning, numbered_column_name("side", index), "force"
            )
    if scene.has_piston_wall:
        yield _LIFT


def _variables_of_summed_records(
    records: Iterable[tuple[str, RecordedVariable | None]],
) -> list[DatasetVariable]:
    """Return one variable for each recorded name; values that effects record under one name are added."""
    columns: dict[RecordedVariable, list[str]] = {}
    for column, record in records:
        if record is not None:
            columns.setdefault(record, []).append(column)
    return [_dataset_variable_of_record(record, " + ".join(names)) for record, names in columns.items()]


def _dataset_variable_of_record(
    record: RecordedVariable, column: str, dims: tuple[str, ...] = ("time",)
) -> DatasetVariable:
    return DatasetVariable(record.name, record.unit, record.meaning, column, record.scale, dims)


def grain_field_variables(scene: Scene) -> tuple[DatasetVariable, ...]:
    """List the variables that the frames of a run contain for each grain."""
    grain_records = (record for effect in scene.effects.in_loop_order for record in effect.grain_records)
    return (
        *GRAIN_FIELDS,
        *(_dataset_variable_of_record(column, "", ("frame", "grain")) for column in grain_records),
    )


def all_run_variables(scene: Scene) -> tuple[DatasetVariable, ...]:
    """List all variables that runs of a scene record, in the order of recording."""
    scalars = (TIME, *scalar_variables(scene), STAGE)
    return (*scalars, FRAME_TIME, FRAME_HEIGHT, *grain_field_variables(scene))


def check_variable_names(scene: Scene) -> None:
    """Raise an error if two variables of a run would have the same name."""
    names = Counter([*COORDINATES, *(variable.name for variable in all_run_variables(scene))])
    for effect in sorted(scene.effects.in_loop_order, key=lambda effect: not effect.user_code_digests):
        effect_records = (
            effect.energy_record,
            effect.loss_record,
            *effect.extra_records,
            *effect.grain_records,
        )
        for record in effect_records:
            if record is not None and names[record.name] > 1:
                raise FieldError(
                    f"its record {quote(record.name)} has the same name as another record of the run; "
                    "give the effect another name",
                    "effects",
                    effect.key,
                )


@dataclasses.dataclass
class RecordBuffer:
    """Records and frames in natural units, in the order of time."""

    count: int
    effects: tuple[Effect, ...] = ()
    rows: list[np.ndarray] = dataclasses.field(default_factory=list)
    stages: list[np.ndarray] = dataclasses.field(default_factory=list)
    frames: list[dict[str, np.ndarray]] = dataclasses.field(default_factory=list)

    def add_records(self, rows: Float[np.ndarray, "r columns"], stage: int) -> None:
        """Append the records of one stage."""
        self.rows.append(rows.copy())
        self.stages.append(np.full(len(rows), stage, dtype=np.int64))

    def add_frame(self, time: float, state: State, constants: Constants) -> None:
        """Append a frame at a time [tau]: positions, velocities, forces and values of effects per grain."""
        frame = {
            "frame_time": np.array(time),
            "frame_height": state.piston[HEIGHT].copy(),
            "position": self._grain_field(state, constants.grains, state.x, state.y),
            "velocity": self._grain_field(state, constants.grains, state.vx, state.vy),
            "force": self._grain_field(state, constants.grains, *force_components_with_far_field(state)),
        }
        for effect, law in zip(self.effects, constants.acting.laws, strict=True):
            for name, values in effect.grain_record_values(law, state).items():
                frame[name] = self._grain_field(state, constants.grains, values)[:, 0]
        self.frames.append(frame)

    def _grain_field(self, state: State, present: int, *components: np.ndarray) -> np.ndarray:
        # Values are NaN for a grain that has left the cell.
        field = np.full((self.count, len(components)), np.nan)
        field[state.label[:present]] = np.stack([component[:present] for component in components], axis=1)
        return field

    def record_and_frame_counts(self) -> tuple[int, int]:
        """Return the number of buffered records and the number of buffered frames."""
        return sum(map(len, self.rows)), len(self.frames)

    def clear(self) -> None:
        """Remove all records and frames."""
        for buffer in (self.rows, self.stages, self.frames):
            buffer.clear()

    def variables_in_si(self, scene: Scene) -> Iterator[tuple[DatasetVariable, np.ndarray]]:
        """Yield the scene's variables, each with all its buffered values in SI."""
        custom_records = sum(len(effect.extra_records) for effect in self.effects)
        columns = column_names(len(self.effects), custom_records, len(scene.cell.lines))
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
