"""Sensitivities averaged over several settled beds of a scene."""

import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granular import Scene, Study, sweep
from granular.__main__ import main
from granular.linear import piston_roots, slopes
from granular.linear.equilibrium import equilibrium_from, settled_scene_positions_and_heights
from granular.shared.errors import InputError
from granular.studies import bed_slopes
from granular.studies.bed_slopes import SlopesOverBeds, slopes_over_beds

KEYS = ("grains.remanence", "piston.mass")


@pytest.fixture(scope="module")
def scene(damper: Scene) -> Scene:
    """Return a bed of 40 grains, enough for different packings.

    With 23 in a cell of 15 D, all packings would be the same.
    """
    return damper.replace(
        **{
            "grains.count": 40,
            "cell.width": "20 D",
            "piston.height": "8 D",
            "piston.mass": 1.5,
            "arrangement.height": "7.5 D",
            "effects.drag.coefficient": 0.5,
        }
    )


@pytest.fixture(scope="module", autouse=True)
def reused() -> Iterator[list[int]]:
    """Yield the list of how many beds each study reused. Missing beds are settled in this process."""
    result: list[int] = []

    def sweep_here(*args: Any, **options: Any) -> Study:
        study = sweep(*args, **options, executor=pool)
        result.append(study.reused)
        return study

    with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor(1) as pool:
        patch.setattr(bed_slopes, "sweep", sweep_here)
        yield result


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("beds")


@pytest.fixture(scope="module")
def found(scene: Scene, folder: Path) -> SlopesOverBeds:
    return slopes_over_beds(scene, 3, KEYS, out=folder, progress=False)


def test_sensitivities_of_each_bed_are_computed_at_its_equilibrium(
    scene: Scene, found: SlopesOverBeds
) -> None:
    assert found.seeds == (1, 2, 3)
    rest = equilibrium_from(*settled_scene_positions_and_heights(scene.replace(**{"arrangement.seed": 2})))
    root = piston_roots(rest)[0]
    assert rest.piston_height is not None
    wanted = [rest.piston_height, root.frequency, root.damping_ratio]
    np.testing.assert_allclose(found.figures[1], wanted, rtol=1e-7)
    np.testing.assert_allclose(found.values[1], slopes(rest, KEYS, root).values, rtol=1e-5, atol=1e-7)


def test_standard_deviation_of_a_sensitivity_is_its_spread_over_beds(found: SlopesOverBeds) -> None:
    by_mass = found.values[:, 1, 1]
    mean = sum(by_mass) / 3
    deviation = np.sqrt(sum((by_mass - mean) ** 2) / 2)
    assert deviation > 1e-4
    assert found.mean.of("piston.mass")[1] == pytest.approx(mean)
    assert found.deviation[1, 1] == pytest.approx(deviation)
    assert found.standard_error[1, 1] == pytest.approx(deviation / np.sqrt(3))
    assert found.to_plain()["error"]["piston.mass"][1] == pytest.approx(deviation / np.sqrt(3))


def test_stored_beds_are_reused_without_being_settled_again(
    scene: Scene, folder: Path, found: SlopesOverBeds, reused: list[int]
) -> None:
    again = slopes_over_beds(scene, 3, KEYS[:1], out=folder, progress=False)
    assert reused[-1] == 3
    np.testing.assert_allclose(again.values[:, 0], found.values[:, 0], rtol=1e-9)


def test_sensitivities_of_a_single_bed_are_refused_because_they_have_no_standard_deviation(
    scene: Scene,
) -> None:
    with pytest.raises(InputError, match="beds = 1 gives no standard deviation; use 2 or more beds"):
        slopes_over_beds(scene, 1)


def test_a_bed_that_does_not_settle_is_identified_by_its_seed(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the bed of arrangement\.seed = 1 has no equilibrium: "):
        slopes_over_beds(scene.replace(**{"protocol.drop.duration": 1.1}), 2, out=tmp_path, progress=False)


def test_command_prints_means_and_standard_deviations_of_sensitivities(
    scene: Scene,
    folder: Path,
    found: SlopesOverBeds,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(bed_slopes, "toolkit_cache_folder", lambda: folder.parent)
    (folder.parent / "beds").symlink_to(folder)
    path = tmp_path / "scene.toml"
    path.write_text(scene.to_toml(), encoding="utf-8")
    main(["modes", str(path), "--beds", "3", "--quiet"])
    mean, deviation = found.mean.of("piston.mass")[1], found.deviation[1, 1]
    assert f"{mean:+.4f} ± {deviation:.4f}" in capsys.readouterr().out
    main(["modes", str(path), "--beds", "3", "--quiet", "--json", "-o", str(tmp_path / "out")])
    shown = json.loads(capsys.readouterr().out)
    assert shown["over_beds"]["deviation"]["piston.mass"][1] == pytest.approx(deviation, rel=1e-9)
    assert shown["slopes"]["piston.mass"] == pytest.approx(found.values[0, 1].tolist(), rel=1e-6)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"{mean:+.4f} ± {deviation:.4f}" in page
    assert "Means over settled beds" in page
