"""A design: the damper, what the maps promised, and what the simulations said."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

from granular.scene.scene import Scene
from reduced_models.designs.candidate import ASPECT, Candidate
from reduced_models.designs.maps import Prediction
from reduced_models.designs.proposal import Wish

if TYPE_CHECKING:
    from collections.abc import Sequence


class Check(NamedTuple):
    """A simulation of a proposal.

    Attributes
    ----------
    seed : int
        Of its random start.
    rest_height, frequency, damping_ratio, lam, k1, k2, k3
        As in `Prediction`, measured.
    misfit : float
        Rms error of the law over the rms swing.
    rest_gap, fall_gap : float
        As in `damper_figures`.
    ledger : float
        Error of the energy ledger over the energy turned over.
    times, heights : list of float
        The motion after the release [s], [m].
    """

    seed: int
    rest_height: float
    frequency: float
    damping_ratio: float
    lam: float
    k1: float
    k2: float
    k3: float
    misfit: float
    rest_gap: float
    fall_gap: float
    ledger: float
    times: Sequence[float]
    heights: Sequence[float]


class Round(NamedTuple):
    """A proposal with its promise and its checks."""

    damper: Candidate
    promise: Prediction
    checks: tuple[Check, ...]

    def mean(self, name: str) -> float:
        """Of a figure, over the checks."""
        return sum(getattr(one, name) for one in self.checks) / len(self.checks)


@dataclasses.dataclass(frozen=True, eq=False)
class DesignData:
    """A damper for a wish.

    Attributes
    ----------
    wish : Wish
    rounds : tuple of Round
        The last one is the design.
    """

    wish: Wish
    rounds: tuple[Round, ...]

    @property
    def damper(self) -> Candidate:
        """Mass of the piston, number of grains, drag, mixture; ``viscosity`` of the liquid."""
        return self.rounds[-1].damper

    @property
    def promise(self) -> Prediction:
        """What the maps say of it."""
        return self.rounds[-1].promise

    @property
    def checks(self) -> tuple[Check, ...]:
        """What the simulations say of it."""
        return self.rounds[-1].checks

    @property
    def scene(self) -> Scene:
        """The scene of the first check."""
        return self.damper.scene(self.checks[0].seed)

    @property
    def frequency(self) -> float:
        """Of the undamped small swing [Hz], mean over the checks."""
        return self.rounds[-1].mean("frequency")

    @property
    def damping_ratio(self) -> float:
        """Mean over the checks."""
        return self.rounds[-1].mean("damping_ratio")

    @property
    def rest_height(self) -> float:
        """[m], mean over the checks."""
        return self.rounds[-1].mean("rest_height")

    def met(self, frequency_tolerance: float, damping_tolerance: float) -> bool:
        """Whether every check lies within these relative tolerances of the wish."""
        return all(
            abs(one.frequency / self.wish.frequency - 1.0) <= frequency_tolerance
            and abs(one.damping_ratio / self.wish.damping - 1.0) <= damping_tolerance
            for one in self.checks
        )

    def spread(self, name: str) -> tuple[float, float]:
        """Least and greatest value over the random starts of the last round."""
        values = [getattr(one, name) for one in self.checks]
        return min(values), max(values)

    def agree(self, frequency_tolerance: float, damping_tolerance: float) -> bool:
        """Whether the random starts differ by so little that all could be within the tolerances."""
        pairs = (
            ("frequency", frequency_tolerance * self.wish.frequency),
            ("damping_ratio", damping_tolerance * self.wish.damping),
        )
        return all(high - low <= 2.0 * room for name, room in pairs
                   for low, high in [self.spread(name)])  # fmt: skip

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be doubted, in plain words."""
        found = []
        gap = min(one.fall_gap for one in self.checks)
        contact = 1.0 if self.wish.small_share == 0.0 else ASPECT
        if gap < contact:
            found.append(
                f"in the fall two grains came as near as {gap:.3g} D, closer than their contact, "
                "which the scene does not hold; drop the piston from lower down"
            )
        if min(one.rest_gap for one in self.checks) < 1.0:
            found.append("at rest grains touch; ask for a lower frequency, or fewer small grains")
        return tuple(found)

    def __str__(self) -> str:
        one, wish = self.damper, self.wish
        share = f", {100.0 * one.small_share:.3g} % of them small" if one.small_share else ""
        lines = [
            f"damper for {wish.frequency:g} Hz and a damping ratio of {wish.damping:g}:",
            f"  piston {one.mass:.4g} kg on {one.grains} grains{share}",
            f"  drag {one.drag:.4g} kg/s a grain (a liquid of {one.viscosity:.3g} Pa s, by Stokes)",
            f"  rests at {self.rest_height:.4g} m",
        ]
        lines += [
            f"  simulated from random start {check.seed}: {check.frequency:.4g} Hz "
            f"({_off(check.frequency, wish.frequency)}), damping ratio "
            f"{check.damping_ratio:.4g} ({_off(check.damping_ratio, wish.damping)})"
            for check in self.checks
        ]
        lines.append(
            f"  the maps had promised {self.promise.frequency:.4g} Hz and "
            f"{self.promise.damping_ratio:.4g}; proposals simulated: {len(self.rounds)}"
        )
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def to_plain(self) -> dict[str, Any]:
        """The design as plain data (numbers, texts, lists)."""
        return {
            "wish": self.wish._asdict(),
            "damper": self.damper._asdict() | {"viscosity": self.damper.viscosity},
            "frequency": self.frequency,
            "damping_ratio": self.damping_ratio,
            "rest_height": self.rest_height,
            "rounds": [
                {
                    "damper": one.damper._asdict(),
                    "promise": one.promise._asdict(),
                    "checks": [_without_motion(check) for check in one.checks],
                }
                for one in self.rounds
            ],
            "notes": list(self.notes),
        }


def _off(value: float, wanted: float) -> str:
    return f"{100.0 * (value / wanted - 1.0):+.2g} %"


def _without_motion(check: Check) -> dict[str, Any]:
    return {k: v for k, v in check._asdict().items() if k not in ("times", "heights")}
