"""Variants of commands that need a further package; a variant is refused if its package is missing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from granular.shared.registry import Registry

FORMS = Registry[Callable[..., Any]](
    "form of a command",
    "",  # no entry points: packages cannot add forms
    {
        "compare --response": "reduced_models.machines.command:compare_response_with_law",
        "export-model SCENE": "reduced_models.machines.design:export_bed",
    },
    lambda _, form: callable(form),
    "a function",
)
"""Functions that run the variants of commands, by command and argument."""
