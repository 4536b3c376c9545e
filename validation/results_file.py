"""Files of results, as they come with the package."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from granular.shared.errors import InputError

Results = TypeVar("Results")


def read_results(path: Path, from_plain: Callable[[Any], Results], empty: Results) -> Results:
    """Results from a file; empty where there is none.

    Raises
    ------
    InputError
        If the file holds something else.
    """
    try:
        return from_plain(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        return empty
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} holds no results ({error}); make it anew") from None
