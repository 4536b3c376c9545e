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
# # 10. Why a magnetic bed damps, in five pictures
#
# A heavy piston falls on magnets that repel each other, oscillates, and comes to rest. The forces
# between magnets are conservative. How is the energy dissipated? This notebook answers the question
# by five pictures of one simulated fall. The last picture also shows the prediction of the fall by
# a law that consists of two equations.

# %%
# %matplotlib inline
# %config InlineBackend.print_figure_kwargs = {"dpi": 80, "bbox_inches": "tight"}
import warnings

import matplotlib.pyplot as plt
import numpy as np

from granular import damper, simulate
from reduced_models import predict

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish
warnings.simplefilter("ignore")  # grains come close as the piston hits the bed; one warning is enough

QUICK = True  # False: six seconds, to see the last oscillations
SECONDS = 2.0 if QUICK else 6.0
DIAMETER, GRAVITY = 0.006, 9.80665  # m, m/s²

# %% [markdown]
# ## The fall
#
# The packaged damper has 368 grains of 6 mm and a piston of 7.5 kg, which is released at a height
# of 20 D. The grains move in air or a liquid, with a drag of 0.1 kg/s times the velocity of the
# grain. This drag is the only dissipative force.

# %%
scene = damper().replace(**{"output.frames": "5 ms"})
run = simulate(scene, t_end=SECONDS, progress=False)
data = run.dataset
time, height, speed = (data[name].values for name in ("time", "piston_height", "piston_velocity"))
mass = scene.piston.mass
grains, drag = scene.grains.count, scene.effects.drag.coefficient

# %% [markdown]
# ## Picture 1: energy balance
#
# The energy of the falling piston is transferred to the bed, which returns most of it in each
# cycle. All the energy missing at the end was dissipated by the drag on the grains. The kinetic
# energy of the grains is always negligible, because the grains are light and are quickly stopped by
# drag.

# %%
falling = mass * GRAVITY * (height - height.min()) + 0.5 * mass * speed**2
bed = sum(data[f"{name}_energy"].values for name in ("pair", "wall", "weight"))
bed = bed - bed[0]
moving = data["kinetic_energy"].values
lost = data["drag_loss"].values - data["drag_loss"].values[0]
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
axes.plot(time, falling, label="piston: weight and motion")
axes.plot(time, bed, label="bed: magnets, walls and weight")
axes.plot(time, lost, color="k", label="lost by drag on the grains")
axes.plot(time, moving, color="C5", linestyle="--", label="motion of the grains")
axes.set(xlabel="time [s]", ylabel="energy [J]", xlim=(0, 2))
axes.legend(loc="upper right")
plt.show()
greatest_share = float(moving.max() / lost[-1])
print(
    f"lost: {lost[-1]:.3g} J; the grains' kinetic energy never exceeds {100 * greatest_share:.2g} % of that"
)

# %% [markdown]
# ## Picture 2: more force on the way down than on the way up
#
# For the piston the bed acts as a spring whose force is nearly a power law of the height: the
# pressure of a triangular lattice of dipoles is proportional to its density to the power 5/2.
# However, the measured force is larger than this power law during compression, and smaller during
# expansion. The area of the resulting loop is the energy lost by the piston.

# %%
force = data["piston_force"].values
law = predict(scene)  # from the scene alone; nothing is fitted
numbers = law.parameters
early = time < 1.0
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for way, rows in (("down", speed < 0.0), ("up", speed >= 0.0)):
    chosen = rows & early
    axes.plot(1e3 * height[chosen], force[chosen], ".", markersize=3, label=f"on the way {way}")
line = np.geomspace(height.min(), height.max(), 60)
axes.plot(
    1e3 * line,
    mass * GRAVITY * (numbers["rest"] / line) ** 2.5,
    "k-",
    linewidth=1.2,
    label="lattice: height$^{-5/2}$",
)
axes.set(xscale="log", yscale="log", xlabel="height of the piston [mm]", ylabel="force on the piston [N]")
axes.set_xticks([40, 60, 80, 100, 120], labels=["40", "60", "80", "100", "120"])
axes.minorticks_off()
axes.legend(markerscale=3)
plt.show()

# %% [markdown]
# ## Picture 3: grains rearrange
#
# If the bed were compressed affinely while the piston descends by a third, the triangles of the
# lattice would be flattened. The arrows show the non-affine displacements of grains in the middle
# of the bed, at true length. They are half a diameter or more, often in opposite directions for
# neighbours. The grains slip past each other, so that the lattice keeps its three directions.

# %%
lowest = float(time[np.argmin(height)])
passing = float(time[np.argmax(height < 1.5 * height.min())])
frames = data["frame_time"].values
first, second = (int(np.argmin(abs(frames - moment))) for moment in (passing, lowest))
before, after = (data["position"].values[one] for one in (first, second))
squeeze = float(data["frame_height"][second] / data["frame_height"][first])
beside = after - before * [1.0, squeeze]
figure, axes = plt.subplots(figsize=(8, 2.9), layout="constrained")
size = np.hypot(*beside.T) / DIAMETER
arrows = axes.quiver(
    *(1e3 * after.T),
    *(1e3 * beside.T),
    size,
    angles="xy",
    scale_units="xy",
    scale=1.0,
    width=0.004,
    cmap="cividis",
)
axes.axhline(1e3 * height.min(), color="#666666", linewidth=2)
axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", xlim=(100, 220))
figure.colorbar(arrows, label="beside the even squeeze [D]")
plt.show()
typical = float(np.sqrt(np.mean(size**2)))
print(f"compressed to {squeeze:.2f} of the height; average non-affine displacement {typical:.2g} D")

# %% [markdown]
# ## Picture 4: the bed resists shear, and yields
#
# During compression the pressure on the piston is larger than the pressure on the side walls, and
# during expansion it is smaller. Half of this difference, divided by the mean pressure, is the
# dimensionless shear stress w. (The drag for affine motion, a third of N γ z', is subtracted
# first.) The shear stress increases as in an elastic body, until the grains rearrange and it
# becomes constant: the bed *yields*. In the law w is a hidden state with the equation w' =
# -(B/z)(z' + |z'| |w| w/y²). This equation is integrated here along the measured motion, with B and
# y from other beds.

# %%
down = (force + grains * drag / 3.0 * speed) / scene.cell.width
aside = 0.5 * (data["left_force"].values + data["right_force"].values) / height
measured = (down - aside) / (down + aside)
modulus, strength = numbers["modulus"], numbers["strength"]
stress = np.zeros(len(time))
for k, step in enumerate(np.diff(time)):
    w, flow = stress[k], abs(speed[k]) * abs(stress[k]) * stress[k] / strength**2
    stress[k + 1] = w - step * modulus / height[k] * (speed[k] + flow)
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
later = early & (time > 0.02)  # earlier, the bed leaves its initial arrangement
axes.plot(time[later], measured[later], label="simulated: walls")
axes.plot(time[early], stress[early], label="law")
axes.axhline(0.0, color="#999999", linewidth=0.8)
axes.set(xlabel="time [s]", ylabel="shear stress over pressure", ylim=(-0.1, 0.12))
axes.legend(loc="upper right", ncols=2)
plt.show()
likeness = float(np.corrcoef(measured[early][100:], stress[early][100:])[0, 1])
print(f"correlation of the two after the first 0.1 s: {likeness:.2f}")

# %% [markdown]
# ## Picture 5: large oscillations lose more, and a law that includes it
#
# If all grains followed the piston affinely, drag would dissipate the power N γ z'²/3 (a grain at
# half height moves at half the speed of the piston). Left: energy loss per cycle divided by the
# loss for affine motion. The first cycles rearrange the bed, and their loss is at least 1.5 times
# as large; the small cycles at the end have the affine loss. Right: the simulated fall, and the
# prediction by the law with drag, pressure and yield, computed from the scene alone.

# %%
even = np.concatenate([[0.0], np.cumsum(grains * drag / 3.0 * speed[:-1] ** 2 * np.diff(time))])
turns = np.flatnonzero((speed[:-1] < 0.0) & (speed[1:] >= 0.0))
excess = np.diff(lost[turns]) / np.diff(even[turns])
told = law.simulate(time, z0=float(height[0]), v0=0.0)
first_loss, last_loss = float(excess[0]), float(excess[-1])
drop = height[0] - numbers["rest"]
error = float(np.sqrt(np.mean((told.height - height) ** 2)) / drop)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.bar(np.arange(1, len(excess) + 1), excess, color="C0", label="simulated")
left.axhline(1.0, color="k", linewidth=1.2, label="even motion")
left.set(xlabel="swing", ylabel="loss over that of even motion", ylim=(0, None))
left.legend()
right.plot(time, 1e3 * height, linewidth=3, color="#ABABAB", label="simulated")
right.plot(time, 1e3 * told.height, linewidth=1.2, color="C1", label="law, nothing fitted")
right.set(xlabel="time [s]", ylabel="piston height [mm]")
right.legend()
plt.show()
print(f"first cycle: {first_loss:.2f} of affine motion, last: {last_loss:.2f}")
print(f"the law errs by {100 * error:.2g} % of the drop")

# %% [markdown]
# ## Why does it damp?
#
# Magnetic forces are conservative, but the drag on moving grains dissipates energy. One part of the
# drag is due to the affine motion of all grains with the piston. In addition, the grains of a
# strongly compressed bed must change neighbours, and each slip is a fast motion that is stopped by
# drag. This causes hysteresis, which damps large oscillations but not small oscillations, even
# without friction.

# %% [markdown]
# ## Exercises
#
# 1. Double the drag (`damper(drag=0.2)`). Which of the five pictures change, and does the area of
#    the loop in picture 2 double?
# 2. Release the piston at 11 D instead of 20 D (`piston.height`, with `arrangement.height` one D
#    less). Does the bed still yield in picture 4, and how large is the loss in picture 5?
