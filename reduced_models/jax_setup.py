"""JAX as this package needs it: double precision, and compiled code kept on disk.

Import ``jax`` from here, so that the settings stand before the first array is made.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from granular.shared.cache_files import toolkit_cache_folder, trusted_cache_folder
from granular.shared.errors import InputError
from granular.shared.message_text import quote, sanitize
from granular.shared.stop_signals import defer_stop_signals

with defer_stop_signals():  # broken off, the import of JAX's C++ ended in a segmentation fault
    import diffrax  # noqa: F401
    import jax

_VARIABLE = "JAX_COMPILATION_CACHE_DIR"


def _cache_folder() -> Path | None:
    """Folder where compiled code is kept; see `granular.shared.cache_files.trusted_cache_folder`."""
    chosen = os.environ.get(_VARIABLE)
    home = toolkit_cache_folder()
    return trusted_cache_folder(Path(chosen) if chosen else home and home / "jax", _VARIABLE)


def _check_platform(chosen: str) -> None:
    """Refuse a device that JAX is set to take and does not find, before anything is computed."""
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:  # the latter where its plug-in is missing
        why = f", {error}" if str(error) else ""
        raise InputError(
            f"JAX_PLATFORMS = {quote(chosen)}, which JAX cannot use here{sanitize(why)}; unset it, "
            "or set it to cpu"
        ) from None


_set: Any = jax.config.update
_set("jax_enable_x64", True)
_folder = _cache_folder()
_set("jax_compilation_cache_dir", None if _folder is None else str(_folder))
_set("jax_persistent_cache_min_compile_time_secs", 0.0)
_set("jax_persistent_cache_min_entry_size_bytes", -1)

if "JAX_PLATFORMS" in os.environ:
    _check_platform(os.environ["JAX_PLATFORMS"])

__all__ = ["jax"]
