"""Settled beds from many random packings: the spread of small oscillations over packings.

``python -m research.packings -o FILE`` settles the packaged damper from thirty random packings and writes
`granular.studies.packing_spread.TABLE`. ``--others`` settles other beds from eight packings each and prints
their spread (ten minutes on two cores).
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from granular import load_scene
from granular.commands.console import Parser, print_result, run_command_and_return_exit_code
from granular.commands.options import OutputOptions
from granular.commands.signature import Option, add_options, collect_arguments_from_options
from granular.linear import piston_roots
from granular.linear.equilibrium import equilibrium_from
from granular.shared.array_types import Float
from granular.shared.blocks import format_number
from granular.shared.files import write_text
from granular.studies.bed_slopes import settled_beds
from granular.studies.packing_spread import relative_spread_over_packings

TWO = ((6.0, 0.5), (4.5, 0.5))
THREE = ((6.0, 0.4), (5.0, 0.3), (4.0, 0.3))
"""Diameters [mm] and shares of mixtures."""
HALF = {"grains.count": 184, "cell.width": "30 D", "piston.mass": 3.75}


HEADER = (
    "| bed | z0 [mm] | f0 [Hz] | zeta [%] | spread of z0 [%] | of f0 [%] | of zeta [%] |",
    "| --- | --- | --- | --- | --- | --- | --- |",
)
FIRST_SEED = 1001
"""Seed of the first tabulated packing, so that the packings of a user's run are others."""
PACKINGS, OTHER_PACKINGS = 30, 8
"""Numbers of random packings of the tabulated bed, and of each other bed."""


class Bed(NamedTuple):
    """A bed: the packaged damper with changes."""

    name: str
    changes: Mapping[str, Any] = {}
    species: Sequence[tuple[float, float]] = ()


TABULATED = Bed("damper", {"arrangement.seed": FIRST_SEED})
OTHERS = (
    Bed("half as many, half as wide", HALF),
    Bed("a quarter as many and as wide", {"grains.count": 92, "cell.width": "15 D", "piston.mass": 1.875}),
    Bed("half as high", {"grains.count": 184, "piston.height": "11 D", "arrangement.height": "10 D"}),
    Bed("330 grains, piston of 6.73 kg", {"grains.count": 330, "piston.mass": 6.7255}),
    Bed("drag 0.03 kg/s", {"effects.drag.coefficient": 0.03}),
    Bed("drag 0.125 kg/s", {"effects.drag.coefficient": 0.125}),
    Bed("drag 0.3 kg/s", {"effects.drag.coefficient": 0.3}),
    Bed("piston of 3 kg", {"piston.mass": 3.0}),
    Bed("piston of 6.53 kg", {"piston.mass": 6.525}),
    Bed("piston of 8.63 kg", {"piston.mass": 8.625}),
    Bed("piston of 15 kg", {"piston.mass": 15.0}),
    Bed("two species", species=TWO),
    Bed("two species, half as many, half as wide", HALF, TWO),
    Bed("three species, drag 0.3 kg/s", {"effects.drag.coefficient": 0.3}, THREE),
)


def settled_bed_figures(
    bed: Bed, packings: int, folder: Path | None, progress: bool
) -> Float[np.ndarray, "p 3"]:
    """Equilibrium height [m], frequency [Hz] and damping ratio of a bed from random packings."""
    changes = dict(bed.changes)
    if bed.species:
        changes["grains.species"] = [
            {"name": f"{size:g} mm", "diameter": f"{size} mm", "share": share} for size, share in bed.species
        ]
    scene = load_scene("damper").replace(**changes)
    rows = []
    for state in settled_beds(scene, packings, out=folder, progress=progress):
        rest = equilibrium_from(*state)
        root = piston_roots(rest)[0]
        rows.append([rest.heights[0], root.frequency, root.damping_ratio])
    return np.array(rows)


def table_text(name: str, figures: Float[np.ndarray, "p 3"]) -> str:
    """Text of the table of a packaged scene."""
    rows = [f"  [{', '.join(f'{value:.7g}' for value in row)}]," for row in figures]
    return "\n".join(
        [
            "# Equilibrium height [m], natural frequency [Hz] and damping ratio of packaged scenes, a line",
            "# for each random packing; written by python -m research.packings.",
            f"{name} = [",
            *rows,
            "]\n",
        ]
    )


def spread_text(name: str, figures: Float[np.ndarray, "p 3"]) -> str:
    """Line with the mean and the relative spread of a bed's small oscillations."""
    height, frequency, damping_ratio = figures.mean(axis=0)
    spread = relative_spread_over_packings(figures)
    deviations = (spread.height.deviation, spread.frequency.deviation, spread.damping_ratio.deviation)
    return (
        f"| {name} | {1e3 * height:.2f} | {frequency:.3f} | {100.0 * damping_ratio:.2f} | "
        f"{' | '.join(format_number(100.0 * deviation, 2) for deviation in deviations)} |"
    )


def write_packings(
    *,
    out: Annotated[str | None, Option("file for the table of the packaged damper", "FILE", "-o")] = None,
    others: Annotated[bool, Option("settle other beds, too")] = False,
    beds: Annotated[str | None, Option("directory that keeps the settled beds", "DIR")] = None,
    output: OutputOptions,
) -> None:
    """Settle beds from random packings, print their spread and write the table of packings."""
    folder = None if beds is None else Path(beds)
    figures = {"damper": settled_bed_figures(TABULATED, PACKINGS, folder, output.shows_progress)}
    if out is not None:
        write_text(Path(out), table_text("damper", figures["damper"]))
    for bed in OTHERS if others else ():
        figures[bed.name] = settled_bed_figures(bed, OTHER_PACKINGS, folder, output.shows_progress)
    lines = [spread_text(name, values) for name, values in figures.items()]
    plain = {name: values.tolist() for name, values in figures.items()}
    print_result(plain, "\n".join([*HEADER, *lines]), output.json)


def main(arguments: Sequence[str]) -> None:
    """Write the table by the given arguments."""
    parser = Parser(prog="python -m research.packings", description=write_packings.__doc__)
    add_options(parser, write_packings)
    write_packings(**collect_arguments_from_options(write_packings, parser.parse_args(arguments)))


if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
