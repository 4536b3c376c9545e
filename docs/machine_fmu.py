"""The packaged machine with its bed as an FMU, coupled by FMPy, compared with the toolkit's law.

python docs/machine_fmu.py [HZ ...]

This script contains the masses, the spring and the force. The bed between them is the FMU written by
`export_bed`: its inputs are height and velocity of the piston, its output is the force, and it has two hidden
states. Any tool that integrates FMUs for model exchange can do the same.
"""

from __future__ import annotations

import math
import sys
import tempfile
from pathlib import Path

import fmpy
import numpy as np
from scipy.integrate import solve_ivp

from granular import load_scene
from reduced_models.machines import export_bed, predicted_response
from reduced_models.machines.design import mass_matrix
from reduced_models.machines.response import MEASURED, SETTLING, CoupledSystem

FORCE = 10.0
"""Amplitude of the sinusoidal force on the machine [N]."""


def machine_amplitude(path: Path, system: CoupledSystem, frequency: float) -> float:
    """Amplitude of the machine [m] under a sinusoidal force of a frequency [Hz], with the bed's FMU."""
    description = fmpy.read_model_description(str(path))
    bed = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, "ModelExchange")
    bed.enterInitializationMode()
    bed.exitInitializationMode()
    number = {variable.name: variable.valueReference for variable in description.modelVariables}
    states = [number[name[4:-1]] for name in number if name.startswith("der(")]
    slopes = [number[name] for name in number if name.startswith("der(")]
    inverse, omega = np.linalg.inv(mass_matrix(system)), math.tau * frequency

    def rates(t: float, y: np.ndarray) -> list[float]:
        """Time derivatives of displacement and velocity of machine and piston, and of the bed's states."""
        bed.setReal([number["height"], number["velocity"], *states], y[2:].tolist())
        machine = FORCE * math.sin(omega * t) - system.stiffness * y[0] - system.damping * y[1]
        piston = bed.getReal([number["force"]])[0] - system.piston * system.gravity
        accelerations = inverse @ np.array([machine, piston])
        return [y[1], accelerations[0], y[3], accelerations[1], *bed.getReal(slopes)]

    end = math.ceil(SETTLING * frequency) / frequency
    last = math.floor(MEASURED * SETTLING * frequency)  # an integer number of periods
    times = end - last / frequency + np.arange(64 * last) / (64 * frequency)
    start = [0.0, 0.0, system.rest, 0.0, *bed.getReal(states)]
    moved = solve_ivp(rates, (0.0, end), start, t_eval=times, rtol=1e-8, atol=1e-10, max_step=0.01)
    bed.terminate()
    return float(2.0 * abs(np.mean(moved.y[0] * np.exp(1j * omega * times))))


def main(words: list[str]) -> None:
    """Print the machine's amplitude with the FMU and by the law at each frequency."""
    frequencies = [float(word) for word in words] or [2.75, 2.85, 2.95]
    scene = load_scene("machine")
    law = predicted_response(scene, frequencies, FORCE).displacement
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bed.fmu"
        export_bed(scene, path)
        for frequency, own in zip(frequencies, law, strict=True):
            fmu = machine_amplitude(path, CoupledSystem.from_host_scene(scene), frequency)
            print(f"{frequency:g} Hz: {1e3 * fmu:.3f} mm with the FMU, {1e3 * own:.3f} mm by the law")


if __name__ == "__main__":
    main(sys.argv[1:])
