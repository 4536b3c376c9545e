"""Command line of the package: ``python -m validation``."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

from granular.commands.console import (
    Command,
    Program,
    command,
    command_registry,
    current_program_and_command,
    print_result,
    refuse_options,
    run_command_and_return_exit_code,
)
from granular.commands.options import OutputOptions, SceneChangeOptions, SceneName
from granular.commands.signature import Fraction, Option, Seconds
from granular.shared.blocks import Text
from granular.shared.errors import InputError

if TYPE_CHECKING:
    from validation.report_tasks import Section

REPORT = "out/validation"
"""Default directory of the report."""

METHOD_REPORT = "out/method"
"""Default directory of the report on user-defined methods."""

EndTime = Annotated[Seconds | None, Option("stop each run at this time [s]", "T")]


@dataclasses.dataclass(frozen=True)
class MeasurementOptions:
    """Options of a measurement: quick or full, and the directory for the results."""

    out: Annotated[
        str | None, Option("directory for the report; results are stored there and reused", "DIR", "-o")
    ] = None
    quick: Annotated[bool, Option("limit the measurements to a few minutes (default)")] = False
    full: Annotated[bool, Option("measure everything, about an hour")] = False

    def __post_init__(self) -> None:
        if self.quick and self.full:
            raise InputError("--quick and --full exclude each other; give only one")

    def print_sections(
        self, sections: Iterable[Section], output: OutputOptions, default: str | None = None
    ) -> None:
        """Measure sections of the report, and print their results."""
        from validation.report import report

        out = self.out or default
        result = report(out, tuple(sections), full=self.full, progress=output.shows_progress)
        _print_report(result, out, output)


@dataclasses.dataclass(frozen=True)
class ReportMeasurementOptions(MeasurementOptions):
    """Options of the complete report: quick or full, and the directory for the results."""

    out: Annotated[
        str | None,
        Option(
            f"directory for the report; results are stored there and reused ({REPORT} if not given)",
            "DIR",
            "-o",
        ),
    ] = None


def _print_report(result: dict[str, Any], out: str | None, output: OutputOptions) -> None:
    from validation.report import console_blocks

    written = [] if out is None else [Text(f"report: {out}/report.html")]
    print_result(result, [*console_blocks(result), *written], output.json)


@command("""\
examples:
  %(prog)s damper --quick                # cost of accuracy and of effects in one scene
  %(prog)s mine.toml bed -o out/mine
  %(prog)s --full -o out/validation      # resumes an interrupted report""")
def report(
    scenes: Annotated[
        tuple[str, ...],
        Option(
            "measure only the cost of accuracy and of effects in these scenes (names or TOML files)", "SCENE"
        ),
    ] = (),
    *,
    overview: Annotated[
        bool,
        Option(
            "measure only the cost of accuracy and of effects in the packaged damper and a compression; "
            "the result is printed, and also written if -o is given"
        ),
    ] = False,
    changes: SceneChangeOptions,
    measuring: ReportMeasurementOptions,
    output: OutputOptions,
) -> None:
    """Measure all sections, and write report.html and report.json."""
    from granular.scene.named_scenes import load_scene
    from validation.overview import OVERVIEW, overview_section_for
    from validation.report import SECTIONS

    changes.import_user_code()
    if changes.changes and not scenes:
        raise InputError(f"--set changes a scene; give one, such as: {current_program_and_command()} damper")
    if overview:
        refuse_options("--overview, which uses packaged scenes", SCENE=scenes)
        measuring.print_sections([OVERVIEW], output)
    elif scenes:
        section = overview_section_for([changes.apply(load_scene(name)) for name in scenes])
        measuring.print_sections([section], output, REPORT)
    else:
        measuring.print_sections(SECTIONS.usable_parts().values(), output, REPORT)


@command(examples="examples:\n  %(prog)s --quick\n  %(prog)s --depaula --quick")
def convergence(
    *,
    depaula: Annotated[
        bool, Option("run only de Paula's test of the integration method, with and without rounding")
    ] = False,
    measuring: MeasurementOptions,
    output: OutputOptions,
) -> None:
    """Measure orders of convergence against exact solutions."""
    from validation.report import SECTIONS

    measuring.print_sections([SECTIONS["depaula" if depaula else "convergence"]], output)


def _section_command(name: str, summary: str) -> Command:
    """Make the command that measures one section of the report."""

    def carry_out(*, measuring: MeasurementOptions, output: OutputOptions) -> None:
        from validation.report import SECTIONS

        measuring.print_sections([SECTIONS[name]], output)

    return Command(summary, "example:\n  %(prog)s --quick", carry_out)


@command("""\
example:
  %(prog)s mclachlan-2 --import mine.py --scene bed.toml --quantity energy

mine.py:
  from granular import Method
  z = 0.1931833275037836
  method = Method("mclachlan-2", 2, kicks=(0, 0.5, 0.5, 0), drifts=(z, 1 - 2*z, z))""")
def method(
    names: Annotated[tuple[str, ...], Option("name of a method, user-defined or built-in", "NAME")],
    *,
    scene: Annotated[str | None, Option("scene for errors against wall time: a name or a TOML file")] = None,
    changes: SceneChangeOptions,
    quantities: Annotated[
        tuple[str, ...],
        Option("quantity whose error is measured, such as energy (can be repeated)", "Q", name="--quantity"),
    ] = (),
    t_end: EndTime = None,
    out: Annotated[
        str, Option(f"directory for the report ({METHOD_REPORT} if not given)", "DIR", "-o")
    ] = METHOD_REPORT,
    output: OutputOptions,
) -> None:
    """Test user-defined methods: order, energy, and error against wall time."""
    from validation.report import method_report

    changes.import_user_code()
    if scene is None and changes.changes:
        raise InputError("--set changes a scene; give one by --scene")
    result = method_report(
        out,
        names,
        scene=None if scene is None else changes.load(scene),
        quantities=quantities or None,
        until=t_end,
        progress=output.shows_progress,
    )
    _print_report(result, out, output)


@command("example:\n  %(prog)s damper 'rest height' 0.01")
def cheapest(
    scene: SceneName,
    quantity: Annotated[str, Option("such as energy, positions, 'rest height', period")],
    tolerance: Annotated[Fraction, Option("allowed error, such as 0.01 or '1 %%'")],
    *,
    changes: SceneChangeOptions,
    t_end: EndTime = None,
    output: OutputOptions,
) -> None:
    """Find the setting that reaches a tolerance in the shortest time."""
    from validation.recommendation import recommend_settings

    loaded = changes.load(scene)
    result = recommend_settings(loaded, quantity, tolerance, until=t_end, progress=output.shows_progress)
    print_result(result.to_plain(), str(result), output.json)


PROGRAM = Program(
    "python -m validation",
    "Check the toolkit's numbers.",
    """\
reliability of the numbers, and cost of accuracy:
  %(prog)s report
  %(prog)s cheapest damper "rest height" 0.01""",
    command_registry(
        "validation.commands",
        {
            "report": report,
            "convergence": convergence,
            "energy": _section_command("energy", "energy over long runs, tested for trends"),
            "work-precision": _section_command("work-precision", "error against wall time"),
            "stability": _section_command("stability", "the catalogue of hard cases"),
            "method": method,
            "cheapest": cheapest,
        },
    ),
)
parser, main = PROGRAM.parser, PROGRAM.main

if __name__ == "__main__":
    sys.exit(run_command_and_return_exit_code(main))
