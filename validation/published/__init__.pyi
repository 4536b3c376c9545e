from .catalogue import entries
from .entry import Entry
from .finding import Finding
from .programme import published
from .protocols import duration
from .results import committed
from .values import published_value

__all__ = [
    "Entry", "Finding", "committed", "duration", "entries", "published", "published_value",
]  # fmt: skip
