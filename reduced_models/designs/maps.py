"""Maps of a damper's figures over piston mass, number of grains, drag and mixture.

Each map is a polynomial in the coordinates of the box, fitted to the study by least squares. Its
error is that of predicting a damper which the fit did not see (leave-one-out, by the diagonal of
the projection; Allen 1974, doi:10.1080/00401706.1974.10489157).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from granular.scene.published_beds import REFERENCE_COUNT
from granular.shared.errors import InputError
from granular.shared.message_text import quote
from reduced_models.designs.damper import (
    ASPECT,
    DIAMETER,
    EXPONENT,
    GRAVITY,
    HIGHEST,
    LOWEST,
    NAMES,
    REFERENCE_MASS,
    REFERENCE_REST,
    DamperCandidate,
    disc_over_dipole_figures,
)
from reduced_models.designs.study import COMMITTED

if TYPE_CHECKING:
    import pandas
    from jaxtyping import Float

    from granular.shared.html_pages import InteractivePage

COLUMNS = ("mass", "grains", "drag", "small_share")
LOGARITHMIC = ("rest_height", "frequency", "damping_ratio")
PLAIN = ("quadratic", "cubic")
"""k2 h/k1 and k3 h^2/k1: how the spring bends, over the rest height h."""
DEGREES = {**dict.fromkeys(LOGARITHMIC, 2), **dict.fromkeys(PLAIN, 3)}
"""Degrees of the maps: that of the least leave-one-out error over the study."""
TEMPLATE = Path(__file__).with_name("view.html")
"""Template of the page with sliders."""
_VIEW_HEIGHT = 560
_EDGE = 1.01
"""Factor by which a damper may lie beyond the box's edge: its number of grains is rounded."""


class FigureMap(NamedTuple):
    """The map of one figure."""

    coefficients: Float[np.ndarray, "terms"]  # of products of Legendre polynomials
    error: float  # leave-one-out, rms: relative, or absolute of quadratic and cubic


class PredictedFigures(NamedTuple):
    """Figures of a damper by the maps."""

    rest_height: float  # [m]
    frequency: float  # [Hz]
    damping_ratio: float
    lam: float
    k1: float  # of z'' + 2 lam z' + k1 x + k2 x^2 + k3 x^3 = 0, x from rest (SI)
    k2: float
    k3: float


class DamperMaps:
    """Maps of a damper's figures over mass, grains, drag and mixture, from a study.

    Each map is a polynomial, fitted by least squares; its error is that of leaving one damper out
    (Allen 1974, doi:10.1080/00401706.1974.10489157).

    Parameters
    ----------
    study : DataFrame
        A row for each damper of dipoles, with the columns ``mass``, ``grains``, ``drag``,
        ``small_share``, ``rest_height``, ``frequency``, ``damping_ratio``, ``k1``, ``k2`` and
        ``k3`` of `run_design_study`. Those that lack a figure, as runs that failed do, are left
        out; at least 70 must be left.

    Attributes
    ----------
    dampers : tuple of DamperCandidate
        Dampers that the maps were fitted to.
    study : DataFrame
        Rows of these dampers, in the same order.
    surfaces : mapping of str to FigureMap
        Polynomial of each figure: of the logarithms of ``rest_height`` [m], ``frequency`` [Hz] and
        ``damping_ratio``, and of ``quadratic`` and ``cubic``, k2 h/k1 and k3 h^2/k1 at the rest
        height h, without unit.

    Raises
    ------
    InputError
        If a column is missing or holds something that is no number, a figure other than
        ``small_share``, ``k2`` and ``k3`` is not above 0, one of these is not finite, or there are
        fewer than 70 dampers.
    """

    def __init__(self, study: pandas.DataFrame) -> None:
        wanted = (*COLUMNS, *LOGARITHMIC, "k1", "k2", "k3")
        missing = [name for name in wanted if name not in study.columns]
        if missing:
            raise InputError(f"the study has no column {missing[0]!r}; make it by run_design_study")
        sound = study[study[list(wanted)].notna().all(axis=1)]
        positive = (*COLUMNS[:3], *LOGARITHMIC, "k1")
        for name in wanted:
            try:
                values = sound[name].to_numpy(dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InputError(f"the study has a {name} that is no number: {error}") from None
            refused = values[~np.isfinite(values) | ((values <= 0.0) & (name in positive))]
            if len(refused):
                limit = "above 0" if name in positive else "finite"
                raise InputError(f"the study has {name} = {refused.min():g}; it must be {limit}")
        least = 2 * len(_monomial_exponents(max(DEGREES.values())))
        if len(sound) < least:
            raise InputError(
                f"the study has {len(sound)} dampers that ran; at least {least} are needed for maps"
            )
        columns = (sound[name] for name in COLUMNS)
        self.dampers = tuple(
            DamperCandidate(float(m), int(n), float(g), float(r)) for m, n, g, r in zip(*columns, strict=True)
        )
        self.study = sound
        positions = [damper.map_coordinates() for damper in self.dampers]
        self.surfaces: Mapping[str, FigureMap] = {
            name: _fit_surface(
                np.array([_monomials(coordinates, DEGREES[name]) for coordinates in positions]), values
            )
            for name, values in _logarithms_and_ratios_of_study(sound).items()
        }

    def predict(self, damper: DamperCandidate) -> PredictedFigures:
        """Predict the figures of a damper; of discs, by theory from those of dipoles.

        Parameters
        ----------
        damper : DamperCandidate
            Damper inside the box: mass over `DamperCandidate.cell_width_ratio` from 2 to 10 kg, 92
            to 368 grains, affine damping ratio from 0.023 to 0.25, and up to half of small grains;
            one hundredth beyond it, in `DamperCandidate.map_coordinates`, is allowed.

        Returns
        -------
        PredictedFigures
            Rest height [m], frequency [Hz] of the undamped small swing, damping ratio, and the law
            of the swing (SI).

        Raises
        ------
        InputError
            If a figure of the damper is out of its range or the damper outside the box, there are
            no such magnets, or its piston presses discs together.
        """
        coordinates = damper.map_coordinates()
        if not np.abs(coordinates).max() <= _EDGE:
            limits = ", ".join(
                f"{name} {low:g} to {high:g}" for name, low, high in zip(NAMES, LOWEST, HIGHEST, strict=True)
            )
            raise InputError(f"{damper} lies outside the maps; keep to {limits}")
        values = {name: self.figure_at(name, coordinates) for name in (*LOGARITHMIC, *PLAIN)}
        dipoles = np.exp([values[name] for name in LOGARITHMIC])
        height, frequency, ratio = (dipoles * disc_over_dipole_figures(damper)).tolist()
        k1 = (2.0 * math.pi * frequency) ** 2
        return PredictedFigures(
            rest_height=height,
            frequency=frequency,
            damping_ratio=ratio,
            lam=ratio * math.sqrt(k1),
            k1=k1,
            k2=values["quadratic"] * k1 / height,
            k3=values["cubic"] * k1 / height**2,
        )

    def figure_at(self, name: str, coordinates: np.ndarray) -> float:
        """Value of a map at a point of the box.

        Parameters
        ----------
        name : str
            Name of a figure: ``rest_height`` [m], ``frequency`` [Hz], ``damping_ratio``,
            ``quadratic`` or ``cubic``.
        coordinates : float64 (4,)
            Point of the box as by `DamperCandidate.map_coordinates`, each from -1 to 1; beyond it
            the polynomial goes on, and means nothing.

        Returns
        -------
        float
            Natural logarithm of the figure, in its unit, for the first three; else the figure
            itself, without unit. NaN where a coordinate is NaN.

        Raises
        ------
        InputError
            If there is no figure of that name, or the coordinates are no four numbers.
        """
        if name not in tuple(self.surfaces):
            raise InputError(f"the maps have no figure {quote(name)}; give one of {', '.join(self.surfaces)}")
        if (point := np.asarray(coordinates)).shape != (4,) or point.dtype.kind not in "fiu":
            raise InputError(f"coordinates = {quote(coordinates)}; give four numbers")
        return float(_monomials(coordinates, DEGREES[name]) @ self.surfaces[name].coefficients)

    def interactive_page(self) -> InteractivePage:
        """Page on which sliders move a damper of dipoles through the maps.

        Returns
        -------
        InteractivePage
            Page that a notebook shows, and whose ``save`` writes it to a file for a browser.
        """
        from granular.shared.html_pages import InteractivePage

        surfaces = {
            name: {
                "coefficients": surface.coefficients.tolist(),
                "powers": _monomial_exponents(DEGREES[name]),
                "error": surface.error,
            }
            for name, surface in self.surfaces.items()
        }
        data = {
            "surfaces": surfaces,
            "lowest": LOWEST,
            "highest": HIGHEST,
            "aspect": ASPECT,
            "diameter": DIAMETER,
            "exponent": EXPONENT,
            "gravity": GRAVITY,
            "mass": REFERENCE_MASS,
            "rest": REFERENCE_REST,
            "count": REFERENCE_COUNT,
        }
        return InteractivePage.from_template(TEMPLATE, "The damper by its maps", data, _VIEW_HEIGHT)


@functools.cache
def damper_maps(path: Path = COMMITTED) -> DamperMaps:
    """Return the maps of a study in a CSV file, of that of the package by default.

    Parameters
    ----------
    path : Path
        CSV file of a study, as the table of `run_design_study`; the package's if not given.

    Returns
    -------
    DamperMaps
        Maps, made once for each path.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no study.

    Examples
    --------
    >>> from reduced_models import DamperCandidate, damper_maps
    >>> said = damper_maps().predict(DamperCandidate(mass=7.5, grains=368, drag=0.1))
    >>> round(said.frequency, 2), round(said.damping_ratio, 3)  # [Hz]
    (3.46, 0.038)
    """
    import pandas

    try:
        return DamperMaps(pandas.read_csv(path))
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} holds no study ({error}); make one by run_design_study") from None


def _logarithms_and_ratios_of_study(study: pandas.DataFrame) -> dict[str, np.ndarray]:
    height, k1 = study["rest_height"].to_numpy(), study["k1"].to_numpy()
    figures = {name: np.log(study[name].to_numpy()) for name in LOGARITHMIC}
    figures["quadratic"] = study["k2"].to_numpy() * height / k1
    figures["cubic"] = study["k3"].to_numpy() * height**2 / k1
    return figures


@functools.cache
def _monomial_exponents(degree: int) -> tuple[tuple[int, ...], ...]:
    return tuple(p for p in itertools.product(range(degree + 1), repeat=4) if sum(p) <= degree)


@functools.cache
def _exponents_by_coordinate(degree: int) -> np.ndarray:
    return np.array(_monomial_exponents(degree)).T


def _monomials(coordinates: np.ndarray, degree: int) -> np.ndarray:
    single = np.polynomial.legendre.legvander(coordinates, degree)
    first, second, third, fourth = _exponents_by_coordinate(degree)
    return np.asarray(single[0, first] * single[1, second] * single[2, third] * single[3, fourth])


def _fit_surface(terms: np.ndarray, values: np.ndarray) -> FigureMap:
    coefficients = np.linalg.lstsq(terms, values, rcond=None)[0]
    orthogonal = np.linalg.qr(terms)[0]
    leverage = (orthogonal**2).sum(axis=1)
    left_out = (values - terms @ coefficients) / (1.0 - leverage)
    return FigureMap(coefficients, float(np.sqrt((left_out**2).mean())))
