"""The stages of a run, one kind a file. A protocol is a list of named stages.

Every stage ends after its ``duration`` or, with ``until = "rest"``, when piston and grains are
seen to rest; the duration is then the limit that may not be passed.
"""

from granular.protocol.descend import Descend
from granular.protocol.follow import Follow
from granular.protocol.formula_force import Force
from granular.protocol.formula_path import Path
from granular.protocol.free import Free
from granular.protocol.hold import Hold
from granular.protocol.lift import Lift
from granular.protocol.move import Move
from granular.protocol.oscillate import Oscillate
from granular.protocol.push import Push
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
    "KINDS", "Descend", "Follow", "Force", "Free", "Hold", "Lift", "Move", "Oscillate", "Path",
    "Push", "Stage",
]  # fmt: skip
