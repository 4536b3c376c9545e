"""Export of a model as a functional mock-up unit (FMI 2.0 or 3.0), for Simulink, Dymola, FMPy, ...

The unit (FMU) serves co-simulation and model exchange. It is compiled by the C compiler of the exporting
computer; the FMU contains its source, so that it can be compiled for another system.
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
from typing import TYPE_CHECKING, NamedTuple
from xml.sax.saxutils import quoteattr

from granular.shared.errors import InputError
from granular.shared.files import write_atomically
from granular.shared.version import __version__
from reduced_models.laws.equation import rate_derivatives
from reduced_models.models.c_code import (
    c_array_elements,
    c_assignments,
    c_local_variables,
    c_source,
    port_c_header_and_source,
)
from reduced_models.models.fitted_law import FittedLaw
from reduced_models.models.ports import ForcePort, PortForExport, prepare_port_for_export
from reduced_models.models.source_code import prepare_law_for_export, replace_steps_by_signs

if TYPE_CHECKING:
    from collections.abc import Sequence

    import sympy

NAME = "damper_model"
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}
_KINDS = {"ModelExchange": "", "CoSimulation": ' canHandleVariableCommunicationStepSize="true"'}
_LIBRARY_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
_STEPS = 10 * 512  # number of steps of the default experiment
_SECONDS = 120.0  # time limit of the compiler
_INPUTS, _PARAMETERS, _RATES, _OUTPUTS, _TIME = 1000, 2000, 3000, 4000, 5000
"""Value references, as in fmu_instance.c."""
_UNITS = {"m": 'm="1"', "m/s": 'm="1" s="-1"', "kg": 'kg="1"', "N": 'kg="1" m="1" s="-2"'}
_BUILD = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{NAME}">
    <SourceFileSet language="C99"><SourceFile name="{NAME}.c"/></SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


class FmuVariable(NamedTuple):
    """A variable of an FMU; for a rate, ``state`` is the value reference of its state."""

    name: str
    reference: int
    causality: str
    variability: str
    start: float | None
    state: int | None = None
    unit: str = ""
    description: str = ""


class FmuContents(NamedTuple):
    """Contents of an FMU that do not depend on the version: source, variables, step [s], comments."""

    source: str
    variables: tuple[FmuVariable, ...]
    step: float
    about: str
    directional: bool


def write_fmu(model: FittedLaw | ForcePort, path: str | Path, version: int = 2) -> str:
    """Write a model as an FMU of FMI 2.0 or 3.0."""
    contents = _port_contents(model) if isinstance(model, ForcePort) else _free_motion_contents(model)
    guid = hashlib.sha256(contents.source.encode()).hexdigest()[:32]
    here = Path(__file__).parent
    wrappers = [(here / name).read_text("utf-8") for name in ("fmu_instance.c", f"fmi{version}.c")]
    source = "\n".join([contents.source, f'#define MODEL_GUID "{guid}"', *wrappers])
    folder, ending, library = _compile_library_folder_ending_and_bytes(source, version)
    describe = _model_description_of_fmi_2 if version == 2 else _model_description_of_fmi_3
    with (
        write_atomically(Path(path), overwrite=True) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as file,
    ):
        file.writestr("modelDescription.xml", describe(contents, guid))
        file.writestr(f"sources/{NAME}.c", source)
        if version == 3:
            file.writestr("sources/buildDescription.xml", _BUILD)
        file.writestr(f"binaries/{folder}/{NAME}{ending}", library)
    return f"an FMU (FMI {version}.0, co-simulation and model exchange)"


def port_jacobian(parts: PortForExport) -> list[list[sympy.Expr]] | None:
    """Return the Jacobian: rows are the states' rates and the force, columns the states and the inputs."""
    import sympy

    real = {
        symbol: sympy.Symbol(symbol.name, real=True)
        for output in parts.outputs
        for symbol in output.free_symbols
    }
    force, *rates = (output.xreplace(real) for output in parts.outputs)
    by = [sympy.Symbol(name) for name in (*parts.states, *parts.inputs)]
    slopes = rate_derivatives([*rates, force], [real.get(symbol, symbol) for symbol in by])
    plain = {symbol: own for own, symbol in real.items()}
    flat = [
        replace_steps_by_signs(slope.replace(sympy.DiracDelta, lambda *_: sympy.S.Zero)).xreplace(plain)
        for slope in slopes
    ]
    if any(slope.has(sympy.Derivative, sympy.Subs) for slope in flat):
        return None
    return [flat[k : k + len(by)] for k in range(0, len(flat), len(by))]


def _free_motion_contents(model: FittedLaw) -> FmuContents:
    """Return the contents of an FMU for the free motion of a record; the states are also outputs."""
    parts = prepare_law_for_export(model)
    glue = f"""
#define MODEL_START model_initial
#define MODEL_JACOBIAN 0
enum {{ MODEL_OUTPUTS = 0 }};
static const double model_start_inputs[] = {{ {c_array_elements([0.0] * len(parts.inputs))} }};
#define model_outputs(parameters, state, inputs, outputs) ((void)outputs)
#define model_jacobian(parameters, state, inputs, rows) ((void)rows)
"""
    names = (model.coordinate, "velocity", *parts.hidden)
    units = (model.coordinate_unit, f"{model.coordinate_unit}/s", *("" for _ in parts.hidden))
    variables = _fmu_variables(
        "output",
        list(zip(names, parts.initial, units, strict=True)),
        [(name, 0.0, "") for name in parts.inputs],
        [(name, value, "") for name, value in zip(parts.parameters, parts.values, strict=True)],
        (),
    )
    return FmuContents(c_source(model) + glue, variables, parts.step, " ".join(parts.comments[:3]), False)


def _port_contents(port: ForcePort) -> FmuContents:
    """Return the contents of an FMU for the force of a bed, whose inputs are height and velocity."""
    parts, slopes = prepare_port_for_export(port), port_jacobian(prepare_port_for_export(port))
    rest = port.model.initial[0] if port.model.at_rest is None else port.model.at_rest.height
    start = [rest, 0.0, *(0.0 for _ in parts.law.inputs)]
    rows = c_assignments("rows", (slope for row in slopes or () for slope in row))
    glue = f"""
#define MODEL_START model_start
#define MODEL_JACOBIAN {int(slopes is not None)}
enum {{ MODEL_OUTPUTS = 1 }};
static const double model_start_inputs[] = {{ {c_array_elements(start)} }};

static void model_outputs(const double *parameters, const double *states, const double *inputs,
                          double *outputs)
{{ outputs[0] = model_force(parameters, states, inputs); }}

static void model_jacobian(const double *parameters, const double *states, const double *inputs,
                           double *rows)
{{
{c_local_variables(parts)}    (void)rows;
{rows}}}
"""
    variables = _fmu_variables(
        "local",
        [(name, value, "") for name, value in zip(parts.states, parts.start, strict=True)],
        list(zip(parts.inputs, start, ("m", "m/s", *("" for _ in parts.law.inputs)), strict=True)),
        list(zip(parts.parameters, parts.values, parts.units, strict=True)),
        (("force", "N", f"force {parts.direction}"),),
    )
    source = "".join(port_c_header_and_source(port, "model")) + glue
    about = " ".join(parts.comments)
    return FmuContents(source, variables, parts.law.step, about, slopes is not None)


def _fmu_variables(
    causality: str,
    states: Sequence[tuple[str, float, str]],
    inputs: Sequence[tuple[str, float, str]],
    parameters: Sequence[tuple[str, float, str]],
    outputs: Sequence[tuple[str, str, str]],
) -> tuple[FmuVariable, ...]:
    """Return the variables with start values and units; states and their rates get the given causality.

    Outputs are given as name, unit and description.
    """
    rates = [(f"der({name})", None, "") for name, *_ in states]
    groups: tuple[tuple[int, str, str, Sequence[tuple[str, float | None, str]]], ...] = (
        (0, causality, "continuous", states),
        (_RATES, "local", "continuous", rates),
        (_INPUTS, "input", "continuous", inputs),
        (_PARAMETERS, "parameter", "tunable", parameters),
        (_OUTPUTS, "output", "continuous", [(name, None, unit) for name, unit, _ in outputs]),
    )
    descriptions = {name: text for name, _, text in outputs}
    return tuple(
        FmuVariable(
            name,
            first + k,
            role,
            variability,
            start,
            k if first == _RATES else None,
            unit,
            descriptions.get(name, ""),
        )
        for first, role, variability, rows in groups
        for k, (name, start, unit) in enumerate(rows)
    )


def _compile_library_folder_ending_and_bytes(source: str, version: int) -> tuple[str, str, bytes]:
    """Compile the library; return its folder in the FMU, its file ending, and its bytes."""
    compiler = next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))), None)
    if sys.platform not in _SYSTEMS or compiler is None:
        raise InputError(
            "an FMU needs a C compiler, on Linux or macOS, but none was found; install gcc or clang, "
            "or export to C (.c) or Modelica (.mo)"
        )
    system, ending = _SYSTEMS[sys.platform]
    bits = "64" if platform.architecture()[0] == "64bit" else "32"
    machine = {"arm64": "aarch64", "AMD64": "x86_64"}.get(platform.machine(), platform.machine())
    folder = f"{system}{bits}" if version == 2 else f"{machine}-{system}"
    with tempfile.TemporaryDirectory() as here:
        path, library = Path(here) / f"{NAME}.c", Path(here) / f"{NAME}{ending}"
        path.write_text(source, encoding="utf-8")
        command = [compiler, *_LIBRARY_FLAGS, str(path), "-o", str(library), "-lm"]
        done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=_SECONDS)
        if done.returncode:
            raise InputError(f"{compiler} cannot compile the model: {done.stderr.strip()[:300]}")
        return folder, ending, library.read_bytes()


def _model_description_of_fmi_2(contents: FmuContents, guid: str) -> str:
    """Return the text of modelDescription.xml for FMI 2.0."""
    directional = str(contents.directional).lower()
    kinds = "".join(
        f"""  <{kind} modelIdentifier="{NAME}" canGetAndSetFMUstate="true"
      providesDirectionalDerivative="{directional}"{more}>
    <SourceFiles><File name="{NAME}.c"/></SourceFiles>
  </{kind}>
"""
        for kind, more in _KINDS.items()
    )
    positions = {variable.reference: k + 1 for k, variable in enumerate(contents.variables)}

    def variable_xml_line(variable: FmuVariable) -> str:
        inner = _number_attributes(variable)
        if variable.state is not None:
            inner += f' derivative="{positions[variable.state]}"'
        initial = _initial_attribute(variable, ("input", "parameter"))
        return (
            f'    <ScalarVariable name="{variable.name}" valueReference="{variable.reference}" '
            f'causality="{variable.causality}" variability="{variable.variability}"{initial}'
            f"{_description_attribute(variable)}>"
            f"<Real{inner}/></ScalarVariable>\n"
        )

    def structure_xml_group(tag: str, which: Sequence[FmuVariable]) -> str:
        items = "".join(f'<Unknown index="{positions[variable.reference]}"/>' for variable in which)
        return f"    <{tag}>{items}</{tag}>\n" if items else ""

    outputs, rates, unknown = _outputs_rates_and_initial_unknowns(contents)
    structure = (
        structure_xml_group("Outputs", outputs)
        + structure_xml_group("Derivatives", rates)
        + structure_xml_group("InitialUnknowns", unknown)
    )
    variables = "".join(map(variable_xml_line, contents.variables))
    return _model_description_text(contents, f'fmiVersion="2.0" guid="{guid}"', kinds, variables, structure)


def _model_description_of_fmi_3(contents: FmuContents, guid: str) -> str:
    """Return the text of modelDescription.xml for FMI 3.0."""
    directional = str(contents.directional).lower()
    kinds = "".join(
        f"""  <{kind} modelIdentifier="{NAME}" canGetAndSetFMUState="true"
      providesDirectionalDerivatives="{directional}"{more}/>
"""
        for kind, more in _KINDS.items()
    )

    def variable_xml_line(variable: FmuVariable) -> str:
        more = _number_attributes(variable) + _initial_attribute(variable, ("input", "independent"))
        more += _description_attribute(variable)
        if variable.state is not None:
            more += f' derivative="{variable.state}"'
        return (
            f'    <Float64 name="{variable.name}" valueReference="{variable.reference}" '
            f'causality="{variable.causality}" variability="{variable.variability}"{more}/>\n'
        )

    groups = zip(
        ("Output", "ContinuousStateDerivative", "InitialUnknown"),
        _outputs_rates_and_initial_unknowns(contents),
        strict=True,
    )
    structure = "".join(
        f'    <{tag} valueReference="{variable.reference}"/>\n' for tag, which in groups for variable in which
    )
    time = FmuVariable("time", _TIME, "independent", "continuous", None)
    variables = "".join(map(variable_xml_line, (time, *contents.variables)))
    return _model_description_text(
        contents, f'fmiVersion="3.0" instantiationToken="{guid}"', kinds, variables, structure
    )


def _model_description_text(
    contents: FmuContents, version: str, kinds: str, variables: str, structure: str
) -> str:
    """Return the text of modelDescription.xml, from the parts that depend on the version of FMI."""
    units = "".join(f'    <Unit name="{name}"><BaseUnit {base}/></Unit>\n' for name, base in _UNITS.items())
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription {version} modelName="{NAME}"
    description={quoteattr(contents.about)}
    generationTool="granular-damper {__version__}" variableNamingConvention="structured">
{kinds}  <UnitDefinitions>
{units}  </UnitDefinitions>
  <DefaultExperiment startTime="0.0" stopTime="{_STEPS * contents.step!r}"/>
  <ModelVariables>
{variables}  </ModelVariables>
  <ModelStructure>
{structure}  </ModelStructure>
</fmiModelDescription>
"""


def _number_attributes(variable: FmuVariable) -> str:
    unit = f' unit="{variable.unit}"' if variable.unit in _UNITS else ""
    return unit + ("" if variable.start is None else f' start="{variable.start!r}"')


def _initial_attribute(variable: FmuVariable, implied: tuple[str, ...]) -> str:
    """Return the XML attribute ``initial`` of a variable; empty for causalities that imply it."""
    if variable.causality in implied:
        return ""
    return f' initial="{"calculated" if variable.start is None else "exact"}"'


def _description_attribute(variable: FmuVariable) -> str:
    return f" description={quoteattr(variable.description)}" if variable.description else ""


def _outputs_rates_and_initial_unknowns(
    contents: FmuContents,
) -> tuple[list[FmuVariable], list[FmuVariable], list[FmuVariable]]:
    """Return outputs, rates of the states, and variables calculated at initialisation."""
    outputs = [item for item in contents.variables if item.causality == "output"]
    rates = [item for item in contents.variables if item.state is not None]
    return outputs, rates, [item for item in [*outputs, *rates] if item.start is None]
