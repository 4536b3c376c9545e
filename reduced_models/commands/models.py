"""The commands ``simulate`` and ``export-model`` for saved models."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

from granular.commands.console import command, given_options, print_result, refuse_options
from granular.commands.options import OutputOptions
from granular.commands.signature import Kilograms, Metres, Option, Seconds, make_quantity_reader
from granular.shared.errors import InputError, quote
from reduced_models.commands.forms import FORMS

MOST_SAMPLES = 10**7


@command("""\
examples:
  %(prog)s model.json --until 3 -o motion.csv
  %(prog)s model.json --until 3 --height "60 mm" --velocity 0""")
def simulate(
    model: Annotated[str, Option("JSON file of a model", "MODEL")],
    *,
    until: Annotated[Seconds, Option("end of the motion [s]", "T")],
    samples: Annotated[int, Option("number of samples")] = 1000,
    height: Annotated[Metres | None, Option("initial height [m]; by default the record's", "H")] = None,
    velocity: Annotated[
        Annotated[float, make_quantity_reader("m/s")] | None,
        Option("initial velocity [m/s]; by default the record's", "V"),
    ] = None,
    out: Annotated[str | None, Option("CSV file", "FILE", "-o")] = None,
    output: OutputOptions,
) -> None:
    """Predict a motion with a saved model."""
    import numpy as np

    from reduced_models.models.model import load_model

    loaded = load_model(model)
    if not 0.0 < until < math.inf:
        raise InputError(f"--until {until:g}; give a time above 0 s")
    if not 2 <= samples <= MOST_SAMPLES:
        raise InputError(f"--samples {samples}; give from 2 to {MOST_SAMPLES}")
    if loaded.law.inputs:
        names = ", ".join(loaded.law.inputs)
        raise InputError(
            f"the law has the inputs {names}, which this command cannot give; simulate it in Python"
        )
    motion = loaded.simulate(np.linspace(0.0, until, samples), height, velocity)
    if note := loaded.outside_range_text(motion):
        warnings.warn(note, stacklevel=1)
    assert motion.velocity is not None
    last = {"height": float(motion.height[-1]), "velocity": float(motion.velocity[-1])}
    text = f"after {until:g} s: height {last['height']:.6g} m, velocity {last['velocity']:.6g} m/s"
    if out is not None:
        motion.to_csv(out)
        text += f"\nmotion: {out}"
    print_result({"samples": len(motion), "end": last, "note": note}, text, output.json)


@command("""\
examples:
  %(prog)s out/model.json -o damper.c
  %(prog)s out/model.json -o damper_model.m      # MATLAB and Octave
  %(prog)s out/model.json -o damper.fmu          # Simulink, Dymola, FMPy, ...
  %(prog)s out/model.json -o bed.fmu --port force --mass '7.5 kg' --fmi 3
  %(prog)s damper -o Bed.mo --port force         # from the scene alone""")
def export_model(
    model: Annotated[str, Option("JSON file of a model; for a port also a scene", "MODEL")],
    *,
    out: Annotated[
        str, Option("file to write; its ending selects the language: .py, .c, .m, .mo, .fmu", "FILE", "-o")
    ],
    port: Annotated[
        Literal["force"] | None,
        Option(
            "write an element between two bodies instead of the record's motion: inputs height [m] and "
            "velocity [m/s] of the piston relative to the cell, output force [N]"
        ),
    ] = None,
    mass: Annotated[
        Kilograms | None, Option("mass of the recorded piston [kg], for --port with a model of a record", "M")
    ] = None,
    gravity: Annotated[
        Annotated[float, make_quantity_reader("m/s^2")] | None,
        Option("gravity of the record [m/s^2] (9.8)", "G"),
    ] = None,
    fmi: Annotated[int, Option("version of FMI of an .fmu, 2 or 3 (2)")] = 2,
    output: OutputOptions,
) -> None:
    """Write a saved model as code: Python, C, MATLAB, Modelica, FMU."""
    from granular.scene.named_scenes import load_scene, scene_names
    from reduced_models.models.model import load_model

    if model in scene_names() or Path(model).suffix == ".toml":
        if port is None:
            raise InputError(f"{quote(model)} is a scene; add --port force, or give a model")
        refuse_options("a scene, which has its own", mass=mass, gravity=gravity)
        what = FORMS.find("export-model SCENE")(load_scene(model), out, fmi=fmi)
    else:
        if port is None:
            refuse_options("a model without --port", mass=mass, gravity=gravity)
        options: dict[str, Any] = given_options(mass=mass, gravity=gravity)
        what = load_model(model).export(out, port=port, fmi=fmi, **options)
    print_result({"file": out, "what": what}, f"{what}: {out}", output.json)
