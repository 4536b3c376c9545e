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
# # 8. An effect and a law of one's own
#
# A law of the piston is an equation. A force on the grains is a formula too, or a class with a few
# functions, which are compiled into the loop like the package's own effects. So are walls, the
# piston's path, and the integration method: ten lines each. All are done here by public names,
# without touching the package.

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import math
import warnings

import matplotlib.pyplot as plt
import numpy as np

from granular import GranularError, Method, damper, effect, evaluate, load_scene, quantity, simulate, wall_law
from reduced_models import FirstGuesses, Law, compare, fit

plt.style.use("tableau-colorblind10")  # lines that colour-blind eyes tell apart
warnings.simplefilter("ignore")  # what they say is printed where it matters

QUICK = True  # False: the damper of 368 grains, and longer runs of the own effect

# %% [markdown]
# ## A law as text
#
# The record is the release of a damper after a lift of 1 D. The law says: the piston alone moves
# under the known weight g, on a spring with a free exponent, (r/z)ⁿ. The names that stand for no
# column of the record (`lam`, `rest`, `power`) are the parameters.

# %%
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the fall squeezes grains below a diameter; see notebook 4
    record = simulate(damper(count=92 if QUICK else 368, lift=1.0), progress=False).piston()
KNOWN_WEIGHT = "z'' + 2*lam*z' = 9.8*((rest/z)**power - 1)"
bounds = {"lam": (0.0, 5.0), "rest": (0.02, 0.08), "power": (1.0, 4.0)}
known_weight = fit(record, KNOWN_WEIGHT, bounds=bounds)
print(known_weight)

# %% [markdown]
# What is written wrongly is refused with the reason.

# %%
mistakes = ("z''**2 + k*z = 0", "z'' + 2*lam*z' + k*(z - rest", "y'' + k*y = 0")
refusals = {}
for text in mistakes:
    try:
        fit(record, text)
    except GranularError as error:
        refusals[text] = str(error)
        print(f"{text}\n  {error}")

# %% [markdown]
# ## A law with start values
#
# Start values of a text come from the accelerations in the record. A law that is used often is a
# `Law`: with a function that proposes them, with parameters that must be positive, and with units.
# This one leaves the inertia open (grains move with the piston, so the weight per moving mass is
# not g), and lets the drag grow as the bed is squeezed. The law above gets such start values too.


# %%
def start(guesses: FirstGuesses, random: np.random.Generator, count: int) -> dict[str, np.ndarray]:
    """Proposals for the parameters."""
    frequency, rest = guesses.frequencies(random, count), guesses.levels(random, count)
    power = random.uniform(2.0, 3.0, count)
    return {
        "lam": guesses.decays(random, count),
        "weight": frequency**2 * rest / power,
        "rest": rest,
        "power": power,
        "rise": random.uniform(-1.0, 1.0, count),
    }


SQUEEZED_DRAG = Law(
    name="squeezed-drag",
    equation="z'' + 2*lam*(rest/z)**rise*z' = weight*((rest/z)**power - 1)",
    start=start,
    positive=("lam", "weight", "rest"),
    units={"lam": "1/s", "weight": "m/s^2", "rest": "m", "power": "1", "rise": "1"},
)
KNOWN = Law(
    name="known-weight",
    equation=KNOWN_WEIGHT,
    start=lambda *arguments: {name: start(*arguments)[name] for name in ("lam", "rest", "power")},
    positive=("lam", "rest"),
    units={"lam": "1/s", "rest": "m", "power": "1"},
)
squeezed = fit(record, SQUEEZED_DRAG)
print(squeezed)

# %% [markdown]
# ## Beside the built-in laws
#
# Own laws take part in `compare` like any other. They are ranked by how they predict the last
# third of the record, which none has seen.

# %%
table = compare(record, ["linear", "power-law-spring", "polynomial-spring", SQUEEZED_DRAG, KNOWN])
print(table)
errors = {row.name: row.error for row in table.rows}

# %% [markdown]
# Here neither freedom buys anything: the weight per moving mass comes out near g, and how the drag
# rises is left open by the data. (The interval of the weight need not hold g: what the law leaves
# over is no noise, as the note says, so its intervals are those of a law that is not quite right.)
# The law with three parameters does as well as those with more; a polynomial spring, whose
# curvature is free, does better.

# %%
weight_over_g = squeezed.parameters["weight"] / 9.8
low, high = squeezed.intervals["rise"]
rise_may_be_none = low <= 0.0 <= high
print(f"weight over g: {weight_over_g:.3f}; the rise of the drag may be none: {rise_may_be_none}")

# %% [markdown]
# ## A force as a formula
#
# Suppose that a second magnet below the cell pulls every grain down with a spring's force, −k y.
# A scene says so by the energy of a grain; force and stiffness are derived from it.

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
places, _ = scene.initial_motion()
as_formula = scene.replace(**{"effects.field": [{"energy": "k*y**2/2", "k": "10 N/m"}]})

# %% [markdown]
# The units must make joules, and names must be known.

# %%
formula_refusals = {}
for energy in ("k*y", "k*y**2/2 + z", "k*y**2/2*exp(y)"):
    try:
        scene.replace(**{"effects.field": [{"energy": energy, "k": "10 N/m"}]})
    except GranularError as error:
        formula_refusals[energy] = str(error)
        print(f"{energy}\n  {error}")

# %% [markdown]
# ## The same as a class
#
# What is no formula is a class: parameters with units, and functions that the loop takes in. Before
# a run they are tried against each other.


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
for changes in ({"k": "-1 N/m"}, {"k": "10 N"}, {"kk": 10.0}):
    try:
        scene.replace(**{"effects.spring": changes})
    except GranularError as error:
        print(error)


# %% [markdown]
# A force that is no gradient is told so.


# %%
@effect
class WrongSpring:
    """Its force is twice too large."""

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
# Both ways give the same forces, minus the gradient of the energy: here by central differences in
# every coordinate.


# %%
def gradient_error(one: object, step: float = 3e-7) -> float:
    """Greatest difference of force and minus the gradient, over the greatest force."""
    force, worst = evaluate(one, places).force, 0.0
    for index in np.ndindex(places.shape):
        there, back = places.copy(), places.copy()
        there[index] += step
        back[index] -= step
        rise = evaluate(one, there).potential_energy - evaluate(one, back).potential_energy
        worst = max(worst, abs(force[index] + rise / (2.0 * step)))
    return worst / float(np.abs(force).max())


own_gradient = gradient_error(as_class)
without = evaluate(scene, places).force[:, 1]
pulls = {
    name: evaluate(one, places).force[:, 1] - without
    for name, one in (("formula", as_formula), ("class", as_class))
}
ways_differ = float(np.abs(pulls["class"] - pulls["formula"]).max())
pull_error = float(np.abs(pulls["class"] + 10.0 * places[:, 1]).max())
print(f"|F + grad U| = {own_gradient:.1e} of the greatest force")
print(f"the two ways differ by {ways_differ:.1e} N, and from −k y by {pull_error:.1e} N")

# %% [markdown]
# The energy ledger counts the spring. A method of order two brings its error down by four where
# the step is halved.

# %%
SPAN = 0.1 if QUICK else 1.0
residuals = {}
for step in ("auto", "auto/2", "auto/4"):
    residuals[step] = simulate(as_class, step, t_end=SPAN, progress=False).settings()["ledger_residual"]
    print(f"dt {step:6}: the ledger closes to {residuals[step]:.1e}")
energy_order = math.log2(residuals["auto"] / residuals["auto/4"]) / 2.0
print(f"order {energy_order:.2f}")

# %% [markdown]
# ## What it does to the bed
#
# With drag both beds come to rest: under their weight alone, and pulled down by the springs.

# %%
LENGTH = 1.0 if QUICK else 5.0
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

# %%
last = sinks["with springs"].dataset.isel(time=-1, frame=-1)
lifted = float(last["bottom_force"] - last["piston_force"])
pulled = 10.0 * float(last["position"].values[:, 1].sum())
weight = 9.8 * float(scene.grains.masses().sum())
balance = abs(lifted / (weight + pulled) - 1.0)
print(f"weight {weight:.4f} N, pull of the springs {pulled:.4f} N: carried to {balance:.1e}")

# %% [markdown]
# ## What takes energy
#
# Such an effect is a flow: the velocity after a span, solved exactly. What it takes is booked.


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


muddy = scene.replace(**{"effects.mud": {"rate": "50 1/s", "depth": "1 cm"}})
run = simulate(muddy, t_end=SPAN, progress=False)
mud_loss = float(run.dataset["mud_loss"][-1])
mud_residual = run.settings()["ledger_residual"]
print(f"lost to the mud: {1e6 * mud_loss:.1f} µJ; the ledger closes to {mud_residual:.1e}")

# %% [markdown]
# ## Effects that the package brings besides
#
# Eddy currents in a copper plate slow grains down in proportion to the square of their moments, a
# field gradient pulls at them, and side walls hold them by dry friction.

# %%
driven = scene.replace(
    **{
        "effects.eddy": {"conductivity": "59.6 MS/m", "thickness": "1 mm", "distance": "4 mm"},
        "effects.gradient": {"y": "-0.1 T/m"},
        "effects.wall_friction": {"coefficient": 0.3},
    }
)
run = simulate(driven, t_end=SPAN, progress=False)
lost = {name: float(run.dataset[name][-1]) for name in ("eddy_loss", "wall_friction_loss")}
print({name: f"{1e6 * energy:.1f} µJ" for name, energy in lost.items()})

# %% [markdown]
# ## A wall, and a stage
#
# A wall has an energy of the distance, and a piston a height as a formula of time.

# %%
waving = scene.replace(
    **{
        "effects.walls.left": {"energy": "a*(l/w)**3", "a": "1 mJ", "l": "6 mm"},
        "protocol": [
            {
                "kind": "path",
                "name": "wave",
                "height": "h0 - a*(1 - cos(w*t))",
                "a": "1 mm",
                "w": "60 1/s",
                "duration": SPAN,
            }
        ],
    }
)
run = simulate(waving, progress=False)
wave_error = float(
    abs(run.dataset["piston_height"] - (0.036 - 1e-3 * (1 - np.cos(60 * run.dataset["time"])))).max()
)
print(f"the piston is on its path to {wave_error:.1e} m")

# %% [markdown]
# A wall as a class has the same three functions, of the distance `w` of a grain from it.


# %%
@wall_law
class Soft:
    """A wall that pushes grains back in proportion to how far they are inside its skin."""

    k: float = quantity("N/m", above=0.0)
    skin: float = quantity("m", above=0.0)

    @staticmethod
    def energy(p, w):
        return 0.5 * p.k * max(p.skin - w, 0.0) ** 2

    @staticmethod
    def force(p, w):
        return p.k * max(p.skin - w, 0.0)

    @staticmethod
    def stiffness(p, w):
        return p.k if w < p.skin else 0.0


skin = {"law": "soft", "k": "400 N/m", "skin": "6 mm"}
soft = scene.replace(**{"effects.drag": True, "effects.walls.bottom": skin})
run = simulate(soft, t_end=LENGTH, progress=False)
last = run.dataset.isel(time=-1, frame=-1)
depth = np.clip(6e-3 - last["position"].values[:, 1], 0.0, None)
wall_error = abs(400.0 * depth.sum() / float(last["bottom_force"]) - 1.0)
print(f"the soft bottom carries {float(last['bottom_force']):.4f} N, ", end="")
print(f"k times the depths to {wall_error:.1e}")

# %% [markdown]
# ## A method
#
# An integration method is a table: kicks (steps of the velocity) and drifts (steps of the
# position), as fractions of the time step. McLachlan's method of order two has two force calls a
# step, and Verlet's one: so it is run at twice the step of Verlet's.

# %%
z = 0.1931833275037836  # McLachlan 1995, doi:10.1137/0916010
mclachlan = Method("mclachlan-2", 2, kicks=(0, 0.5, 0.5, 0), drifts=(z, 1 - 2 * z, z))
method_residuals = {}
for name, method, step in (
    ("mclachlan-2", mclachlan, "auto"),
    ("stormer-verlet", "stormer-verlet", "auto/2"),
):
    run = simulate(as_class, step, method=method, t_end=SPAN, progress=False)
    method_residuals[name] = run.settings()["ledger_residual"]
print({name: f"{residual:.1e}" for name, residual in method_residuals.items()})

# %% [markdown]
# The declared order is checked against all of its conditions; the one that fails is named.

# %%
try:
    Method("too-short", 2, kicks=(0.5, 0.4), drifts=(1.0,))
    wrong_method = ""
except GranularError as error:
    wrong_method = str(error)
print(wrong_method)

# %% [markdown]
# ## What came out

# %%
own_error, fixed_error = errors["squeezed-drag"], errors["known-weight"]
print(f"The own laws predict to {100 * own_error:.2g} % (free weight) and {100 * fixed_error:.2g} % ", end="")
print(f"(weight g); the linear one to {100 * errors['linear']:.2g} %.")
print(f"The own effect is a gradient to {own_gradient:.0e}, keeps its energy to order ", end="")
print(f"{energy_order:.2f},")
print(f"and its pull is carried by the walls to {balance:.0e}.")
gain = method_residuals["stormer-verlet"] / method_residuals["mclachlan-2"]
print(f"With as many force calls, McLachlan's method misses the energy {gain:.1f} times less.")

# %% [markdown]
# ## Exercises
#
# 1. Write the law of a pendulum that rubs, `theta'' + 2*c*theta' + f*tanh(20*theta') +
#    k*sin(theta) = 0`, and fit it to a record that you make yourself.
# 2. Give the effect of this notebook a parameter of your own, with a unit and a limit, and try
#    a value beyond the limit. What does the error say?
