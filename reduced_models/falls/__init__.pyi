from .data import FallRow as FallRow
from .data import Falls as Falls
from .judging import judged_falls as judged_falls
from .shaking import Shaken as Shaken
from .shaking import shaken as shaken
from .theory import predict as predict
from .whole_fall import WholeFall as WholeFall
from .whole_fall import whole_fall as whole_fall
