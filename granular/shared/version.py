"""The version of the toolkit, which stands nowhere else in the code."""

from __future__ import annotations

from collections.abc import Sequence

__version__ = "0.1.0"


def versions(more: Sequence[str] = ()) -> dict[str, str]:
    """Versions of the toolkit and of what it computes with, and the kind of machine."""
    import importlib.metadata
    from platform import machine, python_version

    result = {"python": python_version(), "machine": machine(), "granular-damper": __version__}
    for name in ("numpy", "numba", *more):  # numba may be missing where nothing is simulated
        try:
            result[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return result
