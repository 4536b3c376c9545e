"""Parts of a scene in words, for people to read."""

from __future__ import annotations

import dataclasses
from typing import Any

from granular.schema.field_kinds import QuantityKind
from granular.schema.sections import Section


def describe_fields(section: Section, *, without: tuple[str, ...] = ()) -> str:
    """Values of a section's fields as text, with units; empty where none is given."""
    said = []
    for field in dataclasses.fields(section):
        value = getattr(section, field.name)
        if value is None or value == () or field.name in without:
            continue
        if isinstance(value, tuple):
            said.append("; ".join(map(_value_text, value)))
            continue
        kind = field.metadata["kind"]
        unit = kind.unit if isinstance(kind, QuantityKind) and kind.unit != "1" else ""
        said.append(f"{field.name} {_value_text(value)} {unit}".strip())
    return ", ".join(said)


def _value_text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.12g}"  # 0.2 D is 0.0012 m, not 0.0012000000000000001
    if isinstance(value, Section):
        return describe_fields(value)
    if isinstance(value, tuple):
        return " = ".join(map(str, value))  # a parameter
    return str(value)
