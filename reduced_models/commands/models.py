"""The commands ``simulate`` and ``export-model``: what a saved model is used for."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any

from granular.commands.console import command, given_options, option, print_result, refuse_options
from granular.commands.options import OUTPUT, quantity_reader
from granular.shared.errors import InputError
from granular.shared.message_text import quote

MODEL = option("model", metavar="MODEL", help="JSON file of a model")
MOST_SAMPLES = 10**7


@command(
    "simulate",
    "predict a motion by a model that was saved",
    MODEL,
    option("--until", required=True, metavar="T", help="end of the motion [s]"),
    option("--samples", type=int, default=1000, help="number of samples"),
    option("--height", metavar="H", help="at the start [m]; the record's without"),
    option("--velocity", metavar="V", help="at the start [m/s]; the record's without"),
    option("-o", "--out", metavar="FILE", help="CSV file"),
    OUTPUT,
    examples="""\
examples:
  %(prog)s model.json --until 3 -o motion.csv
  %(prog)s model.json --until 3 --height "60 mm" --velocity 0""",
)
def simulate(options: Any) -> None:
    """Predict a motion by a saved model."""
    import numpy as np

    from granular.schema.units import si_value
    from reduced_models.models.model import load_model

    model = load_model(options.model)
    end = si_value(options.until, "s")
    if not 0.0 < end < math.inf:
        raise InputError(f"--until {quote(options.until)}; give a time above 0 s")
    if not 2 <= options.samples <= MOST_SAMPLES:
        raise InputError(f"--samples {options.samples}; give from 2 to {MOST_SAMPLES}")
    if model.law.inputs:
        names = ", ".join(model.law.inputs)
        raise InputError(f"the law has the inputs {names}; simulate it from Python, with them")
    motion = model.simulate(
        np.linspace(0.0, end, options.samples),
        None if options.height is None else si_value(options.height, "m"),
        None if options.velocity is None else si_value(options.velocity, "m/s"),
    )
    if note := model.outside_range_text(motion):
        warnings.warn(note, stacklevel=1)
    assert motion.velocity is not None
    last = {"height": float(motion.height[-1]), "velocity": float(motion.velocity[-1])}
    text = f"after {end:g} s: height {last['height']:.6g} m, velocity {last['velocity']:.6g} m/s"
    if options.out is not None:
        motion.to_csv(options.out)
        text += f"\nmotion: {options.out}"
    print_result({"samples": len(motion), "end": last, "note": note}, text, options.json)


@command(
    "export-model",
    "write a saved model as code: Python, C, MATLAB, Modelica, FMU",
    option("model", metavar="MODEL", help="JSON file of a model; for a port, a scene too"),
    option(
        "-o",
        "--out",
        metavar="FILE",
        required=True,
        help="file to write; its ending says the language: .py, .c, .m, .mo or .fmu",
    ),
    option(
        "--port",
        choices=("force",),
        help="write an element between two bodies in place of the record's motion: inputs height "
        "[m] and velocity [m/s] of the piston over the cell, output force [N]",
    ),
    option(
        "--mass",
        type=quantity_reader("kg"),
        metavar="M",
        help="of the piston that was recorded, for a port of a record's model [kg]",
    ),
    option("--gravity", type=quantity_reader("m/s^2"), metavar="G", help="there [m/s^2] (9.8)"),
    option("--fmi", type=int, default=2, help="version of FMI of an .fmu, 2 or 3 (2)"),
    OUTPUT,
    examples="""\
examples:
  %(prog)s out/model.json -o damper.c
  %(prog)s out/model.json -o damper_model.m      # MATLAB and Octave
  %(prog)s out/model.json -o damper.fmu          # Simulink, Dymola, FMPy, ...
  %(prog)s out/model.json -o bed.fmu --port force --mass '7.5 kg' --fmi 3
  %(prog)s damper -o Bed.mo --port force         # from the scene alone""",
)
def export_model(options: Any) -> None:
    """Write a saved model as code."""
    from granular.scene.loading import scene_names
    from reduced_models.models.model import load_model

    if options.model in scene_names() or Path(options.model).suffix == ".toml":
        what = _export_scene(options)
    else:
        if options.port is None:
            refuse_options(options, "a model without --port", "mass", "gravity")
        given = given_options(options, "mass", "gravity")
        model = load_model(options.model)
        what = model.export(options.out, port=options.port, fmi=options.fmi, **given)
    print_result({"file": options.out, "what": what}, f"{what}: {options.out}", options.json)


def _export_scene(options: Any) -> str:
    """Write the bed of a scene as an element."""
    from granular.scene.loading import load_scene
    from reduced_models.machines import export_bed

    if options.port is None:
        raise InputError(f"{quote(options.model)} is a scene; add --port force, or give a model")
    refuse_options(options, "a scene, which has its own", "mass", "gravity")
    return export_bed(load_scene(options.model), options.out, fmi=options.fmi)
