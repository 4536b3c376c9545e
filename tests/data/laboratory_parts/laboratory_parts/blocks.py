"""Blocks for result pages, one of them of a new kind."""

from granular.shared.blocks import Heading


class Gauge:
    """A gauge on a page, and its value on a terminal."""

    def __init__(self, value):
        self.value = value

    def __str__(self):
        return f"gauge: {self.value}"

    def _repr_html_(self):
        return f"<meter value={self.value}></meter>"


def bench_blocks(result):
    """Return the gauge of a result with a level; nothing for other results."""
    level = getattr(result, "level", None)
    return () if level is None else (Heading("Bench"), Gauge(level))
