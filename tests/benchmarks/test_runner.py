"""Parts of the benchmark can be selected and resumed, and all measured rows and failures are shown."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import PARTS, runner
from benchmarks.__main__ import parser
from benchmarks.engine import PAIR_METHODS
from benchmarks.page import SHEETS, benchmark_text, growth
from benchmarks.process import ProcessError
from granular.pairs.pair_sum_settings import METHODS
from granular.shared.errors import InputError


def read_row(text: str) -> tuple[str, dict[str, Any]]:
    """Return the benchmark part and the measured row from one line of `TABLE`."""
    part, _, entries = text.partition(": ")
    row: dict[str, Any] = dict(entry.split("=") for entry in entries.split("; "))
    for name, value in row.items():
        row[name] = json.loads(value) if re.fullmatch(r"[-\d.e]+|true|{.*}", value) else value
    return part, row


TABLE = """\
sums: sum=direct sum; grains=368; seconds=3e-5; ns per pair=0.44; times plain=8; over direct=1; error=1e-15
lists: sum=cut-off; grains=368; seconds=2e-5; ns per pair=0.8; times plain=6.0
methods: method=direct; grains=368; seconds=3e-5; times direct=1.0
own: spring=class; grains=92; seconds=6e-6; ratio=1.01
errors: method=cut-off; grains=368; force error=1e-3; energy drift=1e-7
rest: method=mesh; grains=368; piston_force=12.0; greatest_speed=1e-9; piston_force off=1e-4; \
left_force off=0; right_force off=0; bottom_force off=0
threads: method=direct; grains=1472; threads=2; seconds=3e-4; times one=1.7; same bits=true
effects: effect=drag; grains=368; seconds=4e-5; added=1e-6; fraction=0.03
absent: effects=dipole; grains=92; by hand=1e-6; engine=1e-6; ratio=1.0
memory: method=direct; grains=5888; bytes=3e8; of 92 grains=2e8
start: start=cold run; seconds=20.0
package: what=the wheel; bytes=700000
study: cases=20; grains=92; cores=2; seconds=20.0; run alone=1.8; filled=0.9; failed=0
protocol: seed=1; speed=8.33e-3; far every=1; seconds=40.0; simulated=316.9; steps=633800; ledger=3e-3; \
force=15.3; half distance=10.9
fits: law=linear; samples=1000; cold=9.0; next process=3.0; warm=0.1; error=1e-3; converged=1.0
jobs: job=main job; seconds=40.0; processor=70.0; cores=1.75; parts={"simulation": 9.0}"""
ROWS = dict(map(read_row, TABLE.splitlines()))


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Replace measurements by synthetic direct sums at four grain counts, the last of which fails.

    Return the list of counts measured so far.
    """
    made: list[int] = []

    def piece(count: int) -> tuple[dict[str, Any], Callable[[], list[dict[str, Any]]]]:
        def measure() -> list[dict[str, Any]]:
            made.append(count)
            if count == 8000:
                raise ProcessError("LAMMPS ended with 1: too much")
            return [ROWS["sums"] | {"grains": count, "seconds": 1e-9 * count**2}]

        return {"grains": count}, measure

    counts = (1000, 2000, 4000, 8000)
    monkeypatch.setitem(runner._WORK, "sums", lambda full: map(piece, counts))
    return made


def test_every_part_of_the_benchmark_has_measurements_and_a_table() -> None:
    assert set(PARTS) == set(runner._WORK) == set(SHEETS) == set(ROWS)


def test_benchmark_results_are_written_and_reused_in_the_next_call(
    measured: list[int], tmp_path: Path
) -> None:
    found = runner.benchmark(str(tmp_path), parts=["sums"], progress=False)
    assert found["growth"][0]["exponent"] == pytest.approx(2.0)
    assert found["growth"][0]["counts"] == 3
    kept = json.loads((tmp_path / "benchmark.json").read_text())
    assert [one["rows"][0]["grains"] for one in kept["parts"]["sums"][:3]] == [1000, 2000, 4000]
    html = (tmp_path / "benchmark.html").read_text()
    assert "direct sum" in html
    assert "<svg" in html
    assert "LAMMPS ended with 1: too much" in html
    runner.benchmark(str(tmp_path), parts=["sums"], progress=False)
    assert measured == [1000, 2000, 4000, 8000]


def test_benchmark_print_out_shows_measured_rows_and_failures(measured: list[int]) -> None:
    found = runner.benchmark(None, parts=["sums"], progress=False)
    text = benchmark_text(found)
    assert "grains 8000 failed: ProcessError: LAMMPS ended with 1: too much" in text
    assert "2.000" in text
    assert SHEETS["lists"].title not in text


@pytest.mark.parametrize("part", ROWS)
def test_every_part_of_the_benchmark_appears_in_the_print_out_and_on_the_page(
    part: str, tmp_path: Path
) -> None:
    results = {part: [{"rows": [ROWS[part]]}]}
    found = {
        "parts": results,
        "growth": growth(results),
        "missing": [],
        "machine": {"cores": "2"},
        "full": False,
    }
    assert SHEETS[part].title in benchmark_text(found)
    runner._save(found, tmp_path)
    assert SHEETS[part].title in (tmp_path / "benchmark.html").read_text()


def test_exponent_of_time_against_grain_count_requires_three_counts_of_at_least_1000_grains() -> None:
    rows = [ROWS["methods"] | {"grains": n, "seconds": 1e-8 * n} for n in (92, 368, 1000, 2000)]
    assert growth({"methods": [{"rows": rows}]}) == []
    rows.append(ROWS["methods"] | {"grains": 5000, "seconds": 5e-5})
    (found,) = growth({"methods": [{"rows": rows}]})
    assert found["exponent"] == pytest.approx(1.0)


def test_every_pair_sum_method_is_measured() -> None:
    assert set(PAIR_METHODS) == set(METHODS) - {"auto"}
    planned = {key["method"] for key, _ in runner._WORK["memory"](True)}
    assert planned == set(PAIR_METHODS)


def test_benchmark_refuses_an_unwritable_directory_before_measuring(
    measured: list[int], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("here")
    with pytest.raises(InputError, match="cannot be made"):
        runner.benchmark(str(tmp_path / "file"), parts=["sums"], progress=False)
    assert measured == []


def test_command_line_selects_parts_of_the_benchmark() -> None:
    options = parser().parse_args(["--part", "sums", "--part", "start", "--full"])
    assert options.parts == ["sums", "start"]
    assert options.full
    with pytest.raises(InputError, match="invalid choice: 'nothing'"):
        parser().parse_args(["--part", "nothing"])
