"""Stages of a run. A protocol is a list of named stages.

Every stage ends after its ``duration`` or, with ``until = "rest"``, when piston and grains are
seen to rest; the duration is then the limit that may not be passed.
"""

from granular.protocol.driven_piston_stages import Descend, Follow, Hold, Lift, Move, Oscillate, Path
from granular.protocol.free_piston_stages import Force, Free, Push
from granular.protocol.stage import Stage

KINDS: dict[str, type[Stage]] = {
    "hold": Hold,
    "move": Move,
    "descend": Descend,
    "follow": Follow,
    "oscillate": Oscillate,
    "free": Free,
    "push": Push,
    "lift": Lift,
    "path": Path,
    "force": Force,
}

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
