"""The law next to a simulated response: their peaks, and the report that shows both."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from granular.response.report_page import PageComparison, response_page
from granular.response.response import FrequencyResponse
from granular.shared.blocks import Table, format_number
from granular.shared.errors import InputError
from granular.shared.html_pages import Page
from reduced_models.falls.predicted_law import OutsideRangeWarning
from reduced_models.machines.response import predicted_response

if TYPE_CHECKING:
    from jaxtyping import Float

POINTS = 201
"""Frequencies at which the law is solved for each force."""


@dataclasses.dataclass(frozen=True)
class PeakComparison:
    """The greatest displacements at a force, simulated and by the law, over the same frequencies."""

    force: float  # [N]
    simulated: float  # [m]
    law: float  # [m]
    linear: float  # [m]
    outside: str

    @property
    def law_peak_error(self) -> float:
        """Relative error of the law's peak."""
        return self.law / self.simulated - 1.0

    @property
    def small_swing_peak_error(self) -> float:
        """Relative error of the small swing's peak."""
        return self.linear / self.simulated - 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class ResponseComparison:
    """The law's curves next to a response."""

    peaks: tuple[PeakComparison, ...]
    frequencies: Float[np.ndarray, "f"]  # [Hz]
    law: dict[float, np.ndarray]  # [m]
    linear: dict[float, np.ndarray]  # [m]

    @property
    def peak_table(self) -> Table:
        """Table of the peaks."""
        return Table(_HEAD, _table_cells(self.peaks))


_HEAD = ("force [N]", "simulated [mm]", "law [mm]", "error [%]", "linear [mm]", "error [%]")


def compare_response(response: FrequencyResponse) -> ResponseComparison:
    """Solve the law for a response's scene and forces, between its frequencies.

    Parameters
    ----------
    response : FrequencyResponse
        Measured response.

    Returns
    -------
    ResponseComparison
        Peaks of law and simulation [m] at each amplitude of the force [N], and the law's curves over
        the frequency [Hz]. The law is that of `reduced_models.falls.predicted_law`.

    Raises
    ------
    InputError
        If the law is not known for the scene (see `CoupledSystem.from_host_scene`), or no force shakes it.
    """
    data = response.dataset
    if response.quantity != "force":
        raise InputError(
            f"the base of the machine is shaken by its {response.quantity}; the "
            "law is solved for a force on the machine: simulate one (--force)"
        )
    dense = np.linspace(float(data.frequency.min()), float(data.frequency.max()), POINTS)
    peaks, law, linear = [], {}, {}
    for force in data.amplitude.values.tolist():
        with warnings.catch_warnings(record=True, action="always", category=OutsideRangeWarning) as caught:
            predicted = predicted_response(response.scene, dense.tolist(), force)
        outside = [str(warning.message) for warning in caught if warning.category is OutsideRangeWarning]
        law[force], linear[force] = predicted.displacement, predicted.linear
        simulated = float(data.displacement.sel(amplitude=force).max())
        peaks.append(
            PeakComparison(force, simulated, predicted.peak, float(predicted.linear.max()), "".join(outside))
        )
    return ResponseComparison(tuple(peaks), dense, law, linear)


def response_page_with_law(response: FrequencyResponse) -> tuple[Page, ResponseComparison | None, str]:
    """Report of a response with the law; the law; and why, where there is none."""
    try:
        law = compare_response(response)
    except InputError as error:
        why = f"No law stands next to the simulation: {error}."
        return response_page(response, missing=why), None, why
    return response_page(response, _report_section(law)), law, ""


def _report_section(comparison: ResponseComparison) -> PageComparison:
    notes = [f"Under {peak.force:g} N {peak.outside}." for peak in comparison.peaks if peak.outside]
    return PageComparison(
        title="The law in place of the bed",
        words=(
            "The law is the ordinary differential equation of the annealing bed on this machine; "
            "nothing in it is fitted to a machine. Linear is its small swing, in which the bed "
            "does not yield. Errors are of the greatest displacement between the lowest and the "
            "highest frequency above, over the simulated one; where few frequencies were "
            "simulated, their greatest may miss the peak."
        ),
        header=_HEAD,
        rows=_table_cells(comparison.peaks),
        frequencies=comparison.frequencies,
        curves={"law": comparison.law, "linear law": comparison.linear},
        notes=notes,
    )


def _table_cells(peaks: Sequence[PeakComparison]) -> list[tuple[str, ...]]:
    return [
        (
            f"{peak.force:g}",
            format_number(1e3 * peak.simulated, 3),
            format_number(1e3 * peak.law, 3),
            f"{100.0 * peak.law_peak_error:+.0f}",
            format_number(1e3 * peak.linear, 3),
            f"{100.0 * peak.small_swing_peak_error:+.0f}",
        )
        for peak in peaks
    ]
