"""The notebooks run, their numbers are correct, and they match their scripts.

Quick tests run the first notebook as a script. Long tests run all notebooks, each in a separate kernel.
"""

import json
import pickle
import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jupytext
import matplotlib as mpl
import nbformat
import pytest

FOLDER = Path(__file__).parents[2] / "notebooks"
SCRIPTS = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
Numbers = Mapping[str, Any]


def first_bed(found: Numbers) -> None:
    # Walls carry the weight at rest; the residual is below the momentum change of the last second.
    assert found["weight_error"] < 1e-4
    assert found["same_force"] < 1e-9
    assert found["same_bits"]
    # The limit above which a run gets a warning.
    assert found["ledger_error"] < 1e-4
    # Six starts give 6.80 to 6.92 N.
    assert found["piston_force"] == pytest.approx(6.86, abs=0.15)


def compression(found: Numbers) -> None:
    # One start: the published starts scatter by 1.6 %, like ours.
    assert found["force_368"] == pytest.approx(found["published_force"], rel=0.05)
    # As in tests/regression/test_compression.py; there the mean of three starts is within 0.5 %.
    assert found["distance_small"] == pytest.approx(found["published_small"], rel=0.01)
    assert found["distance_368"] == pytest.approx(found["published_368"], rel=0.005)
    # Three deviations of the published starts.
    assert found["hexagons_368"] == pytest.approx(found["published_hexagons"], abs=0.06)
    assert found["order_full"] > found["order_before"]
    assert found["cycle_loss"] > 0.0


def bidisperse(found: Numbers) -> None:
    # Forces of single starts scatter by about 1 %; the published ratio is a ratio of fitted curves.
    assert found["force_ratio"] == pytest.approx(found["published_ratio"], rel=0.05)
    assert found["nearest_kind"] == "small"
    # The known difference: 0.82 to 0.85 D here, 0.88 D published, 0.86 D in the wider cell.
    assert found["least_distance"] == pytest.approx(found["published_least"], abs=0.08)
    # Six starts of big grains alone: 0.933 with a deviation of 0.010, below the published value.
    assert found["regularities"][0.0] == pytest.approx(0.933, abs=0.03)
    assert found["regularities"][0.0] < found["published_regularity"][0.0]
    assert found["regularities"][0.5] == pytest.approx(found["published_regularity"][0.5], abs=0.05)
    assert found["orders"][0.5] < found["orders"][0.0]
    assert found["regularities"][0.5] < found["regularities"][0.0]


def damper_to_equation(found: Numbers) -> None:
    # 368 grains rest at 9.86 D with a period of 0.288 s. A quarter of them is half as high, and the
    # period scales with the root of the height: 0.288/sqrt(9.86/5.21) = 0.209 s.
    assert found["rest_height"] == pytest.approx(5.2, abs=0.1)
    assert found["period"] == pytest.approx(0.207, abs=0.004)
    assert found["damping_ratio"] == pytest.approx(0.0128, abs=0.002)
    # De Paula's law is as bad as the linear one; stiffening springs are ten times better.
    errors = found["errors"]
    assert errors["van-der-pol-like"] == pytest.approx(errors["linear"], rel=0.15)
    assert errors["polynomial-spring"] < 0.1 * errors["linear"]
    assert errors["sindy"] < 0.1 * errors["linear"]
    assert min(found["fall_errors"].values()) > 0.2


def laboratory_record(found: Numbers) -> None:
    # The truth is known: the fit's own 95 % interval is about 0.06 wide to each side.
    assert found["power_corrected"] == pytest.approx(found["TRUTH"]["power"], abs=0.12)
    # The spring's first two derivatives determine the exponent: (n + 1)/r = (2.5 + 1)/59 mm, and with
    # the offset r is 63 mm.
    assert found["power_as_read"] == pytest.approx(3.5 * 63 / 59 - 1, abs=0.12)
    assert found["envelope_decay"] == pytest.approx(found["TRUTH"]["lam"], rel=0.03)
    assert found["residual"] == pytest.approx(found["NOISE"], rel=0.1)
    # A 95 % interval twice as wide misses once in ten thousand times.
    assert found["far"] == []
    assert found["dampings"]["profile"][0] == 0.0
    # A tenth of a millimetre, for a peak-to-peak displacement of twelve.
    assert found["prediction_error"] < 1e-4
    assert len(found["refused"]) == len(found["bad"])
    assert all(found["doubts"].values())
    assert found["same_prediction"]


def what_accuracy_costs(found: Numbers) -> None:
    orders = {"symplectic-euler": 1, "stormer-verlet": 2, "blanes-moan-4": 4, "blanes-moan-6": 6}
    for name, order in orders.items():
        assert found["slopes"][name] == pytest.approx(order, abs=0.05)
    # Few steps are between too coarse and rounding.
    assert found["slopes"]["kahan-li-8"] == pytest.approx(8, abs=0.2)
    # The cut-off loses 2 to 10 %, more in larger beds; the mesh's tolerance is 3e-4 of a force.
    assert -0.06 < found["biases"]["cut-off"] < -0.02
    assert found["biases"]["mesh"] == pytest.approx(0.0, abs=2e-3)


def hard_cases(found: Numbers) -> None:
    assert found["nearest"] == pytest.approx(found["CLOSEST"], rel=0.05)
    # 470 variable steps were enough, or 2700 equal ones.
    assert found["variable_steps"] < 1000
    assert found["equal_steps"] > 2000
    assert found["silent"] == []
    assert len(found["refused"]) == 5
    assert found["heavy_ledger"] < 1e-4
    assert found["stop_error"] == "EnergyError"
    assert (found["verlet_verdict"], found["control_verdict"]) == ("none", "loses")


def own_effect_and_law(found: Numbers) -> None:
    assert found["ways_differ"] < 1e-12
    assert found["pull_error"] < 1e-12
    assert "asks for" in found["wrong_force"]
    assert found["balance"] < 1e-3
    assert found["mud_loss"] > 0.0
    assert found["mud_residual"] < 1e-4
    assert found["energy_order"] == pytest.approx(2.0, abs=0.1)
    assert found["own_error"] < found["errors"]["linear"]


def designing_a_damper(found: Numbers) -> None:
    # The tolerances of `design`, for a random start used neither by the scaling laws nor by its checks.
    assert found["own_frequency"] == pytest.approx(found["wanted_frequency"], rel=0.02)
    assert found["own_damping"] == pytest.approx(found["wanted_damping"], rel=0.05)
    assert found["loaded"].mass == 4.0
    assert len(found["refusals"]) == 2


def why_a_bed_damps(found: Numbers) -> None:
    # Drag stops grains immediately: they never hold the piston's energy.
    assert found["greatest_share"] < 0.03
    # Strongly non-affine: half a spacing of the compressed lattice or more.
    assert found["typical"] > 0.3
    assert found["likeness"] > 0.8
    # The stated error of the law for falls without a fit.
    assert found["error"] < 0.025
    # Large oscillations rearrange the bed, small ones do not.
    assert found["first_loss"] > 1.3
    assert found["last_loss"] == pytest.approx(1.0, abs=0.1)


def damper_at_work(found: Numbers) -> None:
    # The machine alone: approximately force over (2 pi)^2 f0 f c; its dashpot is 0.5 % of critical.
    weak, strong = found["weak"], found["strong"]
    assert weak["alone"] == pytest.approx(10.0 / (14.4 * 2.0 * 3.14159265 * 4.6), rel=0.01)
    assert weak["reduction"] > 4.0
    assert strong["peak"] < 2.5 * weak["peak"]  # 3 times the force
    assert found["grains_share"] > 0.5
    assert found["is_worthwhile"]


def defects_on_the_move(found: Numbers) -> None:
    assert found["tracks"].get("dislocation", 0) > 0
    # Two thermometers over 80 correlated frames of 92 grains.
    assert found["bath_error"] < 0.08
    # A bed held by friction is cold, but not a crystal.
    assert found["settled_heat"] < 0.01
    assert found["frozen"] > 0.05
    assert found["uneven"] > 1.2
    # Five beds of 184 grains: 0.33 to 0.49 over increments of 0.4 s.
    assert 0.2 < found["share"] < 1.1
    assert found["conserved"] > 0.9


def real_magnets(found: Numbers) -> None:
    # From the lattices; starts scatter by a few tenths of a per cent.
    assert found["higher"] == pytest.approx(1.074, abs=0.015)
    assert found["faster"] == pytest.approx(0.94, abs=0.03)
    assert max(found["fall_errors"].values()) < 0.03
    # A compressed bed also resists shear, with either kind of magnet.
    ratios = found["over_lattice"]
    assert ratios["discs"] == pytest.approx(ratios["dipoles"], rel=0.06)
    assert 1.0 < ratios["dipoles"] < 1.3


def small_motions(found: Numbers) -> None:
    # The smallest lift is linear, the largest is not: errors grow with amplitude.
    assert abs(found["frequency_errors"][0]) < 1e-5
    assert abs(found["damping_errors"][0]) < 1e-3
    assert abs(found["frequency_errors"][-1]) == pytest.approx(0.0030, abs=0.0005)
    assert abs(found["damping_errors"][-1]) == pytest.approx(0.048, abs=0.005)
    # A change of 1 % has a second-order part of a few thousandths of the slope.
    assert found["mass_slope"] == pytest.approx(found["exact_slope"], rel=3e-3)
    orders = {"symplectic-euler": 2.0, "stormer-verlet": 2.0, "pefrl": 4.0}
    assert found["halved"] == pytest.approx(orders, abs=0.05)


CHECKS: dict[str, Callable[[Numbers], None]] = {
    "01_first_bed": first_bed,
    "02_compression_and_structure": compression,
    "03_bidisperse_order": bidisperse,
    "04_damper_to_equation": damper_to_equation,
    "05_laboratory_record": laboratory_record,
    "06_what_accuracy_costs": what_accuracy_costs,
    "07_hard_cases": hard_cases,
    "08_own_effect_and_law": own_effect_and_law,
    "09_designing_a_damper": designing_a_damper,
    "10_why_a_bed_damps": why_a_bed_damps,
    "11_damper_at_work": damper_at_work,
    "12_defects_on_the_move": defects_on_the_move,
    "13_real_magnets": real_magnets,
    "14_small_motions": small_motions,
}
KEEP = """
import pickle as _pickle

import numpy as _np


def _is_plain(value):
    if isinstance(value, dict):
        return all(map(_is_plain, value)) and all(map(_is_plain, value.values()))
    if isinstance(value, (list, tuple)):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, (bool, int, float, str, _np.generic))


with open({path!r}, "wb") as _file:
    _pickle.dump({{k: v for k, v in globals().items() if k[0] != "_" and _is_plain(v)}}, _file)
"""
"""Cell that writes the plain numbers and texts of a kernel to a file."""

QUICK = ("01_first_bed",)


def test_notebooks_are_numbered_consecutively() -> None:
    assert [int(one.stem[:2]) for one in SCRIPTS] == list(range(1, len(SCRIPTS) + 1))
    assert SCRIPTS


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda one: one.stem)
def test_each_notebook_has_the_same_cells_as_its_script(script: Path) -> None:
    ours, theirs = jupytext.read(script), jupytext.read(script.with_suffix(".ipynb"))
    assert [one.cell_type for one in ours.cells] == [one.cell_type for one in theirs.cells]
    for one, other in zip(ours.cells, theirs.cells, strict=True):
        assert one.source.strip() == other.source.strip()


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda one: one.stem)
def test_stored_outputs_of_each_notebook_contain_no_errors(script: Path) -> None:
    path = script.with_suffix(".ipynb")
    cells = [one for one in json.loads(path.read_text())["cells"] if one["cell_type"] == "code"]
    assert [one["execution_count"] for one in cells] == list(range(1, len(cells) + 1))
    outputs = [output for one in cells for output in one["outputs"]]
    assert all(output["output_type"] != "error" for output in outputs)
    assert all(output.get("name") != "stderr" for output in outputs)
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert path.stat().st_size < 1_200_000


@pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")
@pytest.mark.parametrize("name", QUICK)
def test_each_notebook_script_gives_the_known_numbers(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    former = mpl.get_backend()
    mpl.use("Agg")
    try:
        CHECKS[name](runpy.run_path(str(FOLDER / f"{name}.py")))
    finally:
        mpl.pyplot.close("all")
        mpl.use(former)


@pytest.mark.long
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda one: one.stem)
def test_each_executed_notebook_gives_the_known_numbers(script: Path, tmp_path: Path) -> None:
    """The notebook is executed in a separate kernel."""
    from nbclient import NotebookClient

    book = nbformat.read(script.with_suffix(".ipynb"), as_version=4)
    kept = tmp_path / "numbers.pickle"
    book.cells.append(nbformat.v4.new_code_cell(KEEP.format(path=str(kept))))
    place = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(book, timeout=600, kernel_name="python3", resources=place).execute()
    CHECKS[script.stem](pickle.loads(kept.read_bytes()))
