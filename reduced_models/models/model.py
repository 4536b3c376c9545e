"""A reduced model: a law with its parameters, how sure they are, and what they were judged on."""

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
from reduced_models.models.plain_data import annotations_of, plain_value
from reduced_models.models.ports import GRAVITY, force_port
from reduced_models.models.printed_model import PrintedModel
from reduced_models.records.sensor import Sensor, motion_signal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OPEN = 20.0
"""Width of an interval, over its value, from which on it is called open."""
_MARGIN = 0.05  # of the range of heights seen


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class ReducedModel(PrintedModel):
    """A law with parameters.

    Attributes
    ----------
    law : Law
        Law of motion.
    parameters : mapping of str to float
        In the units of ``law.units``.
    intervals : mapping of str to (float, float)
        Confidence intervals of the parameters, and of ``shift`` and ``scale`` where fitted, in their
        units; their ends may be infinite.
    confidence : float
        Confidence level of the intervals, between 0 and 1.
        Map from the law's z to the height [m].
    initial : (float, float)
        Height [m] and velocity [m/s] at the record's start.
    at_rest : AtRest or None
        Small swing about the level of rest; None where the law has none near the record.
    quality : Quality
        Quality of the fit: residual, noise, test error and the search.
    undetermined : tuple of ParameterDirection
        Directions that the data leave open.
    domain : mapping of str to (float, float)
        Range of heights [m] and velocities [m/s] seen.
    notes : tuple of str
        Warnings in plain words.
    provenance : mapping of str to str
        Data and fit that the model comes from.
    hidden : mapping of str to float
        Hidden states at the record's start, where they are not zero.
    input_interpolation : str
        Interpolation of the inputs between samples.
    covariance_names : tuple of str
        Entries of the covariance: parameters, ``height``, ``velocity`` and hidden states at the start.
    covariance : float64 (p, p)
        Covariance of these, in their units.
    no_swing : str
        Why ``at_rest`` is None.
    coordinate_unit : "m" or "rad"
        Unit of the height; where that is an angle, [rad] stands for [m] in all that is said here.
    sensor : Sensor or None
        Sensor whose signal was fitted, with its gain and offset; residual and noise are in its
        unit. None where heights were compared.
    untold : tuple of str
        Parameters that the signal does not tell, and ``level`` or ``size`` of the motion: these
        numbers are conventions, and not printed.
    conventions : mapping of str to float
        Values that those parameters are given, so that the motion can be computed; they are neither in
        ``parameters`` nor in ``intervals``.
    observation : str
        Column that the law says is observed, and that was compared; empty for the height.
    quantile : float
        Half-width of an interval over the standard deviation.
    cycles : tuple of HarmonicCycle
        Of a force on a prescribed stroke, as measured: cycles of the records that are alike are one.
    qualities : mapping of str to Quality
        Quality of the fit to further columns that the law observes.
    """

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix (p, p) of what ``covariance_names`` names, from -1 to 1, without unit.

        Rows and columns of what does not vary are zero; (0, 0) where the model has no covariance.
        """
        return prediction.correlation_matrix(self.covariance)

    def residuals(self, record: PistonRecord) -> np.ndarray:
        """Heights of a record that the model was fitted to, less those of the model.

        Where a sensor's signal was fitted, its signal less that of the model, in its unit. The model
        starts at the record's first time from the fitted state, ``initial``.

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
        """Heights of the fitted motion at a record's times, or the signal that was compared.

        Along a prescribed stroke, which is smoothed first, that is what the law observes, as the force.

        Parameters
        ----------
        record : PistonRecord
            Record (n,) that the model was fitted to, with the inputs of the law.

        Returns
        -------
        float64 (n,)
            Heights [m] (of an angle [rad]), or the signal in its unit.

        Raises
        ------
        RecordError
            If the record lacks an input, or the motion of its base.
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
        """Motion with its confidence band, by linear error propagation (JCGM 100:2008, 5); see `simulate`.

        Parameters
        ----------
        t : float64 (n,)
            Two or more increasing times [s]; the fitted initial state is at the first.
        inputs : mapping of str to array, optional
            Inputs (n,) of the law at these times, in the units of the records' columns.
        confidence : float, optional
            Confidence level, between 0 and 1; that of the fit if not given.

        Returns
        -------
        prediction.PredictionBand
            Heights (n,) [m] with lower and upper bounds of the motion, without a sample's noise.

        Raises
        ------
        InputError
            If the confidence is no such fraction, the model has no covariance, the times are fewer than
            two or do not increase, an input is missing or of another length, or the solution diverges.
        """
        from scipy.stats import norm

        level = self.confidence if confidence is None else confidence
        if not 0.0 < level < 1.0:
            raise InputError(f"confidence = {level}; give a fraction between 0 and 1")
        height, spread = prediction.predict_with_deviations(self, t, inputs)
        width = float(norm.ppf(0.5 + 0.5 * level)) * spread
        noise = max(self.quality.noise, self.quality.residual)
        times = np.asarray(t, dtype=np.float64)
        return prediction.PredictionBand(times, height, height - width, height + width, noise, level)

    def plot(self, record: PistonRecord | None = None, ax: Axes | None = None) -> Axes:
        """Draw the model's motion over a record that it was fitted to.

        Without a record: how it swings from the farthest height that it has seen, its inputs zero. In
        a figure of its own what is left over of the record stands below. In [mm], or [rad] of an angle.

        Parameters
        ----------
        record : PistonRecord, optional
            Record (n,) that the model was fitted to, with the inputs of the law.
        ax : Axes, optional
            Axes to draw on; new ones if not given.

        Returns
        -------
        Axes
            Axes that hold the motion.

        Raises
        ------
        InputError
            If the record lacks an input, or the solution diverges or is too stiff to follow; without a
            record, if the law has no level of rest.
        """
        from granular.shared.plotting import axes_or_new, new_axes

        if self.law.prescribed:
            return observed.plot_loops(self, record, axes_or_new(ax))
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
        """Rates of all states, as `scipy.integrate.solve_ivp` calls them; they start at `initial_state`.

        Parameters
        ----------
        t : float
            Time since the start [s].
        state : float64 (s,) or (s, k)
            Height [m] and velocity [m/s], then the states in ``law.hidden`` in that order; k states at a
            time with ``vectorized=True``.
        inputs : mapping of str to float or callable, optional
            Inputs of the law, in the units of the records' columns: each a number, or a function of the
            time. ``solve_ivp(..., args=(inputs,))`` hands them over.

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
        """States at the record's start, in the order that `rhs` takes."""
        return prediction.initial_state(self)

    def __repr__(self) -> str:
        values = ", ".join(
            f"{name} = {value:.{max(5, self.printed_digits)}g} {self.unit_of_parameter(name)}".rstrip()
            for name, value in self.parameters.items()
        )
        return (
            f"ReducedModel {self.law.name!r}: {self.law.equation}\n"
            f"  {values}\n"
            f"  residual {100.0 * self.quality.relative:.3g} % of the rms swing"
        )

    def _repr_html_(self) -> str:
        from granular.shared.html_pages import blocks_html
        from reduced_models.laws.printing import mathml, mathml_of_rate

        rates = [mathml_of_rate(name, rate) for name, rate in self.printed_hidden_rates.items()]
        formulas = map(Equation, (mathml(self.printed_equation), *rates))
        return blocks_html([*formulas, Printout(repr(self))])

    def _repr_latex_(self) -> str:
        return f"$${self.fitted_latex}$$"

    def free_decay(self, amplitude: float, periods: float = 10.0) -> PistonRecord:
        """Motion of a piston released from a height above its level of rest; see `response`.

        Parameters
        ----------
        amplitude : float
            Height above the level of rest at the release [m]; negative below it.
        periods : float
            Duration in periods of small swings, above 0.

        Returns
        -------
        PistonRecord
            Motion from the release on, its inputs zero: times [s], heights [m] and velocities [m/s].

        Raises
        ------
        InputError
            If the law has no level of rest, the duration is not above zero and finite, or the motion
            cannot be followed, as with an amplitude that is not finite.
        """
        return prediction.free_decay(self, amplitude, periods)

    def harmonic_cycle(self, amplitude: float, frequency: float | None = None) -> HarmonicCycle:
        """Equivalent stiffness and damping, and energy dissipated, in a cycle; see `response`.

        Of a force on a prescribed stroke about the middle of the heights seen, in newtons, with errors.
        By one harmonic (Krylov and Bogoliubov 1947, Introduction to Non-Linear Mechanics), inputs zero.

        Parameters
        ----------
        amplitude : float
            Amplitude about the cycle's centre, above 0 [m].
        frequency : float, optional
            Angular frequency, above 0 [rad/s]; by default the root of the equivalent stiffness.

        Returns
        -------
        HarmonicCycle
            Stiffness [1/s^2], damping [1/s] and energy [J/kg] of a cycle, per kilogram.

        Raises
        ------
        InputError
            If the amplitude is not above zero, the frequency not above zero and finite, the law has no
            level of rest, without a frequency no stiffness at this amplitude, or the cycle leaves where
            the law is defined.
        """
        if self.law.prescribed:
            return observed.force_cycle(self, amplitude, frequency)
        return prediction.harmonic_cycle(self, amplitude, frequency)

    def frequency_response(
        self, force: float, frequencies: np.ndarray, largest: float | None = None
    ) -> prediction.SteadyAmplitudes:
        """Steady amplitudes under a harmonic force, by describing functions as in `harmonic_cycle`.

        Parameters
        ----------
        force : float
            Amplitude of the force, above 0 [N/kg].
        frequencies : float64 (k,)
            Angular frequencies, above 0 [rad/s].
        largest : float, optional
            Greatest amplitude looked for, above 0 [m]; by default ten times the record's farthest swing.

        Returns
        -------
        prediction.SteadyAmplitudes
            Least and greatest amplitude (k,) [m] at each frequency; NaN where there is none up to
            the greatest one looked for.

        Raises
        ------
        InputError
            If the force, a frequency or the greatest amplitude is not above zero and finite, the
            frequencies are no array (k,), or the law has no level of rest.
        """
        return prediction.frequency_response(self, force, frequencies, largest)

    @property
    def faster_modes(self) -> tuple[prediction.FasterMode, ...]:
        """Modes of small oscillations above that of ``at_rest``, of a law with several coordinates."""
        return prediction.faster_modes(self)

    @property
    def numpy_source(self) -> str:
        """Python source of a stand-alone module of the model, which needs NumPy alone; SI units."""
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
        """Write the model as code, in the language that a file's ending names; says what it is.

        ``.py`` (NumPy alone), ``.c`` (C99), ``.m`` (MATLAB and Octave), ``.mo`` (Modelica),
        ``.fmu`` (co-simulation and model exchange, compiled by the C compiler that is there).

        Parameters
        ----------
        path : str or Path
            File to write; its ending names the language, and one that exists is replaced.
        port : str, optional
            ``"force"``: in place of the record's motion, an element with the inputs height [m] and
            velocity [m/s] of the piston over the cell, and the output force [N]. A law along a prescribed
            stroke is one in any case, of the force that moves the coordinate upwards.
        mass, gravity : float, optional
            Of the piston that was recorded, above 0 [kg], and [m/s^2]: a port of a motion needs the mass.
        fmi : int
            Version of FMI of an ``.fmu``, 2 or 3.

        Returns
        -------
        str
            Language of the file, in words.

        Raises
        ------
        InputError
            If the ending is another one, the file cannot be written, a name of ``.m``, ``.mo`` or a port's
            ``.c`` is none of a function, ``port`` or ``fmi`` is another one, a port has no mass or is of
            an angle, or no C compiler makes the ``.fmu``.
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
        """Warn in words of a motion that leaves the range of the fit; empty where none does.

        Heights alone are judged, and may leave the range by a twentieth of it, on each side.

        Parameters
        ----------
        motion : PistonRecord
            Motion to judge, of any length.

        Returns
        -------
        str
            Warning, or an empty text, as where the model has no range of heights.
        """
        low, high = self.domain.get("height", (-math.inf, math.inf))
        margin = _MARGIN * (high - low)
        least, most = float(motion.height.min()), float(motion.height.max())
        if least >= low - margin and most <= high + margin:
            return ""
        return (
            f"the motion goes from {least:.4g} to {most:.4g} {self.coordinate_unit}, and the law "
            f"{self.law.name!r} was fitted to {self.coordinate}s from {low:.4g} to {high:.4g} "
            f"{self.coordinate_unit}: read it as an extrapolation"
        )

    def to_plain(self) -> dict[str, Any]:
        """Model as plain data (numbers, texts, lists).

        Returns
        -------
        dict
            The attributes in their units, with equation and LaTeX; ends of intervals may be infinite.
        """
        fields = [name for name in annotations_of(ReducedModel) if name != "law"]
        return {
            "format": schema.FORMAT,
            **schema.law_to_plain(self.law),
            "latex": self.fitted_latex,
            **{name: plain_value(getattr(self, name)) for name in fields},
        }

    def save(self, path: str | Path) -> None:
        """Write the model to a JSON file, which `load_model` reads back to the same bits.

        Parameters
        ----------
        path : str or Path
            JSON file to write; one that exists is replaced.

        Raises
        ------
        InputError
            If the directory does not exist, or the file cannot be written.
        """
        write_json(Path(path), self.to_plain())

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Model from plain data.

        Parameters
        ----------
        plain : mapping of str
            Plain data, as `to_plain` makes them or JSON holds them, with null for infinite ends.

        Returns
        -------
        ReducedModel
            Model, whose law is that of the package where name and equation are the same.

        Raises
        ------
        InputError
            If the data are not those of a model, or the equation cannot be read.
        """
        return cls(**schema.fields_from_plain(plain, ReducedModel))


def load_model(path: str | Path) -> ReducedModel:
    """Load a model from the JSON file that `ReducedModel.save` wrote.

    Parameters
    ----------
    path : str or Path
        JSON file, such as ``model.json``.

    Returns
    -------
    ReducedModel
        Model as it was saved, to the same bits.

    Raises
    ------
    InputError
        If there is no such file, it cannot be read, or it holds no model.
    """
    plain = schema.read_plain_model(Path(path))
    try:
        return ReducedModel.from_plain(plain)
    except InputError as error:
        raise InputError(f"{sanitize(path)}: {error}") from None
