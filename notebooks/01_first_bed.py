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
# Small magnets, all of them upright between two glass plates, repel each other. Here 92 of them
# settle under a piston that stands still. The notebook goes once from a scene to a run, a picture,
# an energy ledger, and a run that is kept on disk.

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

plt.style.use("tableau-colorblind10")  # lines that colour-blind eyes tell apart

QUICK = True  # False: the full bed of 368 grains

# %% [markdown]
# ## The scene
#
# A scene says everything about a bed. The package has some; any of their keys can be changed, with
# or without a unit (`D` is the diameter of a grain). A quarter of the grains need half the width
# and half the height to be packed as tightly.

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
# `simulate` chooses a time step from the stiffest motion that the bed can meet. The first run of a
# kind compiles first; what was compiled is kept on disk.

# %%
run = simulate(scene, progress=False)
print(run_text(run))

# %% [markdown]
# ## Look at it
#
# At the start the grains lie on a jittered grid. Colour shows the force that grains and walls
# exert on each of them: where two are too near to each other it is large.

# %%
still(run, 0, colour="force")

# %% [markdown]
# At the end they have found places where these forces carry the grain's weight and do nothing else,
# so that all have one colour. Mind the scale, which is another one now.

# %%
still(run, -1, colour="force")

# %% [markdown]
# ## Where the energy goes
#
# The bed starts with more energy between its grains than it needs. Some of it becomes motion, and
# drag takes that away. The ledger, kinetic + potential + lost energy less the work from outside,
# must stay what it was: to see it move at all it is drawn on a scale of its own.

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
print(f"energy that the bed gave away: {1e3 * released:.3g} mJ")
print(f"lost to drag:                  {1e3 * float(data['drag_loss'][-1]):.3g} mJ")
print(f"the ledger is off by at most {ledger_error:.1e} of it")

# %% [markdown]
# ## What was computed, and what was not
#
# A scene computes only the effects that it names. What does not act leaves no column: this bed has
# drag, and so a `drag_loss`; it has no dry friction, and so no `friction_loss`.

# %%
for name in data.data_vars:
    unit, meaning = data[name].attrs["units"], data[name].attrs["long_name"]
    print(f"{name:17} {unit:6} {meaning}")

# %% [markdown]
# ## Forces of one arrangement
#
# `evaluate` gives the forces on the grains and on the walls for any places, without time. For the
# last frame it must say what the run said. At rest the bottom carries what the piston pushes down,
# and the weight of all grains.

# %%
last = evaluate(scene, data["position"].values[-1], piston_height=scene.piston.height)
grain_mass = float(np.pi / 4 * 0.006**2 * scene.grains.thickness * scene.grains.density)
weight = scene.grains.count * grain_mass * 9.8
carried = last.wall_forces["bottom"] - last.piston_force
same_force = abs(last.piston_force / float(data["piston_force"][-1]) - 1.0)
weight_error = abs(carried / weight - 1.0)
largest_force = float(np.abs(last.force).max())
print(f"force on the piston: {last.piston_force:.4f} N; of the run: {data['piston_force'][-1]:.4f} N")
print(f"bottom less piston:  {carried:.5f} N; weight of the grains: {weight:.5f} N")
print(f"greatest force that is left on a grain: {largest_force:.1e} N")

# %% [markdown]
# ## Keeping a run
#
# With `out` a run is written while it goes on, and can be read at any time. Here it is stopped
# halfway, and resumed: the result has the same bits as the run in one piece.

# %%
folder = Path(tempfile.mkdtemp()) / "bed"
half = simulate(scene, t_end=0.5, out=folder, progress=False)
simulate(scene, out=folder, resume=True, progress=False)
loaded = load_trajectory(folder)
same_bits = all(np.array_equal(loaded.dataset[name], data[name]) for name in data.data_vars)
print(f"stopped at {float(half.dataset['time'][-1]):g} s, then {loaded.stages[-1].end:g} s")
print(f"files: {', '.join(sorted(one.name for one in folder.iterdir()))}")
print(f"the same bits as in one piece: {same_bits}")

# %% [markdown]
# ## What came out

# %%
piston_force = float(data["piston_force"][-1])
print(f"{scene.grains.count} grains push the piston with {piston_force:.2f} N.")
print(f"The ledger of energies is closed to {ledger_error:.1e} of the energy turned over;")
print(f"the walls carry the grains' weight to {weight_error:.1e}.")

# %% [markdown]
# ## Exercises
#
# 1. Give the bed another random start (`"arrangement.seed": 2`). By how much does the force on
#    the piston change, and by how much do the final places of the grains?
# 2. Halve the drag (`"effects.drag.coefficient": "0.05 kg/s"`). How long does the bed now need
#    to come to rest? Read it off the kinetic energy.
