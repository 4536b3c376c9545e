from .values import duration as duration
from .values import published_value as published_value
