"""A model as a functional mock-up unit (FMI 2.0, co-simulation), for Simulink, Dymola, FMPy, ...

Compiled where it is written, by the C compiler that is there; its source is inside, so that it can
be compiled for another system.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from xml.sax.saxutils import quoteattr

from granular.shared.errors import InputError
from granular.shared.files import replace_when_written
from granular.shared.version import __version__
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.source_code import ExportParts, c_source, export_parts

NAME = "damper_model"
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}
_STEPS = 10 * 512  # of the default experiment
_SECONDS = 120.0  # for a compiler
_INPUTS, _PARAMETERS = 1000, 2000  # value references, as in fmu_functions.c


def write_fmu(model: FittedLaw, path: str | Path) -> None:
    """Write a model as an FMU.

    Raises
    ------
    InputError
        If there is no C compiler, or the file cannot be written.
    """
    parts = export_parts(model)
    plain = c_source(model)
    guid = hashlib.sha256(plain.encode()).hexdigest()[:32]
    wrapper = (Path(__file__).parent / "fmu_functions.c").read_text(encoding="utf-8")
    source = f'{plain}\n#define MODEL_GUID "{guid}"\n\n{wrapper}'
    folder, ending, library = _compile_library(source)
    with (
        replace_when_written(Path(path), overwrite=True) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as file,
    ):
        file.writestr("modelDescription.xml", _model_description(model, parts, guid))
        file.writestr(f"sources/{NAME}.c", source)
        file.writestr(f"binaries/{folder}/{NAME}{ending}", library)


def _compile_library(source: str) -> tuple[str, str, bytes]:
    """Folder of the system in an FMU, the ending of a library there, and the library."""
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))),
                    None)  # fmt: skip
    if sys.platform not in _SYSTEMS or compiler is None:
        raise InputError(
            "an FMU needs a C compiler, on Linux or macOS, and none is here; install gcc or clang, "
            "or export to c or modelica"
        )
    system, ending = _SYSTEMS[sys.platform]
    bits = "64" if platform.architecture()[0] == "64bit" else "32"
    with tempfile.TemporaryDirectory() as here:
        path, library = Path(here) / f"{NAME}.c", Path(here) / f"{NAME}{ending}"
        path.write_text(source, encoding="utf-8")
        command = [compiler, "-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden",
                   str(path), "-o", str(library), "-lm"]  # fmt: skip
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, timeout=_SECONDS
        )
        if done.returncode:
            raise InputError(f"{compiler} cannot compile the model: {done.stderr.strip()[:300]}")
        return f"{system}{bits}", ending, library.read_bytes()


def _model_description(model: FittedLaw, parts: ExportParts, guid: str) -> str:
    """modelDescription.xml."""
    names = (model.coordinate, "velocity", *parts.hidden)
    variables = [
        _variable(name, k, "output", "continuous", value, ' initial="exact"')
        for k, (name, value) in enumerate(zip(names, parts.initial, strict=True))
    ]
    variables += [
        _variable(name, _INPUTS + k, "input", "continuous", 0.0)
        for k, name in enumerate(parts.inputs)
    ]
    variables += [
        _variable(name, _PARAMETERS + k, "parameter", "fixed", value)
        for k, (name, value) in enumerate(zip(parts.parameters, parts.values, strict=True))
    ]
    outputs = "".join(f'<Unknown index="{k + 1}"/>' for k in range(len(names)))
    about = quoteattr(" ".join(parts.comments[:3]))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{NAME}" guid="{guid}" description={about}
    generationTool="granular-damper {__version__}" variableNamingConvention="flat">
  <CoSimulation modelIdentifier="{NAME}" canHandleVariableCommunicationStepSize="true"
      canGetAndSetFMUstate="true"/>
  <DefaultExperiment startTime="0.0" stopTime="{_STEPS * parts.step!r}"/>
  <ModelVariables>
{"".join(variables)}  </ModelVariables>
  <ModelStructure>
    <Outputs>{outputs}</Outputs>
  </ModelStructure>
</fmiModelDescription>
"""


def _variable(
    name: str, reference: int, causality: str, variability: str, start: float, more: str = ""
) -> str:
    return (
        f'    <ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}"{more}><Real start="{start!r}"/></ScalarVariable>\n'
    )
