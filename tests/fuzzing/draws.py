"""Random choices and numbers."""

import math
from typing import Any

from trials import Random


def some(random: Random, chance: float) -> bool:
    return bool(random.random() < chance)


def one_of(random: Random, choices: Any) -> Any:
    return choices[int(random.integers(len(choices)))]


def between(random: Random, low: float, high: float) -> float:
    """A number whose logarithm is evenly spread."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))
