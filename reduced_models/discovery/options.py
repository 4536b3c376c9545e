"""Options of a discovery, checked before anything is computed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, get_args

from granular.shared.errors import InputError, quote
from reduced_models.discovery.term_libraries import AUTO, MEMORY
from reduced_models.laws.equation import parse_equation
from reduced_models.laws.law import HeightLine

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
    height : str
        Height as a straight line in z, in numbers, as a law's text has it: ``"0.06 + 1e-3*z"``, or ``"z"``.
        With ``"auto"`` z is the height itself, or, where the equilibrium is farther from zero than the
        motion is wide, the displacement from it in amplitudes; of the record that moves the furthest.
        With own terms or another library, which mean something by z, it is the height itself.
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
    >>> DiscoveryOptions(polish=0).height
    'auto'
    """

    height: str = "auto"
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
        _ = self.line

    @property
    def line(self) -> HeightLine | None:
        """Line from z to the height; None if it is chosen by the records."""
        if self.height == "auto":
            return None
        wrong = f"height = {quote(self.height)}; give 'auto' or a straight line in z, as '0.06 + 1e-3*z'"
        if not isinstance(self.height, str) or not self.height.strip() or ";" in self.height:
            raise InputError(wrong)
        try:
            parsed = parse_equation(f"z'' = 0; height = {self.height}")
        except InputError:
            raise InputError(wrong) from None
        line = (0, 1) if parsed.line is None else parsed.line
        if parsed.parameters or (parsed.line is None and parsed.observations["height"] != parsed.symbol_z):
            raise InputError(wrong)
        return HeightLine(*map(float, line))


def check_arguments(
    method: str,
    libraries: Sequence[str],
    target: str,
    degree: int,
    terms: Sequence[str],
    column: str | None,
    seed: object,
    line: HeightLine | None,
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
        if terms or column is not None or line is not None or libraries != (AUTO,):
            raise InputError(
                "target = 'height' is a formula of the time; leave out library, terms, input and height"
            )
    if libraries == (MEMORY,) and (column is not None or line not in (None, HeightLine())):
        raise InputError(
            f"library = {MEMORY!r} is of z'' or the force of a bed that is not driven, by the height itself; "
            "leave out input and height"
        )


def text_sequence(name: str, texts: object) -> tuple[str, ...]:
    """Texts, or a single one, as a tuple."""
    result = (texts,) if isinstance(texts, str) else texts
    if not isinstance(result, Sequence) or not all(isinstance(text, str) for text in result):
        raise InputError(f"{name} = {quote(texts)}; give a text, or several in a list")
    return tuple(result)
