"""Typed errors. Each message is one line that gives the value, the limit and the remedy."""

from __future__ import annotations

import difflib
import functools
import importlib
import reprlib
from collections.abc import Callable, Sequence
from typing import Any, Self

LONGEST = 200
"""Maximum number of characters of a user's value in a message."""
MOST = 2000
"""Maximum number of characters of a message."""

_MOST_SHOWN = 30
"""Maximum number of valid words that a message about an unknown word lists."""
_MOST_TIMES = 1e6

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = LONGEST
_SHORT.maxlist = _SHORT.maxtuple = _SHORT.maxdict = _SHORT.maxset = 6
_SHORT.maxlevel = 3


def quote(value: object) -> str:
    """Quote a value in Python's notation, on one line of at most `LONGEST` characters."""
    if isinstance(value, str):
        text = repr(str(value[: LONGEST + 1]))
    elif isinstance(value, int) and value.bit_length() > 1000:
        text = f"an integer of {value.bit_length()} bits"  # Python refuses to format very large integers
    else:
        text = sanitize(_SHORT.repr(value))
    return _shorten(text, LONGEST)


def sanitize(text: object, limit: int = LONGEST) -> str:
    """Shorten a text to one line of at most ``limit`` characters, with control characters as escapes."""
    return _shorten("".join(map(_escape, str(text)[: limit + 1])), limit)


def unknown_word_message(word: str, known: Sequence[str], kind: str) -> str:
    """Return the message for an unknown word, which suggests the most similar valid word or lists all."""
    near = difflib.get_close_matches(str(word)[:LONGEST], known, 1, cutoff=0.5)
    shown = ", ".join(map(sanitize, known[:_MOST_SHOWN])) + ", ..." * (len(known) > _MOST_SHOWN)
    advice = f"did you mean {quote(near[0])}?" if near else f"known are {shown}"
    return f"unknown {kind} {quote(word)}; {advice}"


def one_line(message: object) -> str:
    """Put a message on one line, with control characters as escapes."""
    words = " ".join(str(message).split())
    if len(words) > MOST:
        # The end of the message is kept, since it contains the remedy.
        words = f"{words[: MOST - 400]} ... {words[-400:]}"
    return "".join(map(_escape, words))


def printable(text: object) -> str:
    """Replace control characters by escapes, except for line breaks and tabs."""
    return "".join(sign if sign in "\n\t" else _escape(sign) for sign in str(text))


def format_factor(value: float, digits: int = 2) -> str:
    """Format a factor without a power of ten; above a million it is "more than a million"."""
    if not value < _MOST_TIMES:
        return "more than a million"
    figure = f"{value:.{digits}g}"
    return f"{float(figure):,.0f}" if value >= 10.0**digits else figure


def _escape(sign: str) -> str:
    # A no-break space only serves to keep a number and its unit on one line.
    return sign if sign.isprintable() or sign == "\xa0" else repr(sign)[1:-1]


def _shorten(text: str, limit: int) -> str:
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


__all__ = [
    "EnergyError",
    "GranularError",
    "InputError",
    "Interrupted",
    "MissingPackageError",
    "NotAtRestError",
    "NotFiniteError",
    "OutsideError",
    "RecordError",
    "RunError",
    "SceneError",
    "StoreError",
]


class GranularError(Exception):
    """Base class of the toolkit's errors except `Interrupted`; the message is a single line."""

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(message))


class InputError(GranularError, ValueError):
    """Invalid input from the user (the command line exits with 2); also a `ValueError`."""


class SceneError(InputError):
    """Error of an invalid scene, or of an invalid change to a scene."""


class CautionWarning(UserWarning):
    """Warning that is repeated in the print-out of a result."""


class RecordWarning(CautionWarning):
    """Warning about an assumption made in reading a record, or about a change to its samples."""


class RecordError(InputError):
    """Error of a piston record, from a file or arrays, that cannot be used."""


class StoreError(InputError):
    """Error of a file or run directory that cannot be written, or of a run that cannot be read or resumed."""


class TimeBudgetError(InputError):
    """Error of a computation that exceeded its time limit."""


class MissingPackageError(InputError, ImportError):
    """Error of a required distribution that is not installed."""


class RunError(GranularError, RuntimeError):
    """Error of a run that was stopped because its further results could not be trusted.

    Attributes
    ----------
    step : int
        Number of steps before the failure was detected.
    time : float
        Time of the failure [s].
    grain : int or None
        Index of the grain that caused the error, if any.
    value : float or None
        Value that caused the error, in the unit of the message.
    remedy : str
        Change that avoids the error.
    trajectory : Trajectory or None
        Records up to the failure; None in a copy sent to another process.
    """

    def __init__(
        self,
        cause: str,
        *,
        step: int,
        time: float,
        grain: int | None = None,
        value: float | None = None,
        remedy: str,
    ) -> None:
        self.cause = cause
        self.step = step
        self.time = time
        self.grain = grain
        self.value = value
        self.remedy = remedy
        self.trajectory: object = None
        location = f"step {step}, t = {time:.9g} s" + ("" if grain is None else f", grain {grain}")
        super().__init__(f"{location}: {cause}; {remedy}")

    def with_context(self, words: str, remedy: str = "") -> Self:
        """Return the same error with a likely reason at the start of its message.

        Parameters
        ----------
        words : str
            Likely reason, such as a custom law.
        remedy : str
            Change that avoids the error; if empty, the remedy of this error.

        Returns
        -------
        RunError
            Error of the same type.
        """
        return type(self)(words + self.cause, **self._context_values() | {"remedy": remedy or self.remedy})

    def __reduce__(self) -> tuple[Any, ...]:
        return functools.partial(type(self), self.cause, **self._context_values()), ()

    def _context_values(self) -> dict[str, Any]:
        names = ("step", "time", "grain", "value", "remedy")
        return {name: getattr(self, name) for name in names}


class NotFiniteError(RunError):
    """Error of a run in which a position, velocity or force became infinite or undefined."""


class OutsideError(RunError):
    """Error of a run in which a grain passed through a wall or the piston."""


class EnergyError(RunError):
    """Error of a run whose energy balance has too large a residual."""


class NotAtRestError(RunError):
    """Error of a run in which a stage that ends at rest did not come to rest in time."""


class StepCountError(RunError):
    """Error of a run that needs too many steps."""


class Terminated(KeyboardInterrupt):
    """Exception raised for SIGTERM, which ends a command like Ctrl-C."""


class Interrupted(KeyboardInterrupt):
    """Exception of a run that was stopped by Ctrl-C, or in a command by SIGTERM.

    Attributes
    ----------
    trajectory : Trajectory
        Results up to the interruption.
    terminated : bool
        True for SIGTERM.
    """

    def __init__(self, trajectory: object, terminated: bool = False) -> None:
        super().__init__("terminated" if terminated else "interrupted")
        self.trajectory = trajectory
        self.terminated = terminated


_FITS = "diffrax equinox jax jaxlib mpmath sympy"
_SIMULATION = "PIL llvmlite loky numba numcodecs pandas tomli_w xarray zarr"
NEEDED_BY = dict.fromkeys(_FITS.split(), "fits") | dict.fromkeys(_SIMULATION.split(), "simulation")
"""Modules that a partial installation may lack, each with the group in `pyproject.toml` that installs it."""


def missing_package_error(error: ModuleNotFoundError) -> MissingPackageError | None:
    """Return an error with the command that installs a missing module, or None for unknown modules."""
    module = (error.name or "").partition(".")[0]
    if module not in NEEDED_BY:
        return None
    return MissingPackageError(
        f"{module} is not installed; it belongs to the group {NEEDED_BY[module]!r} of the toolkit's "
        "dependencies: pip install granular-damper installs all of them"
    )


def import_extra(module: str, feature: str, extra: str) -> Any:
    """Import a module that a feature needs; if it is missing, the error names the extra to install."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingPackageError(
            f"{feature} needs the library {module.partition('.')[0].replace('_', '-')}; install it with: "
            f"pip install 'granular-damper[{extra}]'"
        ) from None


def with_missing_package_advice(attribute: Callable[[str], Any]) -> Callable[[str], Any]:
    """Wrap a package's ``__getattr__`` to report how to install a missing module."""

    def get(name: str) -> Any:
        try:
            return attribute(name)
        except ModuleNotFoundError as error:
            advice = missing_package_error(error)
            if advice is None:
                raise
            raise advice from None

    return get
