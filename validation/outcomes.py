"""What became of a hard case: accurate, degraded and said so, stopped with a typed error, or worse.

The worst is a run that ends as if all were well with figures that are not: a silent failure. An
error that is not one of the toolkit's own is as bad for a user, and is called a crash.
"""

from __future__ import annotations

import dataclasses
import math
import time
import warnings
from collections.abc import Callable
from typing import Any

from granular.run.trajectory import Trajectory
from granular.scene.scene import Scene
from granular.shared.errors import GranularError

ACCURATE, DEGRADED, STOPPED = "accurate", "degraded and said so", "stopped"
SILENT, CRASHED = "SILENT FAILURE", "CRASH"
BROKEN = ("EnergyError", "NotFiniteError", "OutsideError")
"""What a step that is too long may end in."""

OVERLAP = "less than a diameter"
"""Part of the warning that two grains overlap where no contact is: physics, not accuracy."""


@dataclasses.dataclass(frozen=True)
class HardCase:
    """One entry of the catalogue.

    Attributes
    ----------
    name, what : str
        ``what`` says what is hard about it.
    scene : callable
        Makes the scene; it may raise a typed error, which counts as a stop.
    measure : callable
        The error of a finished run, of the kind that ``accurate`` says.
    accurate : str
        What is measured.
    limit : float
        The error up to which the run is accurate.
    quick, full : float
        Times up to which it runs [s].
    errors : tuple of str
        Names of the errors that may end it.
    dt : float or str
        The step it is run with.
    may_degrade : bool
        Whether a warning may take the place of accuracy.
    """

    name: str
    what: str
    scene: Callable[[], Scene]
    measure: Callable[[Trajectory], float]
    accurate: str
    limit: float
    quick: float
    full: float
    errors: tuple[str, ...] = ()
    dt: float | str = "auto"
    may_degrade: bool = False


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes
    ----------
    case, method, dt : str
    kind : str
        `ACCURATE`, `DEGRADED`, `STOPPED`, `SILENT` or `CRASHED`.
    error : float
        As measured; NaN where the run did not end.
    limit : float
    said : str
        The typed error's class and message, or the warnings.
    allowed : bool
        Whether the case may end like this.
    seconds : float
        Wall time, the compilation of a new kind of scene included.
    measured : str
        What the error is of, with its unit.
    """

    case: str
    method: str
    dt: str
    kind: str
    error: float
    limit: float
    said: str
    allowed: bool
    seconds: float
    measured: str = ""

    def to_plain(self) -> dict[str, Any]:
        """The outcome as plain data; None for an error that was not measured."""
        error = self.error if math.isfinite(self.error) else None
        return dataclasses.asdict(self) | {"error": error}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Outcome:
        """The outcome from what `to_plain` made."""
        return cls(**plain | {"error": math.nan if plain["error"] is None else plain["error"]})


def outcome(
    case: HardCase,
    method: str = "stormer-verlet",
    dt: float | str | None = None,
    *,
    full: bool = False,
) -> Outcome:
    """Run a case and judge what became of it.

    Parameters
    ----------
    case : HardCase
    method : str
    dt : float or str, optional
        The case's own step without.
    full : bool
        Up to the case's full time instead of the quick one.
    """
    dt = case.dt if dt is None else dt
    begun = time.perf_counter()
    kind, error, said = _attempt(case, method, dt, case.full if full else case.quick)
    name = said.split(":", 1)[0]
    allowed = (
        kind == ACCURATE
        or (kind == DEGRADED and case.may_degrade)
        or (kind == STOPPED and name in case.errors)
    )
    return Outcome(
        case.name, method, str(dt), kind, error, case.limit, said, allowed,
        time.perf_counter() - begun, case.accurate,
    )  # fmt: skip


def _attempt(case: HardCase, method: str, dt: float | str, until: float) -> tuple[str, float, str]:
    from granular import simulate

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run = simulate(case.scene(), dt=dt, t_end=until, method=method, progress=False)
            error = float(case.measure(run))
        except GranularError as stop:
            return STOPPED, math.nan, f"{type(stop).__name__}: {stop}"
        except Exception as crash:  # whatever it is, it belongs into the table
            return CRASHED, math.nan, f"{type(crash).__name__}: {crash}"
    said = "; ".join(str(one.message) for one in caught)
    doubts = [one for one in caught if OVERLAP not in str(one.message)]
    if error <= case.limit:
        return ACCURATE, error, said
    return (DEGRADED if doubts else SILENT), error, said
