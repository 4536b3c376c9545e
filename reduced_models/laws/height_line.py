"""The straight line from the coordinate z of a law, or of a discovery, to the height."""

from __future__ import annotations

from typing import Any, NamedTuple


class HeightLine(NamedTuple):
    """height = shift + scale z."""

    shift: float = 0.0  # height at z = 0 [m, rad]
    scale: float = 1.0  # height per unit of z, in the same unit; not zero

    @property
    def text(self) -> str:
        """Line as an equation of a law."""
        return f"height = {self.shift!r} + {self.scale!r}*z"

    def coordinate(self, height: Any) -> Any:
        """Coordinate z at a height, of any shape."""
        return (height - self.shift) / self.scale

    def height(self, z: Any) -> Any:
        """Height at a coordinate z, of any shape."""
        return self.shift + self.scale * z
