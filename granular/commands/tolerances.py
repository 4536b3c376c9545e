"""The command ``tolerances``: standard deviations of a damper's figures by those of its parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from granular.commands.console import command, option, print_result
from granular.commands.options import (
    CHANGES,
    IMPORT,
    OUTPUT,
    PARTS,
    SCENE,
    parts_from_options,
    quantity_reader,
    scene_from_options,
)
from granular.shared.files import make_directory


@command(
    "tolerances",
    "equilibrium, frequency and damping of a damper by the tolerances of its parts",
    SCENE,
    CHANGES,
    PARTS,
    option(
        "--amplitude",
        type=quantity_reader("m"),
        metavar="A",
        help="amplitude at which the scene's dry friction adds to the damping ratio; small motions without "
        "friction if not given",
    ),
    option("--beds", type=int, default=4, metavar="N", help="settled beds to average over (4)"),
    option(
        "--draws",
        type=int,
        metavar="N",
        help="dampers with all parts drawn at once (200 if slopes alone are not enough, else none)",
    ),
    option("--seed", type=int, default=0, help="of the drawn numbers (0)"),
    option("-o", "--out", metavar="DIR", help="directory for report.html: the table, and bars of all parts"),
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s damper --usual
  %(prog)s damper --part grains.remanence=2.5%% --part cell.width="0.2 mm" --draws 200
  %(prog)s my-damper.toml --usual --part "grains.temperature=5 K" -o out/tolerances

A tolerance is a standard deviation: of limits ± a between which nothing is known, a/1.73.""",
)
def tolerances(options: Any) -> None:
    """Print slopes, contributions and totals of a scene's parts."""
    from granular.studies.tolerance_page import tolerances_page
    from granular.studies.tolerances import tolerances as find_tolerances

    scene = scene_from_options(options)
    result = find_tolerances(
        scene,
        parts_from_options(options, scene),
        options.beds,
        amplitude=options.amplitude,
        draws=options.draws,
        seed=options.seed,
        progress=not options.quiet,
    )
    text = str(result)
    if options.out is not None:
        make_directory(Path(options.out))
        tolerances_page(result, scene).save(Path(options.out) / "report.html")
        text += f"\nreport: {options.out}/report.html"
    print_result(result.to_plain() | {"out": options.out}, text, options.json)
