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
# # 8. A custom effect and a custom law
#
# In this example a second magnet below the cell pulls every grain down like a spring, and a film of
# mud on the plates slows down grains, more strongly at lower heights. The package contains neither
# of these effects. Here they are added, as a formula and as short classes, and tested. Then a
# custom law is fitted to the motion of the piston. Walls, stages, methods and pair laws are added
# in the same manner: see the guide page "How do I add my own law, force or wall?".

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import math
import warnings

import matplotlib.pyplot as plt
import numpy as np

from granular import GranularError, damper, effect, evaluate, load_scene, quantity, simulate
from reduced_models import Parameter, compare, fit

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish

QUICK = True  # False: the damper of 368 grains, and longer runs of the custom effects
SPAN, LENGTH = (0.1, 1.0) if QUICK else (1.0, 5.0)

# %% [markdown]
# ## A force as a formula
#
# The scene contains a formula for the energy of a grain, from which force and stiffness are
# derived.

# %%
scene = load_scene("bed").replace(
    **{
        "grains.count": 23,
        "cell.width": "15 D",
        "piston.height": "6 D",
        "arrangement.height": "5.5 D",
        "effects.drag": None,
    }
)
as_formula = scene.replace(**{"effects.field": [{"energy": "k*y**2/2", "k": "10 N/m"}]})

# %% [markdown]
# ## The same as a class
#
# An effect that cannot be written as a formula is defined by a class. The class contains parameters
# with units and limits, and functions that are compiled into the time loop.


# %%
@effect
class Spring:
    """A spring that pulls every grain towards the bottom."""

    k: float = quantity("N/m", above=0.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * p.k * grain.y**2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -p.k * grain.y

    @staticmethod
    def stiffness(p, grain, time):
        return p.k


as_class = scene.replace(**{"effects.spring": {"k": "10 N/m"}})
places, _ = scene.initial_positions_and_velocities()
without = evaluate(scene, places).force[:, 1]
pulls = {
    name: evaluate(one, places).force[:, 1] - without
    for name, one in (("formula", as_formula), ("class", as_class))
}
ways_differ = float(np.abs(pulls["class"] - pulls["formula"]).max())
pull_error = float(np.abs(pulls["class"] + 10.0 * places[:, 1]).max())
figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
for (name, pull), marker in zip(pulls.items(), "ox", strict=True):
    axes.plot(1e3 * places[:, 1], pull, marker, fillstyle="none", label=name)
axes.plot([0, 33], [0, -0.33], linewidth=0.8, label="−k y")
axes.set(xlabel="height of the grain [mm]", ylabel="pull [N]")
axes.legend()
plt.show()
print(f"the two effects differ by {ways_differ:.1e} N, and from −k y by {pull_error:.1e} N")

# %% [markdown]
# Before a run, these functions are checked for consistency. A force that is not the negative
# gradient of its energy is rejected:


# %%
@effect
class WrongSpring:
    """A spring whose force is twice as large as its energy implies."""

    k: float = quantity("N/m", default=10.0)

    @staticmethod
    def energy(p, grain, time):
        return 0.5 * p.k * grain.y**2

    @staticmethod
    def force(p, grain, time):
        return 0.0, -2.0 * p.k * grain.y


try:
    evaluate(scene.replace(**{"effects.wrong_spring": True}), places)
    wrong_force = ""
except GranularError as error:
    wrong_force = str(error)
print(wrong_force)

# %% [markdown]
# ## Effect on the bed
#
# Two beds come to rest by drag: the first under its weight alone, and the second also under the
# pull of the magnet below the cell.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
sinks = {}
for one, marker, label in ((scene, "o", "weight alone"), (as_class, "s", "with springs")):
    run = simulate(one.replace(**{"effects.drag": True}), t_end=LENGTH, progress=False)
    place = run.dataset["position"].values
    left.plot(*(1e3 * place[-1]).T, marker, fillstyle="none", label=label)
    right.plot(run.dataset["frame_time"], 1e3 * place[:, :, 1].mean(axis=1), label=label)
    sinks[label] = run
left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(0, 90), ylim=(0, 36))
right.set(xlabel="time [s]", ylabel="mean height [mm]")
right.legend()
plt.show()

# %% [markdown]
# The bottom and the piston together must balance the weight and the additional pull:

# %%
last = sinks["with springs"].dataset.isel(time=-1, frame=-1)
lifted = float(last["bottom_force"] - last["piston_force"])
pulled = 10.0 * float(last["position"].values[:, 1].sum())
weight = 9.8 * float(scene.grains.masses().sum())
balance = abs(lifted / (weight + pulled) - 1.0)
print(f"weight {weight:.4f} N, pull of the springs {pulled:.4f} N: balanced by the walls to {balance:.1e}")

# %% [markdown]
# ## A dissipative effect
#
# A dissipative effect is defined by its flow: a function that returns the exact velocity after a
# time interval in which only this effect acts. The dissipated energy is recorded, so the energy
# balance still closes.


# %%
@effect
class Mud:
    """A drag that grows with the depth."""

    rate: float = quantity("1/s", above=0.0)
    depth: float = quantity("m", above=0.0)

    @staticmethod
    def flow(p, grain, vx, vy, span):
        left = math.exp(-p.rate * math.exp(-grain.y / p.depth) * span)
        return left * vx, left * vy


muddy = as_class.replace(**{"effects.mud": {"rate": "50 1/s", "depth": "1 cm"}})
run = simulate(muddy, t_end=SPAN, progress=False)
data = run.dataset
mud_loss = float(data["mud_loss"][-1])
mud_residual = run.settings()["ledger_residual"]
stored = sum(data[f"{name}_energy"] for name in ("pair", "wall", "weight", "spring"))
parts = np.array([stored - stored.min(), data["kinetic_energy"], data["mud_loss"]])
figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
axes.stackplot(
    1e3 * data["time"], 1e3 * parts, labels=("potential, above its least", "kinetic", "lost to the mud")
)
axes.set(xlabel="time [ms]", ylabel="energy [mJ]")
axes.legend(loc="lower right")
plt.show()
print(f"lost to the mud: {1e6 * mud_loss:.1f} µJ; the ledger closes to {mud_residual:.1e}")

# %% [markdown]
# Because the flow for the mud is exact, a method of order two keeps its order: the energy error
# decreases by a factor of four if the step is halved.

# %%
residuals = {
    step: simulate(muddy, step, t_end=SPAN, progress=False).settings()["ledger_residual"]
    for step in ("auto", "auto/2", "auto/4")
}
energy_order = math.log2(residuals["auto"] / residuals["auto/4"]) / 2.0
print(
    ", ".join(f"{step}: {residual:.1e}" for step, residual in residuals.items()), f"order {energy_order:.2f}"
)

# %% [markdown]
# ## A law of the piston
#
# The record contains the motion of a damper after a lift of 1 D. In the law the piston moves under
# the known gravity g on a spring whose force (r/z)ⁿ has a free exponent. Names that are not columns
# of the record (`lam`, `rest`, `power`) are parameters of the fit.

# %%
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the fall pushes grains closer than a diameter; see notebook 4
    record = simulate(damper(count=92 if QUICK else 368, lift=1.0), progress=False).piston()
KNOWN_WEIGHT = "z'' + 2*lam*z' = 9.8*((rest/z)**power - 1)"
parameters = {
    "lam": Parameter(low=0.0, high=5.0),
    "rest": Parameter(low=0.02, high=0.08),
    "power": Parameter(low=1.0, high=4.0),
}
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the note is printed with the model
    known_weight = fit(record, KNOWN_WEIGHT, parameters=parameters)
print(known_weight)
known_weight.plot(record)
plt.show()

# %% [markdown]
# `compare` accepts custom laws like any other law. The laws are ranked by their prediction errors
# on every third cycle, which is not used in the fits.

# %%
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the notes are printed with the table
    table = compare(record, ["linear", "power-law-spring", "polynomial-spring", KNOWN_WEIGHT])
errors = {row.name: row.error for row in table.rows}
print(table)
own_error = errors[KNOWN_WEIGHT]

# %% [markdown]
# ## Results

# %%
print(f"The custom law predicts to {100 * own_error:.2g} %, with 3 parameters; the linear one to ", end="")
print(f"{100 * errors['linear']:.2g} %.")
print(f"The walls balance the springs to {balance:.0e}, the energy ledger with mud closes to ", end="")
print(f"{mud_residual:.0e}.")

# %% [markdown]
# ## Exercises
#
# 1. Write the law of a pendulum with dry friction, `theta'' + 2*c*theta' + f*tanh(20*theta') +
#    k*sin(theta) = 0`, and fit it to a simulated record.
# 2. Give the effect of this notebook another parameter, with a unit and a limit, and try a value
#    outside the limit. Which error message results?
