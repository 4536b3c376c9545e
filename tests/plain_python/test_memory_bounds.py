"""Compiled functions never access memory outside their arrays, for any cell and number of laws.

In plain Python, NumPy checks every index. In compiled code, Numba checks every index if
``NUMBA_BOUNDSCHECK=1``, which `tests/architecture/test_plain_python.py` sets.
"""

from typing import Any

import numpy as np
import pytest

from granular import Scene, evaluate, simulate

WORST = [("flat", 10_000.0, 7.0), ("tall", 7.0, 10_000.0)]
"""Width and height of a cell [D]: a line of the finest level is longer than all that its columns need."""


CLOSE = 2.4e-4
"""Error of a mesh [N]: 1e-4 F*."""


def drawn_cells(count: int) -> list[tuple[str, float, float]]:
    """Return cells with aspect ratios from 1:1000 to 1000:1."""
    random = np.random.default_rng(65)
    short, aspect = random.uniform(7.0, 30.0, count), 10.0 ** random.uniform(0.0, 3.0, count)
    sides = [(float(a), float(a * b)) for a, b in zip(short, aspect, strict=True)]
    return [("flat", high, low) if random.integers(2) else ("tall", low, high) for low, high in sides]


def meshed(width: float, height: float, grains: int, sides: str) -> Scene:
    plain: dict[str, Any] = {
        "grains": {"count": grains, "species": [{"diameter": "6 mm"}]},
        "cell": {"width": f"{width} D"},
        "effects": {"dipole": True},
        "pairs": {"method": "mesh"},
        "arrangement": {"jitter": 0.1},
        "protocol": [{"name": "wait", "kind": "hold", "duration": "1 ms"}],
    }
    if sides == "closed":
        plain["piston"] = {"height": f"{height} D"}
        plain["effects"]["walls"] = True
    else:
        plain["cell"] |= {"sides": "periodic", "height": f"{height} D"}
    return Scene.from_plain(plain)


@pytest.mark.parametrize("case", WORST + drawn_cells(4), ids=str)
def test_mesh_of_any_aspect_ratio_stays_within_its_arrays(case: tuple[str, float, float]) -> None:
    _, width, height = case
    scene = meshed(width, height, 24, "closed")
    place = scene.initial_positions_and_velocities()[0]
    found, wanted = (
        evaluate(one, place).force for one in (scene, scene.replace(**{"pairs.method": "direct"}))
    )
    assert np.abs(found - wanted).max() < CLOSE


@pytest.mark.parametrize("case", [("flat", 300.0, 20.0), ("tall", 20.0, 300.0)], ids=str)
def test_periodic_mesh_of_any_aspect_ratio_stays_within_its_arrays(case: tuple[str, float, float]) -> None:
    _, width, height = case
    scene = meshed(width, height, 40, "periodic")
    force = evaluate(scene, scene.initial_positions_and_velocities()[0]).force
    assert np.abs(force.sum(axis=0)).max() < len(force) * CLOSE
    assert np.abs(force).max() > 1e-5


@pytest.mark.parametrize("laws", [3, 66])
def test_energy_balance_on_a_machine_is_kept_for_any_number_of_force_laws(laws: int) -> None:
    """With dissipation, each kick of a machine is computed three times, always from the same stored
    energy balance.
    """
    scene = meshed(6.0, 6.0, 3, "closed").replace(
        **{
            "pairs.method": "direct",
            "effects.drag": {"coefficient": 0.1},
            "effects.host": {"bodies": [{"mass": 1.0, "stiffness": 100.0}]},
            "effects.field": [
                {"energy": "k*(y - h)**2", "k": f"{0.1 + 0.01 * law} N/m", "h": "1 cm"} for law in range(laws)
            ],
            "output": {"scalars": "1 ms", "frames": "1 ms"},
        }
    )
    run = simulate(scene, dt=5e-5, progress=False)
    assert 0.0 < run.settings()["ledger_residual"] < 1e-3
    assert run.dataset["drag_loss"].values[-1] > 0.0
