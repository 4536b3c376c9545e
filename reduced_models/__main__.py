"""Command line of the identification: ``python -m reduced_models``."""

from __future__ import annotations

import sys

from granular.commands.console import Program, launch
from reduced_models.commands.dampers import calibrate, derive, design, fall
from reduced_models.commands.identification import compare, discover, fit, identify
from reduced_models.commands.models import export_model, simulate
from reduced_models.commands.records import example, look

PROGRAM = Program(
    "python -m reduced_models",
    "From a motion to its equation.",
    """\
from a lab record to its equation, judged on what it has not seen:
  %(prog)s identify lab.csv -o out
  %(prog)s compare lift-1.csv lift-2.csv --law all --test-records lift-3.csv
  %(prog)s simulate out/model.json --until 3 -o motion.csv""",
    (
        *(identify, look, example, fit, discover, compare),
        *(calibrate, design, fall, derive, simulate, export_model),
    ),
)
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(launch(main))
