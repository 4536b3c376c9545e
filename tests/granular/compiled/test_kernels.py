"""Which kernels Python can call."""

import numba
import numpy as np
import pytest

from granular.compiled import compiled, entry
from granular.effects import drag, friction
from granular.pairs.direct_sum import reproducible_sum


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_kernel_for_kernels_says_so_to_python() -> None:
    with pytest.raises(TypeError, match=r"effects\.friction\.velocity_factor_after_friction is a kernel"):
        friction.velocity_factor_after_friction(1.0, 2.0)


def test_entry_makes_a_form_that_python_can_call() -> None:
    values = np.arange(16.0)
    assert entry(reproducible_sum)(values) == values.sum()
    assert entry(friction.velocity_factor_after_friction)(1.0, 2.0) == 0.0
    assert drag.drag_flow_coefficients(1.0, 0.0)[0] == 1.0  # is an entry, and a kernel for kernels


def test_without_compilation_kernels_are_plain_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", True)

    def double(x: float) -> float:
        return 2.0 * x

    assert compiled(double) is double
    assert compiled(inline=True)(double) is double
    assert entry(double) is double


def test_kernels_of_other_files_are_not_kept_on_disk() -> None:
    """Their source is not in the digest that stands for all kernels."""

    @entry
    def double(x: float) -> float:
        return 2.0 * x

    assert double(2.0) == 4.0
    assert getattr(getattr(double, "_cache", None), "cache_path", None) is None
