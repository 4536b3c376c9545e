"""Fast pair sum compared with a plain sum and with extended precision, also on several threads."""

import itertools
import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granular.compiled import entry
from granular.pairs import direct_sum as direct
from granular.pairs.direct_sum import MIN_GRAINS_FOR_PARTS, allocate_partial_sums, pad_coordinates, pad_values
from granular.pairs.grain_arrays import GrainArrays
from granular.pairs.pure_python_sums import pure_python_direct_sum
from tests.granular.pairs.test_cut_off import scattered

direct_sum = entry(direct.direct_sum)

ROOT = Path(__file__).parents[2]


def sums(
    function, positions: np.ndarray, moments, *, full: bool, threaded: bool | None = None
) -> list[np.ndarray]:
    x, y = pad_coordinates(positions)
    out = [np.zeros_like(x) for _ in range(4)]
    extremes = np.zeros(2)
    weight = pad_values(np.linspace(0.2, 1.0, len(positions)))
    wanted = (out[2], extremes, out[3], weight) if full else (None,) * 4
    function(
        GrainArrays(x, y, out[0], out[1], moments, *wanted), allocate_partial_sums(x.size), threaded, None
    )
    return [*(one[: len(positions)] for one in out), extremes]


@settings(max_examples=25, deadline=None)
@given(count=st.integers(1, 60), seed=st.integers(0, 10**6), differing=st.booleans(), full=st.booleans())
def test_fast_pair_sum_equals_a_plain_double_loop(count: int, seed: int, differing: bool, full: bool) -> None:
    positions = scattered(count, seed)
    moments = pad_values(np.linspace(0.3, 1.0, count)) if differing else None
    fast = sums(direct_sum, positions, moments, full=full)
    slow = sums(pure_python_direct_sum, positions, moments, full=full)
    for one, other in zip(fast, slow, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max() + 1e-150)


def exact(positions: np.ndarray, moments: np.ndarray, weight: np.ndarray) -> list[np.ndarray]:
    """Return forces, sums of their magnitudes and friction load, in extended precision."""
    place = positions.astype(np.longdouble)
    delta = place[:, None] - place[None]
    r2 = (delta**2).sum(axis=2)
    np.fill_diagonal(r2, np.inf)
    pairs = moments[:, None] * moments[None]
    force = 0.75 * pairs * r2**-2.5
    np.fill_diagonal(force, 0.0)
    return [
        (force * delta[:, :, 0]).sum(axis=1),
        (force * delta[:, :, 1]).sum(axis=1),
        (0.75 * pairs * r2**-2.0).sum(axis=1),
        (weight[None] * r2**-1.5).sum(axis=1),
    ]


@pytest.mark.parametrize(("count", "differing"), list(itertools.product((7, 92, 368), (False, True))))
def test_error_of_the_pair_sum_is_near_the_rounding_error(count: int, differing: bool) -> None:
    """The error is below 1e-13 of the summed magnitudes of a grain's pair forces."""
    positions = scattered(count, 3)
    moments = np.linspace(0.3, 1.0, count) if differing else np.ones(count)
    fast = sums(direct_sum, positions, pad_values(moments) if differing else None, full=True)
    fx, fy, magnitudes, load = exact(positions, moments, np.linspace(0.2, 1.0, count))
    assert (np.abs(fast[0] - fx) <= 1e-13 * magnitudes).all()
    assert (np.abs(fast[1] - fy) <= 1e-13 * magnitudes).all()
    assert (np.abs(fast[3] - load) <= 1e-13 * load).all()


PORTABLE = """
import json, sys
import numpy as np
from granular.compiled import entry
from granular.pairs.direct_sum import direct_sum, pad_coordinates, pad_values
from granular.pairs.grain_arrays import GrainArrays
positions = np.array(json.loads(sys.argv[1]))
x, y = pad_coordinates(positions)
fx, fy, load = np.zeros((3, x.size))
direct_sum = entry(direct_sum)
weight = pad_values(np.ones(len(positions)))
direct_sum(GrainArrays(x, y, fx, fy, load=load, weight=weight), None, None, None)
(code,) = direct_sum.inspect_asm().values()
print(json.dumps([fx.tolist(), fy.tolist(), load.tolist(), "rsqrt14" in code, "sqrtpd" in code]))
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="other processors run it always")
def test_pair_sum_for_processors_without_avx_is_equally_accurate(tmp_path: Path) -> None:
    """Neither hardware estimates of reciprocal roots nor hardware square roots are used."""
    positions = scattered(57, 8)
    done = subprocess.run(
        [sys.executable, "-c", PORTABLE, json.dumps(positions.tolist())],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env=os.environ
        | {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    *found, estimates, roots = json.loads(done.stdout)
    assert not estimates
    assert not roots
    fx, fy, magnitudes, load = exact(positions, np.ones(57), np.ones(57))
    assert (np.abs(np.array(found[0])[:57] - fx) <= 1e-13 * magnitudes).all()
    assert (np.abs(np.array(found[1])[:57] - fy) <= 1e-13 * magnitudes).all()
    assert (np.abs(np.array(found[2])[:57] - load) <= 1e-13 * load).all()


def test_pair_sum_in_several_parts_equals_the_sum_in_one_part() -> None:
    """A few distant grains raise the number of grains above the limit for a division into parts."""
    positions = scattered(MIN_GRAINS_FOR_PARTS - 8, 5)
    far = np.stack([1e12 * np.arange(1.0, 17.0), np.zeros(16)], axis=1)
    moments = np.linspace(0.3, 1.0, MIN_GRAINS_FOR_PARTS + 8)
    one = sums(direct_sum, positions, pad_values(moments[:-16]), full=True)
    many = sums(direct_sum, np.concatenate([positions, far]), pad_values(moments), full=True)
    for alone, among in zip(one[:3], many[:3], strict=True):
        np.testing.assert_allclose(among[: len(alone)], alone, rtol=1e-11, atol=1e-13)


def test_pair_sum_does_not_depend_on_the_number_of_threads() -> None:
    """Each part is summed by one thread. The parts are added in a fixed order."""
    positions = scattered(MIN_GRAINS_FOR_PARTS + 3, 6)
    one, several = (sums(direct_sum, positions, None, full=True, threaded=way) for way in (None, True))
    for alone, together in zip(one, several, strict=True):
        assert np.array_equal(alone, together)
