from .data import FallRow, Falls
from .judging import judged_falls
from .shaking import Shaken, shaken
from .theory import predict
from .whole_fall import WholeFall, whole_fall

__all__ = [
    "FallRow", "Falls", "Shaken", "WholeFall", "judged_falls", "predict", "shaken", "whole_fall",
]  # fmt: skip
