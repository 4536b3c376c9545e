"""Words of a report that several of its parts use."""

from __future__ import annotations

import dataclasses

from reduced_models.laws.printing import symbol
from reduced_models.models.quality import Direction


def sentence(words: str) -> str:
    """With a capital in front."""
    return words[:1].upper() + words[1:]


def direction_words(direction: Direction) -> str:
    """An open direction, with the signs of its parameters as formulas have them."""
    powers = {symbol(name): power for name, power in direction.powers.items()}
    return str(dataclasses.replace(direction, powers=powers))
