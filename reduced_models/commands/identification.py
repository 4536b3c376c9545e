"""The commands ``identify``, ``fit``, ``discover`` and ``compare``: from records to laws."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granular.commands.console import (
    command,
    option,
    pick_options,
    print_result,
    refuse_options,
    require_options,
)
from granular.commands.options import (
    CHANGES,
    IMPORT,
    METHOD,
    OUTPUT,
    PARTS,
    THREADS,
    parse_changes,
    parse_time_step,
    parts_from_options,
    quantity_reader,
)
from granular.shared.errors import InputError
from granular.shared.files import write_text
from granular.shared.message_text import quote
from reduced_models.commands.records import (
    A_SOURCE,
    READING,
    SOURCES,
    leave_cautions_to_print_out,
    load_records,
    parse_reading_options,
    print_result_and_report_path,
    repeated_option,
)

if TYPE_CHECKING:
    from granular.run.piston_record import PistonRecord
    from reduced_models.fitting.parameter import Parameter

LAWS = repeated_option(
    "--law",
    dest="laws",
    metavar="LAW",
    help="law to fit: a name, 'all', or an equation such as \"z'' + 2*lam*z' + k*z = g0\" "
    "(repeatable); if not given, all that a quick first fit does not rule out",
)

INPUT = option(
    "--input",
    dest="drive",
    metavar="COLUMN",
    help="column of the records that drives the motion: all laws have it as their input",
)
TEST_FRACTION = option(
    "--test-fraction",
    type=quantity_reader("1"),
    default=0.3,
    metavar="S",
    help="fraction of the swings that judge the laws, by fits without them: 0.3 (default) or '30 %%'",
)
BUDGET = option(
    "--budget",
    type=quantity_reader("s"),
    default=300.0,
    metavar="T",
    help="processor time for fits and discovery [s]; what comes later is left out, and said (300)",
)
STARTS = option("--starts", type=int, default=16, help="how many starting points each fit tries (16)")


@command(
    "identify",
    "simulate or read a motion, compare laws, and write a report",
    option("source", metavar="SOURCE", help=A_SOURCE),
    CHANGES,
    PARTS,
    option("-o", "--out", metavar="DIR", help="directory for report, models and run"),
    LAWS,
    option(
        "--discover",
        metavar="METHOD",
        help="also search for a law of unknown form, by sindy, pysindy, operon or pysr",
    ),
    INPUT,
    option(
        "--mass", metavar="M", help="mass of what moves [kg], for stiffness and damping (a scene has its own)"
    ),
    STARTS,
    BUDGET,
    option("--no-checks", action="store_true", help="skip the runs that show step error and scatter"),
    option(
        "--dt",
        help="time step [s], 'auto', or a multiple such as auto/2; if not given, the longest step "
        "and the fastest sum over pairs whose errors random starts hide",
    ),
    METHOD,
    IMPORT,
    THREADS,
    READING,
    option("--verbose", action="store_true", help="print all of the result, not its main lines"),
    OUTPUT,
    examples="""\
examples:
  %(prog)s damper -o out
  %(prog)s lab.csv --mass 7.5 -o out
  %(prog)s lab.csv --law all -o out
  %(prog)s lab.csv --law linear --law "z'' + c*z' + k*(z - r)**3 = 0\"""",
)
def identify(options: Any) -> None:
    """Identify a scene, a run or a CSV file."""
    from granular.run.piston_record import PistonRecord
    from granular.schema.units import si_value
    from granular.shared.progress_bars import print_above_bar
    from granular.user_code import import_user_code
    from reduced_models.identification.identify import identify as identify_source
    from reduced_models.identification.options import IdentifyOptions
    from reduced_models.records.sources import open_source

    import_user_code(options.user_files)
    leave_cautions_to_print_out(options)
    source = _planned_source(open_source(options.source, parse_reading_options(options)), options)
    parts = None
    if options.parts or options.usual:
        parts = parts_from_options(options, getattr(source, "scene", None))
    records = [source] if isinstance(source, PistonRecord) else []
    result = identify_source(
        source,
        options.out,
        laws=parse_laws(options.laws, records) if options.laws else None,
        discovery=options.discover,
        mass=None if options.mass is None else si_value(options.mass, "kg"),
        options=IdentifyOptions(options.budget, not options.no_checks, parts=parts),
        progress=not options.quiet and (lambda first: print_above_bar(first.line_before_checks)),
        **pick_options(options, "drive", "starts"),
    )
    print_result_and_report_path(result, options, None if options.verbose else result.printout())


def _planned_source(source: Any, options: Any) -> Any:
    """Plan of a scene with the changes and the step of a command; a run or a record as it is."""
    from reduced_models.identification.identify import plan_run
    from reduced_models.records.sources import METHOD as DEFAULT_METHOD

    if hasattr(source, "replace"):
        dt = None if options.dt is None else parse_time_step(options.dt)
        scene = source.replace(**parse_changes(options.changes))
        return plan_run(scene, dt, options.method, options.threads, checks=not options.no_checks)
    given = {**pick_options(options, "dt", "method", "threads"), "set": options.changes}
    for name, value in given.items():
        if value not in (None, [], DEFAULT_METHOD):
            raise InputError(f"--{name} applies to a scene only; this is a run or a record: leave it out")
    return source


@command(
    "fit",
    "fit one law to one record, or to several together",
    SOURCES,
    option("--law", default="linear", metavar="LAW", help="name or equation"),
    option("--laws", action="store_true", help="list the laws that can be fitted by their names"),
    repeated_option("--own", metavar="NAME", help="parameter that each record has for itself (repeatable)"),
    repeated_option(
        "--bound",
        dest="bounds",
        metavar="NAME=LOW:HIGH",
        help="lowest and highest value of a parameter, in SI or as '0.1 m:20 cm' (repeatable)",
    ),
    repeated_option(
        "--fix",
        dest="fixed",
        metavar="NAME=VALUE",
        help="parameter that keeps its value, in SI or as '12 cm' (repeatable)",
    ),
    repeated_option(
        "--start",
        dest="start_values",
        metavar="NAME=VALUE",
        help="value about which a parameter is looked for first, in SI or as '12 cm' (repeatable)",
    ),
    TEST_FRACTION,
    STARTS,
    option(
        "--intervals",
        default="linear",
        metavar="HOW",
        help="linear (default) or profile (right also where parameters are bounded or trade places)",
    ),
    option(
        "--drift",
        action=argparse.BooleanOptionalAction,
        help="let the records' zero drift slowly, or not; by the residuals if not given",
    ),
    option(
        "--measured",
        metavar="SENSOR",
        help="what is compared, where it is not the height: velocity, acceleration, base_force, or "
        "force (along a prescribed height), and gain, offset (a number, LOW:HIGH or free), low_pass, "
        "high_pass (in Hz), damping_ratio, column, absolute behind it; by the file's columns if not given",
    ),
    option("-o", "--out", metavar="FILE", help="model of the first record, as JSON"),
    READING,
    OUTPUT,
    examples="""\
examples:
  %(prog)s --laws
  %(prog)s lab.csv --law duffing -o model.json
  %(prog)s a.csv b.csv --law linear --own g0 --bound lam=0:2
  %(prog)s lab.csv --law duffing --fix lam=0.8 --start "omega=21 rad/s"
  %(prog)s shaken.csv --law "z'' + 2*lam*(z' - base_speed) + k*z = g0"
  %(prog)s acc.csv --law linear --columns acceleration=ax
  %(prog)s slow.csv fast.csv --law bouc-wen --columns stroke=lvdt,force=cell
  %(prog)s geo.csv --law linear --columns velocity=ch1 --scale "velocity=1 m/s/V" \\
      --measured "velocity gain=20:30 high_pass=4.5 damping_ratio=0.6\"""",
)
def fit(options: Any) -> None:
    """Fit a law to the records of some sources, or list the laws of the package."""
    from reduced_models.fitting.fit import fit as fit_law
    from reduced_models.fitting.options import FitOptions
    from reduced_models.laws.catalogue import LAWS
    from reduced_models.laws.force_laws import FORCE_LAWS
    from reduced_models.records.sensor import parse_sensor

    if options.laws:
        text = f"{LAWS!r}\n\nof the force on a prescribed stroke (--measured force):\n{FORCE_LAWS!r}"
        print_result({**LAWS.descriptions(), "force": FORCE_LAWS.descriptions()}, text, options.json)
        return
    require_options(options, sources="SOURCE")
    leave_cautions_to_print_out(options)
    models = fit_law(
        load_records(options.sources, options),
        options.law,
        parameters=parse_parameters(**pick_options(options, "bounds", "own", "fixed", "start_values")),
        options=FitOptions(
            drift=options.drift, measured=None if options.measured is None else parse_sensor(options.measured)
        ),
        **pick_options(options, "intervals", "starts", "test_fraction"),
    )
    text = "\n\n".join(map(str, models))
    if options.out is not None:
        models[0].save(options.out)
        text += f"\nmodel: {options.out}"
    print_result({"models": [model.to_plain() for model in models]}, text, options.json)


def parse_parameters(
    bounds: Sequence[str], own: Sequence[str], fixed: Sequence[str] = (), start_values: Sequence[str] = ()
) -> dict[str, Parameter]:
    """Read limits ``NAME=LOW:HIGH``, names that each record has for itself, and values ``NAME=VALUE``."""
    from reduced_models.fitting.parameter import Parameter

    parameters: dict[str, Parameter] = {}

    def add(name: str, **known: Any) -> None:
        name = name.strip()
        parameters[name] = dataclasses.replace(parameters.get(name, Parameter()), **known)

    for item in bounds:
        name, _, pair = item.partition("=")
        low, colon, high = pair.partition(":")
        if not colon:
            raise InputError(f"--bound {quote(item)} is not NAME=LOW:HIGH; write lam=0:2")
        add(name, low=low.strip() or None, high=high.strip() or None)
    for name in own:
        add(name, per_record=True)
    for word, items in (("--start", start_values), ("--fix", fixed)):
        for item in items:
            name, _, value = item.partition("=")
            if not value.strip():
                raise InputError(f"{word} {quote(item)} is not NAME=VALUE; write lam=0.5")
            add(name, value=value.strip(), fixed=word == "--fix")
    return parameters


@command(
    "discover",
    "find the structure of the law in a record, or in several",
    SOURCES,
    option(
        "--method", default="auto", help="auto (sindy and operon side by side), sindy, pysindy, operon, pysr"
    ),
    repeated_option(
        "--library",
        metavar="NAME",
        help="terms to choose from: auto (default: those that the record speaks for), physical, "
        "polynomial, trigonometric, rational, dry friction, contact, driven (repeatable); "
        "memory: with a hidden state, for beds that yield or relax",
    ),
    repeated_option(
        "--terms",
        metavar="TERM",
        help="a term of your own in z, z', the input and the time t, as 'sin(z)' or 'sin(w*t)' (repeatable)",
    ),
    repeated_option(
        "--functions",
        metavar="NAME",
        help="what symbolic regression may use next to sums and products: sin, exp, max, / (repeatable)",
    ),
    option("--degree", type=int, default=3, help="of the physical library's powers of z"),
    INPUT,
    option(
        "--target",
        default="acceleration",
        help="acceleration (default); height for a formula of the time; force, along a prescribed stroke",
    ),
    option(
        "--height",
        metavar="LINE",
        default="auto",
        help="height as a straight line in z [m], as '0.06 + 0.01*z'; by default chosen by the record",
    ),
    option(
        "--effort",
        type=quantity_reader("1"),
        default=1.0,
        metavar="X",
        help="times the usual length of a symbolic regression",
    ),
    option("--seed", type=int, default=0, help="of random searches"),
    option("-o", "--out", metavar="FILE", help="the chosen model, as JSON"),
    READING,
    OUTPUT,
    examples="""\
examples:
  %(prog)s lab.csv -o model.json
  %(prog)s pendulum.csv --library trigonometric --terms "z'**3"
  %(prog)s lab.csv --method operon --functions sin --effort 2 --seed 1 --json""",
)
def discover(options: Any) -> None:
    """Discover a law in the records of some sources."""
    from reduced_models.discovery.discover import discover as discover_law
    from reduced_models.discovery.options import DiscoveryOptions
    from reduced_models.discovery.term_libraries import AUTO

    require_options(options, sources="SOURCE")
    leave_cautions_to_print_out(options)
    records = load_records(options.sources, options)
    result = discover_law(
        records[0] if len(records) == 1 else records,
        library=options.library or AUTO,
        input=options.drive,
        options=DiscoveryOptions(
            progress=not options.quiet, **pick_options(options, "functions", "effort", "height")
        ),
        **pick_options(options, "method", "degree", "terms", "target", "seed"),
    )
    text, model = str(result), result.best.model
    if options.out is not None and model is not None:
        model.save(options.out)
        text += f"\nmodel: {options.out}"
    plain = {
        **result.to_plain(),
        "method_asked_for": options.method,
        "model": None if model is None else model.to_plain(),
    }
    print_result(plain, text, options.json)
    if options.out is not None and model is None:
        why = result.best.note or "the choice was not polished; see the other candidates"
        raise InputError(f"no model was written to {options.out}: {why}")


@command(
    "compare",
    "judge laws by their test errors",
    SOURCES,
    LAWS,
    repeated_option("--test-records", metavar="SOURCE", help="record that no fit sees (repeatable)"),
    TEST_FRACTION,
    STARTS,
    BUDGET,
    option("-o", "--out", metavar="DIR", help="directory for report and models"),
    option(
        "--response",
        metavar="DIR",
        help="in place of records, set the law of the bed next to a machine's simulated response, "
        "which 'response -o DIR' wrote; its report.html is renewed",
    ),
    READING,
    OUTPUT,
    examples="""\
examples:
  %(prog)s a.csv b.csv --law all --test-records c.csv -o out
  %(prog)s --response out/machine        # after 'response machine ... -o out/machine'""",
)
def compare(options: Any) -> None:
    """Compare laws on the records of some sources, or the bed's law with a response."""
    if options.response is None:
        require_options(options, sources="SOURCE")
        _compare_laws(options)
    else:
        written = {"sources": "SOURCE", "laws": "--law", "test_records": "--test-records"}
        refuse_options(options, "--response", "out", **written)
        _compare_response(options)


def _compare_laws(options: Any) -> None:
    from reduced_models.fitting.levenberg_marquardt import spent_budget_text, time_budget
    from reduced_models.identification.candidate_laws import CANDIDATES
    from reduced_models.identification.comparison import compare as compare_laws
    from reduced_models.identification.options import check_budget
    from reduced_models.records.sources import make_directory

    check_budget(options.budget)
    target = make_directory(options.out)
    leave_cautions_to_print_out(options)
    records, further = (load_records(paths, options) for paths in (options.sources, options.test_records))
    default = ("all",) if _are_of_force(records) else CANDIDATES
    laws = parse_laws(options.laws or default, records)
    with time_budget(options.budget, spent_budget_text(options.budget)):
        table = compare_laws(records, laws, options.test_fraction, further, starts=options.starts)
    text = str(table)
    if target is not None:
        from reduced_models.identification.page import comparison_page

        comparison_page(table).save(target / "report.html")
        table.best.save(target / "model.json")
        write_text(target / "equations.txt", table.best.text)
        text += f"\nreport: {target}/report.html"
    print_result(table.to_plain(), text, options.json)


def _compare_response(options: Any) -> None:
    """Solve the law, say how far off it is, and write the report."""
    from granular.response import load_response
    from reduced_models.machines.response_comparison import response_page_with_law

    response = load_response(options.response)
    page, law, why = response_page_with_law(response)
    path = Path(options.response) / "report.html"
    page.save(path)
    peaks = () if law is None else law.peaks
    rows = [
        dataclasses.asdict(peak)
        | {"error": peak.law_peak_error, "linear_error": peak.small_swing_peak_error}
        | {"outside": peak.outside or None}
        for peak in peaks
    ]
    lines = [response.table, why] if law is None else [law.peak_table]
    lines += [f"warning: under {peak.force:g} N {peak.outside}" for peak in peaks if peak.outside]
    print_result(
        {"peaks": rows, "missing": why or None, "report": str(path)},
        "\n".join([*lines, f"written to {path}"]),
        options.json,
    )


def parse_laws(names: Sequence[str], records: Sequence[PistonRecord] = ()) -> tuple[str, ...]:
    """Names of the laws to fit, each once; "all" stands for those of the package for such records."""
    from reduced_models.identification.candidate_laws import candidate_force_laws
    from reduced_models.laws.catalogue import LAWS

    package = [law.name for law in candidate_force_laws(records)] if _are_of_force(records) else list(LAWS)
    every = (package if name == "all" else [name] for name in names)
    return tuple(dict.fromkeys(law for some in every for law in some))


def _are_of_force(records: Sequence[PistonRecord]) -> bool:
    """Return whether records are of a force along a prescribed stroke."""
    return bool(records) and records[0].measured == "force"
