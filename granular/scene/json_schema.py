"""JSON schema of scene and study files, which editors use to complete and check these files.

A schema contains the names, types and limits of single keys. Conditions on several keys are checked only when
a scene is read.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any

from granular.effects.effect import EFFECTS
from granular.effects.formula import FormulaList
from granular.effects.walls import Wall, Walls
from granular.methods.tables import METHODS
from granular.scene.named_scenes import scene_names
from granular.scene.scene import Effects, Scene
from granular.schema import field_kinds as kinds
from granular.schema.cell import SidesKind
from granular.schema.field_kinds import FieldKind
from granular.schema.sections import ParameterValuesKind, Section, SectionWithFormula

DIALECT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]

_ATTRIBUTE = re.compile(r"^    (?P<names>\w+(?:, \w+)*) : .*\n(?P<words>(?:^        .*\n?)*)", re.M)
_LIMITS = {"above": "exclusiveMinimum", "least": "minimum", "below": "exclusiveMaximum", "most": "maximum"}
# With the maximum length of `TextKind`, so that editors refuse the same texts as the loader.
_TEXT = {"type": "string", "minLength": 1, "maxLength": 200}


def scene_schema() -> Schema:
    """Return the schema of scene files, with all registered effects."""
    return {"$schema": DIALECT, "title": "scene of granular-damper", **_section_schema(Scene)}


def study_schema() -> Schema:
    """Return the schema of study files."""
    step = {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, _TEXT]}
    changes = {"type": "object", "description": "keys of the scene with their values"}
    run_settings = {
        "dt": step | {"description": "time step [s], or auto, auto/2, auto*2, ..."},
        "t_end": step | {"description": "end of each run [s]; default: the end of the protocol"},
        "method": {"anyOf": [{"enum": list(METHODS)}, _TEXT, {"type": "object"}]},
    }
    return {
        "$schema": DIALECT,
        "title": "study of granular-damper",
        "type": "object",
        "required": ["scene"],
        "additionalProperties": False,
        "properties": {
            "scene": {
                "anyOf": [{"enum": list(scene_names())}, _TEXT],
                "description": "name of a packaged scene, or path relative to this file",
            },
            "measure": _TEXT
            | {"description": "measure of each run: last-values, or a custom measure by name"},
            **run_settings,
            "changes": changes
            | {"description": "keys of the scene that are changed in all cases, with their values"},
            "grid": changes | {"description": "lists of values; all combinations are run"},
            "cases": {"type": "array", "items": changes, "description": "list of changes, one item per case"},
        },
    }


def _section_schema(section: type[Section]) -> Schema:
    """Return the schema of a section as an object."""
    if section is Effects:
        known = {name: _effect_schema(effect) for name, effect in sorted(EFFECTS.usable_parts().items())}
        return _object_schema(known, [], section)
    if section is Walls:
        sides = _object_schema({}, [], section)
        return sides | {"additionalProperties": {"anyOf": [_section_schema(Wall), {"const": "none"}]}}
    if issubclass(section, Wall):
        plain = _fields_schema(section)
        plain["additionalProperties"] = True  # parameters of a custom law
        del plain["properties"]["own"]
        return {"anyOf": [_TEXT, plain]}
    return _fields_schema(section)


def _effect_schema(effect: type[Section]) -> Schema:
    """Return the schema of an effect: its section, "none" or, if no key is required, also ``true``."""
    if issubclass(effect, FormulaList):
        (fields,) = (field for field in dataclasses.fields(effect) if field.name == "fields")
        item = _section_schema(fields.metadata["kind"].section)
        return {"anyOf": [{"type": "array", "items": item}, item, {"const": "none"}]}
    result = _section_schema(effect)
    if not result.get("required"):
        result = {"anyOf": [result, {"const": True}, {"const": "none"}]}
    return result


def _fields_schema(section: type[Section]) -> Schema:
    properties, required = {}, []
    words = _key_descriptions(section)
    for field in dataclasses.fields(section):
        kind: FieldKind = field.metadata["kind"]
        if isinstance(kind, ParameterValuesKind):
            continue
        schema = _field_kind_schema(kind)
        if kind.optional:
            schema = {"anyOf": [schema, {"const": "none"}]}
        if field.name in words:
            schema = schema | {"description": words[field.name]}
        if isinstance(field.default, str | int | float):
            schema = schema | {"default": field.default}
        if field.default is dataclasses.MISSING:
            required.append(field.name)
        properties[field.name] = schema
    return _object_schema(properties, required, section)


def _object_schema(properties: Schema, required: list[str], section: type[Section]) -> Schema:
    result: Schema = {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": issubclass(section, SectionWithFormula),
    }
    first = (section.__doc__ or "").strip().split("\n\n")[0]
    return result | ({"description": " ".join(first.split())} if first else {})


def _field_kind_schema(kind: FieldKind) -> Schema:
    """Return the schema of a field; empty if the kind of the field has no schema."""
    match kind:
        case kinds.QuantityKind():
            bounds = {word: getattr(kind, name) for name, word in _LIMITS.items()}
            limits = {word: bound for word, bound in bounds.items() if bound is not None}
            unit = "" if kind.unit == "1" else f", such as '1 {kind.unit}'"
            with_unit = _TEXT | {"description": f"a number with a unit{unit}"}
            return {"anyOf": [{"type": "number", **limits}, with_unit]}
        case kinds.IntegerKind():
            return {"type": "integer", "minimum": kind.least, "maximum": kind.most}
        case kinds.FlagKind():
            return {"type": "boolean"}
        case kinds.ChoiceKind():
            return {"enum": list(kind.names)}
        case kinds.TextKind():
            return dict(_TEXT)
        case kinds.PointListKind():
            number = _field_kind_schema(kinds.QuantityKind(unit=kind.unit))
            point = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
            return {"type": "array", "items": point}
        case SidesKind():
            return {"anyOf": [_field_kind_schema(kind.word), _field_kind_schema(kind.table)]}
        case kinds.QuantityListKind():
            return {"type": "array", "items": _field_kind_schema(kind.element)}
        case kinds.NestedSectionKind(section=section) if section is not None:
            return _section_schema(section)
        case kinds.SectionListKind(section=section) if section is not None:
            return {"type": "array", "items": _section_schema(section), "minItems": kind.least}
        case kinds.SectionListKind(kinds=choices) if choices is not None:
            items = [_choice_schema(name, section) for name, section in choices.items()]
            return {"type": "array", "items": {"oneOf": items}, "minItems": kind.least}
    return {}


def _choice_schema(name: str, section: type[Section]) -> Schema:
    """Return the schema of a list item whose kind is named by one of its keys."""
    schema = _section_schema(section)
    properties = {"kind": {"const": name}, **schema["properties"]}
    return schema | {"properties": properties, "required": ["kind", *schema["required"]]}


def _key_descriptions(section: type[Section]) -> dict[str, str]:
    """Collect the descriptions of a section's keys from the docstrings of the section and its bases."""
    result: dict[str, str] = {}
    for ancestor in section.__mro__:
        for match in _ATTRIBUTE.finditer((ancestor.__dict__.get("__doc__") or "") + "\n"):
            words = " ".join(match["words"].split())
            for name in match["names"].split(", "):
                result.setdefault(name, words)
    return result
