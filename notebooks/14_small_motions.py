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
# # 14. Small motions without a time step
#
# A settled bed is an elastic body. Its equilibrium, the complex roots of its small oscillations
# (which give frequency and damping), and the derivatives of these roots with respect to parameters
# follow from the forces alone, without a simulation. How small must a motion be for these results
# to be valid?

# %%
# %matplotlib inline
# %config InlineBackend.print_figure_kwargs = {"dpi": 80, "bbox_inches": "tight"}
import warnings

import matplotlib.pyplot as plt
import numpy as np

from granular import equilibrium, load_scene, simulate
from granular.linear import dynamic_stiffness, root_of_steps, small_motions, transmissibility
from granular.linear.page import (
    plot_density_of_states,
    plot_dynamic_stiffness,
    plot_mode,
    plot_transmissibility,
)

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish
warnings.simplefilter("ignore")  # grains of this scene may overlap in the fall, without contact forces

QUICK = True  # False: the packaged damper of 368 magnets
CHANGES = {"grains.count": 92, "cell.width": "30 D", "piston.mass": 3.75} if QUICK else {}
LIFTS = np.array([0.02, 0.2, 0.6, 1.2, 2.4, 3.6])  # [mm]

# %% [markdown]
# ## From the forces
#
# The scene is simulated until it is at rest. Newton's method then finds the equilibrium exactly,
# and linear algebra gives the roots and their derivatives (slopes).

# %%
scene = load_scene("damper").replace(**CHANGES)
found = small_motions(scene)
rest, root = found.rest, found.roots[0]
print(found)

# %% [markdown]
# ## Modes and curves

# %%
figure, panels = plt.subplots(2, 1, figsize=(7, 4), layout="constrained")
second = np.argsort(found.participation)[-2]
for axes, shape, title in (
    (panels[0], root.shape, f"root of the piston, {root.frequency:.3f} Hz"),
    (panels[1], found.modes.shapes[:, second], f"normal mode, {found.modes.frequencies[second]:.1f} Hz"),
):
    plot_mode(rest, shape, axes)
    axes.set_title(title)
plt.show()
figure, panels = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained")
frequencies = np.unique([*np.geomspace(0.3, 3.0, 60) * root.frequency, root.frequency])
plot_density_of_states(found.modes, panels[0])
plot_transmissibility(frequencies, transmissibility(rest, frequencies), panels[1])
plot_dynamic_stiffness(frequencies, dynamic_stiffness(rest, frequencies), panels[2])
plt.show()

# %% [markdown]
# ## Range of linearity
#
# The piston is lifted from the equilibrium and released. Frequency and damping ratio are averages
# over three cycles, from the heights and times of four minima.


# %%
AT_REST = {"arrangement.positions": rest.positions.tolist(), "piston.height": rest.piston_height}


def released(lift):
    """Return amplitude, frequency and damping ratio after a release, from the run."""
    stages = [
        {"kind": "lift", "name": "lift", "by": lift},
        {"kind": "free", "name": "release", "duration": 5.0 / root.frequency},
    ]
    motion = simulate(scene.replace(**AT_REST, protocol=stages), progress=False).piston("release")
    z, t = motion.height - rest.piston_height, motion.time
    turns = np.flatnonzero((z[1:-1] < z[:-2]) & (z[1:-1] <= z[2:]) & (z[1:-1] < 0.0)) + 1
    times, depths = [], []
    for k in turns[1:5]:
        a, b, c = np.polyfit(t[k - 3 : k + 4] - t[k], z[k - 3 : k + 4], 2)
        times.append(t[k] - 0.5 * b / a)
        depths.append(b * b / (4.0 * a) - c)
    decrement = np.log(depths[0] / depths[3]) / 3.0
    ratio = decrement / np.hypot(decrement, 2.0 * np.pi)
    return depths[0], 3.0 / (times[3] - times[0]) / np.sqrt(1.0 - ratio**2), ratio


measured = np.array([released(1e-3 * lift) for lift in LIFTS])
frequency_errors = (measured[:, 1] / root.frequency - 1.0).tolist()
damping_errors = (measured[:, 2] / root.damping_ratio - 1.0).tolist()
print("lift [mm]   amplitude [mm]   frequency [Hz]   damping [%]    error [%]")
for lift, (size, frequency, ratio), f, zeta in zip(
    LIFTS, measured, frequency_errors, damping_errors, strict=True
):
    print(
        f"{lift:9.2f}{1e3 * size:17.3f}{frequency:17.4f}{100.0 * ratio:14.4f}"
        f"{100.0 * f:+11.3f}{100.0 * zeta:+8.2f}"
    )
figure, axes = plt.subplots(figsize=(6, 2.8), layout="constrained")
axes.loglog(1e3 * measured[:, 0], np.abs(frequency_errors), "o-", label="frequency")
axes.loglog(1e3 * measured[:, 0], np.abs(damping_errors), "s--", label="damping ratio")
axes.set(xlabel="amplitude [mm]", ylabel="relative difference")
axes.legend()
plt.show()

# %% [markdown]
# ## Slopes without a fit
#
# To check the computed slopes, the bed is settled again from the same packing, with a piston that
# is 1 % heavier.

# %%
heavier = {"piston.mass": 1.01 * scene.piston.mass}
moved = equilibrium(scene.replace(**AT_REST, **heavier))
mass_slope = float(np.log(moved.piston_height / rest.piston_height) / np.log(1.01))
exact_slope = float(found.slopes.of("piston.mass")[0])
print(f"d ln rest / d ln mass {mass_slope:+.4f}, by the slopes {exact_slope:+.4f}")

# %% [markdown]
# ## Error of a root from the time step
#
# With a finite time step, the root of a simulated oscillation differs slightly from the exact root,
# depending on the integration method. If the step of a method of order p is halved, this error
# decreases by the factor 2ᵖ. For roots the symplectic Euler method is as accurate as Verlet's
# method, because the two methods have the same multipliers.

# %%
errors = {}
for method in ("symplectic-euler", "stormer-verlet", "pefrl"):
    steps = [4e-4, 2e-4]
    errors[method] = [abs(root_of_steps(rest, root, dt, method) / root.s - 1.0) for dt in steps]
    print(f"{method:18} {errors[method][0]:.2e} {errors[method][1]:.2e}")
halved = {method: float(np.log2(error[0] / error[1])) for method, error in errors.items()}
