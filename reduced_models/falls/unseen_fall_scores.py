"""Scores of laws on held-out falls, and a whole fall computed from its scene alone, in milliseconds.

Multiplying the law of a fall by the moving mass m = WEIGHT M g/weight gives the energy balance. The piston's
potential energy M g (height - rest) becomes work on the bed. Without friction of the grains, drag dissipates
all of this energy. Grains that follow the piston affinely dissipate the power m 2 lam z'^2. Grains that
rearrange dissipate the work of the shear stress, whose power is -m weight (rest/z)^power w z' with the law's
hidden variable w.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.blocks import Table
from granular.shared.errors import GranularError, InputError, quote
from reduced_models.falls.predicted_law import (
    LAW,
    OutsideRangeWarning,
    affine_drag_coefficient,
    piston_mass_and_gravity,
    predict_bed_parameters,
    predicted_moving_mass,
    touching_lattice_density,
)
from reduced_models.fitting.fit import fit, resolve_law
from reduced_models.fitting.problem import STARTS, FitOptions
from reduced_models.laws.equation import compile_rates
from reduced_models.laws.law import Law
from reduced_models.laws.solution import solve_law
from reduced_models.models.model import ReducedModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from granular.scene.scene import Scene


@dataclasses.dataclass(frozen=True, eq=False)
class DropScore:
    """Errors of a law fitted to one fall.

    Attributes
    ----------
    name : str
    model : ReducedModel or None
        None if the fit failed.
    errors : tuple of float
        Error for each held-out fall: rms difference of the heights divided by the height of the drop;
        infinite if the law diverges.
    failure : str
        Reason for a failed fit.
    """

    name: str
    model: ReducedModel | None
    errors: tuple[float, ...] = ()
    failure: str = ""

    @property
    def median_error(self) -> float:
        """Median error, relative to the height of the drop; infinite if there are no errors."""
        return float(np.median(self.errors)) if self.errors else math.inf

    @property
    def greatest_error(self) -> float:
        """Maximum error, relative to the height of the drop; infinite if there are no errors."""
        return max(self.errors, default=math.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class DropScores:
    """Laws fitted to one fall and tested on others.

    Attributes
    ----------
    record : PistonRecord
        The fitted fall.
    rest : float
        Height at which the piston comes to rest [m].
    labels : tuple of str
        For each held-out fall, its difference from the fitted fall in words.
    unseen : tuple of PistonRecord
        The held-out falls.
    rows : tuple of DropScore
        Scores of the laws, the smallest median first.
    scatter : tuple of float
        Spread over packings: for each held-out fall from the same height, rms difference from the
        fitted fall divided by the height of the drop. No law can be expected to be more precise.
    """

    record: PistonRecord
    rest: float
    labels: tuple[str, ...]
    unseen: tuple[PistonRecord, ...]
    rows: tuple[DropScore, ...]
    scatter: tuple[float, ...]

    @property
    def best(self) -> DropScore:
        """Score of the law with the smallest median error."""
        return self.rows[0]

    @property
    def header(self) -> tuple[str, ...]:
        """Headings of the table: law, number of fitted parameters, label of each held-out fall, median."""
        return ("law", "numbers fitted", *self.labels, "median")

    def cells(self) -> list[tuple[str, ...]]:
        """Cells of the table, one row for each law: errors in percent of the drop."""
        rows = []
        for row in self.rows:
            cells = ["", *("" for _ in self.labels), "not fitted"]
            if row.model is not None:
                cells = [str(len(row.model.parameters))]
                cells += [format_percent_of_drop(value) for value in (*row.errors, row.median_error)]
            rows.append((row.name, *cells))
        return rows

    @property
    def table(self) -> Table:
        """Table of all laws and falls."""
        return Table(self.header, self.cells())

    @property
    def verdict(self) -> str:
        """State the best law on held-out falls, and the errors of the others."""
        best, *others = [row for row in self.rows if row.model is not None]
        if math.isinf(best.median_error):
            return "No law fitted to one fall can predict the others."
        words = (
            f"Held-out falls are predicted best by {best.name}, fitted to one fall: the median error is "
            f"{format_percent_of_drop(best.median_error)} of the drop, the maximum "
            f"{format_percent_of_drop(best.greatest_error)}"
        )
        if self.scatter:
            spread = format_percent_of_drop(max(self.scatter))
            words += f"; a different random packing alone changes a fall by {spread}"
        errors = ", ".join(f"{row.name} {format_percent_of_drop(row.median_error)}" for row in others)
        return f"{words}; {errors}." if errors else f"{words}."

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the error [% of the drop] of each law against the height [mm] of the drop."""
        from granular.shared.plotting import axes_or_new, figure_label, label_log_axis_plainly, line_style

        axes = axes_or_new(ax)
        heights = np.array([1e3 * fall.height[0] for fall in self.unseen])
        order = np.argsort(heights, kind="stable")
        for k, row in enumerate(row for row in self.rows if row.model is not None):
            errors = 100.0 * np.array(row.errors)[order]
            errors[np.isinf(errors)] = np.nan
            axes.plot(heights[order], errors, marker="o", label=figure_label(row.name), **line_style(k))
        axes.set_yscale("log")
        label_log_axis_plainly(axes.yaxis)
        axes.set(xlabel="initial height of the piston [mm]", ylabel="error [% of the drop]")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
        return axes

    def to_plain(self) -> dict[str, Any]:
        """Return the scores and models as plain data, in SI units."""
        return {
            "verdict": self.verdict,
            "rest": self.rest,
            "labels": list(self.labels),
            "scatter": list(self.scatter),
            "rows": [
                {"name": row.name, "errors": list(row.errors), "failure": row.failure}
                | {"model": None if row.model is None else row.model.to_plain()}
                for row in self.rows
            ],
        }


def format_percent_of_drop(value: float) -> str:
    """Text of an error in percent of the height of the drop."""
    return "diverges" if math.isinf(value) else f"{100.0 * value:.2g} %"


FALL_LAWS = ("elastoplastic-bed", "power-law-spring", "van-der-pol-like", "linear")
SAME = 1e-3
"""Relative difference below which drop heights count as equal."""


def score_drops(
    record: PistonRecord,
    unseen: Mapping[str, PistonRecord],
    laws: Sequence[str | Law] = FALL_LAWS,
    *,
    rest: float | None = None,
    scene: Scene | None = None,
    starts: int = STARTS,
) -> DropScores:
    """Fit laws to one fall from rest, and predict others from their initial heights alone.

    Parameters
    ----------
    record : PistonRecord
        Fitted fall, times [s] and heights [m] from the release of the piston.
    unseen : mapping of str to PistonRecord
        Held-out falls from rest, with labels that describe their differences.
    laws : sequence of str or Law
        Names, equations or laws to fit.
    rest : float, optional
        Height at which the piston comes to rest [m]; by default the mean of the record's last tenth.
    scene : Scene, optional
        Scene of the fall. Fits of ``elastoplastic-bed`` start at the parameters from
        `reduced_models.predict` if the scene is in the tested range of that law.
    starts : int
        Number of random starts of each fit, from 1 to 10000.

    Returns
    -------
    DropScores
        Rms difference of the heights for each law and fall, divided by the height of the drop, without
        unit; infinite if a law diverges. The law with the smallest median error comes first. A law that
        could not be fitted comes last, without errors and with the reason.

    Raises
    ------
    InputError
        If there is no held-out fall or no law, a law's name is unknown, no law can be fitted (for
        example with fewer than 20 samples, or ``starts`` out of range), ``rest`` is not a finite
        number, or a record does not start above the height of rest.
    """
    if not laws:
        raise InputError("the argument laws is empty; give one or more laws")
    if not isinstance(unseen, Mapping):
        raise InputError(f"unseen is a {type(unseen).__name__}; give a mapping of labels to records")
    if rest is not None and not (isinstance(rest, Real) and math.isfinite(rest)):
        raise InputError(f"rest = {quote(rest)}; give a finite number [m]")
    rest_height = float(record.height[-max(1, len(record) // 10) :].mean()) if rest is None else rest
    _check_records_are_falls(record, unseen, rest_height)  # before the fits, which take minutes
    fits = [fit_law_to_fall(law, record, scene, starts) for law in laws]
    return score_fitted_laws(record, fits, unseen, rest_height)


def _check_records_are_falls(
    record: PistonRecord, unseen: Mapping[str, PistonRecord], rest_height: float
) -> None:
    """Raise an error if there are no held-out falls, or if a record is not a fall."""
    if not unseen:
        raise InputError("the argument unseen is empty; give one or more held-out falls")
    for label, item in {"the fall": record, **unseen}.items():
        if not item.height[0] > rest_height:
            raise InputError(
                f"{label} starts at {item.height[0]:g} m, not above the height of rest, "
                f"{rest_height:g} m; give a record that starts above this height"
            )


def score_fitted_laws(
    record: PistonRecord, fits: Sequence[DropScore], unseen: Mapping[str, PistonRecord], rest_height: float
) -> DropScores:
    """Compute the errors of fitted laws on held-out falls, and rank the laws; ``rest_height`` is in m."""
    _check_records_are_falls(record, unseen, rest_height)
    rows = []
    for row in fits:
        models = [] if row.model is None else [row.model]
        errors = [fall_prediction_error(own, fall, rest_height) for own in models for fall in unseen.values()]
        rows.append(dataclasses.replace(row, errors=tuple(errors)))
    if all(row.model is None for row in rows):
        raise InputError(f"no law could be fitted; the fit of {rows[0].name} failed: {rows[0].failure}")
    rows.sort(key=lambda row: (row.model is None, row.median_error))
    drop = float(record.height[0]) - rest_height
    alike = [fall for fall in unseen.values() if abs(fall.height[0] - record.height[0]) <= SAME * drop]
    scatter = tuple(_rms_height_difference(fall, record.time, record.height) / drop for fall in alike)
    return DropScores(record, rest_height, tuple(unseen), tuple(unseen.values()), tuple(rows), scatter)


def fit_law_to_fall(name: str | Law, record: PistonRecord, scene: Scene | None, starts: int) -> DropScore:
    """Fit a law to a fall from rest (record in s and m); return a score without errors on other falls."""
    law = resolve_law(name, record)
    known: dict[str, float] = {}
    if scene is not None and law.name == "elastoplastic-bed":
        with contextlib.suppress(InputError):
            known = predict_bed_parameters(scene)
    try:
        with warnings.catch_warnings(action="ignore"):  # the model keeps its notes
            model = fit(
                record,
                law,
                parameters=known,
                starts=starts,
                test_fraction=0.0,
                options=FitOptions(initial={"height": float(record.height[0]), "velocity": 0.0}),
            )
    except GranularError as cause:
        return DropScore(law.name, None, failure=str(cause))
    return DropScore(law.name, model)


def fall_prediction_error(model: ReducedModel, fall: PistonRecord, rest_height: float) -> float:
    """Predict a fall from its initial height; return the rms error relative to the drop."""
    first = float(fall.height[0])
    try:
        motion = model.simulate(fall.time, z0=first, v0=0.0)
    except InputError:
        return math.inf
    return _rms_height_difference(fall, motion.time, motion.height) / (first - rest_height)


def _rms_height_difference(record: PistonRecord, time: np.ndarray, height: np.ndarray) -> float:
    """Return the rms difference [m] between a record and another motion over their common duration."""
    end = min(record.time[-1] - record.time[0], time[-1] - time[0])
    since = record.time - record.time[0]
    other = np.interp(since, time - time[0], height)
    return float(np.sqrt(np.mean((record.height - other)[since <= end] ** 2)))


SETTLED = 0.05
"""A piston counts as settled if its distance from equilibrium stays below this fraction of the drop."""
TOUCHING = 1.05
"""Height of the piston, divided by its height on a lattice of touching discs, below which the law is
unreliable. Down to 1.09 the law's error is at most 3 % of the drop; at 1.02 and 0.89 it is 5 and 8 %."""
DURATION = 3.0
"""Duration [s] of a fall onto 368 grains. The duration, like the period, is proportional to grains^(1/4)."""
SAMPLES = 3001


class FallSummary(NamedTuple):
    """Heights, times, forces and losses of a fall that starts from rest.

    Attributes
    ----------
    height, rest : float
        Heights of the start and of rest [m].
    settling_time : float
        Time after which the piston stays within 5 % of the drop about its height of rest [s];
        infinite if it does not settle within the computed time.
    greatest_force : float
        Maximum force of the bed on the piston [N].
    deepest : float
        Minimum height of the piston [m].
    affine_loss : float
        Energy dissipated by the drag of grains that follow the piston affinely [J].
    excess_loss : float
        Additional energy loss by grains that rearrange [J].
    simulated : FallSummary or None
        The same quantities from a simulation, if one was run.
    """

    height: float
    rest: float
    settling_time: float
    greatest_force: float
    deepest: float
    affine_loss: float
    excess_loss: float
    simulated: FallSummary | None = None

    @property
    def loss_over_affine(self) -> float:
        """Ratio of the total energy loss to the loss by affine motion."""
        return 1.0 + self.excess_loss / self.affine_loss

    def __str__(self) -> str:
        settled = (
            f"settles in {self.settling_time:.3g} s"
            if math.isfinite(self.settling_time)
            else "does not settle within the computed time"
        )
        text = (
            f"falls from {1e3 * self.height:.4g} mm to rest at {1e3 * self.rest:.4g} mm, and "
            f"{settled}\n"
            f"minimum height {1e3 * self.deepest:.4g} mm, maximum force {self.greatest_force:.4g} N\n"
            f"lost to drag: {self.affine_loss:.4g} J by affine motion, and "
            f"{self.excess_loss:.4g} J by rearrangements"
        )
        simulated = self.simulated
        return text if simulated is None else f"by the law: {text}\nsimulated: {simulated}"


def whole_fall(
    scene: Scene, height: float | None = None, *, simulate: bool | None = None, progress: bool = True
) -> FallSummary:
    """Compute a fall from the law of `predict`, and simulate the fall if the law is uncertain.

    The fall onto N grains starts from rest; its first 3 s (N/368)^(1/4) are computed.

    Parameters
    ----------
    scene : Scene
        Scene of a bed below a falling piston without friction.
    height : float, optional
        Height of the start [m], finite and above the height of rest; by default the height of the
        scene's piston.
    simulate : bool, optional
        True: always simulate the fall; False: never; by default only outside the law's range, with a
        warning.
    progress : bool
        Show a progress bar of the simulation on standard error, with the remaining time.

    Returns
    -------
    FallSummary
        Heights of start and rest and the minimum height [m], settling time [s] (infinite if it does
        not settle within the computed time), maximum force [N] and energy losses [J]; and the same
        quantities from the simulation, if one was run.

    Raises
    ------
    InputError
        If the scene has no piston with a mass under gravity, or no dipoles or discs; if the piston has
        friction or presses discs into contact at rest; if there are effects other than dipoles or
        discs, walls, gravity, drag and contact, or walls or a cut-off that `predict` refuses; or if the
        height is not a finite number above the height of rest.
    RunError
        If the simulation becomes unreliable.

    Warns
    -----
    OutsideRangeWarning
        With fewer grains than tested, rows of discs that do not touch, a drag per piston mass above
        the range compared with falls, or a fall that presses discs into contact.
    """
    if height is not None and not isinstance(height, Real):
        raise InputError(f"height = {quote(height)}; give a number [m]")
    with warnings.catch_warnings(record=True, action="always") as caught:
        values = predict_bed_parameters(scene, refuse_outside_range=False)
    for warning in caught:
        warnings.warn(warning.message, stacklevel=2)
    outside = any(warning.category is OutsideRangeWarning for warning in caught)
    result = _summarise_fall_by_law(scene, values, height)
    if pressed := _touching_discs_warning(scene, result.deepest):
        outside = True
        warnings.warn(pressed, OutsideRangeWarning, stacklevel=2)
    if not (outside if simulate is None else simulate):
        return result
    return result._replace(simulated=_summarise_simulated_fall(scene, result.height, progress))


def _summarise_fall_by_law(scene: Scene, values: dict[str, float], height: float | None) -> FallSummary:
    from scipy.integrate import simpson

    piston, (mass, gravity) = scene.piston, piston_mass_and_gravity(scene)
    assert piston is not None
    start = piston.height if height is None else float(height)
    if not values["rest"] < start < math.inf:
        raise InputError(
            f"the fall starts at {start:g} m, not above the height of rest, {values['rest']:g} m; "
            "give a larger height"
        )
    times = np.linspace(0.0, _fall_duration(scene), SAMPLES)
    numbers = [values[name] for name in LAW.parameters]
    z, v, w = solve_law(LAW, times, start, 0.0, numbers, start - values["rest"]).states.T
    acceleration = np.asarray(compile_rates(LAW.equation, (), "numpy")(z, v, w, *numbers)[0])
    force = mass * (gravity + acceleration)
    stress = values["weight"] * (values["rest"] / z) ** values["power"] * w
    powers = np.stack([2.0 * values["lam"] * v**2, -stress * v])
    losses = predicted_moving_mass(scene, values) * simpson(powers, x=times)
    return _fall_summary_from_motion(times, z, force, values["rest"], losses)


def _touching_discs_warning(scene: Scene, deepest: float) -> str:
    """Return a warning if a fall presses discs into contact, which the law neglects; otherwise empty."""
    grains = scene.grains
    touching = (
        grains.count * grains.species[0].diameter ** 2 / (scene.cell.width * touching_lattice_density(grains))
    )
    if grains.magnets == "dipoles" or deepest > TOUCHING * touching:
        return ""
    return (
        f"by the law, the piston falls to {1e3 * deepest:.4g} mm, where discs of {quote(scene.name)} touch "
        f"(in a lattice at {1e3 * touching:.4g} mm); simulate the fall, or start it from a lower height"
    )


def _fall_duration(scene: Scene) -> float:
    return DURATION * (scene.grains.count / 368) ** 0.25


def _fall_summary_from_motion(
    times: np.ndarray, z: np.ndarray, force: np.ndarray, rest: float, losses: np.ndarray
) -> FallSummary:
    outside = np.flatnonzero(np.abs(z - rest) > SETTLED * (z[0] - rest))
    settled = math.inf if outside[-1] + 1 == len(times) else float(times[outside[-1] + 1])
    affine, excess = losses.tolist()
    return FallSummary(float(z[0]), rest, settled, float(force.max()), float(z.min()), affine, excess)


def _summarise_simulated_fall(scene: Scene, start: float, progress: bool) -> FallSummary:
    """Simulate a fall and summarise it; the last tenth of the motion gives the height of rest."""
    from granular import simulate

    diameter = scene.grains.species[0].diameter
    run = simulate(
        scene.replace(
            **{
                "piston.height": start,
                "arrangement.height": start - diameter,
                "output.record": None,
                "protocol": [{"kind": "free", "name": "drop", "duration": _fall_duration(scene)}],
            }
        ),
        dt="auto*2",
        progress=progress,
    )
    motion = run.piston()
    assert motion.velocity is not None
    assert motion.force is not None
    affine = affine_drag_coefficient(scene) * float(np.trapezoid(motion.velocity**2, motion.time))
    losses = [name for name in ("drag_loss", "contact_loss") if name in run.dataset]
    lost = sum(float(run.dataset[name].values[-1]) for name in losses)
    rest = float(motion.height[-len(motion.height) // 10 :].mean())
    return _fall_summary_from_motion(
        motion.time, motion.height, motion.force, rest, np.array([affine, lost - affine])
    )
