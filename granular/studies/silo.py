"""Flow rate of magnets out of a silo with openings of several widths.

The bed settles over the closed opening, once for each random packing. Then the opening is opened and grains
fall out. The flow rate is measured between the times at which a tenth and a half of the grains have left. If
less than half leave, the measurement ends when the last of them leaves. If no grain leaves for `CLOG_TIME`
seconds before half of the grains have left, the opening counts as clogged.

The fitted law is Beverloo's law in two dimensions, Q = C sqrt(g/D) (b/D - k)^(3/2), for grains that fall
freely from an arch over an opening of width b. A margin k D of this width does not contribute (Beverloo,
Leniger and van de Velde 1961, doi:10.1016/0009-2509(61)85030-6). Repelling magnets follow this power law
approximately, and can clog although they do not touch (Lumay et al. 2015, doi:10.4279/pip.070013).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.linear.equilibrium import settled_scene_positions_and_heights
from granular.run.simulation import simulate
from granular.scene.scene import Scene
from granular.shared.array_types import Float
from granular.shared.blocks import Block, Table, Text, blocks_text
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from granular.run.trajectory import Trajectory

__all__ = ["SiloFlow", "silo", "with_opening"]

FIRST, LAST = 0.1, 0.5
"""Fractions of the grains that have left at the start and at the end of the measured interval."""

CLOG_TIME = 1.0
"""An opening counts as clogged after this time [s] in which no grain leaves."""

STEP = "auto*4"
"""Time step of the discharge; the energy balance is then correct to 1e-5 of the exchanged energy."""

SETTLING = [{"kind": "hold", "name": "settle", "until": "rest", "duration": "60 s", "tolerance": "1e-2 D"}]
"""Protocol that lets the bed settle over the closed opening."""


class SiloFlow(NamedTuple):
    """Flow rates out of a silo.

    Attributes
    ----------
    diameter : float
        Diameter D of the first species [m].
    gravity : float
        Gravitational acceleration [m/s^2].
    openings : float64 (b,)
        Widths of the opening [m].
    rates : float64 (b, s)
        Flow rate for each opening and packing [grains/s]; NaN if too few grains left.
    clogged : bool (b, s)
        True if the opening clogged before half of the grains had left.
    left : int64 (b, s)
        Number of grains that left.
    """

    diameter: float
    gravity: float
    openings: Float[np.ndarray, "b"]
    rates: Float[np.ndarray, "b s"]
    clogged: np.ndarray
    left: np.ndarray

    @property
    def law(self) -> tuple[float, float]:
        """Factor C and margin k of the fitted law, by least squares over all flows that did not clog.

        Both are NaN if grains flow through fewer than two openings.
        """
        # Linear in sqrt(g/D) C: (Q / sqrt(g/D))^(2/3) = C^(2/3) (b/D - k).
        flows = ~self.clogged & np.isfinite(self.rates)
        if len(set(np.nonzero(flows)[0])) < 2:
            return np.nan, np.nan
        widths = np.broadcast_to(self.openings[:, None] / self.diameter, self.rates.shape)[flows]
        roots = (self.rates[flows] / np.sqrt(self.gravity / self.diameter)) ** (2.0 / 3.0)
        slope, intercept = np.polyfit(widths, roots, 1)
        return float(slope**1.5), float(-intercept / slope)

    def predict(self, openings: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the flow rates of the fitted law.

        Parameters
        ----------
        openings : float (n,)
            Widths of the opening [m].

        Returns
        -------
        float64 (n,)
            Flow rates [grains/s].
        """
        factor, margin = self.law
        free = np.maximum(openings / self.diameter - margin, 0.0)
        return np.asarray(factor * np.sqrt(self.gravity / self.diameter) * free**1.5)

    def rows(self) -> list[list[str]]:
        """Return opening, mean rate, spread over packings, fitted rate and number of clogs as strings.

        Returns
        -------
        list of lists of str
            One row for each opening.
        """
        rows = []
        for index, opening in enumerate(self.openings):
            rates = self.rates[index][np.isfinite(self.rates[index])]
            mean = f"{rates.mean():.1f}" if len(rates) else "-"
            scatter = f"{rates.std(ddof=1):.1f}" if len(rates) > 1 else "-"
            predicted = self.predict(np.array([opening]))[0]
            law = f"{predicted:.1f}" if np.isfinite(predicted) else "-"
            clogs = f"{self.clogged[index].sum()} of {len(self.clogged[index])}"
            rows.append([f"{opening / self.diameter:g} D", mean, scatter, law, clogs])
        return rows

    def blocks(self) -> list[Block]:
        """Flow rates at the openings as a table, and the fitted law.

        Returns
        -------
        list of Block
            Blocks of `granular.shared.blocks`.
        """
        factor, margin = self.law
        head = ["opening", "grains/s", "sd", "law", "clogged"]
        law = f"Q = {factor:.3f} sqrt(g/D) (b/D - {margin:.2f})^(3/2)"
        if not np.isfinite(factor):
            law = "no fitted law: grains flow through fewer than two openings"
        return [Table(head, self.rows()), Text(law)]

    def __str__(self) -> str:
        return blocks_text(self.blocks())

    def to_plain(self) -> dict[str, Any]:
        """Return rates and fitted law as plain data, in SI.

        Returns
        -------
        dict
            Fields by name, with ``factor`` and ``margin`` of the law.
        """
        factor, margin = self.law
        arrays = {name: value.tolist() for name, value in self._asdict().items() if hasattr(value, "tolist")}
        known = np.isfinite(factor)
        return arrays | {"factor": factor if known else None, "margin": margin if known else None}

    def plot(self, ax: Axes | None = None) -> Axes:
        """Plot flow rates and the law against the opening; clogged flows are crosses at 0.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; new ones if not given.

        Returns
        -------
        Axes
            Axes that hold the drawing.
        """
        from granular.shared.plotting import COLOURS, axes_or_new

        ax = axes_or_new(ax)
        widths = self.openings / self.diameter
        rates = np.where(self.clogged, 0.0, self.rates)
        for mask, marker, label in ((~self.clogged, "o", "flows"), (self.clogged, "x", "clogged")):
            index = np.nonzero(mask)
            ax.plot(widths[index[0]], rates[index], marker, color=COLOURS[0], label=label)
        curve = np.linspace(0.0, 1.05 * float(widths.max()), 200)
        ax.plot(curve, self.predict(curve * self.diameter), color=COLOURS[1], label="fitted law")
        ax.set(xlabel="opening [D]", ylabel="flow rate [grains/s]")
        ax.legend()
        return ax


def with_opening(scene: Scene, width: float) -> Scene:
    """Return a silo with another width [m] of the opening between the lowest ends of its sides.

    Parameters
    ----------
    scene : Scene
        Scene whose cell has an opening at height 0, between the free ends of two sides.
    width : float
        Distance between these ends [m]; 0 closes the silo. The other ends of both sides do not move.

    Returns
    -------
    Scene
        Silo with both ends moved symmetrically.

    Raises
    ------
    InputError
        If the scene has no such opening, or the width does not fit between the other ends.
    """
    floors = [line.ends(0.0, 0.0) for line in scene.cell.lines if scene.cell.is_polygon]
    ends = [end for floor in floors for end in floor]
    free = sorted(end for end in ends if ends.count(end) == 1 and end[1] == 0.0)
    if len(free) != 2:
        raise InputError(f"scene {scene.name!r} is not a silo; use a cell.sides with one opening at height 0")
    middle = 0.5 * (free[0][0] + free[1][0])
    outer_ends = [end[0] for floor in floors if {*floor} & {*free} for end in {*floor} - {*free}]
    limit = 2.0 * min(abs(x - middle) for x in outer_ends)
    if not 0.0 <= width < limit:
        raise InputError(
            f"the opening is {width:g} m wide; its width must be 0 m or more and less than {limit:g} m, the "
            "distance between the other ends of its sides; use another width, or longer sides"
        )
    moved = {end: (middle + sign * 0.5 * width, 0.0) for end, sign in zip(free, (-1.0, 1.0), strict=True)}
    sides = scene.to_plain()["cell"]["sides"]
    for side in sides:
        side["ends"] = [moved.get(tuple(end), tuple(end)) for end in side["ends"]]
    return scene.replace(**{"cell.sides": sides})


def silo(scene: Scene, openings: Sequence[float], starts: int = 3, *, progress: bool = False) -> SiloFlow:
    """Measure the flow of magnets out of a silo for several openings and random packings.

    Parameters
    ----------
    scene : Scene
        Scene with one opening at the bottom, such as the packaged ``silo``.
    openings : sequence of float
        Widths of the opening [m].
    starts : int
        Number of settled beds, with the arrangement seeds 1, 2, ...
    progress : bool
        Whether to show the progress of the runs.

    Returns
    -------
    SiloFlow
        Rates, clogs and the fitted law.

    Raises
    ------
    InputError
        If the scene is not a silo, or a width is negative.

    References
    ----------
    Lumay et al., Papers in Physics 7 (2015) 070013, doi:10.4279/pip.070013.

    Examples
    --------
    >>> from granular import load_scene
    >>> from granular.studies.silo import with_opening
    >>> with_opening(load_scene("silo"), 0.06).cell.lines[1].ends(0.0, 0.0)[1]
    (0.09, 0.0)
    """
    gravity = scene.effects.gravity
    if gravity is None:
        raise InputError("the scene has no gravity, which a silo needs; add effects.gravity")
    if min(openings, default=0.0) <= 0.0:
        raise InputError(f"openings = {list(openings)} m; give one or more widths, each above 0 m")
    if starts < 1:
        raise InputError(f"starts = {starts} beds; give 1 or more")
    with_opening(scene, max(openings))
    flows = [
        [
            _flow_rate_clogged_and_outflow_count(run)
            for run in _run_discharges(scene, openings, seed, progress)
        ]
        for seed in range(1, starts + 1)
    ]
    rates, clogged, left = (np.array([[flow[k] for flow in row] for row in flows]).T for k in range(3))
    diameter = scene.grains.species[0].diameter
    return SiloFlow(diameter, gravity.acceleration, np.array(openings), rates, clogged, left)


def _run_discharges(scene: Scene, openings: Sequence[float], seed: int, progress: bool) -> list[Trajectory]:
    """Discharge one settled bed through each opening."""
    closed = with_opening(scene.replace(**{"arrangement.seed": seed, "protocol": SETTLING}), 0.0)
    positions = settled_scene_positions_and_heights(closed)[1]
    resting = scene.replace(arrangement={"positions": positions.tolist()})
    flows = [with_opening(resting, width) for width in openings]
    return [simulate(flow, dt=STEP, progress=progress) for flow in flows]


def _flow_rate_clogged_and_outflow_count(run: Trajectory) -> tuple[float, bool, int]:
    """Return the flow rate [1/s], True if the opening clogged, and the number of grains that left."""
    times, count = run.dataset["departure_time"].values, run.scene.grains.count
    first, last = round(FIRST * count), round(LAST * count)
    end = float(run.dataset["time"].values[-1])
    pauses = np.diff([0.0, *times[:last], *([] if len(times) >= last else [end])])
    clogged = bool(pauses.max() > CLOG_TIME)
    last = min(last, len(times) - 1)
    rate = (last - first) / (times[last] - times[first]) if last > first + 5 else np.nan
    return float(rate), clogged, len(times)
