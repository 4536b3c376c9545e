"""What was run for each question, as plain data: a row a bed, beside how it was made."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from granular.shared.files import finite, write_text
from validation.results_file import read_results

Plain = dict[str, Any]
COMMAND = "python -m validation disorder"
_DIGITS = 5


def committed(question: str) -> Plain:
    """The results that come with the package: ``made`` and ``rows``.

    Parameters
    ----------
    question : str
        Of `STUDIES`.

    Raises
    ------
    InputError
        If the file holds something else.
    """
    return read_results(committed_file(question), _checked, {"made": {}, "rows": []})


def committed_file(question: str) -> Path:
    """Where they are."""
    return Path(__file__).parent / f"{question}.json"


def _checked(plain: Plain) -> Plain:
    return {"made": plain["made"], "rows": list(plain["rows"])}


def write(question: str, rows: list[Plain], path: Path) -> None:
    """Write rows, one a line, so that changes of the file can be read."""
    from validation.parts import machine

    now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d")
    made = {"command": f"{COMMAND} {question} --full", "date": now, **machine()}
    plain = {"made": made, "rows": [_rounded(row) for row in rows]}
    text = json.dumps(finite(plain), separators=(",", ":"))
    write_text(path, text.replace("},{", "},\n{") + "\n")


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _rounded(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _temperature(out: Path | None, progress: bool) -> list[Plain]:
    from validation.defects.temperature import temperature_rows

    return temperature_rows(out, progress=progress)


def _forces(out: Path | None, progress: bool) -> list[Plain]:
    from validation.defects.forces import force_rows

    return force_rows(out, progress=progress)


def _slip(out: Path | None, progress: bool) -> list[Plain]:
    from validation.defects.cycles import cycle_rows

    return cycle_rows(out, progress=progress)


STUDIES: Mapping[str, Callable[[Path | None, bool], list[Plain]]] = {
    "temperature": _temperature, "forces": _forces, "slip": _slip,
}  # fmt: skip
"""Questions, and what runs all beds of one."""
