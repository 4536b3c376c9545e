"""A section of the validation's report."""

import dataclasses

from granular.shared.blocks import Text
from validation.report_tasks import Section, Task


@dataclasses.dataclass(frozen=True)
class Level:
    """Level of the bench."""

    level: float


BENCH = Section(
    "bench",
    "The bench",
    lambda full: [Task("level", {"version": "1.2"}, lambda: Level(0.5))],
    Level,
    lambda results: ("level", True),
    lambda results: [Text(f"The bench is at {result.level}.") for result in results],
)
