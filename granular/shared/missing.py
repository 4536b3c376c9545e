"""What is said where a distribution is missing that simulations or fits need."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granular.shared.errors import MissingError

NEEDED_BY = {
    **dict.fromkeys(
        (
            "diffrax",
            "equinox",
            "jax",
            "jaxlib",
            "lineax",
            "mpmath",
            "optimistix",
            "sympy",
        ),
        "fits",
    ),
    **dict.fromkeys(
        ("PIL", "llvmlite", "loky", "numba", "pandas", "tomli_w", "xarray", "zarr"), "simulation"
    ),
}
"""Modules that an installation of one half lacks, with the group of `pyproject.toml` for each."""


def missing(error: ModuleNotFoundError) -> MissingError | None:
    """The same in words that say what to do; None where the module is none of the toolkit's."""
    module = (error.name or "").partition(".")[0]
    if module not in NEEDED_BY:
        return None
    from granular.shared.errors import MissingError

    return MissingError(
        f"{module} is not installed; it belongs to the group {NEEDED_BY[module]!r} of what the "
        "toolkit needs: pip install granular-damper brings all of it"
    )


def with_advice(attribute: Callable[[str], Any]) -> Callable[[str], Any]:
    """A package's ``__getattr__`` that says so where what it imports is not installed."""

    def found(name: str) -> Any:
        try:
            return attribute(name)
        except ModuleNotFoundError as error:
            advice = missing(error)
            if advice is None:
                raise
            raise advice from None

    return found
