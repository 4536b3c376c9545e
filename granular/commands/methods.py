"""The command ``methods``: which integration methods there are."""

from __future__ import annotations

from typing import Any

from granular.commands.console import Parser, add_import, add_output, emit

WHAT = "list the integration methods"
EXAMPLES = "example:\n  %(prog)s"


def add_options(one: Parser) -> None:
    """The command's options."""
    add_import(one)
    add_output(one)


def carry_out(options: Any) -> None:
    """List the methods that are built in, those of the user's own, and those installed."""
    from granular.methods.named import known_methods
    from granular.own import import_own

    import_own(options.own_files)
    methods = known_methods()
    emit({name: one.to_plain() for name, one in methods.items()}, repr(methods), options.json)
