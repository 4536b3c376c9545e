"""Command line of the simulation: ``python -m granular``."""

from __future__ import annotations

import sys

from granular.commands.console import Program, command_registry, run_command_and_return_exit_code

PROGRAM = Program(
    "python -m granular",
    "Simulate beds of repelling magnets and the piston on them.",
    """\
example of a first run:
  %(prog)s scenes
  %(prog)s show bed
  %(prog)s run bed --t-end 0.5 -o runs/bed
  %(prog)s render runs/bed -o speed.png --colour speed""",
    command_registry(
        "granular.commands",
        {
            "scenes": "granular.commands.scenes:scenes",
            "show": "granular.commands.scenes:show",
            "schema": "granular.commands.scenes:schema",
            "run": "granular.commands.run:run",
            "observe": "granular.commands.observe:observe",
            "defects": "granular.commands.observe:defects",
            "export": "granular.commands.export:export",
            "render": "granular.commands.render:render",
            "sweep": "granular.commands.run:sweep",
            "modes": "granular.commands.modes:modes",
            "tolerances": "granular.commands.tolerances:tolerances",
            "response": "granular.response.command:response",
            "silo": "granular.commands.silo:silo",
        },
    ),
)
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
