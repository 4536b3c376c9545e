"""Options of a discovery, checked before anything is computed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, get_args

from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.discovery.term_libraries import AUTO, MEMORY
from reduced_models.laws.height_map import HeightMap

Method = Literal["auto", "sindy", "pysindy", "operon", "pysr"]
Target = Literal["acceleration", "force", "height"]
SPARSE = ("sindy", "pysindy")
"""Methods that choose among the terms of a library alone."""
_GREATEST_SEED = 2**32 - 1  # that the programs for symbolic regression take


@dataclasses.dataclass(frozen=True)
class DiscoveryOptions:
    """Rare options of `discover`.

    Parameters
    ----------
    map : HeightMap or "auto"
        Z = (height - shift)/scale. Automatically the height itself, or, where the level of rest is
        farther from zero than the swing is wide, the swing about rest in amplitudes; of the record
        that swings the furthest. With own terms or another library, which mean something by z, it
        is the height itself.
    polish : int
        Greatest number of candidates, from 0 on, best first, that are fitted to the records by their
        solutions; those whose criterion is hopeless next to the best one's are not. With 0 no
        candidate has a model.
    functions : sequence of str
        What symbolic regressions may use next to sums, differences and products:
        ``"sin"``, ``"exp"``, ``"max"``, ``"/"`` and others.
    effort : float
        Times the usual length of a symbolic regression, above 0.
    progress : bool
        True for a line on standard error that shows what is being done.

    Raises
    ------
    InputError
        If an option is out of its range.

    Examples
    --------
    >>> from reduced_models import DiscoveryOptions
    >>> DiscoveryOptions(polish=0).map
    'auto'
    """

    map: HeightMap | Literal["auto"] = "auto"
    polish: int = 3
    functions: str | Sequence[str] = ()
    effort: float = 1.0
    progress: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "functions", text_sequence("functions", self.functions))
        if not isinstance(self.polish, int) or self.polish < 0:
            raise InputError(f"polish = {quote(self.polish)}; give an integer from 0 on")
        if not isinstance(self.effort, int | float) or not 0.0 < self.effort < math.inf:
            raise InputError(f"effort = {quote(self.effort)}; give a number above 0")
        if not isinstance(self.map, HeightMap):
            if self.map != "auto":
                raise InputError(f"map = {quote(self.map)}; give 'auto' or HeightMap(shift, scale)")
        elif not (math.isfinite(self.map.shift) and 0.0 < abs(self.map.scale) < math.inf):
            raise InputError(
                f"map has the shift {self.map.shift:g} and the scale {self.map.scale:g} m; "
                "give finite ones, and a scale that is not zero"
            )


def check_arguments(
    method: str,
    libraries: Sequence[str],
    target: str,
    degree: int,
    terms: Sequence[str],
    column: str | None,
    seed: object,
    height_map: object,
) -> None:
    """Check that the arguments of `discover` are in their ranges, and go together."""
    for name, value, valid in (("method", method, get_args(Method)), ("target", target, get_args(Target))):
        if value not in valid:
            raise InputError(f"{name} = {quote(value)}; give one of {', '.join(valid)}")
    if not isinstance(degree, int) or not 1 <= degree <= 5:
        raise InputError(f"degree = {quote(degree)}; give an integer from 1 to 5")
    if not isinstance(seed, int) or not 0 <= seed <= _GREATEST_SEED:
        raise InputError(f"seed = {quote(seed)}; give an integer from 0 to {_GREATEST_SEED}")
    if target == "height":
        if method in ("auto", *SPARSE):
            raise InputError("target = 'height' needs a symbolic method: give method 'operon' or 'pysr'")
        if terms or column is not None or height_map != "auto" or libraries != (AUTO,):
            raise InputError(
                "target = 'height' is a formula of the time; leave out library, terms, input and map"
            )
    if libraries == (MEMORY,) and (column is not None or height_map not in ("auto", HeightMap())):
        raise InputError(
            f"library = {MEMORY!r} is of z'' or the force of a bed that is not driven, by the height itself; "
            "leave out input and map"
        )


def text_sequence(name: str, texts: object) -> tuple[str, ...]:
    """Texts, or a single one, as a tuple."""
    result = (texts,) if isinstance(texts, str) else texts
    if not isinstance(result, Sequence) or not all(isinstance(text, str) for text in result):
        raise InputError(f"{name} = {quote(texts)}; give a text, or several in a list")
    return tuple(result)
