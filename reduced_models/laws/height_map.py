"""The affine map between the height of a piston and the z of a law."""

from __future__ import annotations

import dataclasses
from typing import Any

from granular.shared.errors import InputError
from granular.shared.message_text import quote


@dataclasses.dataclass(frozen=True)
class HeightMap:
    """The affine map between height and the coordinate z of a law: height = shift + scale z.

    It is not checked: functions that take a map refuse numbers that do not suit them.

    Attributes
    ----------
    shift : float
        Height at z = 0 [m]; an angle [rad] for a record of one.
    scale : float
        Height per unit of z, in the same unit; not zero, negative where z points down.
    fitted : bool
        True where the map was fitted to data, False where it was given.

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
        """Map as an equation for z, its numbers rounded.

        Parameters
        ----------
        digits : int
            Significant digits, from 1 on.
        name : str
            Name of the height.
        unit : str
            Unit of shift and scale; only written, nothing is converted.

        Returns
        -------
        str
            Equation such as ``"z = (height - 0.05 m)/(0.006 m)"``.

        Raises
        ------
        InputError
            If ``digits`` is no integer from 1 on.
        """
        check_digits(digits)
        sign = "-" if self.shift >= 0.0 else "+"
        shift, scale = f"{abs(self.shift):.{digits}g}", f"{self.scale:.{digits}g}"
        return f"z = ({name} {sign} {shift} {unit})/({scale} {unit})"

    def to_law(self, height: Any) -> Any:
        """Coordinate z of the law at a height [m].

        Parameters
        ----------
        height : float or array
            Height [m], of any shape.

        Returns
        -------
        float or array
            Coordinate z = (height - shift)/scale, without unit, of the same shape; NaN where the
            height is NaN.

        Raises
        ------
        ZeroDivisionError
            If ``scale`` is 0 and ``height`` a plain number; arrays then give infinities or NaN.
        """
        return (height - self.shift) / self.scale

    def to_height(self, z: Any) -> Any:
        """Height [m] at a coordinate z of the law.

        Parameters
        ----------
        z : float or array
            Coordinate, without unit, of any shape.

        Returns
        -------
        float or array
            Height shift + scale z [m], of the same shape; NaN where z is NaN.
        """
        return self.shift + self.scale * z


def check_digits(digits: object) -> None:
    """Refuse a number of significant digits that is none."""
    if not isinstance(digits, int) or digits < 1:
        raise InputError(f"digits = {quote(digits)}; give an integer from 1 on")
