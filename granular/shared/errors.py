"""Typed errors. Each message is one line that names the value, the limit and the remedy."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from typing import Any, Self

from granular.shared.message_text import one_line

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
    """Base of every error that the toolkit raises on purpose, but for `Interrupted`; one line of text."""

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(message))


class InputError(GranularError, ValueError):
    """Something that the user gave cannot be used (the command line exits with 2); also a `ValueError`."""


class SceneError(InputError):
    """A scene, or a change to it, is not valid."""


class CautionWarning(UserWarning):
    """Warning that the print-out of a result repeats, as a caution or a line on its record."""


class RecordWarning(CautionWarning):
    """Guess about a record, or change of its samples."""


class RecordError(InputError):
    """A piston record (a CSV file or arrays) cannot be used."""


class StoreError(InputError):
    """A file or a run directory cannot be written, or a run directory not read or resumed."""


class TimeBudgetError(InputError):
    """A computation was not done within the time that it was given."""


class MissingPackageError(InputError, ImportError):
    """A distribution that is needed is not installed."""


class RunError(GranularError, RuntimeError):
    """A run cannot be trusted from some step on, and was stopped there.

    Attributes
    ----------
    step : int
        Steps made before the failure was seen.
    time : float
        Time of the failure [s].
    grain : int or None
        Index of the grain concerned, where one is.
    value : float or None
        The offending value, in the unit that the message names.
    remedy : str
        Change that avoids the error.
    trajectory : Trajectory or None
        Everything that was recorded before; a copy that crossed to another process has none.
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
        where = f"step {step}, t = {time:.9g} s" + ("" if grain is None else f", grain {grain}")
        super().__init__(f"{where}: {cause}; {remedy}")

    def with_context(self, words: str, remedy: str = "") -> Self:
        """Make the same error with words before its cause that say what is to blame.

        Parameters
        ----------
        words : str
            What is to blame, such as a law of the user's own.
        remedy : str
            Change that avoids the error; the one that it has where this is empty.

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
    """A position, velocity or force became infinite or undefined."""


class OutsideError(RunError):
    """A grain passed through a wall or the piston."""


class EnergyError(RunError):
    """The energy ledger does not close."""


class NotAtRestError(RunError):
    """A stage that was to end at rest did not come to rest in time."""


class StepCountError(RunError):
    """A run takes more steps than can be made, or counted."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, where a command ends as after Ctrl-C."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, or SIGTERM where a command takes it, during a run. What was computed is kept.

    Attributes
    ----------
    trajectory : Trajectory
        Everything up to the interruption.
    terminated : bool
        Whether it was SIGTERM.
    """

    def __init__(self, trajectory: object, terminated: bool = False) -> None:
        super().__init__("terminated" if terminated else "interrupted")
        self.trajectory = trajectory
        self.terminated = terminated


_FITS = "diffrax equinox jax jaxlib mpmath sympy"
_SIMULATION = "PIL llvmlite loky numba numcodecs pandas tomli_w xarray zarr"
NEEDED_BY = dict.fromkeys(_FITS.split(), "fits") | dict.fromkeys(_SIMULATION.split(), "simulation")
"""Modules that an installation of one half lacks, with the group of `pyproject.toml` for each."""


def missing_package_error(error: ModuleNotFoundError) -> MissingPackageError | None:
    """Turn the error of a missing module into one that says what to install."""
    module = (error.name or "").partition(".")[0]
    if module not in NEEDED_BY:
        return None
    return MissingPackageError(
        f"{module} is not installed; it belongs to the group {NEEDED_BY[module]!r} of what the "
        "toolkit needs: pip install granular-damper brings all of it"
    )


def import_extra(module: str, what: str, extra: str) -> Any:
    """Import a module for what needs it, or say how to install it with an extra of the toolkit."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingPackageError(
            f"{what} needs the library {module.partition('.')[0].replace('_', '-')}; install it with: "
            f"pip install 'granular-damper[{extra}]'"
        ) from None


def with_missing_package_advice(attribute: Callable[[str], Any]) -> Callable[[str], Any]:
    """Wrap a package's ``__getattr__``, so that a missing module is reported with what to install."""

    def get(name: str) -> Any:
        try:
            return attribute(name)
        except ModuleNotFoundError as error:
            advice = missing_package_error(error)
            if advice is None:
                raise
            raise advice from None

    return get
