"""Scenes by a seed and a number: sound, spoiled, and how they are to be run."""

import copy

from draws import one_of, some
from sound_scenes import arguments, sound_scene
from spoiled_scenes import ODD, spoil
from trials import random_of

COMMON = (
    {"walls", "gravity"},
    {"dipole", "walls", "gravity", "drag"},
    {"dipole", "walls", "gravity", "friction"},
    {"dipole", "walls", "gravity", "drag", "contact"},
)
"""Effects of the cases that are compiled too: what others add makes the compiler work anew."""


class Case:
    """A scene and how it is run, from a seed and a number."""

    def __init__(self, seed: int, number: int) -> None:
        random = random_of(seed, number)
        self.common = some(random, 0.3)
        names = {one for one in ("dipole", "walls", "gravity") if some(random, 0.8)}
        rare = ("drag", "friction", "contact", "shaking")
        names |= {one for one in rare if some(random, 0.35)}
        if self.common:
            names = set(one_of(random, COMMON))
        self.plain = sound_scene(random, names, self.common)
        found = self.plain["effects"]
        usual = found.get("friction", {}).get("scheme") != "regularised"
        self.compiled = self.common and usual and found.get("walls") == {}
        self.arguments = arguments(random, self.plain, self.common)
        if some(random, 0.4):
            for _ in range(int(random.integers(1, 4))):
                spoil(random, self.plain)
        if some(random, 0.08):
            name = one_of(random, ("dt", "t_end", "method", "threads"))
            self.arguments[name] = copy.deepcopy(one_of(random, ODD))
        self.resumed = random.uniform(0.1, 0.9) if some(random, 0.2) else None
