"""The command ``silo``: flow rates of magnets through openings, and the fitted law."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from granular.commands.console import command, print_result
from granular.commands.options import OutputOptions, SceneChangeOptions, SceneName
from granular.commands.signature import Metres, Option
from granular.shared.files import make_directory


@command("""\
examples:
  %(prog)s silo
  %(prog)s silo --opening '48 mm' --opening '60 mm' --opening '72 mm' --starts 2 -o out/silo""")
def silo(
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    openings: Annotated[
        tuple[Metres, ...],
        Option(
            "width of the opening, such as '48 mm' (repeatable; default: 2, 3, 4, 6, 8, 10 and 12 diameters)",
            "B",
            name="--opening",
        ),
    ] = (),
    starts: Annotated[int, Option("number of random packings (default: 3)", "N")] = 3,
    out: Annotated[str | None, Option("directory for silo.png: the rates and the law", "DIR", "-o")] = None,
    output: OutputOptions,
) -> None:
    """Measure the flow of magnets out of a silo, through openings of several widths."""
    from granular.render import save_picture
    from granular.shared.plotting import figure
    from granular.studies.silo import silo as measure

    loaded = changes.load(scene)
    diameter = loaded.grains.species[0].diameter
    widths = openings or [k * diameter for k in (2, 3, 4, 6, 8, 10, 12)]
    result = measure(loaded, widths, starts, progress=output.shows_progress)
    if out is not None:
        make_directory(Path(out))
        with figure(width=5.5) as (drawing, axes):
            result.plot(axes)
            save_picture(drawing, Path(out) / "silo.png", overwrite=True)
    print_result(result.to_plain() | {"out": out}, result.blocks(), output.json)
