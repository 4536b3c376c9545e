"""The command ``modes``: small motions of a settled bed, without time stepping."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Annotated

from granular.commands.console import command, print_result
from granular.commands.options import OutputOptions, SceneChangeOptions
from granular.commands.signature import Fraction, Option
from granular.shared.blocks import Printout, Text
from granular.shared.files import make_directory


@command("""\
examples:
  %(prog)s damper
  %(prog)s damper --set piston.mass=6.5 -o out/modes
  %(prog)s damper --friction 0.02
  %(prog)s runs/bed --json

A scene is run until the bed first comes to rest; for a run the last frame is used. The piston
must be free.""")
def modes(
    source: Annotated[str, Option("scene, which is settled first, or directory of a run", "SCENE|RUN")],
    *,
    changes: SceneChangeOptions,
    friction: Annotated[
        Fraction | None,
        Option(
            "static friction coefficient of the grains on the plates (the dynamic coefficient is 3/4 of it); "
            "default: the scene's",
            "MU",
        ),
    ] = None,
    out: Annotated[
        str | None, Option("directory for report.html: modes on the bed, curves, slopes", "DIR", "-o")
    ] = None,
    beds: Annotated[
        int | None,
        Option("give derivatives with respect to parameters as mean ± standard deviation over N beds", "N"),
    ] = None,
    output: OutputOptions,
) -> None:
    """Compute a bed's equilibrium, complex eigenvalues, modes, and derivatives with respect to parameters."""
    from granular.linear.bed_forces import check_free_piston
    from granular.linear.equilibrium import equilibrium_from, settled_scene_positions_and_heights
    from granular.linear.friction import has_friction, motion_friction
    from granular.linear.page import modes_page
    from granular.linear.small_motions import small_motions
    from granular.run.trajectory import Trajectory, load_trajectory
    from granular.studies.bed_slopes import settled_beds, slopes_over_beds

    loaded = changes.load_scene_or_run(source)
    from_run = isinstance(loaded, Path)
    bed = load_trajectory(loaded) if isinstance(loaded, Path) else loaded
    scene = bed.scene if isinstance(bed, Trajectory) else bed
    check_free_piston(scene)
    started, over = time.perf_counter(), None
    if beds is not None:
        over = slopes_over_beds(scene, beds, progress=output.shows_progress)
    reuse = over is not None and not from_run
    state = settled_beds(scene, 1, progress=False)[0] if reuse else settled_scene_positions_and_heights(bed)
    began = time.perf_counter()
    motions = small_motions(equilibrium_from(*state))
    rubs = has_friction(scene) or friction is not None
    rubbing = motion_friction(motions.rest, friction, motions.roots[0]) if rubs else None
    seconds = time.perf_counter() - began
    parts = {"friction": rubbing, "over_beds": over}
    plain = motions.to_plain() | {key: part.to_plain() for key, part in parts.items() if part is not None}
    if over is not None:
        motions = dataclasses.replace(motions, slopes=over.mean, deviation=over.deviation)
    took = f"computed in {seconds:.1f} s"
    if not from_run:
        took += f", after {began - started:.1f} s for a run of the scene to rest"
    blocks = [*motions.blocks(), *([] if rubbing is None else [Printout(str(rubbing))]), Text(took)]
    if out is not None:
        make_directory(Path(out))
        modes_page(motions).save(Path(out) / "report.html")
        blocks.append(Text(f"report: {out}/report.html"))
    figures = {"seconds": seconds, "settling_seconds": began - started, "out": out}
    print_result(plain | figures, blocks, output.json)
