"""The command ``example``: records to try the other commands on."""

from __future__ import annotations

from typing import Any

from granular.commands.console import command, option, print_result
from granular.commands.options import OUTPUT


@command(
    "example",
    "write records as instruments write them, made ones and a real one, to try the other commands on",
    option(
        "-o", "--out", default="lab", metavar="DIR", help="directory for them (lab); nothing is overwritten"
    ),
    OUTPUT,
    examples="""\
examples:
  %(prog)s
  %(prog)s -o somewhere        # then: identify somewhere/lvdt.toml --law linear""",
)
def example(options: Any) -> None:
    """Write the example records."""
    from reduced_models.records.example_records import write_example_records

    truths = write_example_records(options.out)
    lines = [f"written to {options.out}, each with a .toml that says how it is read:"]
    lines += [f"  {name:18} {truth}" for name, truth in truths.items()]
    print_result({"directory": options.out, "records": truths}, "\n".join(lines), options.json)
