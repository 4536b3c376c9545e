"""Colours that mean something are told apart by colour-blind eyes of all three kinds."""

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from granular.render.picture import COLOURINGS, SPECIES
from granular.shared.plotting import COLOURS, SIDES

EYES = {
    "all cones": np.eye(3),
    "without red cones": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "without green cones": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "without blue cones": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""What remains of linear red, green and blue: Machado, Oliveira and Fernandes 2009, Table 1."""

_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)

APART = 15.0
"""Least distance in CIELAB; 2.3 is what eyes just notice between patches that touch."""


def seen(colours: Sequence[str | tuple[float, ...]] | np.ndarray, eyes: str) -> np.ndarray:
    """Colours in CIELAB (n, 3), as these eyes see them."""
    given = np.array([to_rgb(one) for one in colours])
    linear = np.where(given <= 0.04045, given / 12.92, ((given + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ EYES[eyes].T, 0.0, 1.0)
    x, y, z = ((linear @ _XYZ.T) / _XYZ.sum(axis=1)).T
    fx, fy, fz = (np.where(v > 0.008856, np.cbrt(v), 7.787 * v + 16.0 / 116.0) for v in (x, y, z))
    return np.stack([116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)], axis=1)


PALETTES = {"species": SPECIES, "sides": tuple(SIDES.values()), "lines": COLOURS}


@pytest.mark.parametrize("eyes", EYES)
@pytest.mark.parametrize("name", PALETTES)
def test_classes_are_told_apart(name: str, eyes: str) -> None:
    found = seen(PALETTES[name], eyes)
    least = min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(found, 2))
    assert least > APART


@pytest.mark.parametrize("eyes", EYES)
@pytest.mark.parametrize("name", sorted({one.map for one in COLOURINGS.values() if one.map}))
def test_more_is_lighter(name: str, eyes: str) -> None:
    lightness = seen(colormaps[name](np.linspace(0.0, 1.0, 33)), eyes)[:, 0]
    assert (np.diff(lightness) > 0.0).all()
    assert np.ptp(lightness) > 60.0
