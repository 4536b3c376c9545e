"""Variables of a run have one name each; who would take that of another one is told before the run."""

from pathlib import Path
from typing import Any

import pytest

from granular import Scene, effect, quantity, simulate
from granular.effects.effect import EFFECTS
from granular.run.dataset import all_run_variables, check_variable_names
from granular.shared.errors import InputError

TAKEN = ("Kinetic", "Pair", "Piston", "Wall", "Weight")


def pull(name: str) -> type:
    """A spring of a user's own, under that name."""

    def energy(p: Any, grain: Any, time: float) -> Any:
        return 0.5 * p.k * grain.y**2

    def force(p: Any, grain: Any, time: float) -> Any:
        return 0.0, -p.k * grain.y

    content = {
        "__doc__": "A spring.",
        "__module__": __name__,
        "__annotations__": {"k": float},
        "k": quantity("N/m", default=1.0),
        "energy": staticmethod(energy),
        "force": staticmethod(force),
    }
    return type(name, (), content)


def bed_with(name: str) -> Scene:
    effect(pull(name))
    return Scene.from_plain(
        {
            "grains": {"count": 2, "species": [{"diameter": "6 mm"}]},
            "cell": {"width": "6 D"},
            "piston": {"height": "6 D", "mass": "10 g"},
            "effects": {"dipole": True, "walls": True, "gravity": True, name.lower(): True},
            "protocol": [{"name": "wait", "kind": "hold", "duration": "1 ms"}],
        }
    )


@pytest.mark.parametrize("name", TAKEN)
def test_an_own_effect_cannot_take_the_name_of_a_record(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(EFFECTS, "_own", dict(EFFECTS._own))
    scene, out = bed_with(name), tmp_path / "run"
    message = rf"effects\.{name.lower()}: its record '{name.lower()}_energy' has the name of another"
    with pytest.raises(InputError, match=message):
        simulate(scene, dt=1e-4, progress=False, out=out)
    assert not out.exists()


def test_another_name_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EFFECTS, "_own", dict(EFFECTS._own))
    scene = bed_with("Tether")
    check_variable_names(scene)
    names = [variable.name for variable in all_run_variables(scene)]
    assert "tether_energy" in names
    assert len(set(names)) == len(names)
