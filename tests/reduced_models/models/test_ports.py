"""The bed exported as a force element between two bodies: equal forces in every language, and in a
machine.
"""

import importlib.util
import math
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from granular import PistonRecord, Scene, load_scene, simulate
from granular.shared.errors import InputError
from reduced_models import fit
from reduced_models.machines import export_bed
from reduced_models.machines.design import bed_force_port, mass_matrix
from reduced_models.machines.response import CoupledSystem, fill_state_rates
from reduced_models.models.export import write_code
from reduced_models.models.fmu import port_jacobian
from reduced_models.models.modelica_code import port_modelica_source
from reduced_models.models.ports import DRIVING, OF_THE_BED, ForcePort, force_port, prepare_port_for_export
from tests.reduced_models.fitting.test_forces import FORCE, sine
from tests.reduced_models.models.test_exports import LAWS, TIMES, close, model_of, with_step

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
needs_fmpy = pytest.mark.skipif(importlib.util.find_spec("fmpy") is None, reason="FMPy is not installed")
MASS = 7.5
SECONDS = 8.0
"""Duration of a machine's motions [s]."""


def port_of(name: str) -> ForcePort:
    """Return the force element of a law with values of its parameters."""
    return force_port(with_step(model_of(name)), MASS)


def imported(path: Path) -> ModuleType:
    """Import an exported module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAIN = """\
#include <stdio.h>
#include "bed.h"
enum { N = 2 + BED_STATES };
static void rates(const double *s, double *r)
{   /* a piston of mass[0] on a cell at rest; the element's last two parameters are mass and load */
    const double *p = bed_parameters, mass = p[BED_PARAMETERS - 2], load = p[BED_PARAMETERS - 1];
    r[0] = s[1];
    r[1] = (bed_force(bed_parameters, s + 2, s) - load) / mass;
    bed_rates(bed_parameters, s + 2, s, r + 2);
}
int main(void)
{
    double s[N] = {START}, r[4][N], m[N];
    for (int k = 2; k < N; k++) s[k] = bed_start[k - 2];
    for (int n = 0; n <= 100; n++) {
        printf("%.17g\\n", s[0]);
        for (int i = 0; i < 100; i++) {
            const double h = 0.02 / 100, w[4] = {0.0, 0.5 * h, 0.5 * h, h};
            for (int stage = 0; stage < 4; stage++) {
                for (int k = 0; k < N; k++) m[k] = stage ? s[k] + w[stage] * r[stage - 1][k] : s[k];
                rates(m, r[stage]);
            }
            for (int k = 0; k < N; k++)
                s[k] += h / 6 * (r[0][k] + 2 * r[1][k] + 2 * r[2][k] + r[3][k]);
        }
    }
    return 0;
}
"""


@needs_gcc
@pytest.mark.parametrize("name", LAWS)
def test_a_piston_on_the_element_exported_to_c_reproduces_the_record(name: str, tmp_path: Path) -> None:
    port = port_of(name)
    assert len(MAIN.splitlines()) <= 30
    write_code(port, tmp_path / "bed.c")
    start = ", ".join(map(repr, port.model.initial))
    program = compiled(tmp_path, MAIN.replace("START", start))
    heights = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    assert close(np.array(heights.split(), dtype=float), with_step(model_of(name)))


@pytest.mark.parametrize("name", LAWS)
def test_the_exported_python_force_equals_the_force_of_the_law(name: str, tmp_path: Path) -> None:
    port = port_of(name)
    write_code(port, tmp_path / "bed.py")
    bed, model = imported(tmp_path / "bed.py"), port.model
    motion = model.simulate(TIMES[:3], z0=0.06, v0=-0.05)
    step = TIMES[1] / 200.0
    fine = model.simulate(np.array([0.0, step, 2.0 * step]), z0=0.06, v0=-0.05)
    assert motion.velocity is not None
    acceleration = (-3.0 * fine.velocity[0] + 4.0 * fine.velocity[1] - fine.velocity[2]) / (2 * step)
    force = bed.force(0.06, -0.05, states=[0.0] * len(prepare_port_for_export(port).states))
    assert force == pytest.approx(MASS * (acceleration + 9.8), rel=1e-4)
    heavier = {**bed.PARAMETERS, "mass": 2.0 * MASS, "load": 0.0}
    assert bed.force(0.06, -0.05, parameters=heavier) == pytest.approx(2 * (force - MASS * 9.8))


DRIVEN = """\
#include <stdio.h>
#include "bed.h"
int main(void)
{   /* reads time, height and velocity; writes the force */
    double states[BED_STATES + 1], inputs[BED_INPUTS], time, last = 0.0;
    for (int k = 0; k < BED_STATES; k++) states[k] = bed_start[k];
    while (scanf("%lf %lf %lf", &time, inputs, inputs + 1) == 3) {
        bed_advance(bed_parameters, states, inputs, time - last);
        last = time;
        printf("%.17g\\n", bed_force(bed_parameters, states, inputs));
    }
    return 0;
}
"""


def compiled(folder: Path, main: str) -> Path:
    """Compile the element in C with a main program, and assert that there are no warnings."""
    (folder / "main.c").write_text(main, "utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1"]
    done = subprocess.run(
        ["gcc", *flags, "main.c", "bed.c", "-o", "main", "-lm"],
        check=False,
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return folder / "main"


def error_of_force(program: Path, record: PistonRecord) -> float:
    """Return the rms difference [N] of a program's force from a record's."""
    rows = np.column_stack([record.time - record.time[0], record.height, record.velocity])
    text = "\n".join(f"{t!r} {z!r} {v!r}" for t, z, v in rows.tolist())
    done = subprocess.run([program], input=text, check=True, capture_output=True, text=True)
    force = np.array(done.stdout.split(), dtype=float)
    return float(np.sqrt(np.mean((force - record.columns["force"]) ** 2)))


@needs_gcc
@pytest.mark.long  # the quick test above covers a piston on the element in C
def test_the_element_exported_to_c_predicts_the_force_of_a_driven_bed(
    small_damper: Scene, tmp_path: Path
) -> None:
    """At 0.8 times the fitted amplitude, the error is at most as large as in the fitted record."""
    scene = small_damper.replace(**{"protocol.release.duration": 0.5})
    record = simulate(scene, dt="auto*4", progress=False).piston()
    fit(record, "linear").export(tmp_path / "bed.c", port="force", mass=scene.piston.mass)
    program, rest = compiled(tmp_path, DRIVEN), float(record.height[-1])
    times, heights = record.time - record.time[0], rest + 0.8 * (record.height - rest)
    drive = {"kind": "follow", "name": "release", "times": times.tolist(), "heights": heights.tolist()}
    driven = simulate(scene.replace(protocol=[scene.protocol[0], drive]), dt="auto*4", progress=False)
    assert error_of_force(program, driven.piston()) <= error_of_force(program, record) < 0.1 * 9.8


def test_the_exported_jacobian_equals_the_derivatives_of_the_force() -> None:
    parts = prepare_port_for_export(bed_force_port(load_scene("damper")))
    rows = port_jacobian(parts)
    assert rows is not None
    values = {"height": 0.058, "velocity": -0.03, "h_w": 0.02, "h_q": 0.4}
    values |= dict(zip(parts.parameters, parts.values, strict=True))

    def at(expression: Any, changed: dict[str, float]) -> float:
        numbers = values | changed
        numbers |= {"z": numbers["height"], "z_first": numbers["velocity"]}
        return float(expression.subs({s: numbers[s.name] for s in expression.free_symbols}))

    force, *rates = parts.outputs
    for row, expression in zip(rows, [*rates, force], strict=True):
        for slope, name in zip(row, [*parts.states, *parts.inputs], strict=True):
            step = 1e-6 * values[name]
            high, low = (at(expression, {name: values[name] + d}) for d in (step, -step))
            assert at(slope, {}) == pytest.approx((high - low) / (2 * step), rel=1e-5, abs=1e-7)


def runge_kutta(
    rates: Callable[[float, np.ndarray], np.ndarray], state: np.ndarray, step: float
) -> np.ndarray:
    """Return the first entry of the state over 8 s, by the classical Runge-Kutta method."""
    result = [state[0]]
    for n in range(int(SECONDS / step)):
        t = n * step
        k1 = rates(t, state)
        k2 = rates(t + step / 2, state + step / 2 * k1)
        k3 = rates(t + step / 2, state + step / 2 * k2)
        k4 = rates(t + step, state + step * k3)
        state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        result.append(state[0])
    return np.array(result)


def two_bodies(fmu: Any, system: CoupledSystem, force: float, omega: float) -> np.ndarray:
    """Return the displacement of the machine, with the bed as an FMU, and masses and spring in Python."""
    inverse, height, velocity, output = np.linalg.inv(mass_matrix(system)), 1000, 1001, 4000

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        fmu.set([height, velocity], y[2:4])
        fmu.set_states(y[4:])
        host = force * math.sin(omega * t) - system.stiffness * y[0] - system.damping * y[1]
        load = system.piston * system.gravity
        accelerations = inverse @ np.array([host, fmu.get([output])[0] - load])
        return np.array([y[1], accelerations[0], y[3], accelerations[1], *fmu.rates()])

    return runge_kutta(rates, np.array([0.0, 0.0, system.rest, 0.0, *fmu.states]), math.tau / omega / 64)


def own_motion(system: CoupledSystem, force: float, omega: float) -> np.ndarray:
    """Return the displacement of the machine by the toolkit's equation with its time steps."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        result = np.zeros(6)
        fill_state_rates(system, force * math.sin(omega * t), y, result)
        return result

    return runge_kutta(rates, np.array([0.0, 0.0, system.rest, 0.0, 0.0, 0.5]), math.tau / omega / 64)


class Exchange:
    """An FMU for model exchange (FMI 2 or 3), run by FMPy."""

    def __init__(self, path: Path, version: int) -> None:
        import fmpy

        description = fmpy.read_model_description(str(path))
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, "ModelExchange")
        self.get = self.fmu.getReal if version == 2 else self.fmu.getFloat64
        self.write = self.fmu.setReal if version == 2 else self.fmu.setFloat64
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.count = description.numberOfContinuousStates
        names = range(self.count)
        self.states = self.get(list(names))

    def set(self, which: list[int], values: np.ndarray) -> None:
        self.write(which, list(values))

    def set_states(self, values: np.ndarray) -> None:
        self.write(list(range(self.count)), list(values))

    def rates(self) -> list[float]:
        return list(self.get([3000 + k for k in range(self.count)]))


@needs_gcc
@needs_fmpy
def test_a_machine_coupled_to_an_fmu_moves_as_in_the_toolkit(tmp_path: Path) -> None:
    from fmpy.validation import validate_fmu

    scene, path = load_scene("machine"), tmp_path / "bed.fmu"
    export_bed(scene, path, fmi=3)
    assert validate_fmu(str(path)) == []
    system, omega = CoupledSystem.from_host_scene(scene), math.tau * 2.85
    machine, ours = two_bodies(Exchange(path, 3), system, 10.0, omega), own_motion(system, 10.0, omega)
    assert np.abs(machine - ours).max() < 1e-4 * np.abs(ours).max()


@needs_gcc
@needs_fmpy
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_has_tunable_parameters_and_directional_derivatives(version: int, tmp_path: Path) -> None:
    port, path = bed_force_port(load_scene("damper")), tmp_path / "bed.fmu"
    write_code(port, path, version)
    bed = Exchange(path, version)
    names = prepare_port_for_export(port).parameters
    bed.set([1000, 1001], np.array([port.model.initial[0], 0.0]))
    assert bed.get([4000])[0] == pytest.approx(port.load, rel=1e-9)
    bed.set([2000 + names.index("mass")], np.array([2.0 * port.mass]))
    bed.set([2000 + names.index("load")], np.array([1.0]))
    assert bed.get([4000])[0] == pytest.approx(1.0, rel=1e-6)
    slope = bed.fmu.getDirectionalDerivative([4000], [1000], [1.0])[0]
    assert slope == pytest.approx(-2.0 * 2.5 * port.load / port.model.initial[0], rel=1e-9)


@needs_gcc
@needs_fmpy
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_states_the_direction_of_its_force(version: int, tmp_path: Path) -> None:
    import fmpy

    driven = force_port(fit(sine(2.0, 0.01, c=100.0), options=FORCE), None)
    for port, words in ((bed_force_port(load_scene("damper")), OF_THE_BED), (driven, DRIVING)):
        path = tmp_path / "bed.fmu"
        write_code(port, path, version)
        found = fmpy.read_model_description(str(path), validate=True).modelVariables
        assert {item.name: item.description for item in found if item.description} == {
            "force": f"force {words}"
        }


def test_a_bed_exported_to_modelica_is_an_element_between_two_flanges() -> None:
    text = port_modelica_source(port_of("van-der-pol-like"), "Bed")
    assert "extends Modelica.Mechanics.Translational.Interfaces.PartialCompliant" in text
    code = re.sub(r'//.*|"[^"\n]*"', "", text)
    words = (
        "model Bed extends Modelica Mechanics Translational Interfaces parameter output Real unit protected"
    )
    known = {
        *words.split(),
        "protected",
        "PartialCompliantWithRelativeStates",
        "equation",
        "end",
        "f",
        "s_rel",
        "v_rel",
    }
    declared = set(re.findall(r"Real (\w+)", code))
    assert set(re.findall(r"[A-Za-z_]\w*", code)) <= known | declared
    assert "**" not in code


def test_an_exported_force_element_requires_the_mass_of_the_piston() -> None:
    with pytest.raises(InputError, match="give the mass of the recorded piston"):
        force_port(model_of("linear"), None)
    assert force_port(model_of("linear"), MASS).mass == MASS


def test_a_derived_law_cannot_be_exported_as_a_force_element() -> None:
    with pytest.raises(InputError, match="the force of a derived law includes the bed's moving mass"):
        force_port(model_of("derived"), MASS)
