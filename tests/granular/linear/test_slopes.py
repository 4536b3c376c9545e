"""Slopes against paired differences of equilibrium and root of changed scenes."""

from typing import Any

import numpy as np
import pytest

from granular.linear import piston_roots, slopes
from granular.linear.bed_forces import scaled_parameter
from granular.linear.equilibrium import Equilibrium, equilibrium_from
from granular.linear.small_motions import number_keys
from granular.shared.errors import InputError
from tests.granular.linear.small_beds import at_rest, small_damper

SCENES: dict[str, dict[str, Any]] = {
    "damper": {"piston.drag": 0.3},
    "discs": {"grains.magnets": "cylinders"},
    "rows of touching discs": {
        "grains.magnets": "cylinders",
        "effects.walls": {
            side: {"law": "discs", "pitch": "6 mm"} for side in ("left", "right", "bottom", "top")
        },
    },
    "two species": {
        "grains.species": [
            {"name": "big", "diameter": "6 mm", "share": 0.6},
            {"name": "small", "diameter": "5 mm", "share": 0.4},
        ],
        "effects.walls": {"bottom": {"law": "slab"}, "top": {"law": "infinite"}},
    },
    "hard contact": {
        "grains.count": 24,
        "grains.remanence": 0.1,
        "piston.mass": 3.0,
        "piston.height": "8 D",
        "arrangement.height": "7.8 D",
        "effects.contact": {"modulus": 1e8},
    },
    "machine": {
        "effects.host": {
            "bodies": [
                {"mass": 0.5, "stiffness": 600.0, "damping": 0.4},
                {"mass": 0.4, "stiffness": 900.0, "damping": 0.3},
            ]
        }
    },
}
QUICK = ("damper",)
HARDER = {"hard contact": (2e8, 5e8, 1e9)}
"""Moduli in turn [Pa]: the smallest overlap becomes 1e-3 D, three changes of a number."""


def logarithms(rest: Equilibrium) -> np.ndarray:
    root = piston_roots(rest)[0]
    assert rest.piston_height is not None
    return np.log([rest.piston_height, root.frequency, root.damping_ratio])


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in SCENES]
)
def test_slopes_are_those_of_changed_scenes(name: str) -> None:
    rest = at_rest(small_damper(**SCENES[name]))
    for modulus in HARDER.get(name, ()):
        scene = rest.scene.replace(**{"effects.contact.modulus": modulus})
        rest = equilibrium_from(scene, rest.positions, rest.piston_height)
    found = slopes(rest)
    assert {"grains.remanence", "grains.density", "cell.width", "piston.mass"} <= set(found.keys)
    change, error = (1e-5, 5e-3) if name in HARDER else (1e-3, 1e-5)
    for key in found.keys:

        def changed(steps: int, key: str = key) -> np.ndarray:
            scene = scaled_parameter(rest.scene, key, float(np.exp(steps * change)))
            return logarithms(equilibrium_from(scene, rest.positions, rest.piston_height))

        wanted = (8.0 * (changed(1) - changed(-1)) - (changed(2) - changed(-2))) / (12.0 * change)
        np.testing.assert_allclose(found.of(key), wanted, rtol=error, atol=error, err_msg=key)


def test_a_key_that_is_no_number_is_refused() -> None:
    rest = at_rest(small_damper())
    with pytest.raises(InputError, match=r"'cell\.length' is no number"):
        slopes(rest, ["grains.remanence"]).of("cell.length")


def test_numbers_of_named_materials_have_slopes_and_temperatures_none() -> None:
    scene = small_damper(
        **{
            "grains.remanence": None,
            "grains.grade": "N45",
            "grains.temperature": 25.0,
            "effects.drag": {"liquid": "silicone oil 350 cSt"},
        }
    )
    found = number_keys(scene)
    assert {"grains.remanence", "effects.drag.viscosity"} <= set(found)
    assert "grains.temperature" not in found
    at_bed = slopes(at_rest(scene))
    # Forces and liquid go with the square of the remanence and with the viscosity.
    assert at_bed.of("grains.remanence")[0] == pytest.approx(0.7, abs=0.1)
    assert at_bed.of("effects.drag.viscosity")[2] == pytest.approx(1.0, abs=0.05)
