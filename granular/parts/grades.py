"""Grades of sintered NdFeB, as one maker lists them (shanghaimagnet.com, Performance Parameter Table)."""

from __future__ import annotations

from typing import NamedTuple

from granular.shared.errors import InputError
from granular.shared.message_text import quote

# Lowest and highest remanence [T] at 20 degrees Celsius.
_REMANENCE = {
    "N35": (1.17, 1.22),
    "N38": (1.22, 1.25),
    "N40": (1.25, 1.28),
    "N42": (1.28, 1.32),
    "N45": (1.32, 1.37),
    "N48": (1.37, 1.42),
    "N50": (1.39, 1.44),
    "N52": (1.42, 1.46),
}
# Highest temperature [deg C] by the letter behind the number, of magnets 0.7 times as thick as wide: flatter
# ones lose moment for good from lower temperatures on.
_HIGHEST = {"": 80.0, "M": 100.0}
REMANENCE_SLOPE = -1.2e-3
"""Relative change of the remanence with temperature [1/K], of all grades of that table."""
RECOIL_PERMEABILITY = 1.05
"""Ratio to free space, of all grades of that table."""
REFERENCE_TEMPERATURE = 20.0
"""Temperature of the remanence of a grade [deg C]."""


class Grade(NamedTuple):
    """A grade of magnets."""

    name: str
    lowest: float  # remanence [T]
    highest: float
    highest_temperature: float  # [deg C]

    @property
    def remanence(self) -> float:
        """Middle of the grade's range [T]."""
        return 0.5 * (self.lowest + self.highest)


GRADES = {
    number + letter: Grade(number + letter, *remanence, hottest)
    for letter, hottest in _HIGHEST.items()
    for number, remanence in _REMANENCE.items()
}


def find_grade(name: str) -> Grade:
    """Return the grade of that name."""
    if name not in GRADES:
        raise InputError(
            f"there is no grade {quote(name)} in the table, which has {', '.join(GRADES)}; "
            "give the remanence instead"
        )
    return GRADES[name]
