"""The command ``look``: what was understood of a record's file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from granular.commands.console import add_output, emit
from granular.readers.description import is_description, read_description, write_description
from granular.readers.reading import Reading
from reduced_models.reading_options import add_reading, reading_from

EXAMPLES = """\
examples:
  %(prog)s lab.csv
  %(prog)s lab.csv --columns time=t,height=dist --units height=mm --flip --between 0.5:6
  %(prog)s lab.csv --decimal , --skip 12 --write record.toml    # then: identify record.toml"""


def add_look(one: argparse.ArgumentParser) -> None:
    """The command's grammar."""
    one.add_argument("file", metavar="FILE", help="a record as an instrument wrote it")
    one.add_argument("--plot", metavar="FILE", help="draw the motion to this file (.png, .svg)")
    one.add_argument(
        "--write", metavar="FILE",
        help="write what was understood to this TOML file, which every command takes as a record",
    )  # fmt: skip
    add_reading(one)
    add_output(one)


def run_look(options: Any) -> None:
    """Show what was understood, and keep it if asked."""
    from reduced_models.records.look import look, plot_look

    said, path = reading_from(options), Path(options.file)
    found = look(path, said)
    if options.plot is not None:
        from granular.render import save

        save(plot_look(found), options.plot, overwrite=True)
    if options.write is not None:
        if is_description(path):
            path, described = read_description(path)
            said = described.and_then(said)
        columns = {role: name for role, name in found.meaning.source.items() if name}
        understood = Reading(columns=columns, units=found.meaning.units)
        write_description(Path(options.write), path, understood.and_then(said))
    text = str(found)
    if options.write is not None:
        text += f"\nwritten to {options.write}"
    emit(found.to_plain() | {"description": options.write}, text, options.json)
