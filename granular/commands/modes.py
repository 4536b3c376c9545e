"""The command ``modes``: small motions of a settled bed, without a time step."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

from granular.commands.console import command, option, print_result
from granular.commands.options import CHANGES, IMPORT, OUTPUT, quantity_reader, scene_or_run_from_options
from granular.shared.files import make_directory


@command(
    "modes",
    "equilibrium, roots, modes and slopes of a bed, without a time step",
    option("source", metavar="SCENE|RUN", help="scene, which is settled first, or directory of a run"),
    CHANGES,
    option(
        "--friction",
        type=quantity_reader("1"),
        metavar="MU",
        help="static coefficient of the grains on the plates, with a dynamic one of 3/4 of it; the scene's "
        "without",
    ),
    option("-o", "--out", metavar="DIR", help="directory for report.html: modes on the bed, curves, slopes"),
    option("--beds", type=int, metavar="N", help="means of the slopes over N settled beds, ± deviation"),
    IMPORT,
    OUTPUT,
    examples="""\
examples:
  %(prog)s damper
  %(prog)s damper --set piston.mass=6.5 -o out/modes
  %(prog)s damper --friction 0.02
  %(prog)s runs/bed --json

A scene is run up to its first rest; of a run, the last frame is taken. Both need a free piston.""",
)
def modes(options: Any) -> None:
    """Print small motions of a scene's or run's bed, and write a page of them."""
    from granular.linear.bed_forces import check_free_piston
    from granular.linear.equilibrium import equilibrium_from, settled_state
    from granular.linear.friction import motion_friction, names_friction
    from granular.linear.page import modes_page
    from granular.linear.small_motions import small_motions
    from granular.run.trajectory import Trajectory, load_trajectory
    from granular.studies.bed_slopes import settled_beds, slopes_over_beds

    source = scene_or_run_from_options(options, options.source)
    at_run = isinstance(source, Path)
    bed = load_trajectory(source) if isinstance(source, Path) else source
    scene = bed.scene if isinstance(bed, Trajectory) else bed
    check_free_piston(scene)
    started, over = time.perf_counter(), None
    if options.beds is not None:
        over = slopes_over_beds(scene, options.beds, progress=not options.quiet)
    reuse = over is not None and not at_run
    state = settled_beds(scene, 1, progress=False)[0] if reuse else settled_state(bed)
    began = time.perf_counter()
    motions = small_motions(equilibrium_from(*state))
    rubs = names_friction(scene) or options.friction is not None
    friction = motion_friction(motions.rest, options.friction, motions.roots[0]) if rubs else None
    seconds = time.perf_counter() - began
    parts = {"friction": friction, "over_beds": over}
    plain = motions.to_plain() | {key: part.to_plain() for key, part in parts.items() if part is not None}
    if over is not None:
        motions = dataclasses.replace(motions, slopes=over.mean, deviation=over.deviation)
    lines = [str(motions), *([] if friction is None else [str(friction)]), f"computed in {seconds:.1f} s"]
    if not at_run:
        lines[-1] += f", after {began - started:.1f} s for a run of the scene to rest"
    if options.out is not None:
        make_directory(Path(options.out))
        modes_page(motions).save(Path(options.out) / "report.html")
        lines.append(f"report: {options.out}/report.html")
    figures = {"seconds": seconds, "settling_seconds": began - started, "out": options.out}
    print_result(plain | figures, "\n".join(lines), options.json)
