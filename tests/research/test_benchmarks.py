"""Public benchmarks: errors for absent or wrong files, and the page for a synthetic record."""

from pathlib import Path

import numpy as np
import pytest

from granular.shared.errors import InputError
from reduced_models.fitting.fit import resolve_law
from research.benchmarks.__main__ import main
from research.benchmarks.bouc_wen import BOUC_WEN
from research.benchmarks.mr_damper import MR_DAMPER
from research.benchmarks.page import results_as_plain_data, results_page, results_text
from research.benchmarks.silverbox import SILVERBOX

ALL = (BOUC_WEN, MR_DAMPER, SILVERBOX)


def test_the_error_for_a_missing_file_says_where_to_get_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["--data", str(tmp_path), "-o", str(tmp_path / "out")])
    printed = capsys.readouterr().out
    for item in ALL:
        assert item.files[0] in printed
        assert item.missing_files(tmp_path) == item.files
    assert (tmp_path / "out" / "benchmarks.html").is_file()
    with pytest.raises(InputError, match="not a directory"):
        main(["--data", str(tmp_path / "none")])


def test_the_error_for_a_wrong_file_says_why_it_is_not_the_benchmark(tmp_path: Path) -> None:
    file = tmp_path / "SNLS80mV.csv"
    file.write_text("V1,V2\n0.1,0.2\n0.2,0.3\n")
    with pytest.raises(InputError, match="2 samples; the benchmark's record has"):
        SILVERBOX.read(tmp_path)
    file.write_text("time,height\n0.1,0.2\n0.2,0.3\n")
    with pytest.raises(InputError, match="no column 'v1'"):
        SILVERBOX.read(tmp_path)
    (tmp_path / "mrd.csv").write_text("x,v\n0.1,0.2\n0.2,0.3\n")
    with pytest.raises(InputError, match="no columns x, E, f"):
        MR_DAMPER.read(tmp_path)
    for name in BOUC_WEN.files:
        np.savez(tmp_path / name, u=np.zeros(3))
    with pytest.raises(InputError, match="no array"):
        BOUC_WEN.read(tmp_path)


def test_page_of_a_benchmark_compares_errors_and_pictures_with_published_ones(tmp_path: Path) -> None:
    """The synthetic record is of a dashpot controlled by a voltage, instead of the MR damper."""
    clock = np.arange(600) / 500.0
    stroke, speed = np.sin(20.0 * clock), 20.0 * np.cos(20.0 * clock)
    voltage = 1.0 + 0.5 * np.sin(7.0 * clock)
    rows = zip(stroke, speed, voltage, speed * (10.0 + voltage), strict=True)
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    (tmp_path / "mrd.csv").write_text("\n".join(["x,v,E,f", *lines]))
    import dataclasses

    simple = dataclasses.replace(MR_DAMPER, laws={"dashpot": "force = (c + cE*E)*z' + zero"})
    results = {simple: simple.fit_laws_and_measure_errors(tmp_path), BOUC_WEN: None}
    outcome = results_as_plain_data(results)["MR damper"][0]
    assert outcome["errors"]["second half"] < 0.01
    assert outcome["parameters"]["c"] == pytest.approx(10.0, rel=0.01)
    assert "0.0451" in results_text(results)
    assert "<svg" in results_page(results).to_html()


def test_laws_of_the_benchmarks_can_be_parsed(tmp_path: Path) -> None:
    from granular import PistonRecord

    still = np.linspace(0.0, 1.0, 30)
    record = PistonRecord(still, still, force=still, extra={"E": still})
    for item in ALL:
        for law in item.laws.values():
            assert resolve_law(law, record).parameters
