"""What is deprecated says since when, until when, and what to write instead, where it is used."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from granular.shared.deprecation import deprecated

WORDS = r"^former\(\) is deprecated since 0\.2 and goes in 0\.3; write present\(\)$"


def former(value: float) -> float:
    """A public function that will go."""
    deprecated("former()", since="0.2", until="0.3", remedy="write present()")
    return value


def test_warning_names_versions_and_remedy_at_the_line_of_the_user() -> None:
    with pytest.warns(DeprecationWarning, match=WORDS) as found:
        assert former(3.0) == 3.0
    (one,) = found
    line = Path(one.filename).read_text(encoding="utf-8").splitlines()[one.lineno - 1]
    assert line.strip() == "assert former(3.0) == 3.0"


def test_warning_can_be_made_an_error() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(DeprecationWarning, match=WORDS):
            former(1.0)
