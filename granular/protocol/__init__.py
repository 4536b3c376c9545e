"""Stages of a run. A protocol is a list of named stages.

Every stage ends after its ``duration`` or, with ``until = "rest"``, when piston and grains are at rest. The
duration is then an upper limit; if the bed is not at rest by then, an error is raised.
"""

from granular.protocol.stage import Stage
from granular.protocol.stages import (
    KINDS,
    Descend,
    Follow,
    Force,
    Free,
    Hold,
    Lift,
    Move,
    Oscillate,
    Path,
    Push,
)

__all__ = [
    "KINDS",
    "Descend",
    "Follow",
    "Force",
    "Free",
    "Hold",
    "Lift",
    "Move",
    "Oscillate",
    "Path",
    "Push",
    "Stage",
]
