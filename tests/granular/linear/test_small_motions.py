"""Summary of small motions, its plots, its page and its command."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Equilibrium, load_scene, simulate
from granular.__main__ import main
from granular.linear import (
    SmallMotions,
    dynamic_stiffness,
    piston_roots,
    slopes,
    small_motions,
    transmissibility,
)
from granular.linear.equilibrium import equilibrium_from, settled_scene_positions_and_heights
from granular.linear.page import modes_page, plot_density_of_states, plot_mode
from granular.response.linear_system import linear_response
from granular.response.report_page import add_linear_response, linear_displacements_per_drive
from granular.response.response import FrequencyResponse, response_dataset
from granular.scene.scene import Scene
from granular.shared.errors import InputError

DRAG = 0.5
SMALL = {"grains.count": 24, "cell.width": "20 D", "piston.mass": 2.5, "effects.drag.coefficient": DRAG}


@pytest.fixture(scope="module")
def settled() -> tuple[Scene, np.ndarray, float]:
    """Return a settled bed of 24 magnets."""
    scene, positions, height = settled_scene_positions_and_heights(load_scene("damper").replace(**SMALL))
    assert height is not None
    return scene, positions, height


@pytest.fixture(scope="module")
def found(settled: tuple[Scene, np.ndarray, float]) -> SmallMotions:
    return small_motions(equilibrium_from(*settled))


Changed = Callable[..., Equilibrium]


@pytest.fixture(scope="module")
def changed(settled: tuple[Scene, np.ndarray, float]) -> Changed:
    """Return a function that gives the equilibrium of the same bed after changes of its scene."""
    scene, positions, height = settled
    return lambda **changes: equilibrium_from(scene.replace(**changes), positions, height)


def test_the_equivalent_oscillator_has_the_first_eigenvalue_of_the_piston(found: SmallMotions) -> None:
    root, mass = found.roots[0], 2.5 + found.moving_mass
    left = mass * root.s**2 + found.damping * root.s + found.stiffness
    assert abs(left) < 1e-9 * found.stiffness
    assert 0.0 < found.moving_mass < 24 * found.rest.scene.grains.masses()[0]
    # A fixed piston has neither inertia nor drag: storage falls only because of the grains' inertia.
    at_root = dynamic_stiffness(found.rest, np.array([root.frequency]))[0]
    assert found.dynamic_stiffness - at_root == pytest.approx(
        2.5 * (math.tau * root.frequency) ** 2, rel=1e-9
    )


def test_participation_factors_include_all_modes(found: SmallMotions) -> None:
    assert len(found.participation) == 49
    assert found.participation.sum() == pytest.approx(1.0, abs=1e-9)
    assert found.participation.max() == pytest.approx(found.roots[0].mass_fraction, abs=0.01)


def test_losses_of_small_motions_are_divided_between_drag_on_grains_and_on_the_piston(
    changed: Changed,
) -> None:
    found = small_motions(changed(**{"piston.drag": "3 kg/s"}))
    moved = np.abs(found.roots[0].shape) ** 2
    drag = DRAG * moved[:48].sum()
    assert found.loss_shares == {
        "piston": pytest.approx(3.0 / (3.0 + drag), rel=1e-6),
        "drag": pytest.approx(drag / (3.0 + drag), rel=1e-6),
    }


@pytest.mark.long  # compiles a loop with eddy currents, and one without
def test_losses_of_small_motions_are_divided_between_drag_and_eddy_currents(changed: Changed) -> None:
    eddy: dict[str, Any] = {
        "effects.eddy": {"conductivity": "3.5e7 S/m", "thickness": "2 mm", "distance": "2 mm"}
    }
    found = small_motions(changed(**eddy))
    moved = np.abs(found.roots[0].shape) ** 2
    total = np.real(found.roots[0].shape.conj() @ found.rest.pencil.damping_times(found.roots[0].shape))
    assert sum(found.loss_shares.values()) == pytest.approx(1.0)
    assert found.loss_shares["drag"] == pytest.approx(DRAG * moved[:48].sum() / total, rel=1e-6)
    assert found.loss_shares["eddy"] > 0.01


@pytest.mark.long  # compiles loops with eddy currents
def test_loss_by_the_piston_blade_equals_the_loss_by_an_equal_drag_coefficient_of_the_piston(
    changed: Changed,
) -> None:
    parts = {
        "effects.drag.liquid": "silicone oil 350 cSt",
        "cell.separation": "3.4 mm",
        "piston.blade": {"depth": "10 mm", "film": "0.5 mm"},
        "effects.eddy": {"conductivity": 6e7, "thickness": 1e-3, "distance": 4e-3, "mutual": False},
    }
    found = small_motions(changed(**parts)).loss_shares
    viscous = 2.0 * 350e-6 * 970.0 * 0.12 * 0.01 / 0.5e-3
    fixed = small_motions(changed(**parts | {"piston.blade": None, "piston.drag": viscous})).loss_shares
    assert found == pytest.approx(fixed, rel=1e-6)
    assert found["piston"] > 0.01


def test_summary_of_small_motions_notes_that_dry_friction_is_not_included(
    changed: Changed, found: SmallMotions
) -> None:
    rubbed = small_motions(changed(**{"effects.friction": {"static": 0.3, "dynamic": 0.2}}))
    assert "dry friction is not included in the equilibrium" in str(rubbed)
    assert "Dry friction is not included in the equilibrium" in modes_page(rubbed).to_html()
    assert rubbed.to_plain()["dry_friction"] is True
    assert rubbed.roots[0].s == pytest.approx(found.roots[0].s, rel=1e-9)
    assert "dry friction" not in str(found)


def test_plain_data_of_the_summary_are_strict_json(found: SmallMotions) -> None:
    plain = json.loads(json.dumps(found.to_plain(), allow_nan=False))
    assert plain["roots"][0]["frequency"] == found.roots[0].frequency
    assert plain["slopes"]["piston.mass"] == slopes(found.rest, ["piston.mass"]).values[0].tolist()


def test_plots_of_small_motions_show_all_grains_and_modes(found: SmallMotions) -> None:
    axes = plot_mode(found.rest, found.roots[0].shape)
    grains, piston = (part for part in axes.collections if hasattr(part, "U"))
    assert len(grains.U) == 24
    longest = max(np.hypot(grains.U, grains.V).max(), np.abs(piston.V).max())
    assert longest == pytest.approx(1.5 * 6.0)  # [mm]
    bars = plot_density_of_states(found.modes).patches
    assert sum(bar.get_height() for bar in bars) == 49


def test_the_page_of_small_motions_has_all_its_sections(found: SmallMotions) -> None:
    page = modes_page(found).to_html()
    assert page.count("<svg") == 3
    for words in ("Modes", "Response to a small harmonic motion", "Logarithmic slopes", "piston.mass"):
        assert words in page
    assert "cell.separation" not in page  # does not enter any force
    assert f"{found.roots[0].frequency:.6g} Hz" in page


def test_command_modes_analyses_the_small_motions_of_a_run(
    settled: tuple[Scene, np.ndarray, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = settled[0].replace(protocol=settled[0].to_plain()["protocol"][:1], **{"output.record": None})
    run, out = tmp_path / "run", tmp_path / "out"
    simulate(scene, out=run, progress=False)
    main(["modes", str(run), "-o", str(out), "--json"])
    shown = json.loads(capsys.readouterr().out)
    assert shown["is_stable"]
    assert shown["roots"][0]["damping_ratio"] == pytest.approx(
        piston_roots(equilibrium_from(*settled))[0].damping_ratio
    )
    assert (out / "report.html").stat().st_size > 10_000
    assert "friction" not in shown
    main(["modes", str(run), "--friction", "0.02", "--json"])
    rubbing = json.loads(capsys.readouterr().out)["friction"]
    assert rubbing["force"] == pytest.approx(0.015 * rubbing["moving_load"])
    with pytest.raises(InputError, match="is a run, whose scene is fixed"):
        main(["modes", str(run), "--set", "piston.mass=2"])


def test_command_modes_refuses_a_scene_without_a_free_piston_before_simulating_it() -> None:
    with pytest.raises(InputError, match="has no free piston"):
        main(["modes", "bed"])
    with pytest.raises(InputError, match="no stage of the protocol ends at rest"):
        main(["modes", "damper", "--set", "protocol.drop.until=none", "--set", "protocol.drop.duration=1"])


def test_a_bed_on_a_driven_machine_settles_without_the_drive(found: SmallMotions) -> None:
    scene = load_scene("machine").replace(**SMALL, **{"piston.height": "20 D", "arrangement.height": "19 D"})
    rest = equilibrium_from(*settled_scene_positions_and_heights(scene))
    assert rest.pencil.bed.machine is not None
    assert rest.piston_height == pytest.approx(found.rest.piston_height, rel=1e-9)
    moved = small_motions(rest)
    assert math.isnan(moved.moving_mass)
    assert moved.stiffness == pytest.approx(found.stiffness, rel=1e-6)
    assert "moves along" not in str(moved)
    assert moved.to_plain()["loss_shares"].keys() == {"host", "drag"}


def response_of(scene: Scene, quantity: str) -> FrequencyResponse:
    still = ("m", "amplitude", np.full((2, 3), 1e-3))
    return FrequencyResponse(
        scene, response_dataset(quantity, [1.0, 2.0], [2.0, 3.0, 4.0], {"displacement": still})
    )


def test_linear_response_of_a_mass_on_a_moving_base_agrees_with_its_transmissibility(
    changed: Changed,
) -> None:
    drive = {"kind": "sine", "displacement": "1 mm", "frequency": "3 Hz"}
    rest = changed(**{"effects.host": {"mount": "base", "bodies": [], "excitation": drive}})
    frequencies = np.array([1.0, 3.0, 9.0])
    swing = linear_displacements_per_drive(rest, "displacement", frequencies)
    np.testing.assert_allclose(1.0 + swing, transmissibility(rest, frequencies), rtol=1e-9)
    accelerated = linear_displacements_per_drive(rest, "acceleration", frequencies)
    np.testing.assert_allclose(-((math.tau * frequencies) ** 2) * accelerated, swing, rtol=1e-9)


def test_static_response_of_a_machine_to_a_force_is_the_compliance_of_its_spring(changed: Changed) -> None:
    rest = changed(**{"effects.host": load_scene("machine").effects.host.to_plain()})
    assert linear_displacements_per_drive(rest, "force", np.array([1e-4]))[0] == pytest.approx(
        1.0 / 41.7e3, rel=1e-6
    )
    # If the cell moves by 1, the force on the machine is the inertia of everything in the cell.
    frequency = 3.1
    alone, rate = changed().pencil, (math.tau * frequency) ** 2
    uplift = changed().pencil.bed.cell_displacement_coefficients_and_uplift()[1]
    inertia = (rate * (alone.mass @ uplift)).astype(complex)
    moved = alone.solve(2j * math.pi * frequency, inertia[:, None])[:, 0]
    hung = -rate * (uplift @ (alone.mass @ (uplift + moved)))
    host = rest.scene.effects.host
    assert host is not None
    assert host.excitation is not None
    expected = linear_response(host, [frequency], hung)[0, -1] / host.excitation.force
    assert linear_displacements_per_drive(rest, "force", np.array([frequency]))[0] == pytest.approx(
        expected, rel=1e-8
    )


def test_frequency_response_without_a_linear_curve_gives_the_reason() -> None:
    scene = load_scene("machine").replace(**{"grains.count": 0})
    kept = add_linear_response(response_of(scene, "force"))
    assert "linear" not in kept.dataset
    assert "the scene has no grains and therefore no bed" in kept.dataset.attrs["no_linear"]
