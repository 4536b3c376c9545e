"""The affine map between the height of a piston and the z of a law."""

from __future__ import annotations

import dataclasses
from typing import Any


@dataclasses.dataclass(frozen=True)
class HeightMap:
    """The affine map of the height: height = shift + scale z.

    Attributes
    ----------
    shift, scale : float
        Height at z = 0, and height per unit of z [m].
    fitted : bool
        Whether the map was fitted to the data, or given.

    Examples
    --------
    >>> from reduced_models import HeightMap
    >>> HeightMap(shift=0.05, scale=0.006)
    HeightMap(shift=0.05, scale=0.006, fitted=False)
    """

    shift: float = 0.0
    scale: float = 1.0
    fitted: bool = False

    def __str__(self) -> str:
        return self.text()

    def text(self, digits: int = 5, name: str = "height", unit: str = "m") -> str:
        """Map in words, its numbers cut to so many digits.

        Parameters
        ----------
        digits : int
            Significant digits.
        name : str
            Name of the height.
        unit : str
            Unit of the height.

        Returns
        -------
        str
            The map as an equation.
        """
        sign = "-" if self.shift >= 0.0 else "+"
        shift, scale = f"{abs(self.shift):.{digits}g}", f"{self.scale:.{digits}g}"
        return f"z = ({name} {sign} {shift} {unit})/({scale} {unit})"

    def to_law(self, height: Any) -> Any:
        """Coordinate z of the law at a height [m].

        Parameters
        ----------
        height : float or array
            Height [m].

        Returns
        -------
        float or array
            Coordinate z, without unit.
        """
        return (height - self.shift) / self.scale

    def to_height(self, z: Any) -> Any:
        """Height [m] at a coordinate z of the law.

        Parameters
        ----------
        z : float or array
            Coordinate, without unit.

        Returns
        -------
        float or array
            Height [m].
        """
        return self.shift + self.scale * z
