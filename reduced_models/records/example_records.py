"""Write example records in the formats of instruments, each with a ``record.toml`` that describes it.

All except the record of the real pendulum are simulated: the motion follows from a law with known
parameters, given in `EXAMPLES`, and noise from a seed is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granular.records.options import ReadOptions, write_record_description
from granular.shared.errors import InputError
from granular.shared.files import write_text
from reduced_models.records.sources import make_directory, shortened_path_text


class ExampleRecord(NamedTuple):
    """Example record on which users can try the commands."""

    columns: Callable[[np.random.Generator], dict[str, np.ndarray]] | Path
    options: Mapping[str, Any]
    truth: str  # law and parameters of the motion


def write_example_records(out: str | Path) -> dict[str, str]:
    """Write the records of `EXAMPLES`, each as a CSV file and a description (TOML)."""
    directory = make_directory(out)
    files = {name: directory / f"{name}.csv" for name in EXAMPLES}
    for path in (*files.values(), *(path.with_suffix(".toml") for path in files.values())):
        if path.exists():
            raise InputError(
                f"{path.name} already exists in {shortened_path_text(directory)}, and files are not "
                "overwritten; give another directory (-o)"
            )
    for seed, (name, example) in enumerate(EXAMPLES.items()):
        if isinstance(example.columns, Path):
            write_text(files[name], example.columns.read_text(encoding="utf-8"))
        else:
            columns = example.columns(np.random.default_rng(seed))
            rows = zip(*columns.values(), strict=True)
            lines = [",".join(columns), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
            write_text(files[name], "\n".join([*lines, ""]))
        options = ReadOptions(**example.options)
        write_record_description(files[name].with_suffix(".toml"), files[name], options)
    return {files[name].name: example.truth for name, example in EXAMPLES.items()}


def _oscillation_after_release(time: np.ndarray, frequency: float, ratio: float) -> np.ndarray:
    """Free oscillation of a linear oscillator that is held at 1 and released at time 0."""
    since = np.maximum(time, 0.0)
    omega = 2.0 * math.pi * frequency
    damped = omega * math.sqrt(1.0 - ratio**2)
    decay = np.exp(-ratio * omega * since)
    sine = ratio * omega / damped * np.sin(damped * since)
    return np.asarray(decay * (np.cos(damped * since) + sine))


def _simulate_lvdt_columns(random: np.random.Generator) -> dict[str, np.ndarray]:
    time = np.arange(0.0, 3.4, 0.002)
    height = 4.0 * _oscillation_after_release(time - 0.4, 4.1, 0.05) + random.normal(0.0, 0.02, len(time))
    return {"time [s]": time, "lvdt [V]": 2.513 + height / 2.4894}


def _simulate_encoder_columns(random: np.random.Generator) -> dict[str, np.ndarray]:
    from scipy.integrate import solve_ivp

    time = np.arange(0.0, 20.0, 0.01)

    def pendulum(_time: float, state: np.ndarray) -> tuple[float, float]:
        return state[1], -0.1 * state[1] - 30.0 * math.sin(state[0])

    angle = solve_ivp(pendulum, (0.0, 20.0), (1.2, 0.0), t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    dither = random.uniform(-0.5, 0.5, len(time))
    counts = np.round(1024.0 + angle * 2048.0 / (2.0 * math.pi) + dither)
    return {"time [ms]": 1e3 * time, "encoder [counts]": counts}


def _simulate_accelerometer_columns(random: np.random.Generator) -> dict[str, np.ndarray]:
    time = np.arange(0.0, 4.0, 0.001)
    omega, displacement = 2.0 * math.pi * 6.0, 3e-3 * _oscillation_after_release(time, 6.0, 0.03)
    acceleration = -(omega**2 * displacement + 0.06 * omega * np.gradient(displacement, time)) / 9.80665
    return {
        "time [s]": time,
        "laser [mil]": (60e-3 + displacement + random.normal(0.0, 5e-6, len(time))) / 2.54e-5,
        "accelerometer [g]": acceleration + random.normal(0.0, 0.002, len(time)),
    }


def _simulate_driven_oscillation_columns(random: np.random.Generator) -> dict[str, np.ndarray]:
    from scipy.signal import lsim

    time = np.arange(0.0, 12.0, 0.004)
    force = 6.0 * np.sin(2.0 * math.pi * (1.5 + 0.25 * time) * time)
    omega = 2.0 * math.pi * 4.1
    _, displacement, _ = lsim(([1.0 / 7.5], [1.0, 0.1 * omega, omega**2]), force, time)
    height = 60e-3 + displacement + random.normal(0.0, 1e-5, len(time))
    return {"time [s]": time, "height [mm]": 1e3 * height, "force [N]": force}


def _simulate_force_stroke_columns(random: np.random.Generator) -> dict[str, np.ndarray]:
    time = np.arange(0.0, 4.0, 0.002)
    phase = 2.0 * math.pi * 1.5 * time
    stroke, speed = 10e-3 * np.sin(phase), 10e-3 * 2.0 * math.pi * 1.5 * np.cos(phase)
    force = 120.0 * speed + 900.0 * stroke + random.normal(0.0, 0.05, len(time))
    return {"time [s]": time, "stroke [mm]": 1e3 * stroke, "load cell [lbf]": force / 4.4482216}


PLATFORM = {"mass": 2.0e7, "B1": 2.4e5, "B2": 1.2e6, "period": 22.0}
"""Platform in heave: mass including added mass [kg], linear damping B1 [N s/m], quadratic damping B2
[N s^2/m^2], and period [s]."""


def simulate_platform_decay(
    amplitude: float, random: np.random.Generator, noise: float = 0.02
) -> dict[str, np.ndarray]:
    """Return time [s] and heave [m] of a simulated decay test of a platform, with noise and drift.

    The noise is a fraction of the amplitude [m]; the zero drifts by 3 cm within a quarter of an hour.
    """
    from scipy.integrate import solve_ivp

    mass, b1, b2, period = PLATFORM.values()
    stiffness = mass * (2.0 * math.pi / period) ** 2

    def rates(_time: float, state: np.ndarray) -> tuple[float, float]:
        height, speed = state
        return speed, -(b1 * speed + b2 * abs(speed) * speed + stiffness * height) / mass

    time = np.arange(0.0, 240.0, 0.1)
    heave = solve_ivp(rates, (0.0, 240.0), (amplitude, 0.0), t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    drift = 0.03 * np.sin(2.0 * math.pi * time / 900.0 + random.uniform(0.0, 2.0 * math.pi))
    return {"time [s]": time, "heave [m]": heave + drift + random.normal(0.0, noise * amplitude, len(time))}


def _platform_record(amplitude: float) -> ExampleRecord:
    """Return the example record of a decay test of the platform, released at an amplitude [m]."""
    return ExampleRecord(
        lambda random: simulate_platform_decay(amplitude, random),
        {},
        f"heave of a platform released at {amplitude:g} m: period 22 s, damping B1 = 2.4e5 N s/m and "
        "B2 = 1.2e6 N s^2/m^2, mass 2e7 kg with added mass",
    )


DYNAMOMETER = {"c": 600.0, "k": 4000.0, "friction": 90.0, "rho": 1500.0, "sigma": 1.0, "zero": 0.0}
"""Parameters of the simulated damper on a dynamometer: law ``bouc-wen``, SI units."""
DYNAMOMETER_TESTS = {"slow": (0.5, 0.010), "medium": (2.0, 0.005), "fast": (8.0, 0.002)}
"""Frequency [Hz] and amplitude [m] of the tests of this damper."""


def simulate_dynamometer_test(
    frequency: float, amplitude: float, random: np.random.Generator, noise: float = 0.01
) -> dict[str, np.ndarray]:
    """Return time [s], stroke [m] and force [N] of four cycles of the simulated damper, with noise.

    The frequency is in Hz, the amplitude in m; the noise is a fraction of the rms force.
    """
    from scipy.integrate import solve_ivp

    c, k, friction, rho, sigma, _ = DYNAMOMETER.values()
    omega, duration = 2.0 * math.pi * frequency, 4.0 / frequency

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        speed = amplitude * omega * math.cos(omega * time)
        slip = sigma * abs(speed) * np.abs(state) * state + (1.0 - sigma) * speed * state**2
        return np.asarray(rho * (speed - slip))

    time = np.linspace(0.0, duration, 1600, endpoint=False)
    hysteresis = solve_ivp(rate, (0.0, duration), (0.0,), t_eval=time, rtol=1e-8, atol=1e-10).y[0]
    stroke, speed = amplitude * np.sin(omega * time), amplitude * omega * np.cos(omega * time)
    force = c * speed + k * stroke + friction * hysteresis
    force = force + random.normal(0.0, noise * float(np.sqrt(np.mean(force**2))), len(time))
    return {"time [s]": time, "stroke [m]": stroke, "force [N]": force}


def _dynamometer_record(frequency: float, amplitude: float) -> ExampleRecord:
    """Return the example record of a dynamometer test at a frequency [Hz] and an amplitude [m]."""

    def columns(random: np.random.Generator) -> dict[str, np.ndarray]:
        time, stroke, force = simulate_dynamometer_test(frequency, amplitude, random).values()
        return {"time [s]": time, "lvdt [mm]": 1e3 * stroke, "cell [N]": force}

    return ExampleRecord(
        columns,
        {"columns": {"stroke": "lvdt", "force": "cell"}},
        f"a damper moved by {1e3 * amplitude:g} mm at {frequency:g} Hz: 600 N s/m, 4000 N/m, and 90 N of "
        "friction (bouc-wen)",
    )


RING_DOWN = {"frequency": 10.07, "damping_ratio": 1e-4, "amplitude": 1e-4}
"""Simulated resonator: frequency [Hz], damping ratio, and amplitude at the start [m]."""


def simulate_ring_down(
    random: np.random.Generator,
    duration: float = 120.0,
    rate: float = 50.0,
    noise: float = 0.01,
    drift: float = 0.2,
    detuning: float = 0.0,
) -> dict[str, np.ndarray]:
    """Return time [s] and displacement [m] of the simulated resonator.

    The sampling rate is in Hz. Noise and the drift of the zero within 120 s are fractions of the amplitude;
    the detuning is the relative change of the frequency within 120 s.
    """
    frequency, ratio, amplitude = RING_DOWN.values()
    omega, time = 2.0 * math.pi * frequency, np.arange(0.0, duration, 1.0 / rate)
    phase = omega * time * (1.0 + 0.5 * detuning * time / 120.0)
    motion = np.exp(-ratio * omega * time) * np.cos(phase) + drift * (1.0 - np.exp(-time / 60.0))
    displacement = amplitude * (motion + random.normal(0.0, noise, len(time)))
    return {"time [s]": time, "displacement [m]": displacement}


def _simulate_ring_down_columns(random: np.random.Generator) -> dict[str, np.ndarray]:
    time, displacement = simulate_ring_down(random).values()
    return {"time [s]": time, "displacement [um]": 1e6 * displacement}


EXAMPLES = {
    "lvdt": ExampleRecord(
        _simulate_lvdt_columns,
        {"scale": "2.4894 mm/V", "zero": "2.513 V"},
        "a linear oscillation of 4.1 Hz and 5 % damping, released after 0.4 s",
    ),
    "encoder": ExampleRecord(
        _simulate_encoder_columns,
        {"scale": "360 deg/2048 counts", "zero": "1024 counts"},
        "a pendulum, theta'' + 0.1*theta' + 30*sin(theta) = 0, released at 1.2 rad",
    ),
    "accelerometer": ExampleRecord(
        _simulate_accelerometer_columns,
        {"columns": {"height": "laser"}},
        "a linear oscillation of 6 Hz and 3 % damping about 60 mm, with its acceleration",
    ),
    "driven": ExampleRecord(
        _simulate_driven_oscillation_columns,
        {},
        "a mass of 7.5 kg driven by a force: 4.1 Hz and 5 % damping about 60 mm",
    ),
    "force-stroke": ExampleRecord(
        _simulate_force_stroke_columns,
        {"columns": {"stroke": "stroke", "force": "load cell"}},
        "a damper moved at 1.5 Hz: 120 N s/m times the velocity and 900 N/m times the stroke",
    ),
    # The board divided the 4000 counts of a turn by 360 as integers: its degrees are 11 counts.
    "pendulum": ExampleRecord(
        Path(__file__).with_name("pendulum.csv"),
        {
            "skip": 27,
            "rate": "1000 Hz",
            "columns": {"angle": 1},
            "scale": "3960 deg/4000 deg",
            "between": (0.15, 5.0),
        },
        "a real pendulum with dry friction, as published; the file gives source and licence",
    ),
    **{f"platform-{amplitude}m": _platform_record(amplitude) for amplitude in (1, 2, 4)},
    **{f"dynamometer-{name}": _dynamometer_record(*test) for name, test in DYNAMOMETER_TESTS.items()},
    "ring-down": ExampleRecord(
        _simulate_ring_down_columns,
        {},
        "a resonator of 10.07 Hz with a damping ratio of 1e-4; its zero drifts",
    ),
}
"""Example records by file name."""
