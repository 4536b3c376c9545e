"""Redraw the pictures of the README and the guide: ``python docs/pictures.py [NAME ...]``."""

from __future__ import annotations

import base64
import datetime
import functools
import io
import itertools
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import textwrap
import tomllib
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from compared import lammps_comparison, pysindy_comparison
from magpylib_compared import disc_deviations, free_magnets, magpylib_forces, positions, times_and_deviations
from matplotlib.patches import Rectangle
from measured import averaging, discs_over_dipoles, falls, head_on_steps, magnets_compared_with_dipoles
from scipy.signal import butter, lfilter

from granular import PistonRecord, Scene, Trajectory, damper, evaluate, load_scene, mono_bed
from granular import simulate as simulated
from granular.linear import small_motions, transmissibility
from granular.linear.page import plot_mode, plot_transmissibility
from granular.observables import per_distance, radial_distribution, track_defects
from granular.observables.plots import plot_correlation_function, plot_defect_paths
from granular.render import movie, save_picture, still
from granular.response import frequency_response
from granular.run.work_precision import FLOORS, SceneWorkPrecision, packing_count_to_average
from granular.run.work_precision import load_work_precision_scenes as prices
from granular.schema.natural_units import Scales
from granular.shared.plotting import COLOURS, GREY, figure, line_style
from granular.studies.silo import silo
from reduced_models import Parameter, design, fit, predict, whole_fall
from reduced_models.falls.predicted_law import lattice_under_piston_weight
from reduced_models.machines import design_for, predicted_response
from reduced_models.machines.response import CoupledSystem, LinearOscillator, solve_host_response
from reduced_models.records.backbone import backbone_of_free_oscillation
from reduced_models.records.example_records import (
    DYNAMOMETER_TESTS,
    PLATFORM,
    RING_DOWN,
    simulate_dynamometer_test,
    simulate_platform_decay,
    simulate_ring_down,
)
from research.published.judging import judge_all_entries
from research.published.results import read_committed_results
from validation import convergence, exact_problem, hard_case_catalogue, run_hard_case
from validation.hard_case_outcomes import ACCURATE, DEGRADED, STOPPED
from validation.overview import effect_costs
from validation.work_precision_result import duration_text

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
DISCOVERY = DOCS / "results" / "discovery.md"
OTHERS = DOCS / "results" / "other-tools.md"
DIAMETER = 0.006
GRAVITY = 9.8


@functools.cache
def damper_run() -> Trajectory:
    """The packaged damper: fall, lift, oscillation."""
    return simulated(damper())


@functools.cache
def compressed_run() -> Trajectory:
    """A bed compressed to its maximum."""
    scene = mono_bed(368, speed=33e-3, relaxation=1.0)
    return simulated(scene.replace(protocol=scene.to_plain()["protocol"][:2]))


def keep(drawing: Any, name: str) -> None:
    save_picture(drawing, IMAGES / f"{name}.png", overwrite=True)


def draw_motion() -> None:
    """The fall in real time, as made by ``granular run`` and ``granular render``."""
    run = simulated(damper().replace(**{"output.frames": "5 ms"}), t_end=2.5)
    movie(run, IMAGES / "fall.gif", colour="speed", fps=20.0, width=760, overwrite=True)


def draw_damper() -> None:
    """The bed 0.2 s after release of the piston."""
    keep(still(damper_run(), 2, colour="speed"), "damper")


def draw_fall() -> None:
    """The fall, and the oscillation after the lift with the law fitted to its first two thirds."""
    run = damper_run()
    drop, oscillation = run.piston("drop").with_time_from_zero(), run.piston("release").with_time_from_zero()
    shown = oscillation.between(0.0, 4.0)
    model = fit(shown, law="polynomial-spring", test_fraction=0.0)
    predicted = model.simulate(oscillation.time)
    with figure(1, 2, width=9.0, height=3.0) as (drawing, (fall_axes, oscillation_axes)):
        fall_axes.plot(drop.time, drop.height / DIAMETER, color=COLOURS[0])
        fall_axes.set(xlabel="time [s]", ylabel="height of the piston [D]", xlim=(0.0, 4.0))
        fall_axes.set_title("the fall from 20 D", fontsize=10)
        oscillation_axes.plot(
            oscillation.time, oscillation.height / DIAMETER, color=GREY, linewidth=3, label="simulated"
        )
        oscillation_axes.plot(
            oscillation.time, predicted.height / DIAMETER, color=COLOURS[1], linewidth=1, label="its equation"
        )
        oscillation_axes.axvline(shown.time[-1], color=GREY, linestyle=":")
        oscillation_axes.set(xlabel="time [s]", xlim=(0.0, 6.0))
        oscillation_axes.set_title(
            "lifted by 0.2 D and released; fitted left of the dotted line", fontsize=10
        )
        oscillation_axes.legend()
        keep(drawing, "fall")


def draw_theory() -> None:
    """Force of the bed against height, and energy losses, compared with theory."""
    scene, data = damper(), damper_run().dataset
    chosen = data["time"] < 2.0
    time = data["time"].values[chosen]
    height, speed, force, loss = (
        data[name].values[chosen]
        for name in ("piston_height", "piston_velocity", "piston_force", "drag_loss")
    )
    grains, piston, drag = scene.grains, scene.piston, scene.effects.drag
    assert piston is not None
    assert piston.mass is not None
    assert drag is not None
    weight = piston.mass * GRAVITY
    affine = grains.count * drag.coefficient / 3.0
    rest = lattice_height(scene)
    turns = np.flatnonzero((speed[:-1] < 0.0) & (speed[1:] >= 0.0))
    step = float(time[1] - time[0])
    taken = np.diff(loss[turns])
    expected = [affine * step * float(np.sum(speed[a:b] ** 2)) for a, b in itertools.pairwise(turns)]
    ratios = taken / np.array(expected)
    with figure(1, 2, width=9.0, height=3.4) as (drawing, (left, right)):
        for name, way, colour in (("down", speed < 0.0, 0), ("up", speed >= 0.0, 1)):
            left.plot(
                1e3 * height[way],
                force[way],
                ".",
                color=COLOURS[colour],
                markersize=2.0,
                label=f"on the way {name}",
            )
        line = np.geomspace(height.min(), height.max(), 50)
        left.plot(
            1e3 * line,
            weight * (rest / line) ** 2.5,
            color="black",
            linewidth=1.2,
            label="lattice: height$^{-2.5}$",
        )
        left.set(
            xscale="log",
            yscale="log",
            xlabel="height of the piston [mm]",
            ylabel="force on it [N]",
            xticks=[40, 60, 80, 100, 120],
        )
        left.set_xticklabels(["40", "60", "80", "100", "120"])
        left.minorticks_off()
        left.set_ylim(bottom=5.0)
        left.legend(markerscale=4.0)
        right.plot(np.arange(1, len(ratios) + 1), ratios, "o-", color=COLOURS[0])
        right.axhline(1.0, color="black", linewidth=1.2)
        right.set(xlabel="cycle after the fall", ylabel="energy lost over affine loss", ylim=(0.0, None))
        keep(drawing, "theory")
    at_rest = fit(damper_run().piston(), law="polynomial-spring").at_rest
    told = predict(scene).at_rest
    assert at_rest is not None
    assert told is not None
    assert at_rest.damping_ratio is not None
    omega = math.sqrt(2.5 * GRAVITY / rest)
    ratio = affine / (2.0 * piston.mass * 2.0 * math.pi / at_rest.period)
    rows = [
        "| packaged damper | derived above | simulated |",
        "|---|---|---|",
        f"| equilibrium height | {rest / DIAMETER:.2f} D | {at_rest.height / DIAMETER:.2f} D |",
        f"| frequency if the bed re-packs | {omega / (2.0 * math.pi):.2f} Hz | |",
        f"| frequency with the shear modulus of falling beds | {1.0 / told.period:.2f} Hz "
        f"| {1.0 / at_rest.period:.2f} Hz |",
        f"| damping ratio by affine drag | {ratio:.4f} | {at_rest.damping_ratio:.4f} |",
        f"| loss over affine loss, cycles 1 to {len(ratios)} | 1 "
        f"| {', '.join(f'{one:.2f}' for one in ratios)} |",
    ]
    write_block("theory", "\n".join([*rows, ""]), DOCS / "guide" / "theory.md")


def lattice_height(scene: Scene) -> float:
    """Height at which the triangular lattice supports the piston [m]."""
    return scene.grains.count * DIAMETER**2 / (scene.cell.width * lattice_under_piston_weight(scene).density)


def draw_effects() -> None:
    """Forces of pairs and walls against distance, computed by `evaluate`."""
    distances = np.linspace(0.8, 4.0, 60)
    base = load_scene("bed").replace(
        **{
            "grains.count": 2,
            "cell.width": "40 D",
            "piston.height": "40 D",
            "arrangement.height": "39 D",
            "effects.gravity": None,
            "effects.drag": None,
        }
    )
    free = dict.fromkeys(("left", "right", "top"), "none")
    with figure(width=7.0, height=3.4) as (drawing, axes):
        pair = [
            np.abs(
                evaluate(
                    base.replace(**{"effects.walls": None}),
                    np.array([[15.0, 20.0], [15.0 + r, 20.0]]) * DIAMETER,
                    piston_height=40 * DIAMETER,
                ).force[0, 0]
            )
            for r in distances
        ]
        axes.plot(distances, pair, color=COLOURS[0], label="two grains, distance of the centres")
        for colour, law in enumerate(("experimental", "infinite", "slab"), 1):
            scene = base.replace(**{"effects.walls": {**free, "bottom": law}})
            walls = [
                evaluate(
                    scene, np.array([[10.0, w], [30.0, w]]) * DIAMETER, piston_height=40 * DIAMETER
                ).wall_forces["bottom"]
                / 2.0
                for w in distances
            ]
            style = "--" if law == "slab" else "-"
            axes.plot(distances, walls, style, color=COLOURS[colour], label=f"wall, {law}")
        weight = 6.2498e-4 * GRAVITY
        axes.axhline(weight, color=GREY, linestyle=":", label="weight of a grain")
        axes.set(yscale="log", xlabel="distance [D]", ylabel="force [N]")
        axes.legend()
        keep(drawing, "effects")


def draw_eddy() -> None:
    """Damping ratio of the damper in oil and over copper, against the drag of a single grain."""
    plates = {"conductivity": "59.6 MS/m", "thickness": "1 mm", "distance": "4 mm", "plates": 2}
    scene = damper().replace(**{"effects.drag": None, "effects.eddy": plates})
    unit = scene.effects.eddy.dipole_drag_coefficient(Scales.from_grains(scene.grains))
    drags = (0.1, 0.2)
    with figure(width=7.0, height=3.2) as (drawing, axes):
        for place, (label, mutual) in enumerate(
            (("oil", None), ("copper, each grain separately", False), ("copper, with neighbours", True))
        ):
            ratios = []
            for drag in drags:
                made = scene.replace(
                    **{"effects.eddy.thickness": 1e-3 * drag / unit, "effects.eddy.mutual": mutual}
                )
                if mutual is None:
                    made = damper().replace(**{"effects.drag.coefficient": drag})
                law = fit(simulated(made, progress=False).piston("release"), "linear")
                rate, frequency = law.parameters["lam"], law.parameters["omega"]
                print(label, drag, f"{rate:.3f} 1/s")
                ratios.append(100.0 * rate / frequency)
            axes.plot((0.0, *drags), (0.0, *ratios), "o-", color=COLOURS[place], label=label)
        axes.set(xlabel="drag of a single grain [kg/s]", ylabel="damping ratio [%]")
        axes.legend()
        keep(drawing, "eddy")


def draw_methods() -> None:
    """Error of four methods against time step, for a grain oscillating about its equilibrium."""
    names = ("symplectic-euler", "stormer-verlet", "blanes-moan-4", "blanes-moan-6")
    slopes = []
    with figure(width=7.0, height=3.4) as (drawing, axes):
        for place, name in enumerate(names):
            found = convergence(exact_problem("oscillation"), name)
            assert found.fit is not None
            slopes.append(f"{found.fit.value:.2f}")
            axes.plot(
                1e3 * np.array(found.steps),
                found.errors,
                "o-",
                color=COLOURS[place],
                markersize=3.0,
                label=f"{name}, order {found.order}",
            )
        axes.set(xscale="log", yscale="log", xlabel="time step [ms]", ylabel="maximum error [m]")
        axes.legend()
        keep(drawing, "methods")
    measured = f"{', '.join(slopes[:-1])} and {slopes[-1]} for methods of order 1, 2, 4 and 6"
    words = f"- Orders measured on a grain that oscillates about equilibrium: {measured}"
    write_block("methods", words, DOCS / "results" / "verification.md")


def draw_pairs() -> None:
    """Error of the pressure due to a cut-off: virial of the pairs within a radius relative to all pairs."""
    places = compressed_run().dataset["position"].values[-1] / DIAMETER
    first, second = np.triu_indices(len(places), 1)
    distances = np.linalg.norm(places[first] - places[second], axis=1)
    radii = np.linspace(3.0, 40.0, 150)
    virial = distances**-3.0
    off = [100.0 * (float(virial[distances < one].sum() / virial.sum()) - 1.0) for one in radii]
    with figure(width=7.0, height=3.2) as (drawing, axes):
        axes.plot(radii, off, color=COLOURS[1], label="pairs within the cut-off")
        axes.axhline(0.0, color=COLOURS[0], label="every pair, or the mesh")
        axes.axvline(11.26, color=GREY, linestyle=":", label="de Paula (2025): 11.26 D")
        axes.set(xlabel="cut-off [D]", ylabel="pressure by pairs [% off]")
        axes.legend()
        keep(drawing, "pairs")


def draw_observables() -> None:
    """The pair distribution of a bed at full compression."""
    run = compressed_run()
    last = float(run.dataset["frame_time"].values[-1])
    axes = plot_correlation_function(per_distance(run, radial_distribution, start=last))
    drawing: Any = axes.figure
    drawing.set_size_inches(7.0, 3.2)
    keep(drawing, "distribution")
    keep(still(compressed_run(), -1, colour="sides"), "compressed")


def draw_studies() -> None:
    """Equilibrium height of small dampers against the mass of the piston."""
    masses, seeds = (2.0, 2.75, 3.75, 5.0), (1, 2, 3)
    drop = [{"kind": "free", "name": "drop", "duration": 4.0}]
    heights = [
        [
            simulated(
                damper(count=92, mass=mass).replace(
                    **{"arrangement.seed": seed, "protocol": drop, "output.record": "drop"}
                )
            )
            .piston()
            .height[-1]
            / DIAMETER
            for seed in seeds
        ]
        for mass in masses
    ]
    with figure(width=7.0, height=3.2) as (drawing, axes):
        for mass, some in zip(masses, heights, strict=True):
            axes.plot([mass] * len(some), some, "o", color=COLOURS[0])
        line = np.linspace(masses[0], masses[-1], 50)
        middle = float(np.mean(heights[2]))
        axes.plot(
            line, middle * (line / masses[2]) ** -0.4, color="black", label="mass$^{-0.4}$, lattice theory"
        )
        axes.set(xlabel="mass of the piston [kg]", ylabel="equilibrium height [D]")
        axes.legend()
        keep(drawing, "studies")


def draw_record() -> None:
    """A record with noise and a gap, the law fitted to it, and the residual."""
    record = noisy(damper_run().piston().with_time_from_zero().between(0.0, 4.0))
    model = fit(record, law="polynomial-spring")
    drawing: Any = model.plot(record).figure
    drawing.set_size_inches(7.0, 4.2)
    keep(drawing, "record")


def noisy(record: PistonRecord) -> PistonRecord:
    """The record as measured by a sensor with 20 µm noise, with a gap."""
    seen = (record.time < 1.2) | (record.time > 1.5)
    errors = np.random.default_rng(1).normal(0.0, 20e-6, len(record))
    return PistonRecord(record.time[seen], (record.height + errors)[seen])


def draw_pendulum() -> None:
    """A pendulum released at two radians, fitted by a linear law and by the pendulum equation."""
    times = np.linspace(0.0, 20.0, 1000)
    start = PistonRecord(times, 2.0 * np.exp(-0.1 * times) * np.cos(1.3 * times))
    true = fit(start, "z'' + c*z' + k*sin(z) = 0", parameters={"c": 0.2, "k": 2.0}).simulate(times)
    errors = np.random.default_rng(2).normal(0.0, 0.02, len(times))
    record = PistonRecord(times, true.height + errors)
    with figure(width=7.0, height=3.2) as (drawing, axes):
        axes.plot(times, record.height, ".", color=GREY, markersize=2.5, label="record")
        for place, (name, law) in enumerate(
            (("linear", "linear"), ("pendulum", "z'' + c*z' + k*sin(z - rest) = 0"))
        ):
            model = fit(record, law)
            axes.plot(times, model.simulate(times).height, color=COLOURS[1 - place], label=name)
        axes.set(xlabel="time [s]", ylabel="angle [rad]")
        axes.legend()
        keep(drawing, "pendulum")


def draw_decay_tests() -> None:
    """Decay tests of the made platform with the fitted law, and the log decrement of each cycle."""
    mass = PLATFORM["mass"]
    records = [
        PistonRecord(*simulate_platform_decay(amplitude, np.random.default_rng(seed)).values())
        for seed, amplitude in enumerate((1, 2, 4), start=6)
    ]
    law = f"{mass:g}*z'' + B1*z' + B2*z'*Abs(z') + K*(z - rest) = 0"
    models = fit(records, law, parameters={"rest": Parameter(per_record=True)})
    with figure(1, 2, width=9.0, height=3.4) as (drawing, (left, right)):
        for index, (record, model) in enumerate(zip(records, models, strict=True)):
            left.plot(record.time, record.height, ".", color=GREY, markersize=1.5)
            motion = model.simulate(record.time, z0=record.height[0], v0=0.0)
            left.plot(motion.time, motion.height, color=COLOURS[index], label=f"from {2**index} m")
            measured = backbone_of_free_oscillation(record)
            decrement, error = 2.0 * np.pi * measured.damping_ratio, 2.0 * np.pi * measured.damping_error
            right.errorbar(measured.amplitude, decrement, error, fmt="o", color=COLOURS[index], markersize=3)
        values = models[0].parameters
        omega = math.sqrt(values["K"] / mass)
        amplitudes = np.linspace(0.0, 4.0, 2)
        line = np.pi * values["B1"] / (mass * omega) + 8.0 * values["B2"] / (3.0 * mass) * amplitudes
        right.plot(amplitudes, line, color=GREY, label="p + q A, from B1 and B2")
        left.set(xlabel="time [s]", ylabel="heave [m]")
        right.set(xlabel="amplitude A [m]", ylabel="log decrement", ylim=(0.0, None))
        left.legend()
        right.legend()
        keep(drawing, "decay-tests")


def draw_dynamometer() -> None:
    """Force-stroke loops of the simulated damper with the fitted law, and the energy of a cycle."""
    records = [
        PistonRecord(time, stroke, force=force, measured="force")
        for seed, test in enumerate(DYNAMOMETER_TESTS.values(), start=9)
        for time, stroke, force in [simulate_dynamometer_test(*test, np.random.default_rng(seed)).values()]
    ]
    model, *_ = fit(records, "bouc-wen")
    with figure(1, 2, width=9.0, height=3.4) as (drawing, (left, right)):
        for index, (record, (frequency, amplitude)) in enumerate(
            zip(records, DYNAMOMETER_TESTS.values(), strict=True)
        ):
            name = f"{frequency:g} Hz, {1e3 * amplitude:g} mm"
            last = record.time >= 3.0 / frequency
            left.plot(1e3 * record.height[last], record.columns["force"][last], ".", color=GREY, markersize=2)
            force = model.simulate_signal(record)
            left.plot(1e3 * record.height[last], force[last], color=COLOURS[index], label=name)
            omega, amplitudes = 2.0 * math.pi * frequency, np.geomspace(1e-3, 1e-2, 12)
            energy = [model.harmonic_cycle(size, omega).energy for size in amplitudes]
            right.plot(1e3 * amplitudes, energy, color=COLOURS[index], label=f"law, {frequency:g} Hz")
        for cycle in model.cycles:
            right.plot(1e3 * cycle.amplitude, cycle.energy, "ko", markersize=5)
        left.set(xlabel="stroke [mm]", ylabel="force [N]", xticks=range(-10, 11, 5), ylim=(-170.0, 290.0))
        right.set(xlabel="amplitude [mm]", ylabel="energy per cycle [J]", xscale="log", yscale="log")
        right.set_xticks([1, 2, 5, 10], ["1", "2", "5", "10"])
        right.set_yticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
        right.minorticks_off()
        left.legend(loc="upper left")
        right.legend(title="points: measured")
        keep(drawing, "dynamometer")


def draw_ring_down() -> None:
    """Ring-down of the simulated resonator, the interval of its damping, and its limits."""
    motion, rate = RING_DOWN, 50.0
    omega, amplitude = 2.0 * math.pi * motion["frequency"], motion["amplitude"]
    size, decay = 1e6 * amplitude, motion["damping_ratio"] * omega
    time, displacement = simulate_ring_down(np.random.default_rng(12)).values()
    first = fitted_ring_down(seed=12)
    envelope = size * np.exp(-first.damping_ratio * omega * time)
    with figure(1, 2, width=9.0, height=3.4) as (drawing, (left, right)):
        left.plot(time, 1e6 * displacement, color=GREY, linewidth=0.2)
        zero = 1e6 * np.convolve(displacement, np.full(501, 1.0 / 501), "same")
        inside = slice(250, -250)
        left.plot(time[inside], zero[inside], color=COLOURS[1], label="its drifting zero")
        for sign in (-1.0, 1.0):
            label = "envelope of the fit" if sign > 0.0 else None
            upper = zero + sign * envelope
            left.plot(time[inside], upper[inside], color=COLOURS[0], label=label)
        left.set(xlabel="time [s]", ylabel="displacement [µm]", ylim=(-110.0, 175.0))
        left.legend(loc="upper right")
        durations = np.array([15.0, 30.0, 60.0, 120.0])
        for index, noise in enumerate((0.01, 0.05)):
            found = [fitted_ring_down(duration=one, noise=noise, drift=0.0) for one in durations]
            errors = [100.0 * interval_error(one) / motion["damping_ratio"] for one in found]
            right.plot(durations, errors, "o", color=COLOURS[index], label=f"fit, noise {100 * noise:g} %")
            bound = 1.96 * math.sqrt(24.0 / rate) * noise / (durations**1.5 * decay)
            right.plot(durations, 100.0 * bound, color=COLOURS[index], linewidth=1.0)
        right.set(xlabel="duration of the record [s]", ylabel="95 % interval of ζ [± %]")
        right.set(xscale="log", yscale="log")
        right.set_xticks(durations, [f"{one:g}" for one in durations])
        right.set_yticks([0.2, 1, 5, 20], ["0.2", "1", "5", "20"])
        right.minorticks_off()
        right.legend(title="lines: bound for a weak decay")
        keep(drawing, "ring-down")
    rows = ["| record of 120 s | ζ by the fit | |", "|---|---|---|"]
    for name, changes in RING_DOWN_CASES.items():
        found = fitted_ring_down(**changes)
        value = f"{1e4 * found.damping_ratio:.4f} ± {1e4 * interval_error(found):.4f}"
        off = abs(found.damping_ratio - motion["damping_ratio"]) > interval_error(found)
        rows.append(f"| {name} | ({value})·10⁻⁴ | {'true ζ outside the interval' if off else ''} |")
    write_block("ring-down", "\n".join([*rows, ""]), DOCS / "guide" / "ring-down.md")


RING_DOWN_CASES: Mapping[str, Mapping[str, Any]] = {
    "noise of 1 %": {"drift": 0.0},
    "noise of 1 %, and a zero that drifts by 20 %": {},
    "noise of 5 %": {"drift": 0.0, "noise": 0.05},
    "rounded to a fifth of the amplitude": {"drift": 0.0, "round_to": 0.2},
    "frequency that drifts by 10⁻⁴": {"drift": 0.0, "detuning": 1e-4},
    "behind a low-pass filter of 5 Hz": {"drift": 0.0, "low_pass": 5.0},
    "sampled at 25 Hz": {"drift": 0.0, "rate": 25.0},
    "sampled at 11 Hz, so that the frequency appears as 0.93 Hz": {"drift": 0.0, "rate": 11.0},
}
"""Records of the resonator, with noise of 1 % unless another is given."""


def fitted_ring_down(
    seed: int = 0, round_to: float = 0.0, low_pass: float | None = None, **changes: float
) -> Any:
    """Small oscillation of the linear law fitted to a ring-down, rounded [amplitude] or filtered [Hz]."""
    time, displacement = simulate_ring_down(np.random.default_rng(seed), **changes).values()
    if low_pass is not None:
        b, a = butter(1, low_pass, fs=1.0 / (time[1] - time[0]))
        displacement = lfilter(b, a, displacement)
    if round_to:
        step = round_to * RING_DOWN["amplitude"]
        displacement = step * np.round(displacement / step)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return fit(PistonRecord(time, displacement), "linear").at_rest


def interval_error(at_rest: Any) -> float:
    """Half-width of the interval of the damping ratio."""
    low, high = at_rest.intervals["damping_ratio"]
    return float(0.5 * (high - low))


def draw_magpylib() -> None:
    """Forces on thirty magnets by the toolkit and by magpylib, and the times of both over their number."""
    places = positions(30)
    ours, theirs = evaluate(free_magnets(30), places).force, magpylib_forces(places, discs=False)
    rows, discs = times_and_deviations(), disc_deviations()
    with figure(1, 2, width=9.0, height=3.6) as (drawing, (left, right)):
        millimetres, reach = 1e3 * places.T, 9.0 / np.abs(ours).max()
        for index, force in enumerate((theirs, ours)):
            width, colour = ((0.018, GREY), (0.005, COLOURS[0]))[index]
            left.quiver(
                *millimetres,
                *(reach * force.T),
                angles="xy",
                scale_units="xy",
                scale=1.0,
                width=width,
                color=colour,
                label=("getFT", "evaluate")[index],
            )
        left.plot(*millimetres, ".", color="black", markersize=3)
        left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(-3.0, 58.0), ylim=(-3.0, 66.0))
        left.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        counts, getft, direct, _ = np.array(rows).T
        right.plot(counts, getft, "o-", color=GREY, label="getFT of N dipoles on N")
        right.plot(counts, direct, "o-", color=COLOURS[0], label="evaluate, every pair")
        right.set(xscale="log", yscale="log", xlabel="number of magnets N", ylabel="time [s]")
        right.legend()
        keep(drawing, "magpylib")
    table = [
        "| N dipoles | `getFT` [s] | `evaluate` [s] | maximum deviation |",
        "|---|---|---|---|",
        *(
            f"| {count} | {'' if math.isnan(slow) else f'{slow:.2g}'} | {fast:.2g} "
            f"| {'' if math.isnan(off) else f'{off:.1g}'} |"
            for count, slow, fast, off in rows
        ),
        "",
        "| cells of a disc in `getFT` | maximum deviation of the forces on ten discs |",
        "|---|---|",
        *(f"| {cells} | {off:.1g} |" for cells, off in discs),
        "",
    ]
    write_block("magpylib", "\n".join(table), DOCS / "guide" / "magpylib.md")


def draw_limits() -> None:
    """A law fitted to a small lift, extrapolated to a whole fall."""
    run = damper_run()
    small = fit(run.piston(), law="power-law-spring")
    fall = run.piston("drop").with_time_from_zero().between(0.0, 2.0)
    asked = small.simulate(fall.time, z0=float(fall.height[0]), v0=0.0)
    known = predict(damper()).simulate(fall.time, z0=float(fall.height[0]), v0=0.0)
    with figure(width=7.0, height=3.2) as (drawing, axes):
        axes.plot(fall.time, 1e3 * fall.height, color=GREY, linewidth=4, label="simulated fall")
        axes.plot(fall.time, 1e3 * asked.height, color=COLOURS[1], label="law fitted to a lift of 0.2 D")
        axes.plot(fall.time, 1e3 * known.height, "--", color=COLOURS[0], label="law of whole falls")
        axes.set(xlabel="time [s]", ylabel="height of the piston [mm]")
        axes.legend()
        keep(drawing, "limits")


def draw_misprints() -> None:
    """The load on the plates against diameter, by [D, eq. 4.10] as printed and as corrected."""
    diameter = np.linspace(3.5, 9.0, 100)
    thickness, distance = 3.0, 3.1
    diagonal = np.hypot(diameter, thickness)
    phi = np.arctan(thickness / diameter)
    whole = np.arcsin(distance / diagonal)
    with figure(width=7.0, height=3.2) as (drawing, axes):
        for place, (name, theta) in enumerate((("printed", whole), ("meant", whole - phi))):
            factor = 0.75 * diameter * np.cos(theta) * np.sin(theta)
            axes.plot(
                diameter, factor / (np.cos(phi + theta) * diagonal), color=COLOURS[1 - place], label=name
            )
        axes.set(yscale="log", xlabel="diameter of the grains [mm]", ylabel="load of a neighbour, $K$")
        axes.legend(title="[D, eq. 4.10]")
        keep(drawing, "misprints")


def write_whole_falls() -> None:
    """Two whole falls, simulated and predicted by the law."""
    rows = [
        "| bed | | settles | maximum force | minimum height | affine loss | all loss |",
        "|---|---|---|---|---|---|---|",
    ]
    for mass, drag, height in ((7.5, 0.1, 20), (10.0, 0.2, 24)):
        scene = damper(mass).replace(
            **{
                "piston.height": f"{height} D",
                "arrangement.height": f"{height - 1} D",
                "effects.drag.coefficient": drag,
                "output.record": None,
                "protocol": [{"kind": "free", "name": "drop", "duration": 4.0}],
            }
        )
        run = simulated(scene)
        motion, rest = run.piston(), float(run.dataset["piston_height"].values[-500:].mean())
        assert motion.velocity is not None
        assert motion.force is not None
        away = np.abs(motion.height - rest) > 0.05 * (height * DIAMETER - rest)
        affine = scene.grains.count * drag / 3.0
        loss = affine * float(np.trapezoid(motion.velocity**2, motion.time))
        law = whole_fall(scene, height * DIAMETER)
        bed = f"{scene.grains.count} grains, {mass:g} kg, {drag:g} kg/s, from {height} D"
        for name, *figures in (
            (
                f"{bed} | simulated",
                motion.time[away][-1],
                motion.force.max(),
                motion.height.min(),
                loss,
                run.dataset["drag_loss"].values[-1],
            ),
            (
                "| law",
                law.settling_time,
                law.greatest_force,
                law.deepest,
                law.affine_loss,
                law.affine_loss + law.excess_loss,
            ),
        ):
            settled, force, deepest, one, whole = map(float, figures)
            rows.append(
                f"| {name} | {settled:.2f} s | {force:.0f} N | {1e3 * deepest:.1f} mm "
                f"| {one:.2f} J | {whole:.2f} J |"
            )
    write_block("whole-fall", "\n".join([*rows, ""]), DOCS / "guide" / "design.md")


def draw_silo() -> None:
    """Flow rates of the packaged silo against its opening with the fitted law, and a picture of the flow."""
    scene = load_scene("silo")
    result = silo(scene, [k * DIAMETER for k in (2, 3, 4, 6, 8, 10, 12)])
    with figure(width=5.5) as (drawing, axes):
        result.plot(axes)
        keep(drawing, "silo-law")
    keep(still(simulated(scene, dt="auto*4", t_end=0.6), -1, colour="speed"), "silo")
    head = ["opening", "flow rate [grains/s]", "sd over three starts", "fitted law", "clogged"]
    rows = [head, ["---"] * len(head), *result.rows()]
    factor, margin = result.law
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    unit = math.sqrt(GRAVITY / DIAMETER)
    law = f"Fitted: Q = {factor:.3g} √(g/D) (b/D - {margin:.3g})^(3/2), with √(g/D) = {unit:.3g} /s."
    write_block("silo", f"{table}\n\n{law}", DOCS / "guide" / "silo.md")


def draw_small_motions() -> None:
    """The piston's oscillation as a mode of the packaged damper, and the response to a shaken base."""
    found = small_motions(damper_run())
    root = found.roots[0]
    frequencies = np.unique([*np.geomspace(0.3, 3.0, 60) * root.frequency, root.frequency])
    with figure(rows=2, width=7.0, height=5.6, height_ratios=[1.0, 1.4]) as (drawing, (bed, response)):
        plot_mode(found.rest, root.shape, bed)
        bed.set_title("displacements in the piston's oscillation")
        plot_transmissibility(frequencies, transmissibility(found.rest, frequencies), response)
        keep(drawing, "small-motions")


def draw_design() -> None:
    """The simulated falls of the packings that check a design."""
    keep(design(frequency=3.3, damping=0.1, seeds=(2, 3, 4)).plot(), "design")


def draw_first_bed() -> None:
    """The bed of the start page, coloured by force."""
    keep(still(simulated(load_scene("bed"), t_end=0.5), -1, colour="force"), "bed")


def draw_defects() -> None:
    """Paths of defects during the last second of a compression."""
    scene = mono_bed(368, speed=33e-3, relaxation=1.0).replace(**{"output.frames": 0.01})
    run = simulated(scene, t_end=20.0)
    found = track_defects(run, start=19.0)
    with figure(width=7.8, height=3.6) as (drawing, axes):
        plot_defect_paths(found, run.dataset["position"].values[-1], axes)
        keep(drawing, "defects")


def draw_machine() -> None:
    """The packaged machine without and with its damper, simulated and by the law."""
    scene = load_scene("machine")
    frequencies = [2.6, 2.75, 2.8, 2.85, 2.9, 2.95, 3.0, 3.1, 3.25, 3.4, 3.6]
    found = frequency_response(scene, frequencies, dt="auto*4")
    dense = np.linspace(2.6, 3.6, 101)
    law = predicted_response(scene, dense)
    with figure(width=7.0, height=3.4) as (drawing, axes):
        found.plot(axes)
        axes.get_lines()[0].set(linestyle="none", marker="o", label="with the damper, simulated")
        axes.plot(dense, 1e3 * law.displacement, color=COLOURS[1], label="with the damper, law")
        axes.set_title("displacement of the machine under 10 N", fontsize=10)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        keep(drawing, "machine")
    measured = found.peaks()[0]
    words = (
        "In simulations at 11 frequencies from 2.6 to 3.6 Hz, the machine's maximum displacement is "
        f"{1e3 * measured['alone']:.1f} mm without\nthe damper, {1e3 * measured['peak']:.2f} mm with the "
        f"damper (at {measured['frequency']:g} Hz), and {1e3 * measured['ideal']:.2f} mm with an ideal tuned "
        "mass."
    )
    write_block("machine", words, DOCS / "guide" / "machine.md")


def write_machine_law() -> None:
    """Peaks of the packaged machine for three packings, compared with the law and two linear laws.

    Simulations are stored in out/machine-law and reused.
    """
    forces = (3.0, 5.0, 7.0, 10.0, 12.0, 20.0)
    frequencies = np.geomspace(2.75, 2.95, 5).tolist()
    scene = load_scene("machine")
    simulations = [
        frequency_response(
            scene.replace(**{"arrangement.seed": seed}),
            frequencies,
            amplitudes=forces,
            dt="auto*4",
            out=DOCS.parent / "out" / "machine-law" / str(seed),
        ).dataset
        for seed in (1, 2, 3)
    ]
    numbers = fit(damper_run().piston(), "linear").parameters
    fitted = LinearOscillator(numbers["omega"], numbers["lam"])
    law = CoupledSystem.from_host_scene(scene)
    rows = [
        "| force | amplitude of the piston | simulated, three packings | law | linearised "
        "law | linear law fitted to a free decay |",
        "|---|---|---|---|---|---|",
    ]
    for force in forces:
        at_force = [one.sel(amplitude=force) for one in simulations]
        peaks = [1e3 * float(one.displacement.max()) for one in at_force]
        places = [int(one.displacement.values.argmax()) for one in at_force]
        piston_amplitude = np.mean([one.stroke.values[k] for one, k in zip(at_force, places, strict=True)])
        mean = float(np.mean(peaks))
        predictions = [
            solve_host_response(law, frequencies, force).peak,
            float(np.abs(law.linear_response(frequencies, force)).max()),
            float(np.abs(law.linear_response(frequencies, force, fitted)).max()),
        ]
        predicted = " | ".join(
            f"{1e3 * one:.2f} mm ({1e5 * one / mean - 100.0:+.0f} %)" for one in predictions
        )
        simulated = f"{mean:.2f} mm ({min(peaks):.2f} to {max(peaks):.2f})"
        rows.append(f"| {force:g} N | {piston_amplitude / DIAMETER:.1f} D | {simulated} | {predicted} |")
    write_block("machine-law", "\n".join([*rows, ""]), DOCS / "guide" / "machine.md")


def write_machine_design() -> None:
    """Simulate the damper designed for the packaged machine."""
    host = load_scene("machine").effects.host
    assert host is not None
    assert host.excitation is not None
    found = design_for(host, host.excitation, limit=7.75)
    response = frequency_response(
        found.scene,
        np.geomspace(2.6, 3.8, 13).tolist(),
        dt="auto*4",
        out=DOCS.parent / "out" / "machine-design",
    )
    (peak,) = response.peaks()
    words = (
        "In simulations of the proposed damper at 13 frequencies from 2.6 to 3.8 Hz, the machine's maximum\n"
        f"displacement is {1e3 * peak['peak']:.2f} mm, at {peak['frequency']:.2f} Hz. The law predicts "
        f"{1e3 * found.peak:.2f} mm."
    )
    write_block("machine-design", words, DOCS / "guide" / "machine.md")


def write_prices() -> None:
    """Fastest setting in the stored table for three error levels, for each scene and quantity."""
    levels = {"1 %": 1e-2, "0.1 %": 1e-3, "10⁻⁶": 1e-6}
    rows = [
        f"| scene | quantity | {' | '.join(levels)} | spread over packings |",
        f"|---|---|{'---|' * len(levels)}---|",
    ]
    for scene in prices():
        for quantity, floor in scene.floors.items():
            cells = [fastest(scene, quantity, level) for level in levels.values()]
            scatter = f"{100.0 * floor:.2g} %" if floor else "nothing"
            case = f"{scene.name.split('-')[0]}, {scene.grains} grains"
            rows.append(f"| {case} | {quantity} | {' | '.join(cells)} | {scatter} |")
    source = f"The values are from the table in the package, measured on {prices()[0].date}."
    words = "\n".join([*rows, "", source])
    write_block("prices", words, DOCS / "guide" / "methods.md")


def fastest(scene: SceneWorkPrecision, quantity: str, level: float) -> str:
    """The fastest setting within an error level, with its time; for several starts if one is not enough."""
    floor, starts = scene.floors[quantity], 1
    if level < FLOORS * floor:
        starts = packing_count_to_average(floor, level)
    found = [one for one in scene.entries if one.bounds[quantity] <= level]
    if not found and starts > 1:  # the step error cannot be distinguished from the scatter
        found = [one for one in scene.entries if quantity not in one.clear]
    if not found:
        return "beyond the table"
    best = min(found, key=lambda one: one.seconds)
    method = "" if best.method == "stormer-verlet" else f"`{best.method}`, "
    price = duration_text(starts * best.seconds)
    if starts == 1:
        return f"{method}`{best.dt}`, {price}"
    exponent = math.floor(math.log10(starts))
    count = f"{starts}" if exponent < 4 else f"{starts / 10**exponent:.0f}·10{superscript(exponent)}"
    return f"{method}`{best.dt}`, {count} starts, {price}"


def superscript(number: int) -> str:
    """A number in superscript."""
    return str(number).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


def draw_cost() -> None:
    """Errors of a bed's energy and piston force against the time of a run, from the stored table."""
    scene = next(one for one in prices() if one.name == "bed-92")
    with figure(width=7.0, height=3.4) as (drawing, axes):
        for place, method in enumerate(sorted({one.method for one in scene.entries}, reverse=True)):
            ones = [one for one in scene.entries if one.method == method]
            for quantity, fill in (("energy", "full"), ("piston force", "none")):
                axes.plot(
                    [one.seconds for one in ones],
                    [one.bounds[quantity] for one in ones],
                    marker="o",
                    fillstyle=fill,
                    label=f"{quantity}, {method}",
                    **line_style(place) | {"linestyle": "-" if fill == "full" else "--"},
                )
        axes.axhline(scene.floors["piston force"], color=GREY, linestyle=":")
        axes.annotate(
            "spread of the piston force over packings",
            (1.0, scene.floors["piston force"]),
            (-4, 4),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            fontsize=9,
        )
        axes.set(xscale="log", yscale="log", ylim=(1e-9, 0.1), xticks=[0.03, 0.05, 0.1])
        axes.set_xticklabels(["0.03", "0.05", "0.1"])
        axes.set_xticks([], minor=True)
        axes.set(xlabel="time of a run [s]", ylabel="relative error of the step")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        keep(drawing, "cost")


def write_hard_cases() -> None:
    """Write the outcome of each hard case, with its error and limit."""
    cases = hard_case_catalogue()
    outcomes = [run_hard_case(case) for case in cases]
    kinds = {kind: sum(one.kind == kind for one in outcomes) for kind in (ACCURATE, DEGRADED, STOPPED)}
    wrong = sum(not one.allowed for one in outcomes)
    words = (
        f"Of {len(outcomes)} cases, {kinds[ACCURATE]} have an error below the limit, "
        f"{kinds[DEGRADED]} exceeds the limit and warns, {kinds[STOPPED]} are rejected or stopped by an "
        f"error message that gives the cause, and {wrong} give a wrong result without a warning."
    )
    rows = ["| case | difficulty | error | limit | outcome |", "|---|---|---|---|---|"]
    for case, one in zip(cases, outcomes, strict=True):
        error, limit = ("", "") if math.isnan(one.error) else (f"{one.error:.1g}", f"{one.limit:.0e}")
        ending = one.said.split(":", 1)[0] if one.kind == STOPPED else one.kind
        rows.append(f"| {one.case} | {case.difficulty} | {error} | {limit} | {ending} |")
    write_block("hard-cases", "\n".join([words, "", *rows, ""]), DOCS / "results" / "hard-cases.md")


def write_effect_costs() -> None:
    """Write the cost of each effect of the packaged damper per step."""
    costs = effect_costs(load_scene("damper"))
    rows = ["| effect | added alone | removed from the full scene |", "|---|---|---|"]
    for one in costs.effects:
        first, last = (f"{value:.2f} ± {doubt:.2f} µs" for value, doubt in (one[1:3], one[3:]))
        rows.append(f"| `{one.effect}` | {first} | {last} |")
    words = (
        f"A step of the scene `{costs.scene}` ({costs.grains} grains) takes {costs.step:.1f} µs of processor "
        f"time, and {costs.nothing:.2f} µs without any effect.\n"
        "The table gives the additional time of each effect:"
    )
    write_block("effect-costs", "\n".join([words, "", *rows, ""]), DOCS / "guide" / "effects.md")


def draw_guarantees() -> None:
    """A run that is interrupted and resumed, and one with different rounding, compared with an uninterrupted
    run.
    """
    scene = damper(count=92)
    whole = simulated(scene, t_end=2.0).dataset
    with tempfile.TemporaryDirectory() as name:
        simulated(scene, t_end=0.7, out=Path(name) / "run")
        cut = simulated(scene, t_end=2.0, out=Path(name) / "run", resume=True).dataset.load()
    other = simulated(scene, method="stormer-verlet+compensated", t_end=2.0).dataset
    with figure(width=7.0, height=3.2) as (drawing, axes):
        for place, (label, one) in enumerate(
            (("cut at 0.7 s and resumed", cut), ("different rounding of sums", other))
        ):
            apart = np.abs(one["piston_height"].values - whole["piston_height"].values)
            axes.plot(whole["time"], apart, label=label, **line_style(place))
        axes.axvline(0.7, color=GREY, linestyle=":")
        axes.set_yscale("symlog", linthresh=1e-17)
        axes.set(xlabel="time [s]", ylabel="difference of the\npiston's height [m]")
        axes.set_ylim(-4e-18, 1e-2)
        axes.set_yticks([0.0, 1e-16, 1e-13, 1e-10, 1e-7, 1e-4])
        axes.legend(loc="center right")
        keep(drawing, "guarantees")


def draw_verification() -> None:
    """Ratio of computed to published values of de Paula, for results averaged over packings."""
    groups: dict[str, list[tuple[float, float, bool]]] = {}
    for row in judge_all_entries(read_committed_results()):
        if row.verdict.words not in ("agrees", "differs") or row.found is None:
            continue
        half = row.found.half_width()
        if row.published == 0.0 or half is None or row.entry.key.endswith("_std"):
            continue
        unit = row.entry.unit or "ratios"
        group = "hysteresis" if "hysteresis" in row.entry.key else unit
        ratio = row.found.value / row.published
        error = half / abs(row.published)
        if 0.5 < ratio < 2.0:
            agrees = row.verdict.words == "agrees"
            groups.setdefault(group, []).append((ratio, error, agrees))
    flat = [one for unit in sorted(groups) for one in groups[unit]]
    with figure(width=7.0, height=3.4) as (drawing, axes):
        for agrees, colour, label in ((True, 0, "agrees"), (False, 1, "differs")):
            chosen = [k for k, one in enumerate(flat) if one[2] is agrees]
            values, errors = ([flat[k][one] for k in chosen] for one in (0, 1))
            axes.errorbar(
                chosen,
                values,
                errors,
                color=COLOURS[colour],
                label=label,
                fmt="o" if agrees else "s",
                markersize=3.5,
                linewidth=1.0,
            )
        axes.axhline(1.0, color="black", linewidth=0.8)
        start = 0
        for unit in sorted(groups):
            axes.axvline(start - 0.5, color=GREY, linestyle=":")
            axes.annotate(
                unit,
                (start, 1.0),
                (2, 4),
                textcoords="offset points",
                xycoords=("data", "axes fraction"),
                fontsize=9,
            )
            start += len(groups[unit])
        axes.set(xlabel="values published by de Paula (2025)", ylabel="here over published", xticks=[])
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        keep(drawing, "verification")


STARTS = {
    "simulate": "from granular import load_scene, simulate\nsimulate(load_scene('bed'), t_end=0.01)",
    "fit": "import numpy as np\nfrom reduced_models import PistonRecord, fit\n"
    "t = np.linspace(0.0, 6.0, 1500)\n"
    "z = 0.06 + 1e-3 * np.exp(-0.8 * t) * np.cos(21.8 * t)\n"
    "fit(PistonRecord(t, z), law='linear')",
}
"""A script with the first use of each package."""


def draw_installation() -> None:
    """Processor time of a first start, with compilation, and of the second."""
    seconds: dict[str, list[float]] = {}
    for name, code in STARTS.items():
        with tempfile.TemporaryDirectory() as folder:
            os.chmod(folder, 0o700)
            keys = ("NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR")
            kept = {key: str(Path(folder) / key.lower()) for key in keys}
            seconds[name] = [run_seconds(code, kept) for _ in range(2)]
    with figure(width=7.0, height=2.2) as (drawing, axes):
        for k, label in enumerate(("first start, with compilation", "second start")):
            places = [place - 0.2 + 0.4 * k for place in range(len(seconds))]
            spent = [one[k] for one in seconds.values()]
            axes.barh(places, spent, 0.38, color=COLOURS[k], label=label)
        axes.set_yticks(range(len(seconds)), list(seconds))
        axes.invert_yaxis()
        axes.set_xlabel("processor time of a script with one call [s]")
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        keep(drawing, "installation")
    (run, again), (fitted, later) = seconds["simulate"], seconds["fit"]
    words = (
        f"A script that calls `simulate` once takes {run:.0f} s of processor time at the first start, with "
        f"compilation, and\n{again:.1f} s at the second. A script that calls `fit` once takes {fitted:.0f} s "
        f"and then {later:.1f} s."
    )
    write_block("installation", words, DOCS / "guide" / "installation.md")


def run_seconds(code: str, kept: Mapping[str, str]) -> float:
    """Processor time of a process that runs the code, with a given cache of compiled code [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        env=os.environ | dict(kept),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def draw_libraries() -> None:
    """Processor time of importing each library."""
    names = (
        "numpy",
        "scipy.optimize",
        "numba",
        "xarray",
        "zarr",
        "pandas",
        "matplotlib.pyplot",
        "sympy",
        "jax",
        "diffrax",
    )
    empty = min(run_seconds("", {}) for _ in range(3))
    costs = {}
    for name in names:
        costs[name] = min(run_seconds(f"import {name}", {}) for _ in range(3)) - empty
    costs["granular, reduced_models"] = (
        min(run_seconds("import granular, reduced_models", {}) for _ in range(3)) - empty
    )
    ordered = sorted(costs, key=lambda one: costs[one])
    ours = [COLOURS[1] if "granular" in one else COLOURS[0] for one in ordered]
    with figure(width=7.0, height=3.6) as (drawing, axes):
        axes.barh(ordered, [costs[one] for one in ordered], color=ours)
        axes.set_xlabel("processor time of the import, minus an empty Python [s]")
        keep(drawing, "libraries")


def draw_rooms() -> None:
    """Layers of the packages: a directory imports from those below it, and from packages to its left."""
    contracts = tomllib.loads((DOCS.parent / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    with figure(width=9.0, height=5.6, size=10.0) as (drawing, axes):
        axes.axis("off")
        axes.set(xlim=(0.0, 3.0), ylim=(-0.2, 21.0))
        for left, package in enumerate(("granular", "reduced_models", "validation")):
            (layers,) = (
                contract["layers"]
                for contract in contracts
                if contract["type"] == "layers" and contract.get("containers") == [package]
            )
            height = 0.0
            for layer in reversed(layers[1:]):
                text = textwrap.fill(layer.replace(" |", ","), 32)
                tall = 1.0 + 0.7 * text.count("\n")
                box = Rectangle(
                    (left, height), 0.94, tall - 0.12, color=COLOURS[left], alpha=0.16, linewidth=0
                )
                axes.add_patch(box)
                axes.text(left + 0.02, height + tall / 2.0 - 0.06, text, va="center")
                height += tall
            axes.text(left + 0.03, height + 0.3, package, weight="bold", size=12.0)
        keep(drawing, "rooms")


def draw_forms() -> None:
    """One oscillation in four file formats, each as it is read."""
    times = np.linspace(0.0, 2.0, 400)
    height = 0.06 + 1.2e-3 * np.exp(-0.8 * times) * np.cos(21.8 * times)
    pairs = list(zip(times, height, strict=True))
    labview = """LabVIEW Measurement
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
***End_of_Header***
Channels\t1
Y_Unit_Label\tm
X_Dimension\tTime
***End_of_Header***
X_Value\theight"""
    forms = {
        "plain.csv": ("time [s],height [mm]", [f"{t:.4f},{1e3 * z:.5f}" for t, z in pairs]),
        "messung.txt": (
            "Messung 4;Labor 2\n\nZeit [ms];Weg [cm]",
            [f"{1e3 * t:.2f};{100 * z:.6f}".replace(".", ",") for t, z in pairs],
        ),
        "logger.tsv": ("Timestamp\tdist (m)", [f"2026-03-01 12:00:{t:06.3f}\t{z:.7f}" for t, z in pairs]),
        "labview.lvm": (labview, [f"{t:.6f}\t{z:.8f}" for t, z in pairs]),
    }
    with (
        figure(len(forms), 2, width=8.0, height=5.6, sharex="col") as (drawing, rows),
        tempfile.TemporaryDirectory() as folder,
    ):
        for place, ((name, (head, lines)), (left, right)) in enumerate(zip(forms.items(), rows, strict=True)):
            path = Path(folder) / name
            path.write_text("\n".join([head, *lines, ""]), encoding="utf-8")
            record = PistonRecord.from_file(path)
            top = head.split("\n")
            shown = top if len(top) < 4 else [top[0], "...", top[-1]]
            text = "\n".join([*shown, *lines[:2], "..."]).expandtabs(4)
            left.axis("off")
            left.set_title(name, fontsize=10, loc="left")
            left.text(0.0, 0.98, text, va="top", family="monospace", fontsize=9, transform=left.transAxes)
            right.plot(record.with_time_from_zero().time, 1e3 * record.height, color=COLOURS[place])
            right.set_ylabel("height [mm]")
        rows[-1][1].set_xlabel("time [s]")
        keep(drawing, "forms")


def draw_own() -> None:
    """A bed under its weight only, and with additional springs defined by a formula."""
    scene = load_scene("bed").replace(
        **{
            "grains.count": 23,
            "cell.width": "15 D",
            "piston.height": "6 D",
            "arrangement.height": "5.5 D",
            "output.frames": "5 ms",
        }
    )
    pulled = scene.replace(**{"effects.field": [{"energy": "k*y**2/2", "k": "10 N/m"}]})
    with figure(1, 2, width=9.0, height=3.0) as (drawing, (left, right)):
        for place, (one, sign, label) in enumerate(
            ((scene, "o", "weight only"), (pulled, "s", "with k*y**2/2"))
        ):
            data = simulated(one, t_end=0.5).dataset
            places = 1e3 * data["position"].values
            left.plot(*places[-1].T, sign, color=COLOURS[place], fillstyle="none", label=label)
            right.plot(data["frame_time"], places[:, :, 1].mean(axis=1), label=label, **line_style(place))
        left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(0, 90), ylim=(0, 36))
        right.set(xlabel="time [s]", ylabel="mean height of the grains [mm]")
        right.legend()
        keep(drawing, "own")


def draw_notebooks() -> None:
    """The first picture of each notebook."""
    pictures = []
    for path in sorted((DOCS.parent / "notebooks").glob("[0-9][0-9]_*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        found = [
            output["data"]["image/png"]
            for cell in cells
            for output in cell.get("outputs", ())
            if "image/png" in output.get("data", {})
        ]
        largest = max(found, key=len)
        pictures.append((path.stem, plt_image(base64.b64decode("".join(largest)))))
    columns = 3
    lines = -(-len(pictures) // columns)
    with figure(lines, columns, width=11.0, height=2.5 * lines) as (drawing, rows):
        for axes in rows.flat:
            axes.axis("off")
        for axes, (name, picture) in zip(rows.flat, pictures, strict=False):
            axes.imshow(picture)
            axes.set_title(name.replace("_", " "), fontsize=9)
        keep(drawing, "notebooks")


def plt_image(content: bytes) -> Any:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


def write_block(name: str, text: str, path: Path) -> None:
    """Write measured values between their marks in a page, with the command and the date."""
    page = path.read_text(encoding="utf-8")
    begin, end = f"<!-- made by docs/pictures.py: {name} -->", f"<!-- end: {name} -->"
    before, _, rest = page.partition(begin)
    made = f"  (`python docs/pictures.py {name}`, {datetime.date.today():%Y-%m-%d}.)"
    after = rest.partition(end)[2]
    path.write_text(f"{before}{begin}\n{text}\n{made}\n{end}{after}", encoding="utf-8")


PICTURES: Mapping[str, Callable[[], None]] = {
    "motion": draw_motion,
    "damper": draw_damper,
    "fall": draw_fall,
    "theory": draw_theory,
    "small-motions": draw_small_motions,
    "design": draw_design,
    "first-bed": draw_first_bed,
    "silo": draw_silo,
    "effects": draw_effects,
    "eddy": draw_eddy,
    "methods": draw_methods,
    "pairs": draw_pairs,
    "observables": draw_observables,
    "studies": draw_studies,
    "record": draw_record,
    "pendulum": draw_pendulum,
    "decay-tests": draw_decay_tests,
    "dynamometer": draw_dynamometer,
    "ring-down": draw_ring_down,
    "magpylib": draw_magpylib,
    "limits": draw_limits,
    "misprints": draw_misprints,
    "whole-fall": write_whole_falls,
    "defects": draw_defects,
    "machine": draw_machine,
    "machine-law": write_machine_law,
    "machine-design": write_machine_design,
    "prices": write_prices,
    "cost": draw_cost,
    "hard-cases": write_hard_cases,
    "effect-costs": write_effect_costs,
    "head-on": lambda: write_block("head-on", head_on_steps(), DOCS / "guide" / "methods.md"),
    "discs": lambda: write_block("discs", discs_over_dipoles(), DOCS / "guide" / "pairs.md"),
    "magnets": lambda: write_block("magnets", magnets_compared_with_dipoles(), DOCS / "results" / "laws.md"),
    "falls": lambda: write_block("falls", falls(), DOCS / "results" / "laws.md"),
    "averaging": lambda: write_block("averaging", averaging(), DISCOVERY),
    "lammps": lambda: write_block("lammps", lammps_comparison(), OTHERS),
    "pysindy": lambda: write_block("pysindy", pysindy_comparison(), OTHERS),
    "guarantees": draw_guarantees,
    "verification": draw_verification,
    "installation": draw_installation,
    "libraries": draw_libraries,
    "forms": draw_forms,
    "rooms": draw_rooms,
    "own": draw_own,
    "notebooks": draw_notebooks,
}


def main(names: list[str]) -> None:
    """Draw the given pictures, or all."""
    unknown = sorted(set(names) - set(PICTURES))
    if unknown:
        sys.exit(f"error: no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    IMAGES.mkdir(exist_ok=True)
    for name in names or PICTURES:
        PICTURES[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
