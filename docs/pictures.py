"""Draw the pictures of the README and the guide anew: ``python docs/pictures.py [NAME ...]``."""

from __future__ import annotations

import datetime
import functools
import itertools
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from granular import PistonRecord, Scene, Trajectory, damper, evaluate, load_scene, mono_bed
from granular import simulate as simulated
from granular.observables import radial_distribution_of_run
from granular.observables.plots import plot_correlation_function
from granular.render import movie, save, still
from granular.shared.plotting import COLOURS, GREY, figure
from reduced_models import damper_maps, fit, predict
from reduced_models.designs.page import plot_maps
from validation import convergence, exact_problem

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"
DIAMETER = 0.006
GRAVITY = 9.8


@functools.cache
def damper_run() -> Trajectory:
    """The packaged damper: fall, lift, swing."""
    return simulated(damper())


@functools.cache
def compressed_run() -> Trajectory:
    """A bed up to its full compression."""
    scene = mono_bed(368, speed=33e-3, relaxation=1.0)
    return simulated(scene.replace(protocol=scene.to_plain()["protocol"][:2]))


def keep(drawing: Any, name: str) -> None:
    save(drawing, IMAGES / f"{name}.png", overwrite=True)


def draw_motion() -> None:
    """The fall in real time, as ``granular run`` and ``granular render`` make it."""
    run = simulated(damper().replace(**{"output.frames": "5 ms"}), t_end=2.5)
    movie(run, IMAGES / "fall.gif", colour="speed", fps=20.0, width=760, overwrite=True)


def draw_damper() -> None:
    """The bed 0.2 s after the piston was let go."""
    keep(still(damper_run(), 2, colour="speed"), "damper")


def draw_fall() -> None:
    """The fall, and the swing after the lift with the law fitted to its first two thirds."""
    run = damper_run()
    drop, swing = run.piston("drop").from_zero(), run.piston("release").from_zero()
    seen = swing.between(0.0, 4.0)
    model = fit(seen, law="polynomial-spring", holdout=0.0)
    predicted = model.simulate(swing.time)
    with figure(1, 2, width=9.0, height=3.0) as (drawing, (left, right)):
        left.plot(drop.time, drop.height / DIAMETER, color=COLOURS[0])
        left.set(xlabel="time [s]", ylabel="height of the piston [D]", xlim=(0.0, 4.0))
        left.set_title("the fall from 20 D", fontsize=10)
        right.plot(swing.time, swing.height / DIAMETER, color=GREY, linewidth=3, label="simulated")
        right.plot(swing.time, predicted.height / DIAMETER, color=COLOURS[1], linewidth=1,
                   label="its equation")  # fmt: skip
        right.axvline(seen.time[-1], color=GREY, linestyle=":")
        right.set(xlabel="time [s]", xlim=(0.0, 6.0))
        right.set_title("lifted by 0.2 D and released; fitted left of the dots", fontsize=10)
        right.legend()
        keep(drawing, "fall")


def draw_theory() -> None:
    """The force of the bed over its height, and its losses, beside what theory says of them."""
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
    expected = [
        affine * step * float(np.sum(speed[a:b] ** 2)) for a, b in itertools.pairwise(turns)
    ]
    ratios = taken / np.array(expected)
    with figure(1, 2, width=9.0, height=3.4) as (drawing, (left, right)):
        for name, way, colour in (("down", speed < 0.0, 0), ("up", speed >= 0.0, 1)):
            left.plot(1e3 * height[way], force[way], ".", color=COLOURS[colour], markersize=2.0,
                      label=f"on the way {name}")  # fmt: skip
        line = np.geomspace(height.min(), height.max(), 50)
        left.plot(1e3 * line, weight * (rest / line) ** 2.5, color="black", linewidth=1.2,
                  label="lattice: height$^{-2.5}$")  # fmt: skip
        left.set(xscale="log", yscale="log", xlabel="height of the piston [mm]",
                 ylabel="force on it [N]", xticks=[40, 60, 80, 100, 120])  # fmt: skip
        left.set_xticklabels(["40", "60", "80", "100", "120"])
        left.minorticks_off()
        left.set_ylim(bottom=5.0)
        left.legend(markerscale=4.0)
        right.plot(np.arange(1, len(ratios) + 1), ratios, "o-", color=COLOURS[0])
        right.axhline(1.0, color="black", linewidth=1.2)
        right.set(xlabel="swing after the fall", ylabel="energy lost over affine loss",
                  ylim=(0.0, None))  # fmt: skip
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
        f"| height of rest | {rest / DIAMETER:.2f} D | {at_rest.height / DIAMETER:.2f} D |",
        f"| frequency if the bed re-packs | {omega / (2.0 * math.pi):.2f} Hz | |",
        f"| frequency with the shear modulus of falling beds | {1.0 / told.period:.2f} Hz "
        f"| {1.0 / at_rest.period:.2f} Hz |",
        f"| damping ratio by affine drag | {ratio:.4f} | {at_rest.damping_ratio:.4f} |",
        f"| loss over affine loss, first swing | 1 | {ratios[0]:.2f} |",
        f"| the same, last of {len(ratios)} swings | 1 | {ratios[-1]:.2f} |",
    ]
    write_block("theory", "\n".join([*rows, ""]), DOCS / "guide" / "theory.md")


def lattice_height(scene: Scene) -> float:
    """Where the triangular lattice carries the piston [m]."""
    grain = scene.grains
    volume = math.pi / 4.0 * DIAMETER**2 * grain.thickness
    moment = grain.remanence * volume / (4e-7 * math.pi)
    unit = 4e-7 * math.pi * moment**2 / (math.pi * DIAMETER**4)
    assert scene.piston is not None
    assert scene.piston.mass is not None
    width, weight = scene.cell.width, scene.piston.mass * GRAVITY
    over = 1.6674 * unit * width / (DIAMETER * weight)
    return grain.count * DIAMETER**2 / width * over**0.4


def draw_effects() -> None:
    """Forces of pairs and walls over the distance, as `evaluate` gives them."""
    distances = np.linspace(0.8, 4.0, 60)
    base = load_scene("bed").replace(
        **{
            "grains.count": 2, "cell.width": "40 D", "piston.height": "40 D",
            "arrangement.height": "39 D", "effects.gravity": None, "effects.drag": None,
        }
    )  # fmt: skip
    free = dict.fromkeys(("left", "right", "top"), "none")
    with figure(width=7.0, height=3.4) as (drawing, axes):
        pair = [
            np.abs(evaluate(base.replace(**{"effects.walls": None}),
                            np.array([[15.0, 20.0], [15.0 + r, 20.0]]) * DIAMETER,
                            piston_height=40 * DIAMETER).force[0, 0])
            for r in distances
        ]  # fmt: skip
        axes.plot(distances, pair, color=COLOURS[0], label="two grains, distance of the centres")
        for colour, law in enumerate(("experimental", "infinite", "slab"), 1):
            scene = base.replace(**{"effects.walls": {**free, "bottom": law}})
            walls = [
                evaluate(scene, np.array([[10.0, w], [30.0, w]]) * DIAMETER,
                         piston_height=40 * DIAMETER).wall_forces["bottom"] / 2.0
                for w in distances
            ]  # fmt: skip
            style = "--" if law == "slab" else "-"
            axes.plot(distances, walls, style, color=COLOURS[colour], label=f"wall, {law}")
        weight = 6.2498e-4 * GRAVITY
        axes.axhline(weight, color=GREY, linestyle=":", label="weight of a grain")
        axes.set(yscale="log", xlabel="distance [D]", ylabel="force [N]")
        axes.legend()
        keep(drawing, "effects")


def draw_methods() -> None:
    """Error of four methods over the step, on a grain that swings about its place of rest."""
    names = ("symplectic-euler", "stormer-verlet", "blanes-moan-4", "blanes-moan-6")
    slopes = []
    with figure(width=7.0, height=3.4) as (drawing, axes):
        for place, name in enumerate(names):
            found = convergence(exact_problem("oscillation"), name)
            assert found.fit is not None
            slopes.append(f"{found.fit.value:.2f}")
            axes.plot(1e3 * np.array(found.steps), found.errors, "o-", color=COLOURS[place],
                      markersize=3.0, label=f"{name}, order {found.order}")  # fmt: skip
        axes.set(xscale="log", yscale="log", xlabel="time step [ms]",
                 ylabel="greatest error [m]")  # fmt: skip
        axes.legend()
        keep(drawing, "methods")
    measured = f"{', '.join(slopes[:-1])} and {slopes[-1]} for methods of order 1, 2, 4 and 6"
    words = f"- Orders measured on a grain that swings about rest: {measured}"
    write_block("methods", words, DOCS.parent / "README.md")


def draw_pairs() -> None:
    """What a cut-off takes off the pressure: the virial of pairs within a radius over all."""
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
    axes = plot_correlation_function(radial_distribution_of_run(run, start=last))
    drawing: Any = axes.figure
    drawing.set_size_inches(7.0, 3.2)
    keep(drawing, "distribution")
    keep(still(compressed_run(), -1, colour="sides"), "compressed")


def draw_studies() -> None:
    """Height of rest of small dampers over the mass of their piston."""
    masses, seeds = (2.0, 2.75, 3.75, 5.0), (1, 2, 3)
    drop = [{"kind": "free", "name": "drop", "duration": 4.0}]
    heights = [
        [
            simulated(damper(count=92, mass=mass).replace(
                **{"arrangement.seed": seed, "protocol": drop, "output.record": "drop"}
            )).piston().height[-1] / DIAMETER
            for seed in seeds
        ]
        for mass in masses
    ]  # fmt: skip
    with figure(width=7.0, height=3.2) as (drawing, axes):
        for mass, some in zip(masses, heights, strict=True):
            axes.plot([mass] * len(some), some, "o", color=COLOURS[0])
        line = np.linspace(masses[0], masses[-1], 50)
        middle = float(np.mean(heights[2]))
        axes.plot(line, middle * (line / masses[2]) ** -0.4, color="black",
                  label="mass$^{-0.4}$, as the lattice says")  # fmt: skip
        axes.set(xlabel="mass of the piston [kg]", ylabel="height of rest [D]")
        axes.legend()
        keep(drawing, "studies")


def draw_record() -> None:
    """A record with noise and a gap, the law fitted to it, and what is left over."""
    record = noisy(damper_run().piston().from_zero().between(0.0, 4.0))
    model = fit(record, law="polynomial-spring")
    drawing: Any = model.plot(record).figure
    drawing.set_size_inches(7.0, 4.2)
    keep(drawing, "record")


def noisy(record: PistonRecord) -> PistonRecord:
    """The record as a sensor of 20 µm noise sees it, with a gap."""
    seen = (record.time < 1.2) | (record.time > 1.5)
    errors = np.random.default_rng(1).normal(0.0, 20e-6, len(record))
    return PistonRecord(record.time[seen], (record.height + errors)[seen])


def draw_pendulum() -> None:
    """A pendulum let go at two radians: the linear law, and the pendulum's own."""
    times = np.linspace(0.0, 20.0, 1000)
    start = PistonRecord(times, 2.0 * np.exp(-0.1 * times) * np.cos(1.3 * times))
    true = fit(start, "z'' + c*z' + k*sin(z) = 0", start={"c": 0.2, "k": 2.0}).simulate(times)
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


def draw_limits() -> None:
    """A law of small lifts, asked for a whole fall, which it has not seen."""
    run = damper_run()
    small = fit(run.piston(), law="power-law-spring")
    fall = run.piston("drop").from_zero().between(0.0, 2.0)
    asked = small.simulate(fall.time, z0=float(fall.height[0]), v0=0.0)
    known = predict(damper()).simulate(fall.time, z0=float(fall.height[0]), v0=0.0)
    with figure(width=7.0, height=3.2) as (drawing, axes):
        axes.plot(fall.time, 1e3 * fall.height, color=GREY, linewidth=4, label="simulated fall")
        axes.plot(fall.time, 1e3 * asked.height, color=COLOURS[1],
                  label="law fitted to a lift of 0.2 D")  # fmt: skip
        axes.plot(fall.time, 1e3 * known.height, "--", color=COLOURS[0], label="law of whole falls")
        axes.set(xlabel="time [s]", ylabel="height of the piston [mm]")
        axes.legend()
        keep(drawing, "limits")


def draw_misprints() -> None:
    """The load on the plates over the diameter, as [D, eq. 4.10] prints it and as it is meant."""
    diameter = np.linspace(3.5, 9.0, 100)
    thickness, distance = 3.0, 3.1
    diagonal = np.hypot(diameter, thickness)
    phi = np.arctan(thickness / diameter)
    whole = np.arcsin(distance / diagonal)
    with figure(width=7.0, height=3.2) as (drawing, axes):
        for place, (name, theta) in enumerate((("printed", whole), ("meant", whole - phi))):
            factor = 0.75 * diameter * np.cos(theta) * np.sin(theta)
            axes.plot(diameter, factor / (np.cos(phi + theta) * diagonal), color=COLOURS[1 - place],
                      label=name)  # fmt: skip
        axes.set(yscale="log", xlabel="diameter of the grains [mm]",
                 ylabel="load of a neighbour, $K$")  # fmt: skip
        axes.legend(title="[D, eq. 4.10]")
        keep(drawing, "misprints")


def draw_maps() -> None:
    """The maps of designs."""
    keep(plot_maps(damper_maps()), "maps")


def draw_first_bed() -> None:
    """The bed of the first page, coloured by force."""
    keep(still(simulated(load_scene("bed"), t_end=0.5), -1, colour="force"), "bed")


def write_block(name: str, text: str, path: Path) -> None:
    """Write what was measured between its marks in a page, with the command and the date."""
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
    "first-bed": draw_first_bed,
    "effects": draw_effects,
    "methods": draw_methods,
    "pairs": draw_pairs,
    "observables": draw_observables,
    "studies": draw_studies,
    "record": draw_record,
    "pendulum": draw_pendulum,
    "limits": draw_limits,
    "misprints": draw_misprints,
    "maps": draw_maps,
}


def main(names: list[str]) -> None:
    """Draw the named pictures, or all."""
    unknown = sorted(set(names) - set(PICTURES))
    if unknown:
        sys.exit(f"error: no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    IMAGES.mkdir(exist_ok=True)
    for name in names or PICTURES:
        PICTURES[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
