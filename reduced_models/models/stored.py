"""The parts of a stored model, made of plain data that were checked."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from granular.shared.errors import InputError
from granular.shared.messages import visible
from reduced_models.laws.catalogue import LAWS
from reduced_models.laws.law import Law
from reduced_models.models.quality import Quality


def law_from_plain(plain: Mapping[str, Any]) -> Law:
    """A law of the package, or one of the user's own, from its equation."""
    own = Law(
        name=plain["law"],
        equation=plain["equation"],
        positive=tuple(plain["positive"]),
        units=plain["units"],
        mapped=plain["mapped"],
        source=plain["source"],
        inputs=tuple(plain["inputs"]),
        resolution=plain["resolution"],
    )
    if set(own.parameters) != set(plain["parameters"]):
        raise InputError(
            "the data are not those of a reduced model: the equation has the parameters "
            f"{', '.join(own.parameters) or 'none'}, and values are given of "
            f"{', '.join(map(visible, plain['parameters'])) or 'none'}; correct one of them"
        )
    packaged = LAWS.get(own.name)
    return packaged if packaged is not None and packaged.equation == own.equation else own


def quality_from_plain(plain: Mapping[str, Any]) -> Quality:
    """How good a model is. Files hold no infinity: the error of what diverged is put back."""
    quality = Quality(**plain)
    if quality.holdout is None and quality.holdout_from is not None:
        return dataclasses.replace(quality, holdout=math.inf)
    return quality
