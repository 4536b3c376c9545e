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
# # 2. Compression and structure
#
# In the thesis of de Paula (2025), beds of equal grains with dry friction are relaxed, compressed
# at constant speed, expanded and relaxed again. The thesis reports the force on the piston, the
# distances between grains and the order of the bed. This notebook computes the same quantities,
# with a shorter protocol in the quick mode, and compares them with the published values.

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import matplotlib.pyplot as plt
import numpy as np

from granular import Trajectory, mono_bed, simulate
from granular.observables import (
    depaula_pair_distance,
    hysteresis_cycles,
    per_frame,
    polygon_fractions,
    psi6,
    radial_distribution,
    voronoi_cells,
)
from granular.observables.plots import plot_cells, plot_hysteresis, plot_series
from validation.measured_quantities import compression_duration, published_value

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish

QUICK = True  # False: 368 grains with the published protocol, three starts; takes some minutes

COUNT = 92 if QUICK else 368
STARTS = (1,) if QUICK else (1, 2, 3)
SPEED = 33e-3 if QUICK else 8.33e-3
RELAXATION = 5.0 if QUICK else None  # [s]; None: 5 T, T the duration of the compression
STEP = 5e-4
DIAMETER = 6e-3

# %% [markdown]
# ## The protocol
#
# In the thesis the beds relax for 5 T (T is the duration of the compression) and are compressed at
# 8.33 mm/s. In the quick mode of this notebook they relax for 5 s and are compressed at 33 mm/s.
# The thesis gives forces and fractions of polygons only for 368 grains and more. A bed of 368
# grains is therefore also simulated, for one initial packing.


# %%
def compressed(count: int, seed: int) -> Trajectory:
    """Run the full cycle of a bed."""
    relaxation = 5.0 if RELAXATION is None else RELAXATION / compression_duration(count, SPEED)
    scene = mono_bed(count, speed=SPEED, relaxation=relaxation, seed=seed)
    often = {"output.scalars": 20 * STEP, "output.frames": 200 * STEP}
    return simulate(scene.replace(**often), STEP, progress=False)


def full_compression(run: Trajectory) -> int:
    """Return the frame with the lowest piston."""
    return int(run.dataset["frame_height"].values.argmin())


runs = [compressed(COUNT, seed) for seed in STARTS]
large = [compressed(368, 1)] if QUICK else runs
run = runs[0]
for stage in run.stages:
    print(f"{stage.name:9} {stage.start:7.2f} to {stage.end:7.2f} s, {1e3 * stage.height:6.1f} mm")

# %% [markdown]
# ## Force over height
#
# The piston needs more force on its way down than on its way up: dry friction dissipates part of
# the work. The area between the two curves is the energy lost in the cycle.

# %%
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
plot_hysteresis(run, axes)
axes.set_yscale("log")
axes.set_xlim(right=1.02e3 * run.stage("relax").height)
plt.show()

# %%
cycle_loss = float(hysteresis_cycles(run)["energy"][0])
lowest = int(run.dataset["piston_height"].values.argmin())
force_at_full = float(run.dataset["piston_force"][lowest])
print(f"force at full compression: {force_at_full:.2f} N")
print(f"work lost in the cycle:    {1e3 * cycle_loss:.1f} mJ")

# %% [markdown]
# ## Distances
#
# The published "mean distance" is half of the mean over all pairs, because its formula counts every
# pair once but divides by twice the number of pairs. This distance decreases during compression
# (solid), and does not recover completely during expansion (dashed).

# %%
half_distance = np.array([depaula_pair_distance(one) for one in run.dataset["position"].values])
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
full = full_compression(run)
before = int(np.searchsorted(run.dataset["frame_time"], run.stage("relax").end))
for part, style in ((slice(before, full + 1), "-"), (slice(full, None), "--")):
    axes.plot(1e3 * run.dataset["frame_height"][part], half_distance[part] / DIAMETER, style)
axes.set(xlabel="piston height [mm]", ylabel="half mean distance [D]")
plt.show()

# %% [markdown]
# ## Order
#
# Each grain has a Voronoi cell; only cells inside the bounding box of the outermost grains are
# included. In a perfect lattice all cells are hexagons, shown in light grey. A cell with five sides
# (orange) next to a cell with seven (purple) is a dislocation. Left: before the compression. Right:
# at full compression.

# %%
figure, pair = plt.subplots(1, 2, figsize=(7, 4.6), sharex=True, sharey=True, layout="constrained")
for axes, frame, title in zip(pair, (before, full), ("before", "compressed"), strict=True):
    places = run.dataset["position"].values[frame]
    plot_cells(voronoi_cells(places), places, axes)
    axes.set_title(title)
plt.show()

# %% [markdown]
# The picture shows the fractions of polygons, and Ψ₆ (1 in perfect hexagonal order), over time. The
# compression lies between the vertical lines. A small bed has few cells, so every defect makes the
# curves jump.

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 5), sharex=True, layout="constrained")
plot_series(per_frame(run, "polygons"), above)
above.set(xlabel="", ylim=(0, 1))
orders = per_frame(run, "hexatic_order")
below.plot(orders["frame_time"], orders)
below.set(xlabel="time [s]", ylabel="Ψ₆", ylim=(0, 1))
for axes in (above, below):
    axes.axvline(run.stage("compress").start, color="#999999", linewidth=0.8)
    axes.axvline(run.stage("compress").end, color="#999999", linewidth=0.8)
plt.show()

# %% [markdown]
# ## g(r)
#
# The pair correlation function g(r) of 368 grains at full compression has peaks near the neighbour
# shells of a perfect lattice of the same density, at 1, √3, 2 and √7 spacings (dashed).

# %%
places = large[0].dataset["position"].values[full_compression(large[0])]
cells = voronoi_cells(places)
spacing = float(np.sqrt(2.0 / np.sqrt(3.0) * np.nanmean(cells.area)))
g = radial_distribution(places, np.linspace(0.3, 3.5, 49) * spacing)
middle = 0.5 * (g.edges[1:] + g.edges[:-1])
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
axes.plot(1e3 * middle, g.values)
for shell in np.sqrt((1, 3, 4, 7)):
    axes.axvline(1e3 * shell * spacing, color="#999999", linestyle="--", linewidth=0.8)
axes.set(xlabel="distance [mm]", ylabel="g(r)")
plt.show()
first_peak = float(middle[np.argmax(g.values)]) / spacing
print(f"first peak at {first_peak:.2f} spacings, a spacing being {spacing / DIAMETER:.2f} D")

# %% [markdown]
# ## Comparison with the published values
#
# Each published force is a mean over three starts, whose forces differ; the quick mode has only one
# start.


# %%
def figures(run: Trajectory) -> tuple[float, float, float]:
    """Return force [N], half mean distance [D] and fraction of hexagons at full compression."""
    data = run.dataset
    places = data["position"].values[full_compression(run)]
    force = float(data["piston_force"][data["piston_height"].values.argmin()])
    shares = polygon_fractions(voronoi_cells(places))
    return force, depaula_pair_distance(places) / DIAMETER, shares.hexagons


force_368, distance_368, hexagons_368 = np.mean([figures(one) for one in large], axis=0)
distance_small = float(np.mean([figures(one)[1] for one in runs]))
sizes = published_value("half_mean_distance.n")
published_small = published_value("half_mean_distance.minimum")[sizes.index(COUNT)]
published_368 = published_value("half_mean_distance.minimum")[sizes.index(368)]
published_force = published_value("piston_force_direct_sum.mean[0]")
published_scatter = published_value("piston_force_direct_sum.std[0]")
published_hexagons = published_value("voronoi_shares_direct_sum.hexagons[0]")
hexagons_scatter = published_value("voronoi_shares_direct_sum.hexagons_std[0]")
rows = [
    (f"half mean distance, {COUNT} grains [D]", f"{distance_small:.2f}", f"{published_small}"),
    ("half mean distance, 368 grains [D]", f"{distance_368:.2f}", f"{published_368}"),
    ("force, 368 grains [N]", f"{force_368:.2f}", f"{published_force} ± {published_scatter}"),
    ("hexagons, 368 grains", f"{hexagons_368:.3f}", f"{published_hexagons} ± {hexagons_scatter}"),
]
settling = "5 T" if RELAXATION is None else f"{RELAXATION:g} s"
print(f"protocol here: {1e3 * SPEED:g} mm/s after {settling}, {len(large)} start(s) of 368 grains")
print("published:     8.33 mm/s after 5 T, three starts\n")
print(f"{'':36} {'here':>8}   published")
for what, here, printed in rows:
    print(f"{what:36} {here:>8}   {printed}")

# %% [markdown]
# ## Results

# %%
places = large[0].dataset["position"].values
start = int(np.searchsorted(large[0].dataset["frame_time"], large[0].stage("relax").end))
order_before = psi6(places[start])
order_full = psi6(places[full_compression(large[0])])
force_error = force_368 / published_force - 1.0
distance_error = distance_small / published_small - 1.0
print(f"The force of 368 grains is off the published mean by {100 * force_error:+.1f} %,")
print(f"the distance of {COUNT} grains by {100 * distance_error:+.2f} %.")
print(f"Ψ₆ of 368 grains rises from {order_before:.2f} to {order_full:.2f} in the compression.")

# %% [markdown]
# ## Exercises
#
# 1. Compress ten times faster (`speed=0.33`). How does the loop of force over height change, and
#    why?
# 2. Use `local_psi6` to colour the grains of the last frame. Where does the order begin: at the
#    walls, or in the middle?
