"""A reduced model: a law with parameters, their uncertainty, and the quality of the fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from granular.records.record import PistonRecord
from granular.shared.array_types import Float
from granular.shared.blocks import Equation, Printout
from granular.shared.errors import InputError, quote, sanitize
from granular.shared.files import write_json
from reduced_models.models import export, observed, prediction, schema
from reduced_models.models.at_rest import HarmonicCycle
from reduced_models.models.plain_data import field_annotations_of_class, plain_value
from reduced_models.models.ports import GRAVITY, force_port
from reduced_models.models.printed_model import PrintedModel
from reduced_models.records.sensor import Sensor, motion_signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OPEN = 20.0
"""An interval is printed as "open" if its width, divided by the value, exceeds this."""
_MARGIN = 0.05  # tolerated excess, relative to the range of fitted heights


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ReducedModel(PrintedModel):
    """A law with fitted parameters.

    Attributes
    ----------
    law : Law
        Law of motion.
    parameters : mapping of str to float
        In the units of ``law.units``.
    intervals : mapping of str to (float, float)
        Confidence intervals of the parameters, and of ``shift`` and ``scale`` if fitted, in their
        units; ends of intervals may be infinite.
    confidence : float
        Confidence level of the intervals, between 0 and 1.
    initial : (float, float)
        Height [m] and velocity [m/s] at the record's start.
    at_rest : AtRest or None
        Small oscillations about equilibrium; None if the law has no equilibrium near the record.
    quality : Quality
        Quality of the fit: residual, noise, test error, and success of the search.
    undetermined : tuple of ParameterDirection
        Combinations of parameters that the data do not determine.
    domain : mapping of str to (float, float)
        Range of heights [m] and velocities [m/s] in the fitted records.
    notes : tuple of str
        Warnings in plain words.
    provenance : mapping of str to str
        Data and fit from which the model was made.
    hidden : mapping of str to float
        Nonzero hidden states at the record's start.
    input_interpolation : str
        Interpolation of the inputs between samples.
    covariance_names : tuple of str
        Names of the rows of the covariance: parameters, and ``height``, ``velocity`` and hidden states
        at the start.
    covariance : float64 (p, p)
        Covariance of the quantities in ``covariance_names``, in their units.
    no_swing : str
        Reason why ``at_rest`` is None.
    coordinate_unit : "m" or "rad"
        Unit of the height; for an angle, [m] means [rad] throughout.
    sensor : Sensor or None
        Sensor of the fitted signal, with gain and offset; residual and noise are in the unit of the
        signal. None if heights were fitted.
    untold : tuple of str
        Quantities that the signal does not determine: parameters, or ``level`` or ``size`` of the motion.
        Their values are conventions and are not printed.
    conventions : mapping of str to float
        Values, chosen by convention, of parameters that the record does not determine; the motion is
        computed with them. These parameters are neither in ``parameters`` nor in ``intervals``.
    observation : str
        Column that the law describes and to which it was fitted; empty for the height.
    quantile : float
        Ratio of the half-width of an interval to the standard deviation.
    cycles : tuple of HarmonicCycle
        Measured cycles of a force on a prescribed stroke; similar cycles are averaged.
    qualities : mapping of str to Quality
        Quality of the fit to further columns that the law observes.
    """

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix (p, p) of the entries in ``covariance_names``, from -1 to 1, without unit.

        Rows and columns of fixed entries are zero. The shape is (0, 0) if the model has no covariance.
        """
        return prediction.correlation_matrix(self.covariance)

    def residuals(self, record: PistonRecord) -> np.ndarray:
        """Return the heights of a fitted record minus the heights of the model.

        If a sensor's signal was fitted: measured minus modelled signal, in the unit of the signal. The
        model starts at the record's first time from the fitted state, ``initial``.

        Parameters
        ----------
        record : PistonRecord
            Record (n,) that the model was fitted to.

        Returns
        -------
        float64 (n,)
            Residuals [m], or in the unit of the sensor's signal.

        Raises
        ------
        RecordError
            If the record lacks an input, the sensor's signal, or the motion of its base.
        InputError
            If the solution diverges or is too stiff to follow.
        """
        sensor = self.sensor or Sensor("height", column=self.observation or None)
        return sensor.signal(record.columns) - self.simulate_signal(record)

    def simulate_signal(self, record: PistonRecord) -> np.ndarray:
        """Return the heights of the fitted motion at a record's times, or the fitted signal.

        For a law along a prescribed stroke, the stroke is smoothed and the result is the quantity that
        the law describes, such as the force.

        Parameters
        ----------
        record : PistonRecord
            Record (n,) that the model was fitted to, with the inputs of the law.

        Returns
        -------
        float64 (n,)
            Heights [m] (for an angle [rad]), or the signal in its unit.

        Raises
        ------
        RecordError
            If the record lacks an input of the law, or the motion of the sensor's base.
        InputError
            If the solution diverges or is too stiff to follow.
        """
        if self.observation:
            return observed.simulate_observation(self, record)
        motion = self.simulate_record(record)
        if self.sensor is None:
            return motion.height
        assert motion.velocity is not None
        base = self.sensor.base_motion(record.columns)
        return motion_signal(self.sensor, motion.time, motion.height, motion.velocity, base)

    def predict_with_band(
        self, t: np.ndarray, inputs: Mapping[str, np.ndarray] | None = None, confidence: float | None = None
    ) -> prediction.PredictionBand:
        """Return the motion with its confidence band, by linear error propagation (JCGM 100:2008, section 5).

        Parameters
        ----------
        t : float64 (n,)
            Two or more increasing times [s]; at the first time the motion has the fitted initial state.
        inputs : mapping of str to array, optional
            Inputs (n,) of the law at these times, in the units of the records' columns.
        confidence : float, optional
            Confidence level, between 0 and 1; by default the confidence level of the fit.

        Returns
        -------
        prediction.PredictionBand
            Heights (n,) [m] with lower and upper bounds of the motion, without measurement noise.

        Raises
        ------
        InputError
            If the confidence is not between 0 and 1, the model has no covariance, there are fewer than two
            times or they do not increase, an input is missing or of another length, or the solution
            diverges.
        """
        from scipy.stats import norm

        level = self.confidence if confidence is None else confidence
        if not 0.0 < level < 1.0:
            raise InputError(f"confidence = {level}; give a fraction between 0 and 1")
        height, spread = prediction.predict_heights_and_deviations(self, t, inputs)
        width = float(norm.ppf(0.5 + 0.5 * level)) * spread
        noise = max(self.quality.noise, self.quality.residual)
        times = np.asarray(t, dtype=np.float64)
        return prediction.PredictionBand(times, height, height - width, height + width, noise, level)

    def plot(self, record: PistonRecord | None = None, ax: Axes | None = None) -> Axes:
        """Draw the model's motion over a fitted record.

        Without a record, draw the free decay with zero inputs from the fitted height farthest from
        equilibrium. A new figure also shows the residuals below. Heights are in mm, angles in rad.

        Parameters
        ----------
        record : PistonRecord, optional
            Record (n,) that the model was fitted to, with the inputs of the law.
        ax : Axes, optional
            Axes to draw on; new ones if not given.

        Returns
        -------
        Axes
            Axes with the motion.

        Raises
        ------
        InputError
            If the record lacks an input, or the solution diverges or is too stiff to follow; without a
            record, if the law has no equilibrium.
        """
        from granular.shared.plotting import axes_or_new, new_axes

        if self.law.prescribed:
            return observed.plot_force_loops(self, record, axes_or_new(ax))
        if record is None:
            return prediction.plot_decay(self, axes_or_new(ax))
        height = self.simulate_record(record).height
        if ax is None:
            ax, below = new_axes(2, height=4.6, sharex=True, height_ratios=(2, 1))
            prediction.plot_residuals(self, record.time, record.height - height, below)
        return prediction.plot_model(self, record.time, height, record.height, ax)

    def rhs(
        self,
        t: float,
        state: Float[np.ndarray, "s"],
        inputs: Mapping[str, float | Callable[[float], float]] | None = None,
    ) -> Float[np.ndarray, "s"]:
        """Return the time derivatives of all states, for `scipy.integrate.solve_ivp` from `initial_state`.

        Parameters
        ----------
        t : float
            Time since the start [s].
        state : float64 (s,) or (s, k)
            Height [m] and velocity [m/s], then the states in ``law.hidden`` in that order; with
            ``vectorized=True``, k such states.
        inputs : mapping of str to float or callable, optional
            Inputs of the law, in the units of the records' columns: each a number, or a function of the
            time. Pass them by ``solve_ivp(..., args=(inputs,))``.

        Returns
        -------
        float64 (s,) or (s, k)
            Time derivatives of the states.

        Raises
        ------
        InputError
            If the law describes a force along a prescribed stroke, an input is missing, or the number of
            states is wrong.
        """
        return prediction.state_rates(self, t, state, inputs or {})

    @property
    def initial_state(self) -> Float[np.ndarray, "s"]:
        """States at the record's start, in the order that `rhs` expects."""
        return prediction.initial_state(self)

    def __repr__(self) -> str:
        values = ", ".join(
            f"{name} = {value:.{max(5, self.printed_digits)}g} {self.unit_of_parameter(name)}".rstrip()
            for name, value in self.parameters.items()
        )
        return (
            f"ReducedModel {self.law.name!r}: {self.law.equation}\n"
            f"  {values}\n"
            f"  residual {100.0 * self.quality.relative:.3g} % {self.error_reference_text}"
        )

    def _repr_html_(self) -> str:
        from granular.shared.html_pages import blocks_html
        from reduced_models.laws.printing import equation_as_mathml, hidden_rate_as_mathml

        rates = [hidden_rate_as_mathml(name, rate) for name, rate in self.printed_hidden_rates.items()]
        formulas = map(Equation, (equation_as_mathml(self.printed_equation), *rates))
        return blocks_html([*formulas, Printout(repr(self))])

    def _repr_latex_(self) -> str:
        return f"$${self.fitted_latex}$$"

    def free_decay(self, amplitude: float, periods: float = 10.0) -> PistonRecord:
        """Return the motion of a piston released from a height above equilibrium.

        Parameters
        ----------
        amplitude : float
            Height above equilibrium at the release [m]; negative below equilibrium.
        periods : float
            Duration in periods of small oscillations, above 0.

        Returns
        -------
        PistonRecord
            Motion from the release on, with zero inputs: times [s], heights [m] and velocities [m/s].

        Raises
        ------
        InputError
            If the law has no equilibrium, the duration is not above zero and finite, or the motion
            cannot be computed, for example with an infinite amplitude.
        """
        return prediction.free_decay(self, amplitude, periods)

    def harmonic_cycle(self, amplitude: float, frequency: float | None = None) -> HarmonicCycle:
        """Return equivalent stiffness and damping of a harmonic cycle, and the dissipated energy.

        They are computed in the one-harmonic approximation (Krylov and Bogoliubov 1947, Introduction to
        Non-Linear Mechanics) with zero inputs. For a force on a prescribed stroke the results are in
        newtons, with errors, for a cycle about the middle of the fitted heights.

        Parameters
        ----------
        amplitude : float
            Amplitude about the cycle's centre, above 0 [m].
        frequency : float, optional
            Angular frequency, above 0 [rad/s]; by default the square root of the equivalent stiffness.

        Returns
        -------
        HarmonicCycle
            Stiffness [1/s^2], damping [1/s] and energy [J/kg] of a cycle, per kilogram.

        Raises
        ------
        InputError
            If the amplitude is not above zero, the frequency is not above zero and finite, the law has no
            equilibrium, no frequency is given for a law without stiffness at this amplitude, or the cycle
            leaves the range in which the law is defined.
        """
        if self.law.prescribed:
            return observed.simulate_force_cycle(self, amplitude, frequency)
        return prediction.harmonic_cycle(self, amplitude, frequency)

    def frequency_response(
        self, force: float, frequencies: np.ndarray, largest: float | None = None
    ) -> prediction.SteadyAmplitudes:
        """Return steady amplitudes under a harmonic force, from describing functions as in `harmonic_cycle`.

        Parameters
        ----------
        force : float
            Amplitude of the force, above 0 [N/kg].
        frequencies : float64 (k,)
            Angular frequencies, above 0 [rad/s].
        largest : float, optional
            Maximum amplitude searched, above 0 [m]; by default ten times the record's maximum displacement.

        Returns
        -------
        prediction.SteadyAmplitudes
            Smallest and largest steady amplitude (k,) [m] at each frequency; NaN without a steady
            amplitude up to ``largest``.

        Raises
        ------
        InputError
            If the force, a frequency or the maximum amplitude is not above zero and finite, the
            frequencies are not an array (k,), or the law has no equilibrium.
        """
        return prediction.frequency_response(self, force, frequencies, largest)

    @property
    def faster_modes(self) -> tuple[prediction.FasterMode, ...]:
        """Modes of a law with several coordinates, except the slowest mode, which is in ``at_rest``."""
        return prediction.faster_modes(self)

    @property
    def numpy_source(self) -> str:
        """Python source of a stand-alone module of the model in SI units, which needs only NumPy."""
        return export.numpy_source(self)

    def export(
        self,
        path: str | Path,
        *,
        port: Literal["force"] | None = None,
        mass: float | None = None,
        gravity: float = GRAVITY,
        fmi: int = 2,
    ) -> str:
        """Write the model as code in the language given by a file's ending.

        ``.py`` (only NumPy), ``.c`` (C99), ``.m`` (MATLAB and Octave), ``.mo`` (Modelica),
        ``.fmu`` (co-simulation and model exchange, compiled by the installed C compiler).

        Parameters
        ----------
        path : str or Path
            File to write; its ending selects the language, and an existing file is replaced.
        port : str, optional
            With ``"force"`` the file contains the force of the bed instead of the record's motion: inputs
            are height [m] and velocity [m/s] of the piston relative to the cell, output is the force [N].
            A law along a prescribed stroke is always written in this form; its force is the one that moves
            the coordinate upwards.
        mass, gravity : float, optional
            Mass of the recorded piston, above 0 [kg], and gravity [m/s^2]; ``port="force"`` needs the
            mass if the law is for a motion.
        fmi : int
            Version of FMI for an ``.fmu``, 2 or 3.

        Returns
        -------
        str
            Language of the file, in words.

        Raises
        ------
        InputError
            If the ending, ``port`` or ``fmi`` is not one of these, the file cannot be written, the name of a
            ``.m`` or ``.mo`` file or a port's ``.c`` file is not a valid name of a function, a port has no
            mass or is for an angle, or no C compiler can compile the ``.fmu``.
        """
        if port not in (None, "force"):
            raise InputError(f"port = {quote(port)}; give 'force'")
        is_element = port is not None or self.law.prescribed
        element = force_port(self, mass, gravity) if is_element else self
        return export.write_code(element, Path(path), fmi)

    @property
    def text(self) -> str:
        """Equation, parameters with units and intervals, domain, provenance and LaTeX as text."""
        return export.equations_text(self)

    def outside_range_text(self, motion: PistonRecord) -> str:
        """Return a warning if a motion leaves the range of heights in the fit; otherwise an empty text.

        On each side heights may exceed the range by a twentieth of its width.

        Parameters
        ----------
        motion : PistonRecord
            Motion to check, of any length.

        Returns
        -------
        str
            Warning; empty if the motion stays inside or the model has no range of heights.
        """
        low, high = self.domain.get("height", (-math.inf, math.inf))
        margin = _MARGIN * (high - low)
        least, most = float(motion.height.min()), float(motion.height.max())
        if least >= low - margin and most <= high + margin:
            return ""
        return (
            f"the motion is an extrapolation: it extends from {least:.4g} to {most:.4g} "
            f"{self.coordinate_unit}, but the law {self.law.name!r} was fitted to "
            f"{self.coordinate}s from {low:.4g} to {high:.4g} {self.coordinate_unit}"
        )

    def to_plain(self) -> dict[str, Any]:
        """Return the model as plain data (numbers, strings, lists).

        Returns
        -------
        dict
            The attributes in their units, with equation and LaTeX; ends of intervals may be infinite.
        """
        fields = [name for name in field_annotations_of_class(ReducedModel) if name != "law"]
        return {
            "format": schema.FORMAT,
            **schema.law_to_plain(self.law),
            "latex": self.fitted_latex,
            **{name: plain_value(getattr(self, name)) for name in fields},
        }

    def save(self, path: str | Path) -> None:
        """Write the model to a JSON file, which `load_model` reads back bit for bit.

        Parameters
        ----------
        path : str or Path
            JSON file to write; an existing file is replaced.

        Raises
        ------
        InputError
            If the directory does not exist, or the file cannot be written.
        """
        write_json(Path(path), self.to_plain())

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Return a model from plain data.

        Parameters
        ----------
        plain : mapping of str
            Plain data from `to_plain` or from JSON, with null for infinite ends of intervals.

        Returns
        -------
        ReducedModel
            The model. If the package has a law with the same name and equation, the model has that law.

        Raises
        ------
        InputError
            If the data are not a model, or the equation cannot be read.
        """
        return cls(**schema.fields_from_plain(plain, ReducedModel))


def load_model(path: str | Path) -> ReducedModel:
    """Load a model from a JSON file of `ReducedModel.save`.

    Parameters
    ----------
    path : str or Path
        JSON file, such as ``model.json``.

    Returns
    -------
    ReducedModel
        Model as saved, bit for bit.

    Raises
    ------
    InputError
        If the file does not exist, cannot be read, or contains no model.
    """
    plain = schema.read_plain_model(Path(path))
    try:
        return ReducedModel.from_plain(plain)
    except InputError as error:
        raise InputError(f"{sanitize(path)}: {error}") from None
