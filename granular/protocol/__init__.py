"""Stages of a run. A protocol is a list of named stages.

Every stage ends after its ``duration`` or, with ``until = "rest"``, when piston and grains are at rest;
the duration is then an upper limit, and a bed not yet at rest by then is an error.
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
