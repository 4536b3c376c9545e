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
# # 6. What accuracy costs
#
# The time step can be short or long, the integration method can have a low or a high order, and the
# sum over pairs can be complete or cut off. What are the cost and the accuracy of each choice? The
# notebook compares time steps and methods on a problem with a known solution and on a small bed,
# and then compares sums over pairs.

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import matplotlib.pyplot as plt
import numpy as np

from granular import load_scene, simulate
from granular.methods import METHODS
from validation import SolverSettings, convergence, convergence_table, exact_problem, work_precision

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish

QUICK = True  # False: also shorter steps, and pair sums of up to 5888 grains

# %% [markdown]
# ## Orders on an exact problem
#
# A single grain oscillates about its equilibrium above the magnetic bottom wall. Its exact motion
# is known to thirty digits. If the step of a method of order p is halved, the error should decrease
# by the factor 2ᵖ. The slope on logarithmic axes is therefore the order.

# %%
problem = exact_problem("oscillation")
names = ("symplectic-euler", "stormer-verlet", "blanes-moan-4", "blanes-moan-6", "kahan-li-8")
results = {name: convergence(problem, name) for name in names}
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for result, marker in zip(results.values(), "osd^v", strict=True):
    result.plot(axes)
    axes.lines[-2].set_marker(marker)
axes.legend(loc="lower left", fontsize=8)
plt.show()

# %% [markdown]
# The table gives the slopes, with intervals from the fit of a straight line to the thick parts of
# the curves above. At smaller errors rounding bends the curves; at larger errors the step is too
# long to show the order.

# %%
slopes = {name: result.fit.value for name, result in results.items()}
print(f"{'method':18} {'order':>5} {'slope':>8}   interval")
for name, result in results.items():
    low, high = result.fit.interval
    print(f"{name:18} {result.order:5} {slopes[name]:8.4f}   {low:.3f} to {high:.3f}")

# %% [markdown]
# The toolkit prints the same table, with the steps used in the fit and the rounding error:

# %%
print(convergence_table([results["stormer-verlet"], results["kahan-li-8"]]))

# %% [markdown]
# ## Work and precision on the problem
#
# A step of a high-order method takes more computing time. In a bed, most of this time is spent on
# evaluations of the forces. The picture shows the error over the number of force evaluations: a
# high order is worthwhile only below a certain error.

# %%
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for name, marker in zip(names, "osd^v", strict=True):
    result = results[name]
    calls = [METHODS[name].force_evaluations_per_step * problem.time / step for step in result.steps]
    axes.loglog(calls, result.errors, marker + "-", markersize=4, label=name)
axes.set(xlabel="force calls", ylabel="error [m]")
axes.legend(fontsize=8)
plt.show()

# %% [markdown]
# ## A small bed
#
# The packaged bed of 368 grains is simulated for 20 ms, during its fastest motion. `auto` denotes
# the automatic step. The error is the maximum deviation of the grains' positions from a run with a
# much shorter step, in diameters. Computing times depend on the machine and differ from run to run.

# %%
bed = load_scene("bed").replace(**{"output.frames": "5 ms"})
steps = ("auto*8", "auto*4", "auto*2", "auto", "auto/2") + (() if QUICK else ("auto/4", "auto/8"))
settings = [SolverSettings(name, step) for name in names[:4] for step in steps]
study = work_precision(bed, "positions", settings, until=0.02)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
study.plot(axes)
axes.legend(fontsize=8)
plt.show()

# %% [markdown]
# If the step is too long for a method, the energy ledger stops the run; such runs count as failed.

# %%
failed = [one for one in study.points if one.has_failed]
for one in failed:
    print(f"{one.setting.method}, {one.setting.dt}: {one.failure}")

# %% [markdown]
# ## The cheapest setting for a given error
#
# `cheapest` gives the fastest combination of method and step that reaches a tolerance. A step is
# accepted only if all shorter steps of the same method also reach the tolerance.

# %%
choices = {tolerance: study.cheapest_point(tolerance) for tolerance in (1e-2, 1e-4, 1e-6, 1e-9)}
for tolerance, choice in choices.items():
    setting = choice.setting
    print(
        f"{tolerance:7g} D: {setting.method:15} {setting.dt:7} error {choice.error:.1e} D "
        f"in {1e3 * choice.seconds:.0f} ms, {choice.steps} steps"
    )

# %% [markdown]
# On the command line: `granular-damper validate cheapest bed positions 1e-6`.
#
# ## Pair sums
#
# The time for a sum over all pairs grows as N². A cut-off at 11.26 D takes less time, but lowers
# the pressure of the bed, because in two dimensions the contribution of pairs beyond the cut-off is
# not small. A mesh sums this contribution approximately. A bed settles with each of the three
# methods, and the forces on the piston are compared.

# %%
COUNT = 736 if QUICK else 1472
LARGER = (736, 1472, 2944) if QUICK else (1472, 2944, 5888)


def sized(count: int, pairs: str) -> object:
    """Return the packaged bed with another number of grains, at the same packing."""
    size = np.sqrt(count / 368)
    return load_scene("bed").replace(
        **{
            "grains.count": count,
            "cell.width": f"{60 * size} D",
            "piston.height": f"{20 * size} D",
            "arrangement.height": f"{19 * size} D",
            "pairs.method": pairs,
        }
    )


ways = ("direct", "mesh", "cut-off")
forces = {}
for way in ways:
    run = simulate(sized(COUNT, way), t_end=0.5, threads=1, progress=False)
    forces[way] = float(run.dataset["piston_force"][-1])
biases = {way: forces[way] / forces["direct"] - 1.0 for way in ways}
for way in ways:
    print(f"{way:8} piston force {forces[way]:.3f} N, {100 * biases[way]:+.2f} %")

# %% [markdown]
# Time per step for three sizes (minimum over three runs of 400 steps, on one thread). The time of
# the direct sum grows with the square of the number of grains; the times of the other methods are
# roughly proportional to this number.

# %%
took = {way: [] for way in ways}
for way in ways:
    for count in LARGER:
        scene = sized(count, way).replace(**{"output.scalars": "4 ms"})
        spans = []
        for _ in range(3):
            done = simulate(scene, 2e-5, t_end=8e-3, threads=1, progress=False).settings()
            spans.append(done["seconds"] / done["steps"])
        took[way].append(min(spans))
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
for way, marker in zip(ways, "osd", strict=True):
    axes.loglog(LARGER, [1e6 * one for one in took[way]], marker + "-", label=way)
axes.set(xlabel="grains", ylabel="time of a step [µs]")
axes.set_xticks(LARGER, labels=map(str, LARGER))
axes.minorticks_off()
axes.legend()
plt.show()
exponents = {way: float(np.polyfit(np.log(LARGER), np.log(took[way]), 1)[0]) for way in ways}
for way in ways:
    print(f"{way:8} time of a step ~ N^{exponents[way]:.2f}")

# %% [markdown]
# ## Results

# %%
print(f"All {len(slopes)} methods have their declared order.")
print(f"For an error of 0.01 D {choices[1e-2].setting.method} was cheapest, for 1e-9 D ", end="")
print(f"{choices[1e-9].setting.method}.")
print(f"The cut-off lowers the piston's force by {-100 * biases['cut-off']:.1f} %, ", end="")
print(f"the mesh changes it by {100 * biases['mesh']:+.2f} %.")

# %% [markdown]
# ## Exercises
#
# 1. Measure the order of `forest-ruth` and of `pefrl`, both of order four. Which one has the
#    smaller error at the same step, and which at the same wall time?
# 2. Ask `cheapest` for a tolerance of 1e-6 of the rest height. Why does no step reach it?
