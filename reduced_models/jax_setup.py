"""JAX as this package needs it: double precision, and compiled code kept on disk.

Import ``jax`` from here, so that the settings stand before the first array is made.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import jax

_set: Any = jax.config.update
_set("jax_enable_x64", True)
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    _set("jax_compilation_cache_dir", str(_home / "granular-damper" / "jax"))
_set("jax_persistent_cache_min_compile_time_secs", 0.0)
_set("jax_persistent_cache_min_entry_size_bytes", -1)

__all__ = ["jax"]
