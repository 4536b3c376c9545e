from .data import FallRow as FallRow
from .data import Falls as Falls
from .judging import judged_falls as judged_falls
from .theory import predict as predict
