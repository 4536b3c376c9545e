# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 7. Hard cases
#
# A hard case is a scene that is difficult to simulate. It should either run accurately, or end in
# an error that gives the reason. This notebook runs some hard cases of the toolkit: a head-on
# collision, a heavy piston, steps beyond the stability limit, and impossible starts. It also tests
# whether the energy drifts.

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import warnings

import matplotlib.pyplot as plt
import numpy as np

from granular import GranularError, Scene, damper, load_scene, simulate
from validation import (
    energy_change,
    energy_trend,
    hard_case_catalogue,
    head_on_collision,
    run_hard_case,
    scene_near_stability_limit,
)
from validation.exact_solution import harmonic_period
from validation.exact_solution import oscillation_problem as wide_swing

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish

QUICK = True  # False: longer runs, and the whole catalogue

# %% [markdown]
# ## A head-on collision
#
# Two grains approach each other and turn back at a distance of 0.02 D. The stiffness of their
# repulsion changes by twelve powers of ten. After the collision the kinetic energy must return to
# its initial value.

# %%
CLOSEST = 0.02
collision = head_on_collision(CLOSEST)
often = {"output.scalars": collision.time / 2000, "output.frames": collision.time / 20}
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")  # the warning that they overlap, without contact
    run = simulate(
        collision.scene.replace(**often), t_end=collision.time, method="adaptive-verlet", progress=False
    )
gap = run.dataset["closest_distance"].values / 0.005
figure, axes = plt.subplots(figsize=(7, 3.0), layout="constrained")
axes.semilogy(1e3 * run.dataset["time"], gap)
axes.set(xlabel="time [ms]", ylabel="distance of the grains [D]")
plt.show()
nearest = float(gap.min())
print(f"closest distance on record: {nearest:.4f} D")

# %% [markdown]
# ## Variable and equal steps
#
# Steps of equal length must be short enough for the closest approach, and are then unnecessarily
# short for the rest of the time. Variable steps, chosen by a time-reversible method, are short only
# near the closest approach. The error is the relative change of the energy. If equal steps are too
# long, the energy ledger stops the run; these runs are missing in the picture.


# %%
def energy_error(**options: object) -> tuple[int, float]:
    """Return the number of steps, and the change of the energy; NaN if the run was stopped."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the error is measured here
        try:
            run = simulate(collision.scene, t_end=collision.time, progress=False, **options)
        except GranularError:
            return 0, float("nan")
    return int(run.settings()["steps"]), energy_change(run)


counts = (500, 1000, 2000, 2400, 2700, 3000, 4000, 8000)
equal = [energy_error(dt=collision.time / count) for count in counts]
factors = ("auto*8", "auto*4", "auto*2", "auto", "auto/2")
variable = [energy_error(dt=one, method="adaptive-verlet") for one in factors]
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for points, style, label in ((equal, "o-", "equal steps"), (variable, "s--", "variable steps")):
    done = np.array([one for one in points if one[0]])
    axes.loglog(done[:, 0], np.maximum(done[:, 1], 1e-16), style, label=label)
axes.axhline(1e-6, color="#999999", linewidth=0.8)
axes.set(xlabel="steps", ylabel="change of the energy")
axes.legend()
plt.show()

# %%
for what, points in (("equal", equal), ("variable", variable)):
    print(what)
    for steps, error in points:
        print(f"  {steps:6} steps: {error:.1e}" if steps else "         stopped")
variable_steps = min(steps for steps, error in variable if steps and error < 1e-6)
equal_steps = min(steps for steps, error in equal if steps and error < 1e-6)

# %% [markdown]
# ## A heavy piston
#
# A piston with thirteen times the mass of the packaged damper's piston falls on the bed. The grains
# are points without contact forces here, and come as close as a fraction of a diameter, so the bed
# is very stiff for a moment. The automatic step is adapted to this stiffness: it is shortened
# during compression.

# %%
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    heavy = simulate(
        damper(mass=100.0, count=92).replace(**{"output.record": None}),
        t_end=0.15 if QUICK else 1.0,
        progress=False,
    )
print("\n".join(str(one.message) for one in said))
data = heavy.dataset
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.4), sharex=True, layout="constrained")
above.plot(1e3 * data["time"], 1e3 * data["piston_height"])
above.set(ylabel="piston height [mm]")
below.semilogy(1e3 * data["time"], data["stiffest_mode"])
below.set(xlabel="time [ms]", ylabel="highest frequency [rad/s]")
plt.show()
heavy_settings = heavy.settings()
heavy_ledger = heavy_settings["ledger_residual"]
print(f"minimum height {1e3 * float(data['piston_height'].min()):.1f} mm")
print(f"steps from {1e6 * heavy_settings['shortest_step']:.2g} to ", end="")
print(f"{1e6 * heavy_settings['longest_step']:.2g} µs")
print(f"energy ledger closed to {heavy_ledger:.1e} of the energy turned over")

# %% [markdown]
# ## Steps beyond the stability limit
#
# A grain oscillates about its equilibrium above the wall. Verlet's method is stable for such an
# oscillation up to a step of 2/ω. At 0.95 of the limit the amplitude is constant; at 1.05 it grows
# with every step, until the energy ledger stops the run with an error that gives step, time, grain
# and remedy. Results up to that time are not lost.

# %%
below_limit, short = scene_near_stability_limit(0.95)
beyond_limit, long = scene_near_stability_limit(1.05)


def every_step(scene: Scene, step: float) -> Scene:
    """Return the scene with a record and a frame of each step."""
    return scene.replace(**{"output.scalars": step, "output.frames": step})


calm = simulate(every_step(below_limit(), short), short, t_end=60 * short, progress=False)
try:
    simulate(every_step(beyond_limit(), long), long, t_end=60 * long, progress=False)
    stopped = None
except GranularError as error:
    stopped = error
print(f"{type(stopped).__name__}: {stopped}")

# %%
figure, axes = plt.subplots(figsize=(7, 3.0), layout="constrained")
for done, style, label in ((calm, ".", "0.95 of the limit"), (stopped.trajectory, "s", "1.05")):
    place = done.dataset["position"].values[:, 0, 1] / 0.005
    way = np.abs(place - place[0])[1:]
    times = done.dataset["frame_time"].values[1:]
    axes.semilogy(times, np.maximum(way, 1e-9), style, markersize=4, label=label)
axes.set(xlabel="time [s]", ylabel="way from the start [D]")
axes.legend()
plt.show()

# %% [markdown]
# ## Impossible starts
#
# The following runs do not start: the scene is rejected with a one-line message that gives the
# remedy.

# %%
bed = {"grains.count": 92, "cell.width": "30 D", "piston.height": "10 D"}
impossible = {
    "piston inside the bed": lambda: load_scene("bed").replace(**bed, **{"arrangement.height": "12 D"}),
    "a height in kilograms": lambda: load_scene("bed").replace(**{"piston.height": "3 kg"}),
    "a misspelt key": lambda: load_scene("bed").replace(**{"grains.cuont": 92}),
    "a position that is not a number": lambda: load_scene("single-particle").replace(
        **{"arrangement.positions": [[0.15, float("nan")]]}
    ),
    "dry friction, order four": lambda: simulate(
        load_scene("bed").replace(**{"effects.friction": True}), method="pefrl", progress=False
    ),
}
refused = {}
for what, attempt in impossible.items():
    try:
        attempt()
    except GranularError as error:
        refused[what] = type(error).__name__
        print(f"{what}\n  {type(error).__name__}: {error}")

# %% [markdown]
# ## From the catalogue
#
# `validation.hard_cases` contains many more cases; `run_hard_case` runs one case and classifies the
# outcome. "Accurate" means that the error is below the limit of the case. "Stopped" means that the
# run ended with an error message that the case allows. A wrong result without a warning must never
# occur.

# %%
chosen = (
    "shot at the wall with 100 D/tau",
    "coincident grains",
    "overlapping start",
    "step at 0.95 of the stability limit",
    "step at 1.05 of the stability limit",
    "extreme: remanence of 100 T",
    "extreme: gravity of 1e4 m/s^2",
    "injected nan: a velocity",
    "injected inf: the step",
)
cases = [one for one in hard_case_catalogue() if not QUICK or one.name in chosen]
outcomes = [run_hard_case(one, full=False) for one in cases]
print(f"{'case':38} {'outcome':10} {'error':>8} {'limit':>8}")
for one in outcomes:
    error = "" if np.isnan(one.error) else f"{one.error:.1e}"
    print(f"{one.case:38} {one.kind:10} {error:>8} {one.limit:8.0e}")
silent = [one.case for one in outcomes if not one.allowed]

# %% [markdown]
# ## Does the energy drift?
#
# With a symplectic method the energy oscillates with the motion indefinitely, but has no trend. A
# limit on the energy error would not reveal a slow trend. Therefore a statistical test decides
# whether a trend is significant, for two models of the noise. The control is the classical
# Runge-Kutta method, which has order four and is not symplectic. Both methods integrate many large
# oscillations of a grain above the wall.

# %%
swing = wide_swing(0.5)
period = harmonic_period(swing.scene, 0.5)
SWINGS, STEPS = (400, 60) if QUICK else (4000, 120)


def energy_course(method: str, steps_per_period: int) -> tuple[np.ndarray, np.ndarray]:
    """Return times, and the change of the energy over the maximum kinetic energy."""
    dt = period / steps_per_period
    often = {"output.scalars": 7 * dt, "output.frames": 7000 * dt}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the drift is measured here
        run = simulate(swing.scene.replace(**often), dt, t_end=SWINGS * period, method=method, progress=False)
    data = run.dataset
    energy = data["kinetic_energy"] + data["wall_energy"] + data["weight_energy"]
    share = (energy - energy[0]) / float(data["kinetic_energy"].max())
    return data["time"].values[:-1], share.values[:-1]


courses = {"stormer-verlet": energy_course("stormer-verlet", STEPS)}
courses["runge-kutta-4"] = energy_course("runge-kutta-4", STEPS)
trends = {name: energy_trend(*course) for name, course in courses.items()}
figure, pair = plt.subplots(1, 2, figsize=(9, 3.0), layout="constrained")
for axes, (name, (times, share)) in zip(pair, courses.items(), strict=True):
    axes.plot(times, share, ".", markersize=1)
    axes.set(xlabel="time [s]", ylabel="energy, relative change", title=name)
plt.show()
for name, trend in trends.items():
    print(
        f"{name:15} {trend.verdict():6} drift {trend.total_drift:+.1e}, amplitude {trend.swing:.1e}, ", end=""
    )
    print(f"p = {trend.p_value:.2g}")

# %% [markdown]
# ## Results

# %%
step_saving = equal_steps / variable_steps
stop_error = type(stopped).__name__
verlet_verdict = trends["stormer-verlet"].verdict()
control_verdict = trends["runge-kutta-4"].verdict()
print(f"A collision down to {CLOSEST} D conserves energy to 1e-6 with {variable_steps} variable ")
print(f"steps, and with {equal_steps} equal ones. Of {len(outcomes)} hard cases none failed silently.")
print(f"Beyond the stability limit the run ends in an {stop_error}. Verlet's energy has no trend;")
print(f"Runge and Kutta's method {control_verdict} {-trends['runge-kutta-4'].total_drift:.1e} of its energy.")

# %% [markdown]
# ## Exercises
#
# 1. Let the two grains collide ten times faster. How close do the grains come, and how many
#    variable steps are needed?
# 2. Find, to 10 %, the longest step with which `stormer-verlet` conserves the energy of the small
#    bed. Compare it with the step of `auto`.
