"""Forms of commands that rooms of their own bring: without its room, a form is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from granular.shared.registry import Registry

FORMS = Registry[Callable[..., Any]](
    "form of a command",
    "",  # these two alone: no package brings one
    {
        "compare --response": "reduced_models.machines.command:compare_response_with_law",
        "export-model SCENE": "reduced_models.machines.design:export_bed",
    },
    lambda _, form: callable(form),
    "a function",
)
"""Functions by the command and what is given to it."""
