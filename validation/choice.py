"""The cheapest setting that reaches a tolerance, ready for `simulate` and for the command line."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Any

from granular.run.allowed import is_allowed
from granular.scene.scene import Scene
from granular.shared.errors import InputError
from validation.cost import Setting, WorkPrecision, work_precision
from validation.quantities import MeasuredQuantity, quantity_named

STEPS = ("auto*8", "auto*4", "auto*2", "auto", "auto/2", "auto/4", "auto/8")
CANDIDATES = ("stormer-verlet", "adaptive-verlet", "blanes-moan-4", "blanes-moan-6")


@dataclasses.dataclass(frozen=True)
class Choice:
    """A setting that reaches a tolerance.

    Attributes
    ----------
    scene, quantity : str
    tolerance, error : float
        What was asked for, and what was measured.
    seconds : float
        What it takes.
    keywords : dict
        For ``simulate(scene.replace(**choice.changes), **choice.keywords)``.
    changes : dict
        Keys of the scene.
    study : WorkPrecision
        All settings that were tried.
    """

    scene: str
    quantity: str
    tolerance: float
    error: float
    seconds: float
    keywords: dict[str, Any]
    changes: dict[str, Any]
    study: WorkPrecision

    @property
    def command(self) -> str:
        """The same for the command line."""
        words = ["python", "-m", "granular", "run", self.scene]
        for key, value in self.changes.items():
            words += ["--set", f"{key}={value}"]
        words += ["--dt", str(self.keywords["dt"]), "--method", self.keywords["method"]]
        return shlex.join(words)

    def __str__(self) -> str:
        return (
            f"{self.quantity} of {self.scene} to {self.tolerance:g}: error {self.error:.2g} in "
            f"{self.seconds:.3g} s\n  {self.command}"
        )

    def to_plain(self) -> dict[str, Any]:
        """The choice as plain data, with its command."""
        plain = dataclasses.asdict(self) | {"command": self.command}
        return plain | {"study": self.study.to_plain()}


def candidates(scene: Scene, methods: Sequence[str] = CANDIDATES) -> tuple[Setting, ...]:
    """The settings that `cheapest` tries: methods, steps, and both schemes of dry friction."""
    schemes: list[dict[str, Any]] = [{}]
    if scene.effects.friction is not None:
        schemes = [{"effects.friction.scheme": one} for one in ("velocity", "regularised")]
    return tuple(
        Setting(name, dt, scheme)
        for scheme in schemes
        for name in methods
        for dt in STEPS
        if is_allowed(scene.replace(**scheme), dt, name)
    )


def cheapest(
    scene: Scene, quantity: str | MeasuredQuantity, tolerance: float, until: float | None = None
) -> Choice:
    """The setting that gives a quantity to a tolerance in the least time.

    Parameters
    ----------
    scene : Scene
    quantity : str or MeasuredQuantity
        One of `validation.quantities.QUANTITIES`, or one's own.
    tolerance : float
        Error that is allowed; relative, but for the positions (in D) and the energy (over the
        energy turned over).
    until : float, optional
        Stop each run at this time [s]; the whole protocol without.

    Raises
    ------
    InputError
        If the tolerance is not above 0, the quantity is unknown, or no setting tried reaches it.
    RunError
        If the reference fails.
    """
    chosen = quantity_named(quantity)
    if not tolerance > 0.0:
        raise InputError(f"tolerance = {tolerance!r}; give an error above 0, such as 0.01")
    study = work_precision(scene, chosen, candidates(scene), until=until)
    return choice(study, tolerance)


def choice(study: WorkPrecision, tolerance: float) -> Choice:
    """The choice that a study answers.

    Raises
    ------
    InputError
        If no setting of the study reaches the tolerance.
    """
    found = study.cheapest(tolerance)
    if found is None:
        front = study.front()
        best = f"{front[-1].error:.2g}" if front else "none"
        raise InputError(
            f"tolerance = {tolerance:g} for the {study.quantity} is reached by no setting tried; "
            f"the least error is {best}: give a larger tolerance or other settings"
        )
    setting = found.setting
    return Choice(
        study.scene, study.quantity, tolerance, found.error, found.seconds,
        {"dt": setting.dt, "method": setting.method}, dict(setting.changes), study,
    )  # fmt: skip
