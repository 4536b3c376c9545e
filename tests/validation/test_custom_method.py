"""A user's own methods, measured next to those that are built in."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from granular import Method
from granular.commands.console import launch
from granular.methods.registry import register_methods
from granular.shared.errors import InputError
from validation.__main__ import main
from validation.convergence_order import convergence
from validation.exact_problems import exact_problem
from validation.report import method_report

Z = 0.1931833275037836
MCLACHLAN = Method(
    "mclachlan-2",
    2,
    "McLachlan 1995, doi:10.1137/0916010",
    kicks=(0.0, 0.5, 0.5, 0.0),
    drifts=(Z, 1.0 - 2.0 * Z, Z),
)
RUTH = Method(
    "ruth-3",
    3,
    "Ruth 1983, doi:10.1109/TNS.1983.4332919",
    kicks=(7 / 24, 3 / 4, -1 / 24, 0.0),
    drifts=(2 / 3, -2 / 3, 1.0),
)


@pytest.mark.parametrize("method", [MCLACHLAN, RUTH], ids=lambda method: method.name)
def test_custom_methods_show_their_order(method: Method) -> None:
    register_methods([method])
    found = convergence(exact_problem("oscillation"), method.name)
    assert found.order == method.order
    assert found.fit is not None
    assert found.fit.value == pytest.approx(method.order, abs=0.05)


@pytest.mark.long
def test_the_command_measures_a_method_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.py").write_text(
        "from granular import Method\nm = Method('of-a-file', 2, kicks=(0.5, 0.5), drifts=(1,))\n"
    )
    words = ["method", "of-a-file", "--import", str(tmp_path / "mine.py"), "--quiet", "--json"]
    words += ["--scene", "single-particle", "--t-end", "0.1", "-o", str(tmp_path / "out")]
    assert launch(main, words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["held"] == {"convergence": True, "energy": True, "work-precision": True}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "of-a-file" in page
    assert "blanes-moan-4" in page


def test_bad_requests_end_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no method is given"):
        method_report(tmp_path, [])
    with pytest.raises(InputError, match="unknown method 'nothing'"):
        method_report(tmp_path, ["nothing"])
    with pytest.raises(InputError, match="give it a name of its own"):
        method_report(tmp_path, [Method("stormer-verlet", 1, kicks=(1.0, 0.0), drifts=(1.0,))])
    with pytest.raises(InputError, match="unknown quantity 'nonsense'"):
        method_report(tmp_path, ["pefrl"], quantities=["energy", "nonsense"])
    assert not list(tmp_path.iterdir())  # before anything is measured
    assert launch(main, ["method", "pefrl", "--set", "grains.count=2", "--quiet"]) == 2
