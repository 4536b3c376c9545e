"""The command ``silo``: flow rates of magnets through openings, and the fitted law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from granular.commands.console import command, option, print_result
from granular.commands.options import CHANGES, IMPORT, OUTPUT, SCENE, quantity_reader, scene_from_options
from granular.shared.files import make_directory


@command(
    "silo",
    "flow of magnets out of a silo, through several openings",
    SCENE,
    CHANGES,
    option(
        "--opening",
        action="append",
        type=quantity_reader("m"),
        metavar="B",
        help="width of the opening, such as '48 mm'; may be given several times (2, 3, 4, 6, 8, 10, 12 D)",
    ),
    option("--starts", type=int, default=3, metavar="N", help="random starts (3)"),
    option("-o", "--out", metavar="DIR", help="directory for silo.png: the rates and the law"),
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s silo
  %(prog)s silo --opening '48 mm' --opening '60 mm' --opening '72 mm' --starts 2 -o out/silo""",
)
def silo(options: Any) -> None:
    """Print flow rates, their scatter and the law."""
    from granular.render import save_picture
    from granular.shared.plotting import figure
    from granular.studies.silo import silo as measure

    scene = scene_from_options(options)
    diameter = scene.grains.species[0].diameter
    openings = options.opening or [k * diameter for k in (2, 3, 4, 6, 8, 10, 12)]
    result = measure(scene, openings, options.starts, progress=not options.quiet)
    if options.out is not None:
        make_directory(Path(options.out))
        with figure(width=5.5) as (drawing, axes):
            result.plot(axes)
            save_picture(drawing, Path(options.out) / "silo.png", overwrite=True)
    print_result(result.to_plain() | {"out": options.out}, str(result), options.json)
