"""What is wrong with a scene: one place of it becomes something odd."""

import copy
import math
from collections.abc import Iterator
from typing import Any

from draws import one_of, some
from sound_scenes import Plain
from trials import Random

ODD: tuple[Any, ...] = (
    0,
    -1,
    1,
    2,
    2**53 + 1,
    2**63,
    -(2**70),
    1e-300,
    1e-30,
    1e-29,
    1e-12,
    1e12,
    1e29,
    1e30,
    1e300,
    -1e30,
    math.nan,
    math.inf,
    -math.inf,
    True,
    False,
    None,
    "",
    "none",
    "5 mm",
    "1 D",
    "3 kg",
    "1e3",
    "x" * 300,
    "\x1b[31mred",
    "magnétique 磁",
    [],
    {},
    [1],
    [[1, 2]],
    [[1, 2, 3]],
    {"a": 1},
)


def leaves(plain: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of a nested structure: its container, and its key or index."""
    items = plain.items() if isinstance(plain, dict) else enumerate(plain)
    for key, value in list(items):
        yield plain, key
        if isinstance(value, dict | list):
            yield from leaves(value)


def spoil(random: Random, plain: Plain) -> None:
    """Change one place into something odd; most often a number."""
    places = list(leaves(plain))
    if some(random, 0.7):
        places = [one for one in places if isinstance(one[0][one[1]], float)] or places
    container, key = one_of(random, places)
    value = container[key]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if number and some(random, 0.4):
        container[key] = value * 10.0 ** random.uniform(-30.0, 30.0)
    elif number and some(random, 0.6):
        container[key] = value * 10.0 ** random.uniform(-3.0, 3.0)
    elif some(random, 0.1):
        del container[key]
    elif isinstance(container, dict) and some(random, 0.1):
        container[f"{key}x"] = container.pop(key)
    else:
        container[key] = copy.deepcopy(one_of(random, ODD))
