"""The stages of a run, one kind a file. A protocol is a list of named stages.

Every stage ends after its ``duration`` or, with ``until = "rest"``, when piston and grains are
seen to rest; the duration is then the limit that may not be passed.
"""

from granular.protocol.free import Free
from granular.protocol.hold import Hold
from granular.protocol.lift import Lift
from granular.protocol.move import Move
from granular.protocol.stage import Stage

KINDS: dict[str, type[Stage]] = {"hold": Hold, "move": Move, "free": Free, "lift": Lift}

__all__ = ["KINDS", "Free", "Hold", "Lift", "Move", "Stage"]
