"""Command line of the identification: ``python -m reduced_models``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from granular.commands.console import (
    Parser,
    add_output,
    add_run,
    add_scene,
    command_parser,
    in_unit,
    launch,
)
from reduced_models.look_command import EXAMPLES as LOOK_EXAMPLES
from reduced_models.look_command import add_look, run_look
from reduced_models.reading_options import add_reading
from reduced_models.response_command import EXAMPLES as RESPONSE_EXAMPLES
from reduced_models.response_command import WHAT as RESPONSE_WHAT
from reduced_models.response_command import add_response_law, run_response_law

PROG = "python -m reduced_models"

EXAMPLES = {
    "": """\
from a lab record to its equation, judged on what it has not seen:
  %(prog)s identify lab.csv -o out
  %(prog)s compare lift-1.csv lift-2.csv --law all --held-out lift-3.csv
  %(prog)s simulate out/model.json --until 3 -o motion.csv""",
    "identify": """\
examples:
  %(prog)s damper -o out
  %(prog)s lab.csv --mass 7.5 -o out
  %(prog)s lab.csv --law all -o out
  %(prog)s lab.csv --law linear --law "z'' + c*z' + k*(z - r)**3 = 0\"""",
    "fit": """\
examples:
  %(prog)s lab.csv --law duffing -o model.json
  %(prog)s a.csv b.csv --law linear --own g0 --bound lam=0:2
  %(prog)s shaken.csv --law "z'' + 2*lam*(z' - base_speed) + k*z = g0\"""",
    "discover": """\
examples:
  %(prog)s lab.csv -o model.json
  %(prog)s pendulum.csv --library trigonometric --terms "z'**3"
  %(prog)s lab.csv --method operon --functions sin --effort 2 --seed 1 --json""",
    "compare": """\
example:
  %(prog)s a.csv b.csv --law all --held-out c.csv -o out""",
    "calibrate": """\
examples:
  %(prog)s lab.csv damper -o out
  %(prog)s lab.csv my-damper.toml --parameter piston.mass
  %(prog)s forced.csv damper --parameter piston.mass \\
      --parameter effects.drag.coefficient --parameter grains.remanence -o out""",
    "design": """\
examples:
  %(prog)s --frequency 3.2 --damping 0.1 -o out
  %(prog)s --frequency 4 --damping 0.05 --mass 5 -o out""",
    "fall": """\
examples:
  %(prog)s damper --height '144 mm'
  %(prog)s damper --set piston.mass=10 --set 'effects.drag.coefficient=0.2 kg/s'""",
    "laws": """\
example:
  %(prog)s""",
    "look": LOOK_EXAMPLES,
    "response-law": RESPONSE_EXAMPLES,
    "maps": """\
examples:
  %(prog)s -o out              # those that come with the package
  %(prog)s --simulate -o out   # the study behind them, anew""",
    "export-model": """\
examples:
  %(prog)s out/model.json -o damper.c
  %(prog)s out/model.json -o damper_model.m      # MATLAB and Octave
  %(prog)s out/model.json -o damper.fmu          # Simulink, Dymola, FMPy, ...""",
    "simulate": """\
examples:
  %(prog)s model.json --until 3 -o motion.csv
  %(prog)s model.json --until 3 --height "60 mm" --velocity 0""",
}
_SOURCE = "a scene (name or TOML file), a run directory, or a record as an instrument wrote it"
_LAW = (
    "law to fit: a name, 'all', or an equation such as \"z'' + 2*lam*z' + k*z = g0\" (repeatable); "
    "if not given, all that a quick first fit does not rule out"
)


def parser(prog: str = PROG) -> Parser:
    """The command line's grammar; ``prog`` is what the user types before a command."""
    top, add = command_parser(prog, "From a motion to its equation.", EXAMPLES)
    _add_identify(add("identify", "simulate or read a motion, compare laws, and write a report"))
    add_look(add("look", "show what is understood of a record's file, before anything is fitted"))
    add_output(add("laws", "list the laws that can be fitted by their names"))
    _add_fit(add("fit", "fit one law to one record, or to several at once"))
    _add_discover(add("discover", "find the structure of the law in a record, or in several"))
    _add_compare(add("compare", "judge laws by their hold-out errors"))
    _add_calibrate(add("calibrate", "fit numbers of a scene to a record, by simulations"))
    _add_design(add("design", "choose mass, grains and drag for a wanted frequency and damping"))
    _add_fall(add("fall", "predict a whole fall from the scene alone"))
    add_response_law(add("response-law", RESPONSE_WHAT))
    _add_maps(add("maps", "show frequency and damping over mass, grains, drag and mixture"))
    _add_simulate(add("simulate", "predict a motion by a model that was saved"))
    _add_export(
        add("export-model", "write a saved model as code: Python, C, MATLAB, Modelica, FMU")
    )
    return top


def _add_identify(one: Parser) -> None:
    add_scene(one, "source", _SOURCE)
    one.add_argument("-o", "--out", metavar="DIR", help="directory for report, models and run")
    one.add_argument("--law", dest="laws", action="append", metavar="LAW", help=_LAW)
    one.add_argument("--discover", metavar="METHOD",
        help="also search for a law of unknown form, by sindy, operon or pysr",
    )  # fmt: skip
    one.add_argument(
        "--input", dest="drive", metavar="COLUMN",
        help="column of the record that drives the motion: all laws have it as their input",
    )  # fmt: skip
    one.add_argument(
        "--mass",
        metavar="M",
        help="mass of what moves [kg], for stiffness and damping (a scene has its own)",
    )
    one.add_argument(
        "--starts", type=int, default=16, help="how many starting points each fit tries (16)"
    )
    one.add_argument(
        "--no-checks", action="store_true", help="skip the runs that show step error and scatter"
    )
    add_run(one)
    add_reading(one)
    add_output(one)


def _add_fit(one: Parser) -> None:
    one.add_argument("sources", nargs="+", metavar="SOURCE", help=_SOURCE)
    one.add_argument("--law", default="van-der-pol-like", metavar="LAW", help="name or equation")
    one.add_argument(
        "--own", action="append", default=[], metavar="NAME",
        help="parameter that each record has for itself (repeatable)",
    )  # fmt: skip
    one.add_argument(
        "--bound", dest="bounds", action="append", default=[], metavar="NAME=LOW:HIGH",
        help="least and greatest value of a parameter, in SI or as '0.1 m:20 cm' (repeatable)",
    )  # fmt: skip
    one.add_argument(
        "--holdout", type=in_unit("1"), default=0.3, metavar="S",
        help="share of the record, at its end, that the fit does not see: 0.3 (default) or '30 %%'",
    )  # fmt: skip
    one.add_argument(
        "--starts", type=int, default=16, help="how many starting points the fit tries (16)"
    )
    one.add_argument(
        "--intervals", default="linear", metavar="HOW",
        help="linear (default), bootstrap (resampled records) or profile (right also where "
        "parameters are bounded or trade places)",
    )  # fmt: skip
    one.add_argument("--drift", action="store_true", help="let the records' zero drift slowly")
    one.add_argument("-o", "--out", metavar="FILE", help="model of the first record, as JSON")
    add_reading(one)
    add_output(one)


def _add_discover(one: Parser) -> None:
    one.add_argument("sources", nargs="+", metavar="SOURCE", help=_SOURCE)
    one.add_argument(
        "--method", default="auto", help="auto (sindy and operon side by side), sindy, operon, pysr"
    )
    one.add_argument(
        "--library", action="append", default=[], metavar="NAME",
        help="terms to choose from: auto (default: those that the record speaks for), physical, "
        "polynomial, trigonometric, rational, dry friction, contact, driven (repeatable); "
        "memory: with a hidden state, for beds that yield or relax",
    )  # fmt: skip
    one.add_argument(
        "--terms", action="append", default=[], metavar="TERM",
        help="a term of your own in z, z' and the input, such as 'sin(z)' (repeatable)",
    )  # fmt: skip
    one.add_argument(
        "--functions", action="append", default=[], metavar="NAME",
        help="what symbolic regression may use beside sums and products: sin, exp, max, / "
        "(repeatable)",
    )  # fmt: skip
    one.add_argument("--degree", type=int, default=3, help="of the physical library's powers of z")
    one.add_argument(
        "--form", default="weak", help="of sindy: weak (integrals, default) or strong (derivatives)"
    )
    one.add_argument(
        "--input", dest="drive", metavar="COLUMN",
        help="column of the records that drives the motion",
    )  # fmt: skip
    one.add_argument(
        "--target",
        default="acceleration",
        help="acceleration (default); height for z(t) itself; force, with the library memory",
    )
    one.add_argument(
        "--map", metavar="SHIFT:SCALE",
        help="z = (height - SHIFT)/SCALE, as '60 mm:10 mm'; by itself without",
    )  # fmt: skip
    one.add_argument(
        "--effort", type=in_unit("1"), default=1.0, metavar="X",
        help="times the usual length of a symbolic regression",
    )  # fmt: skip
    one.add_argument("--seed", type=int, default=0, help="of random searches")
    one.add_argument("-o", "--out", metavar="FILE", help="the chosen model, as JSON")
    add_reading(one)
    add_output(one)


def _add_compare(one: Parser) -> None:
    one.add_argument("sources", nargs="+", metavar="SOURCE", help=_SOURCE)
    one.add_argument("--law", dest="laws", action="append", metavar="LAW", help=_LAW)
    one.add_argument(
        "--held-out", action="append", default=[], metavar="SOURCE",
        help="record that no fit sees (repeatable)",
    )  # fmt: skip
    one.add_argument(
        "--holdout", type=in_unit("1"), default=0.3, metavar="S",
        help="share of the record, at its end, that the fit does not see: 0.3 (default) or '30 %%'",
    )  # fmt: skip
    one.add_argument(
        "--starts", type=int, default=16, help="how many starting points each fit tries (16)"
    )
    one.add_argument("-o", "--out", metavar="DIR", help="directory for report and models")
    add_reading(one)
    add_output(one)


def _add_calibrate(one: Parser) -> None:
    one.add_argument(
        "record", metavar="RECORD", help="a record as an instrument wrote it, or a run directory"
    )
    add_scene(one, "scene", "name of a packaged scene, or TOML file: all that is not fitted")
    one.add_argument(
        "--parameter", dest="parameters", action="append", metavar="KEY",
        help="number of the scene to fit, such as piston.mass, effects.drag.coefficient or "
        "grains.remanence; the first two without (repeatable)",
    )  # fmt: skip
    one.add_argument("--seeds", type=int, default=4, help="random starts of the bed")
    one.add_argument(
        "--law", default="polynomial-spring", metavar="LAW",
        help="law whose rest, period and damping are compared: name or equation",
    )  # fmt: skip
    one.add_argument("--no-checks", action="store_true", help="skip the run with half the step")
    one.add_argument(
        "-o", "--out", metavar="DIR",
        help="directory for report, scene and simulations; the same one again goes on",
    )  # fmt: skip
    one.add_argument("--dt", default="auto", help="time step [s], 'auto' or a multiple of it")
    one.add_argument("--method", default="stormer-verlet",
        help="integration method, by name (stormer-verlet); 'granular methods' lists them",
    )  # fmt: skip
    add_reading(one)
    add_output(one)


def _add_design(one: Parser) -> None:
    one.add_argument(
        "--frequency", type=in_unit("Hz"), required=True, metavar="F",
        help="of the undamped small swing about rest [Hz]",
    )  # fmt: skip
    one.add_argument(
        "--damping", type=in_unit("1"), required=True, metavar="R",
        help="damping ratio, as 0.04 or '4 %%'",
    )  # fmt: skip
    one.add_argument(
        "--grains", type=int, metavar="N", help="number of grains; chosen if not given"
    )
    one.add_argument(
        "--mass",
        type=in_unit("kg"),
        metavar="M",
        help="mass of the piston [kg]; chosen if not given",
    )
    one.add_argument(
        "--small-share",
        type=in_unit("1"),
        default=0.0,
        metavar="S",
        help="share of grains of 0.6 D (0)",
    )
    one.add_argument(
        "--maps",
        metavar="FILE",
        help="study.csv that 'maps --simulate' wrote; if not given, the package's own",
    )
    one.add_argument(
        "-o", "--out", metavar="DIR",
        help="directory for report, scene and simulations; the same one again goes on",
    )  # fmt: skip
    one.add_argument("--workers", type=int, metavar="N", help="processes (all processors)")
    add_output(one)


def _add_fall(one: Parser) -> None:
    add_scene(one)
    one.add_argument(
        "--height", type=in_unit("m"), metavar="H", help="of the start [m]; the scene's without"
    )
    add_output(one)


def _add_maps(one: Parser) -> None:
    one.add_argument(
        "-o", "--out", metavar="DIR", required=True,
        help="directory for report.html, sliders.html and study.csv; the same one again goes on",
    )  # fmt: skip
    one.add_argument(
        "--simulate", action="store_true", help="simulate the study anew (about half an hour)"
    )
    one.add_argument(
        "--points", type=int, default=128, metavar="N",
        help="dampers of the study beside sixteen corners, a power of two (128)",
    )  # fmt: skip
    one.add_argument("--workers", type=int, metavar="N", help="processes (all processors)")
    add_output(one)


def _add_simulate(one: Parser) -> None:
    one.add_argument("model", metavar="MODEL", help="JSON file of a model")
    one.add_argument("--until", required=True, metavar="T", help="end of the motion [s]")
    one.add_argument("--samples", type=int, default=1000, help="number of samples")
    one.add_argument("--height", metavar="H", help="at the start [m]; the record's without")
    one.add_argument("--velocity", metavar="V", help="at the start [m/s]; the record's without")
    one.add_argument("-o", "--out", metavar="FILE", help="CSV file")
    add_output(one)


def _add_export(one: Parser) -> None:
    one.add_argument("model", metavar="MODEL", help="JSON file of a model")
    one.add_argument(
        "-o", "--out", metavar="FILE", required=True,
        help="file to write; its ending says the language: .py, .c, .m, .mo or .fmu",
    )  # fmt: skip
    add_output(one)


def main(arguments: Sequence[str], prog: str = PROG) -> None:
    """Run one command."""
    options: Any = parser(prog).parse_args(arguments)
    from reduced_models import commands

    {
        "identify": commands.identify_source,
        "laws": commands.list_laws,
        "look": run_look,
        "fit": commands.fit_sources,
        "discover": commands.discover_source,
        "compare": commands.compare_sources,
        "calibrate": commands.calibrate_scene,
        "design": commands.design_damper,
        "fall": commands.predict_fall,
        "response-law": run_response_law,
        "maps": commands.map_dampers,
        "simulate": commands.simulate_model,
        "export-model": commands.export_model,
    }[options.command](options)


if __name__ == "__main__":
    sys.exit(launch(main))
