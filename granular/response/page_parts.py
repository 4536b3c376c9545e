"""What the parts of a response's report share: words of amplitudes, and rows that are shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray

    from granular.response.response import Response

MOST_ROWS = 25
_NAMES = {
    "force": ("force [N]", "Under {size:g} N", 1.0),
    "acceleration": ("base [m/s²]", "On a base that is shaken by {size:g} m/s²", 1.0),
    "displacement": ("base [mm]", "On a base that moves by {size:g} mm", 1e3),
}


def labels(found: Response) -> tuple[str, float]:
    """Head of the column of amplitudes, and what they are multiplied by for it."""
    head, _, scale = _NAMES[str(found.dataset.amplitude.attrs["long_name"])]
    return head, scale


def amplitude_words(found: Response, size: float) -> str:
    """An amplitude, as a sentence begins with it."""
    _, words, scale = _NAMES[str(found.dataset.amplitude.attrs["long_name"])]
    return words.format(size=scale * size)


def shown_rows(found: Response) -> int:
    """How many frequencies the tables show."""
    return min(found.dataset.sizes["frequency"], MOST_ROWS)


def shown_part(found: Response, size: float) -> xarray.Dataset:
    """The response at an amplitude, at the frequencies that tables show; its peak is one of them.

    On ``frequency``.
    """
    part = found.dataset.sel(amplitude=size)
    count = part.sizes["frequency"]
    places = np.unique(np.linspace(0, count - 1, shown_rows(found)).round().astype(int))
    peak = int(part.displacement.values.argmax())
    places[int(np.abs(places - peak).argmin())] = peak
    return part.isel(frequency=places)
