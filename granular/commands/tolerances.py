"""The command ``tolerances``: standard deviations of a damper's properties from tolerances of its parts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from granular.commands.console import command, print_result
from granular.commands.options import OutputOptions, SceneChangeOptions, SceneName, ToleranceOptions
from granular.commands.signature import Metres, Option
from granular.shared.blocks import Text
from granular.shared.files import make_directory


@command("""\
examples:
  %(prog)s damper --usual
  %(prog)s damper --part grains.remanence=2.5%% --part cell.width="0.2 mm" --draws 200
  %(prog)s my-damper.toml --usual --part "grains.temperature=5 K" -o out/tolerances

A tolerance is a standard deviation; for a uniform distribution between limits ± a it is a/1.73.""")
def tolerances(
    scene: SceneName,
    *,
    changes: SceneChangeOptions,
    parts: ToleranceOptions,
    amplitude: Annotated[
        Metres | None,
        Option(
            "amplitude of the motion for which the damping ratio includes the scene's dry friction; "
            "default: a small motion without friction",
            "A",
        ),
    ] = None,
    beds: Annotated[int, Option("number of settled beds to average over (default: 4)", "N")] = 4,
    draws: Annotated[
        int | None,
        Option(
            (
                "number of dampers with all parts drawn randomly (default: 200 if slopes do not suffice, "
                "otherwise none)"
            ),
            "N",
        ),
    ] = None,
    seed: Annotated[int, Option("seed of the random numbers (default: 0)")] = 0,
    out: Annotated[
        str | None, Option("directory for report.html: the table, and a bar chart of all parts", "DIR", "-o")
    ] = None,
    output: OutputOptions,
) -> None:
    """Compute the effect of tolerances of a damper's parts on equilibrium, frequency and damping."""
    from granular.studies.study_page import tolerances_page
    from granular.studies.tolerances import tolerances as find_tolerances

    loaded = changes.load(scene)
    result = find_tolerances(
        loaded,
        parts.tolerances_by_key(loaded),
        beds,
        amplitude=amplitude,
        draws=draws,
        seed=seed,
        progress=output.shows_progress,
    )
    blocks = result.blocks()
    if out is not None:
        make_directory(Path(out))
        tolerances_page(result, loaded).save(Path(out) / "report.html")
        blocks.append(Text(f"report: {out}/report.html"))
    print_result(result.to_plain() | {"out": out}, blocks, output.json)
