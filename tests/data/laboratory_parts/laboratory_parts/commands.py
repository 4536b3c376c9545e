"""A command for all three programs, and a command whose options cannot be parsed."""

from granular.commands.console import command, print_result
from granular.commands.options import OutputOptions


@command("example:\n  %(prog)s --json")
def bench(*, output: OutputOptions) -> None:
    """Show the state of the bench."""
    print_result({"bench": "ready"}, "the bench is ready", output.json)


UNTYPED = command("")(lambda speed: None)
