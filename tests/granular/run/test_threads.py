"""Threads are taken where they are quicker; the bits do not tell how many there were."""

import numba
import pytest

from granular import Scene
from granular.run.plan import ThreadCountTuner, choose_thread_count

TWO = pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one processor")


def heard(found: ThreadCountTuner, seconds: dict[int, float], calls: int) -> list[int]:
    """The numbers of threads that are taken, where steps take so long with each."""
    taken = []
    for _ in range(calls):
        taken.append(found.count)
        found.record_step_time(10, 10 * seconds[found.count])
    return taken


@TWO
@pytest.mark.parametrize(("slow", "quick"), [(1, 2), (2, 1)])
def test_the_quicker_number_is_taken(slow: int, quick: int) -> None:
    """Both are tried, in short calls, and then the quicker one is kept."""
    found = ThreadCountTuner(2)
    assert found.trying
    taken = heard(found, {slow: 5e-4, quick: 1e-4}, 6)
    assert set(taken[:2]) == {1, 2}
    assert taken[2:] == [quick] * 4
    assert not found.trying
    assert numba.get_num_threads() == quick


def test_one_thread_stays_one() -> None:
    found = ThreadCountTuner(1)
    assert heard(found, {1: 1.0}, 3) == [1, 1, 1]
    assert not found.trying


def test_small_beds_and_the_source_s_list_take_one(bed: Scene) -> None:
    large = bed.replace(
        **{"grains.count": 2000, "cell.width": "140 D", "piston.height": "62 D", "arrangement.height": "60 D"}
    )
    assert choose_thread_count(bed, None) == 1
    assert choose_thread_count(large.replace(**{"pairs.method": "verlet-list"}), None) == 1
    assert choose_thread_count(large, 1) == 1


@TWO
@pytest.mark.parametrize("method", ["cut-off", "mesh", "direct"])
def test_large_beds_take_several(bed: Scene, method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    large = bed.replace(
        **{
            "grains.count": 2000,
            "cell.width": "140 D",
            "piston.height": "62 D",
            "arrangement.height": "60 D",
            "pairs.method": method,
        }
    )
    monkeypatch.setattr(numba.config, "THREADING_LAYER", "workqueue")
    assert (choose_thread_count(large, None) > 1) == (method == "direct")
