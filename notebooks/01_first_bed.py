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
# # 1. A first bed
#
# Small magnets with parallel moments, between two glass plates, repel each other. Here 92 such
# magnets settle under a fixed piston. The notebook shows how to define a scene, simulate and draw
# it, check its energy balance, and store a run on disk.

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from granular import evaluate, load_scene, load_trajectory, run_text, scene_text, simulate
from granular.render import still

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish

QUICK = True  # False: the full bed of 368 grains

# %% [markdown]
# ## The scene
#
# A scene describes a bed completely. The package contains several scenes, and each key of a scene
# can be changed, with or without a unit (`D` is the diameter of a grain). The number of grains is
# reduced to a quarter here; the packing stays the same if width and height are halved.

# %%
scene = load_scene("bed")
if QUICK:
    scene = scene.replace(
        **{"grains.count": 92, "cell.width": "30 D", "piston.height": "10 D", "arrangement.height": "9.5 D"}
    )
print(scene_text(scene))

# %% [markdown]
# ## The run
#
# `simulate` chooses the time step from the stiffest motion that can occur in the bed. When a
# combination of effects is run for the first time, its code is compiled, and then cached on disk.

# %%
run = simulate(scene, progress=False)
print(run_text(run))

# %% [markdown]
# ## Picture of the bed
#
# At the start the grains lie on a jittered grid. The colour of a grain shows the total force that
# other grains and walls exert on this grain. The force is large if grains are too close to each
# other.

# %%
still(run, 0, colour="force")

# %% [markdown]
# At the end this force balances the weight of the grain, so all grains have the same colour. The
# colour scale differs from the first picture.

# %%
still(run, -1, colour="force")

# %% [markdown]
# ## Energy balance
#
# The grains start with excess potential energy. Some of it becomes kinetic energy, which drag
# dissipates. The sum of kinetic, potential and dissipated energy minus the external work (the
# energy ledger) must be constant. Its change is so small that it is drawn on a separate scale.

# %%
data = run.dataset
potential = data["pair_energy"] + data["wall_energy"] + data["weight_energy"]
ledger = data["kinetic_energy"] + potential + data["drag_loss"] - data["work"]
released = float(potential[0] - potential[-1])
ledger_error = float(abs(ledger - ledger[0]).max()) / released

figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5), sharex=True, layout="constrained")
above.plot(data["time"], 1e3 * (potential - potential[-1]), label="potential, above its end")
above.plot(data["time"], 1e3 * data["drag_loss"], "--", label="lost to drag")
above.plot(data["time"], 1e3 * data["kinetic_energy"], ":", label="kinetic")
above.set(ylabel="energy [mJ]", xscale="log", xlim=(1e-3, float(data["time"][-1])))
above.legend()
below.plot(data["time"], 1e6 * (ledger - ledger[0]))
below.set(xlabel="time [s]", ylabel="ledger, less its start [µJ]")
plt.show()

# %%
print(f"energy that the bed lost:      {1e3 * released:.3g} mJ")
print(f"dissipated by drag:            {1e3 * float(data['drag_loss'][-1]):.3g} mJ")
print(f"maximum deviation of the ledger: {ledger_error:.1e} of it")

# %% [markdown]
# ## Recorded quantities
#
# A run computes only the effects listed in its scene, and records columns only for these effects.
# This bed has drag, and therefore a column `drag_loss`; there is no column `friction_loss`, because
# the bed has no dry friction.

# %%
for name in data.data_vars:
    unit, meaning = data[name].attrs["units"], data[name].attrs["long_name"]
    print(f"{name:17} {unit:6} {meaning}")

# %% [markdown]
# ## Forces of one arrangement
#
# `evaluate` computes the forces on grains and walls for given positions, without time stepping. For
# the positions of the last frame, the result must agree with the forces recorded in the run. At
# rest the bottom carries the piston force and the weight of all grains.

# %%
last = evaluate(scene, data["position"].values[-1], piston_height=scene.piston.height)
grain_mass = float(np.pi / 4 * 0.006**2 * scene.grains.thickness * scene.grains.density)
weight = scene.grains.count * grain_mass * 9.8
carried = last.wall_forces["bottom"] - last.piston_force
same_force = abs(last.piston_force / float(data["piston_force"][-1]) - 1.0)
weight_error = abs(carried / weight - 1.0)
largest_force = float(np.abs(last.force).max())
print(f"force on the piston: {last.piston_force:.4f} N; in the run: {data['piston_force'][-1]:.4f} N")
print(f"bottom minus piston: {carried:.5f} N; weight of the grains: {weight:.5f} N")
print(f"maximum residual force on a grain: {largest_force:.1e} N")

# %% [markdown]
# ## Storing a run
#
# With `out` a run is written to disk while it is running, and can be read at any time. Here it is
# stopped halfway and resumed: the result is identical to the uninterrupted run, bit by bit.

# %%
folder = Path(tempfile.mkdtemp()) / "bed"
half = simulate(scene, t_end=0.5, out=folder, progress=False)
simulate(scene, out=folder, resume=True, progress=False)
loaded = load_trajectory(folder)
same_bits = all(np.array_equal(loaded.dataset[name], data[name]) for name in data.data_vars)
print(f"stopped at {float(half.dataset['time'][-1]):g} s, then {loaded.stages[-1].end:g} s")
print(f"files: {', '.join(sorted(one.name for one in folder.iterdir()))}")
print(f"identical to the uninterrupted run: {same_bits}")

# %% [markdown]
# ## Results

# %%
piston_force = float(data["piston_force"][-1])
print(f"{scene.grains.count} grains push the piston with {piston_force:.2f} N.")
print(f"The energy ledger closes to {ledger_error:.1e} of the energy turned over;")
print(f"the walls carry the grains' weight to {weight_error:.1e}.")

# %% [markdown]
# ## Exercises
#
# 1. Start the bed from another random arrangement (`"arrangement.seed": 2`). By how much do the
#    force on the piston and the final positions of the grains change?
# 2. Halve the drag (`"effects.drag.coefficient": "0.05 kg/s"`). How long does the bed now take to
#    come to rest? Use the kinetic energy.
