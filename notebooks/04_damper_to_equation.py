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
# # 4. From a damper to its equation
#
# A piston falls on a bed of magnets, comes to rest, is lifted a little and released. Equations of
# motion ("laws") are fitted to the motion of the piston after the release. Which law describes this
# motion, which law predicts a record that was not used in the fit, and when do all laws fail?

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
from IPython.display import Image

from granular import Trajectory, damper, simulate
from granular.render import movie, still
from reduced_models import compare, discover, fit, roll_out

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish
warnings.simplefilter("ignore")  # relevant notes are printed below

QUICK = True  # False: the full damper of 368 grains; takes much longer

COUNT = 92 if QUICK else 368
DIAMETER = 6e-3

# %% [markdown]
# ## The damper
#
# `damper(count=92)` is the packaged damper with a quarter of its grains; the width, the mass of the
# piston and the height of the drop are halved. Three runs differ only in the height of the lift:
# two are used for the fit, and one for the test. During the fall some grains come closer than a
# diameter, which is possible for point dipoles but not for real grains; the run gives a warning.


# %%
def lifted(lift: float) -> tuple[Trajectory, list[str]]:
    """Run the damper with a lift [D], and return the run with its warnings."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run = simulate(damper(count=COUNT, lift=lift), progress=False)
    return run, [str(one.message) for one in said]


TRAINING, JUDGED = (0.2, 1.0), 0.75
runs = {}
for lift in (*TRAINING, JUDGED):
    runs[lift], said = lifted(lift)
print("\n".join(said))

# %% [markdown]
# The picture shows the piston at rest on its bed:

# %%
still(runs[0.2], time=runs[0.2].stage("drop").end)

# %% [markdown]
# The movie shows the first 1.2 seconds of the fall in real time, with the height of the piston.

# %%
short = simulate(damper(count=COUNT).replace(**{"output.frames": "5 ms"}), t_end=1.2, progress=False)
folder = Path(tempfile.mkdtemp())
Image(movie(short, folder / "fall.gif", colour="speed", fps=20.0, width=760, progress=False))

# %% [markdown]
# The picture shows the whole run: the fall with its rebounds, the long settling until everything is
# at rest, the lift, and the motion after the release (right of the line).

# %%
run = runs[0.2]
data = run.dataset
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.plot(data["time"], 1e3 * data["piston_height"])
left.set(xlabel="time [s]", ylabel="piston height [mm]", title="the first two seconds", xlim=(0, 2))
release = run.stage("release").start
late = data["time"] > release - 1.0
right.plot(data["time"][late], 1e3 * data["piston_height"][late])
right.axvline(release, color="#999999", linewidth=0.8)
right.set(xlabel="time [s]", ylabel="piston height [mm]", title="lift and release")
plt.show()
rest_height = run.stage("drop").height / DIAMETER
print(f"rest: after {run.stage('drop').end:.1f} s, at {rest_height:.3f} D")

# %% [markdown]
# ## The published law, and others
#
# De Paula (2025) fits a Van der Pol-like law, z″ + 2α(z² − 2z)z′ + ω²z = g₀. Here this law and
# three other laws are fitted to the small lift. `fit` reports how well a law describes the record,
# how well it predicts the last third of the record, which is not fitted, and which parameters the
# data do not determine.

# %%
record = run.piston()
laws = ("van-der-pol-like", "linear", "power-law-spring", "polynomial-spring")
models = {}
for law in laws:
    models[law] = fit(record, law=law)
print(models["van-der-pol-like"])

# %%
print(models["polynomial-spring"])

# %% [markdown]
# The parameters of the Van der Pol-like law are not determined by one small oscillation: their
# intervals are unbounded. Nevertheless all four laws describe this small oscillation almost
# equally.

# %%
print(f"{'law':18} {'period [s]':>10} {'damping ratio':>14} {'residual':>9}")
for name, model in models.items():
    rest = model.at_rest
    share = 100 * model.quality.relative
    print(f"{name:18} {rest.period:10.5f} {rest.damping_ratio:14.5f} {share:8.3f} %")
period = models["polynomial-spring"].at_rest.period
damping_ratio = models["polynomial-spring"].at_rest.damping_ratio

# %% [markdown]
# The shape of the residuals is informative. The residuals of the Van der Pol-like law lie above
# zero and oscillate with twice the frequency of the piston. This is typical of a spring that is
# stiffer below the equilibrium than above it.

# %%
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
for name, style in (("van-der-pol-like", "-"), ("polynomial-spring", "--")):
    left_over = record.height - models[name].simulate_record(record).height
    axes.plot(record.time - record.time[0], 1e6 * left_over, style, label=name)
axes.set(xlabel="time since the release [s]", ylabel="height less model [µm]", xlim=(0, 2))
axes.legend()
plt.show()

# %% [markdown]
# ## Which law predicts?
#
# Each law is now fitted to the lifts of 0.2 D and 1 D together, and then predicts the lift of
# 0.75 D; the initial state of this prediction is estimated from the first period. `compare` ranks
# the laws, and reports whether the data can distinguish them.

# %%
training = [runs[lift].piston() for lift in TRAINING]
judged = runs[JUDGED].piston()
table = compare(training, laws, test_records=[judged])
print(table)

# %% [markdown]
# ## A discovered law
#
# `discover` searches for an equation of motion among sums of physical terms. A star marks the
# chosen equation. Note the warning below: the true equation is not among these sums, and the chosen
# equation only summarises the records.

# %%
found = discover(training, method="sindy", library="physical")
print(found)

# %% [markdown]
# ## Prediction of the held-out lift
#
# The table gives the prediction errors over the whole test record, in % of its rms displacement.
# The prediction that the piston stays at rest would have an error of 100 %.

# %%
errors = {row.name: row.records[0].relative for row in table.rows}
errors["sindy"] = roll_out(found.model, judged).relative
ranked = sorted(errors, key=errors.__getitem__)
figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
axes.barh(ranked[::-1], [100 * errors[name] for name in ranked[::-1]])
axes.set(xscale="log", xlabel="error of the prediction [% of the rms swing]", xlim=(0.1, 100))
plt.show()
for name in ranked:
    print(f"{name:18} {100 * errors[name]:7.3f} %")

# %% [markdown]
# The picture shows the errors of the predictions over time, for an oscillation with an amplitude of
# several millimetres:

# %%
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
since = judged.time - judged.time[0]
by_name = {row.name: row for row in table.rows}
for name, style in (("van-der-pol-like", "-"), ("polynomial-spring", "--")):
    motion = by_name[name].records[0].motion
    axes.plot(since, 1e3 * (judged.height - motion.height), style, label=name)
axes.set(xlabel="time since the release [s]", ylabel="height less prediction [mm]", xlim=(0, 2))
axes.legend()
plt.show()

# %% [markdown]
# ## Failure of all laws
#
# The fall covers a far larger range of heights than the lifts. The models warn of this
# extrapolation, and their predictions of the fall are indeed wrong.

# %%
fall = run.piston("drop").between(0.0, 5.0)
best = by_name["polynomial-spring"].models[-1]  # with the range of heights of the higher lift
print(best.outside_range_text(fall))
fall_errors = {row.name: roll_out(row.models[0], fall).relative for row in table.rows}
for name, error in fall_errors.items():
    print(f"{name:18} {100 * error:7.1f} %")

# %% [markdown]
# ## Verdict

# %%
winner = ranked[0]
source_error = errors["van-der-pol-like"]
gain = source_error / errors["polynomial-spring"]
print(f"The test lift is predicted best by {winner}, to {100 * errors[winner]:.2g} %.")
print(f"The published Van der Pol-like law errs by {100 * source_error:.3g} %, the linear")
print(f"oscillator by {100 * errors['linear']:.3g} %; a spring that stiffens as the bed is")
print(f"squeezed, polynomial with drag, is {gain:.0f} times better.")
print(f"None of them predicts the fall: the best errs by {100 * min(fall_errors.values()):.0f} %.")

# %% [markdown]
# ## Exercises
#
# 1. Fit the Van der Pol-like law to a damper with ten times the drag
#    (`damper(count=92).replace(**{"effects.drag.coefficient": "1 kg/s"})`). Is it still no
#    better than the linear law?
# 2. Fit `power-law-spring` to the fall instead of the lift. Which exponent results, and how large
#    is the error of the prediction for a fall from another height?
