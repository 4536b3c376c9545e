"""What a run has recorded and not yet written: records, frames, and where each stage lies."""

from __future__ import annotations

import dataclasses

import numpy as np

from granular.engine.loop import COLUMNS
from granular.engine.state import State


@dataclasses.dataclass
class Recorder:
    """Records and frames in natural units, in the order of time."""

    rows: list[np.ndarray] = dataclasses.field(default_factory=list)
    stages: list[np.ndarray] = dataclasses.field(default_factory=list)
    frames: list[np.ndarray] = dataclasses.field(default_factory=list)
    frame_times: list[tuple[float, float]] = dataclasses.field(default_factory=list)

    def add_rows(self, rows: np.ndarray, stage: int) -> None:
        self.rows.append(rows.copy())
        self.stages.append(np.full(len(rows), stage, dtype=np.int64))

    def add_frame(self, time: float, state: State, count: int) -> None:
        fields = (state.x, state.y, state.vx, state.vy, state.fx, state.fy)
        frame = np.stack([one[:count] for one in fields], axis=1).reshape(count, 3, 2)
        self.frames.append(frame.transpose(1, 0, 2).copy())
        self.frame_times.append((time, float(state.piston[0])))

    def counts(self) -> tuple[int, int]:
        """How many records and frames are held."""
        return sum(map(len, self.rows)), len(self.frames)

    def clear(self) -> None:
        for one in (self.rows, self.stages, self.frames, self.frame_times):
            one.clear()

    def arrays(self, count: int) -> dict[str, np.ndarray]:
        """Everything as arrays: ``rows``, ``stages``, ``frames`` (k, 3, n, 2), ``frame_times``."""
        return {
            "rows": np.concatenate([np.empty((0, len(COLUMNS))), *self.rows]),
            "stages": np.concatenate([np.empty(0, dtype=np.int64), *self.stages]),
            "frames": np.array(self.frames).reshape(-1, 3, count, 2),
            "frame_times": np.array(self.frame_times).reshape(-1, 2),
        }
