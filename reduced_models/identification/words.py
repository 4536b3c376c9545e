"""Words of a report that several of its parts use."""

from __future__ import annotations

import dataclasses

from reduced_models.laws.printing import symbol
from reduced_models.models.model import Direction


def sentence(words: str) -> str:
    """With a capital in front."""
    return words[:1].upper() + words[1:]


def times(value: float) -> str:
    """A factor, with two digits and no power of ten."""
    return f"{float(f'{value:.2g}'):,.0f}" if value >= 10.0 else f"{value:.2g}"


def direction_words(direction: Direction) -> str:
    """An open direction, with the signs of its parameters as formulas have them."""
    powers = {symbol(name): power for name, power in direction.powers.items()}
    return str(dataclasses.replace(direction, powers=powers))
