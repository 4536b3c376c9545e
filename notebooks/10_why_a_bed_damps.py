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
# between magnets are conservative. How is the energy dissipated? Five pictures of one simulated
# fall answer this question. The last picture also shows a law of two equations that predicts the
# fall.

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
# The packaged damper: 368 grains of 6 mm, a piston of 7.5 kg, released at 20 D. The grains move in
# air or a liquid, whose drag is 0.1 kg/s times a grain's velocity. Nothing else dissipates energy.

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
# The energy of the falling piston goes into the bed, which returns most of it, again and again. All
# the energy missing at the end was dissipated by drag on the grains. The kinetic energy of the
# grains is negligible at all times: they are light, and drag stops them immediately.

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
# The piston feels the bed as a spring whose force is nearly a power of the height: the pressure of
# a triangular lattice of dipoles grows with its density to the power 5/2. Yet the force forms a
# loop around that line: above it during compression, below it during expansion. The area of the
# loop is the energy lost by the piston.

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
# While the piston descends by a third, a purely affine compression would flatten the triangles of
# the lattice. Each arrow is the non-affine displacement of a grain in the middle of the bed, at its
# true length: half a diameter or more, often in opposite directions for neighbours. They slip past
# each other, and the lattice keeps its three directions.

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
# The bed presses harder on the piston than on the side walls during compression, and less during
# expansion. Half of that difference, divided by the mean pressure, is the shear stress w (after
# subtraction of the drag of affine motion, a third of N γ z'). It grows like the stress of an
# elastic body, and stops growing when grains rearrange: the bed *yields*. In the law w is a hidden
# state, w' = -(B/z)(z' + |z'| |w| w/y²), integrated here along the measured motion with B and y
# from other beds.

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
# If all grains followed the piston affinely, drag would dissipate a third of N γ z'² (a grain at
# half height moves at half the piston's speed). Left: energy loss per cycle relative to affine
# motion. The first cycles rearrange the bed and lose 1.5 times as much or more; the small cycles at
# the end do not. Right: the simulated fall, and the prediction of the law with drag, pressure and
# yield, computed from the scene alone.

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
# Magnetic forces are conservative; drag on moving grains is not. A piston on a bed moves all grains
# along, which is the affine part. In addition, the grains of a strongly compressed bed must change
# neighbours, and every slip is a fast motion that is stopped by drag. That is hysteresis: it damps
# large oscillations but not small ones, without any friction.

# %% [markdown]
# ## Exercises
#
# 1. Double the drag (`damper(drag=0.2)`). Which of the five pictures change, and does the area of
#    the loop in picture 2 double?
# 2. Release the piston at 11 D instead of 20 D (`piston.height`, with `arrangement.height` one D
#    less). Does the bed still yield in picture 4? What is the loss in picture 5 then?
