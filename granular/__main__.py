"""Command line of the simulation: ``python -m granular``."""

from __future__ import annotations

import sys

from granular.commands.console import Program, launch
from granular.commands.export import export
from granular.commands.modes import modes
from granular.commands.observe import defects, observe
from granular.commands.render import render
from granular.commands.response import response
from granular.commands.run import run, sweep
from granular.commands.scenes import scenes, schema, show
from granular.commands.silo import silo
from granular.commands.tolerances import tolerances

PROGRAM = Program(
    "python -m granular",
    "Simulate beds of repelling magnets and the piston on them.",
    """\
a first run, looked at:
  %(prog)s scenes
  %(prog)s show bed
  %(prog)s run bed --t-end 0.5 -o runs/bed
  %(prog)s render runs/bed -o speed.png --colour speed""",
    (scenes, show, schema, run, observe, defects, export, render, sweep, modes, tolerances, response, silo),
)
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(launch(main))
