"""Command line of the identification: ``python -m reduced_models``."""

from __future__ import annotations

import sys

from granular.commands.console import Program, command_registry, run_command_and_return_exit_code

PROGRAM = Program(
    "python -m reduced_models",
    "From a measured motion to its equation.",
    """\
from lab records to an equation, tested on a record that was not fitted:
  %(prog)s identify lab.csv -o out
  %(prog)s compare lift-1.csv lift-2.csv --law all --test-records lift-3.csv
  %(prog)s simulate out/model.json --until 3 -o motion.csv""",
    command_registry(
        "reduced_models.commands",
        {
            "identify": "reduced_models.commands.identification:identify",
            "look": "reduced_models.commands.records:look",
            "example": "reduced_models.commands.records:example",
            "fit": "reduced_models.commands.identification:fit",
            "discover": "reduced_models.commands.identification:discover",
            "compare": "reduced_models.commands.identification:compare",
            "calibrate": "reduced_models.commands.dampers:calibrate",
            "design": "reduced_models.commands.dampers:design",
            "fall": "reduced_models.commands.dampers:fall",
            "derive": "reduced_models.commands.dampers:derive",
            "simulate": "reduced_models.commands.models:simulate",
            "export-model": "reduced_models.commands.models:export_model",
        },
    ),
)
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
