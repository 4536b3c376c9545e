"""The commands ``identify``, ``fit``, ``discover`` and ``compare``: from records to laws."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from granular.commands.console import command, given_options, print_result, refuse_options, require_options
from granular.commands.options import (
    MethodName,
    OutputOptions,
    SceneChangeOptions,
    ThreadCount,
    TimeStep,
    ToleranceOptions,
)
from granular.commands.signature import Fraction, Kilograms, Option, Seconds
from granular.shared.errors import InputError, quote
from granular.shared.files import write_text
from reduced_models.commands.forms import FORMS
from reduced_models.commands.records import (
    ReadingOptions,
    Source,
    Sources,
    print_result_and_report_path,
    silence_caution_warnings_of_text_output,
)

if TYPE_CHECKING:
    from granular.records.record import PistonRecord
    from reduced_models.fitting.parameter import Parameter

LawNames = Annotated[
    tuple[str, ...],
    Option(
        "law to fit: a name, 'all', or an equation such as \"z'' + 2*lam*z' + k*z = g0\" (repeatable); by "
        "default all laws that a quick first fit does not exclude",
        "LAW",
        name="--law",
    ),
]
Drive = Annotated[
    str | None,
    Option(
        "column of the records that drives the motion; it becomes an input of all laws",
        "COLUMN",
        name="--input",
    ),
]
TestFraction = Annotated[
    Fraction,
    Option("fraction of the cycles held out for the prediction error: 0.3 (default) or '30 %%'", "S"),
]
Budget = Annotated[
    Seconds,
    Option("processor time for fits and discovery [s]; remaining laws are skipped with a note (300)", "T"),
]
StartCount = Annotated[int, Option("number of random starts of each fit (16)")]


@command("""\
examples:
  %(prog)s damper -o out
  %(prog)s lab.csv --mass 7.5 -o out
  %(prog)s lab.csv --law all -o out
  %(prog)s lab.csv --law linear --law "z'' + c*z' + k*(z - r)**3 = 0\"""")
def identify(
    source: Source,
    *,
    changes: SceneChangeOptions,
    parts: ToleranceOptions,
    out: Annotated[str | None, Option("directory for report, models and run", "DIR", "-o")] = None,
    laws: LawNames = (),
    discover: Annotated[
        str | None,
        Option("also search for a law of unknown form, by sindy, pysindy, operon or pysr", "METHOD"),
    ] = None,
    drive: Drive = None,
    mass: Annotated[
        Kilograms | None,
        Option("moving mass [kg], for stiffness and damping (by default a scene's piston)", "M"),
    ] = None,
    coordinates: Annotated[
        int,
        Option(
            "2 to fit two linear modes to a free decay in one column, and compare with one mode (default: 1)"
        ),
    ] = 1,
    starts: StartCount = 16,
    budget: Budget = 300.0,
    no_checks: Annotated[
        bool, Option("skip the runs that give the error of the time step and the spread over packings")
    ] = False,
    packings: Annotated[
        int | None, Option("number of random packings of a scene that give the spread, 2 to 100 (3)", "N")
    ] = None,
    dt: Annotated[
        TimeStep | None,
        Option(
            "time step [s], 'auto', or a multiple such as auto/2; by default the coarsest step and the "
            "fastest pair sum whose errors are below the spread between random packings"
        ),
    ] = None,
    method: MethodName = "stormer-verlet",
    threads: ThreadCount = None,
    reading: ReadingOptions,
    verbose: Annotated[bool, Option("print the full result, not only its main lines")] = False,
    output: OutputOptions,
) -> None:
    """Simulate or read a motion, compare laws, and write a report."""
    from granular.records.record import PistonRecord
    from granular.shared.progress_bars import print_above_bar
    from reduced_models.identification.identify import IdentifyOptions, plan_simulation_run
    from reduced_models.identification.identify import identify as identify_source
    from reduced_models.identification.scene_checks import PACKINGS
    from reduced_models.records.sources import DEFAULT_METHOD, open_source

    changes.import_user_code()
    silence_caution_warnings_of_text_output(output)
    opened: Any = open_source(source, reading.parse())
    if hasattr(opened, "replace"):
        opened = plan_simulation_run(changes.apply(opened), dt, method, threads, checks=not no_checks)
    else:
        named_method = None if method == DEFAULT_METHOD else method
        of_scene = {"dt": dt, "method": named_method, "threads": threads, "set": changes.changes or None}
        for name in given_options(**of_scene):
            raise InputError(
                f"--{name} applies to a scene, but the source is a run or a record: remove --{name}"
            )
    if packings is not None and (no_checks or isinstance(opened, PistonRecord)):
        raise InputError(
            "--packings applies to the checks of a scene or run: remove --packings"
            + " or --no-checks" * no_checks
        )
    tolerances = parts.tolerances_by_key(getattr(opened, "scene", None)) if parts else None
    records = [opened] if isinstance(opened, PistonRecord) else []
    result = identify_source(
        opened,
        out,
        laws=parse_laws(laws, records) if laws else None,
        discovery=discover,
        drive=drive,
        mass=mass,
        coordinates=coordinates,
        starts=starts,
        options=IdentifyOptions(
            budget, not no_checks, packings=PACKINGS if packings is None else packings, parts=tolerances
        ),
        progress=output.shows_progress and (lambda first: print_above_bar(first.line_before_checks)),
    )
    print_result_and_report_path(result, out, output, None if verbose else result.printout())


@command("""\
examples:
  %(prog)s --laws
  %(prog)s lab.csv --law duffing -o model.json
  %(prog)s a.csv b.csv --law linear --own g0 --bound lam=0:2
  %(prog)s lab.csv --law duffing --fix lam=0.8 --start "omega=21 rad/s"
  %(prog)s shaken.csv --law "z'' + 2*lam*(z' - base_speed) + k*z = g0"
  %(prog)s acc.csv --law linear --columns acceleration=ax
  %(prog)s slow.csv fast.csv --law bouc-wen --columns stroke=lvdt,force=cell
  %(prog)s geo.csv --law linear --columns velocity=ch1 --scale "velocity=1 m/s/V" \\
      --measured "velocity gain=20:30 high_pass=4.5 damping_ratio=0.6\"""")
def fit(
    sources: Sources = (),
    *,
    law: Annotated[str, Option("law to fit: name or equation", "LAW")] = "linear",
    laws: Annotated[bool, Option("list the laws that can be fitted by name")] = False,
    own: Annotated[
        tuple[str, ...], Option("parameter with a separate value for each record (repeatable)", "NAME")
    ] = (),
    bounds: Annotated[
        tuple[str, ...],
        Option(
            "lower and upper bound of a parameter, in SI or such as '0.1 m:20 cm' (repeatable)",
            "NAME=LOW:HIGH",
            name="--bound",
        ),
    ] = (),
    fixed: Annotated[
        tuple[str, ...],
        Option(
            "parameter with a fixed value, in SI or such as '12 cm' (repeatable)", "NAME=VALUE", name="--fix"
        ),
    ] = (),
    start_values: Annotated[
        tuple[str, ...],
        Option(
            "start value of a parameter in the search, in SI or such as '12 cm' (repeatable)",
            "NAME=VALUE",
            name="--start",
        ),
    ] = (),
    test_fraction: TestFraction = 0.3,
    starts: StartCount = 16,
    intervals: Annotated[
        Literal["linear", "profile"],
        Option(
            "linear (default) or profile (also valid for bounded or strongly correlated parameters)", "HOW"
        ),
    ] = "linear",
    drift: Annotated[
        bool | None,
        Option("whether to fit a slow drift of the records' zero; by default only if the residuals show one"),
    ] = None,
    measured: Annotated[
        str | None,
        Option(
            "measured quantity other than the height: velocity, acceleration, base_force, or force "
            "(along a prescribed height), followed by gain, offset (a number, LOW:HIGH or free), low_pass, "
            "high_pass (in Hz), damping_ratio, column, absolute; by default from the file's columns",
            "SENSOR",
        ),
    ] = None,
    out: Annotated[str | None, Option("JSON file for the model of the first record", "FILE", "-o")] = None,
    reading: ReadingOptions,
    output: OutputOptions,
) -> None:
    """Fit one law to one record, or to several together."""
    from reduced_models.fitting.fit import fit as fit_law
    from reduced_models.fitting.problem import FitOptions
    from reduced_models.laws.catalogue import LAWS
    from reduced_models.laws.force_laws import FORCE_LAWS
    from reduced_models.records.sensor import parse_sensor

    if laws:
        text = f"{LAWS!r}\n\nof the force on a prescribed stroke (--measured force):\n{FORCE_LAWS!r}"
        print_result({**LAWS.descriptions(), "force": FORCE_LAWS.descriptions()}, text, output.json)
        return
    require_options(SOURCE=sources)
    silence_caution_warnings_of_text_output(output)
    models = fit_law(
        reading.load(sources, output),
        law,
        parameters=parse_parameters(bounds, own, fixed, start_values),
        options=FitOptions(drift=drift, measured=None if measured is None else parse_sensor(measured)),
        intervals=intervals,
        starts=starts,
        test_fraction=test_fraction,
    )
    text = "\n\n".join(map(str, models))
    if out is not None:
        models[0].save(out)
        text += f"\nmodel: {out}"
    print_result({"models": [model.to_plain() for model in models]}, text, output.json)


def parse_parameters(
    bounds: Sequence[str], own: Sequence[str], fixed: Sequence[str] = (), start_values: Sequence[str] = ()
) -> dict[str, Parameter]:
    """Return the parameters that the options --bound, --own, --fix and --start describe."""
    from reduced_models.fitting.parameter import Parameter

    parameters: dict[str, Parameter] = {}

    def change_parameter(name: str, **changes: Any) -> None:
        name = name.strip()
        parameters[name] = dataclasses.replace(parameters.get(name, Parameter()), **changes)

    for item in bounds:
        name, _, pair = item.partition("=")
        low, colon, high = pair.partition(":")
        if not colon:
            raise InputError(f"--bound {quote(item)} is not NAME=LOW:HIGH; write, for example, lam=0:2")
        change_parameter(name, low=low.strip() or None, high=high.strip() or None)
    for name in own:
        change_parameter(name, per_record=True)
    for word, items in (("--start", start_values), ("--fix", fixed)):
        for item in items:
            name, _, value = item.partition("=")
            if not value.strip():
                raise InputError(f"{word} {quote(item)} is not NAME=VALUE; write, for example, lam=0.5")
            change_parameter(name, value=value.strip(), fixed=word == "--fix")
    return parameters


@command("""\
examples:
  %(prog)s lab.csv -o model.json
  %(prog)s pendulum.csv --library trigonometric --terms "z'**3"
  %(prog)s lab.csv --method operon --functions sin --effort 2 --seed 1 --json""")
def discover(
    sources: Sources = (),
    *,
    method: Annotated[
        Literal["auto", "sindy", "pysindy", "operon", "pysr"],
        Option("auto (sindy and operon together), sindy, pysindy, operon, pysr"),
    ] = "auto",
    library: Annotated[
        tuple[str, ...],
        Option(
            "terms to choose from: auto (default: the library that fits the record best), physical, "
            "polynomial, trigonometric, rational, dry friction, contact, driven (repeatable); memory: with a "
            "hidden state, for beds that yield or relax",
            "NAME",
        ),
    ] = (),
    terms: Annotated[
        tuple[str, ...],
        Option(
            "custom term in z, z', the input and the time t, such as 'sin(z)' or 'sin(w*t)' (repeatable)",
            "TERM",
        ),
    ] = (),
    functions: Annotated[
        tuple[str, ...],
        Option(
            "function for symbolic regression, besides sums and products: sin, exp, max, / (repeatable)",
            "NAME",
        ),
    ] = (),
    degree: Annotated[int, Option("highest power of z in the physical library")] = 3,
    drive: Drive = None,
    target: Annotated[
        Literal["acceleration", "height", "force"],
        Option(
            "quantity given by the law: acceleration (default), height (a formula of the time), or "
            "force (along a prescribed stroke)"
        ),
    ] = "acceleration",
    height: Annotated[
        str, Option("height [m] linear in z, such as '0.06 + 0.01*z'; by default from the record", "LINE")
    ] = "auto",
    effort: Annotated[Fraction, Option("length of a symbolic regression relative to the default", "X")] = 1.0,
    seed: Annotated[int, Option("seed of random searches")] = 0,
    least_effect: Annotated[
        float, Option("minimum change of the motion by a term, relative to the rms displacement (1e-3)", "X")
    ] = 1e-3,
    out: Annotated[str | None, Option("JSON file for the chosen model", "FILE", "-o")] = None,
    reading: ReadingOptions,
    output: OutputOptions,
) -> None:
    """Find the structure of the law of one record, or of several."""
    from reduced_models.discovery.discover import DiscoveryOptions
    from reduced_models.discovery.discover import discover as discover_law
    from reduced_models.discovery.term_libraries import AUTO

    require_options(SOURCE=sources)
    silence_caution_warnings_of_text_output(output)
    records = reading.load(sources, output)
    result = discover_law(
        records[0] if len(records) == 1 else records,
        method=method,
        library=library or AUTO,
        degree=degree,
        terms=terms,
        input=drive,
        target=target,
        seed=seed,
        least_effect=least_effect,
        options=DiscoveryOptions(
            progress=output.shows_progress, functions=functions, effort=effort, height=height
        ),
    )
    text, model = str(result), result.best.model
    if out is not None and model is not None:
        model.save(out)
        text += f"\nmodel: {out}"
    plain = {
        **result.to_plain(),
        "method_asked_for": method,
        "model": None if model is None else model.to_plain(),
    }
    print_result(plain, text, output.json)
    if out is not None and model is None:
        why = result.best.note or "the chosen equation was not fitted to the motion; see the other candidates"
        raise InputError(f"no model was written to {out}: {why}")


@command("""\
examples:
  %(prog)s a.csv b.csv --law all --test-records c.csv -o out
  %(prog)s --response out/machine        # after 'response machine ... -o out/machine'""")
def compare(
    sources: Sources = (),
    *,
    laws: LawNames = (),
    test_records: Annotated[
        tuple[str, ...], Option("record held out of all fits (repeatable)", "SOURCE")
    ] = (),
    test_fraction: TestFraction = 0.3,
    starts: StartCount = 16,
    budget: Budget = 300.0,
    out: Annotated[str | None, Option("directory for report and models", "DIR", "-o")] = None,
    response: Annotated[
        str | None,
        Option(
            "instead of records, compare the law of the bed with a machine's simulated response from "
            "'response -o DIR'; the report.html in DIR is rewritten",
            "DIR",
        ),
    ] = None,
    reading: ReadingOptions,
    output: OutputOptions,
) -> None:
    """Compare laws by their prediction errors on held-out data."""
    if response is not None:
        refuse_options("--response", out=out, SOURCE=sources, law=laws, test_records=test_records)
        FORMS.find("compare --response")(response, output)
        return
    require_options(SOURCE=sources)
    from reduced_models.fitting.levenberg_marquardt import spent_budget_text, time_budget
    from reduced_models.identification.candidate_laws import CANDIDATES
    from reduced_models.identification.comparison import compare as compare_laws
    from reduced_models.identification.identify import check_budget
    from reduced_models.records.sources import make_directory

    check_budget(budget)
    target = None if out is None else make_directory(out)
    silence_caution_warnings_of_text_output(output)
    records, further = (reading.load(paths, output) for paths in (sources, test_records))
    default = ("all",) if _records_have_prescribed_strokes(records) else CANDIDATES
    every = parse_laws(laws or default, records)
    with time_budget(budget, spent_budget_text(budget)):
        table = compare_laws(records, every, test_fraction, further, starts=starts)
    text = str(table)
    if target is not None:
        from reduced_models.identification.page import comparison_page

        comparison_page(table).save(target / "report.html")
        table.best.save(target / "model.json")
        write_text(target / "equations.txt", table.best.text)
        text += f"\nreport: {target}/report.html"
    print_result(table.to_plain(), text, output.json)


def parse_laws(names: Sequence[str], records: Sequence[PistonRecord] = ()) -> tuple[str, ...]:
    """Return distinct names of the laws to fit; "all" means all laws of the package that suit the records."""
    from reduced_models.identification.candidate_laws import candidate_force_laws
    from reduced_models.laws.catalogue import LAWS

    package = (
        [law.name for law in candidate_force_laws(records)]
        if _records_have_prescribed_strokes(records)
        else list(LAWS.usable_parts())
    )
    every = (package if name == "all" else [name] for name in names)
    return tuple(dict.fromkeys(law for some in every for law in some))


def _records_have_prescribed_strokes(records: Sequence[PistonRecord]) -> bool:
    """Return whether the records contain forces along prescribed strokes."""
    return bool(records) and records[0].measured == "force"
