"""The command ``observe``: observables of a run, as a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from granular.commands.console import Parser, add_import, add_output, emit
from granular.shared.files import write_text

WHAT = "observables of every frame of a run, as a table"
EXAMPLES = """\
examples:
  %(prog)s runs/bed mean_distance hexatic_order -o order.csv
  %(prog)s runs/bed greatest_force --import mine.py

observables:
  mean_distance     mean distance of two grains
  piston_distance   distance of the piston from the grain next to it
  packing           packing fraction below the piston, or of a periodic cell
  hexatic_order     mean of |psi_6| over the grains
  temperature       kinetic temperature of the bed

mine.py:
  import numpy as np
  from granular.observables import observable

  @observable("N", "greatest force on a grain")
  def greatest_force(frame):
      return np.nanmax(np.linalg.norm(frame.forces, axis=1))"""


def add_options(one: Parser) -> None:
    """The command's options."""
    one.add_argument("run", metavar="RUN", help="directory that a run was written to")
    one.add_argument(
        "names", metavar="NAME", nargs="+", help="of an observable; see below, or your own"
    )
    add_import(one)
    one.add_argument("-o", "--out", metavar="FILE", help="write the table to this CSV file")
    add_output(one)


def carry_out(options: Any) -> None:
    """Make a table of observables."""
    from granular.observables.named import observable_named
    from granular.observables.of_frames import observed_table
    from granular.own import import_own
    from granular.run.trajectory import load_trajectory

    own = import_own(options.own_files).observables
    run = load_trajectory(options.run)
    table = observed_table(run, [observable_named(name, own) for name in options.names])
    if options.out is not None:
        write_text(Path(options.out), table.to_csv(index=False))
    text = table.to_string(index=False) if options.out is None else f"written to {options.out}"
    emit({"table": table.to_dict("list"), "out": options.out}, text, options.json)
