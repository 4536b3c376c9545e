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
# # 11. A damper at work
#
# A machine on springs, driven by a force near its natural frequency, carries a bed of magnets under
# a free piston. The piston moves relative to the machine, and the energy of this motion is
# dissipated by the grains. How large is the remaining vibration, how is the energy dissipated, and
# which damper would be better?

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Image

from granular import load_scene, simulate
from granular.render import movie
from granular.response import frequency_response
from reduced_models.machines import design_for, predicted_response

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish
warnings.simplefilter("ignore")  # the warning that grains come close is expected; see notebook 4

QUICK = True  # False: the packaged machine, whose damper has 368 grains, and more frequencies

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The machine
#
# The effect `host` defines the structure that carries the cell: here one body on a spring and a
# dashpot, with a sinusoidal force on it. The packaged scene `machine` has 100 kg at 3.25 Hz and a
# damper of 368 grains. In the quick mode the bed has a quarter of the grains, is half as high, and
# carries half the mass of the piston. It oscillates faster; the mass of the machine is therefore
# also halved, and its frequency is higher.

# %%
SCENE = load_scene("machine")
if QUICK:
    SCENE = SCENE.replace(
        **{
            "grains.count": 92,
            "cell.width": "30 D",
            "piston.height": "8 D",
            "piston.mass": "3.75 kg",
            "arrangement.height": "7.5 D",
            "effects.drag.coefficient": "0.2 kg/s",
            "effects.host.bodies": [{"mass": "50 kg", "stiffness": "41.8 kN/m", "damping": "14.4 kg/s"}],
            "effects.host.excitation.frequency": "4.2 Hz",
            "protocol.shake.duration": "9 s",
        }
    )
host = SCENE.effects.host
(body,) = host.bodies
own_frequency = np.sqrt(body.stiffness / body.mass) / (2.0 * np.pi)
print(f"the machine alone: {own_frequency:.2f} Hz, force {host.excitation.force:g} N")

# %% [markdown]
# ## One run
#
# The bed settles for three seconds before the force is switched on. The displacement of the machine
# is measured from its equilibrium with the damper installed.

# %%
run = simulate(SCENE, "auto*4", progress=False)
data = run.dataset
figure, axes = plt.subplots(2, 1, figsize=(8, 4), sharex=True, layout="constrained")
axes[0].plot(data["time"], 1e3 * data["host_displacement"])
axes[0].set(ylabel="machine [mm]")
axes[1].plot(data["time"], 1e3 * data["piston_height"], color="C1")
axes[1].set(xlabel="time [s]", ylabel="piston over the cell [mm]")
axes[0].axvline(host.excitation.start, color="0.6", linestyle=":", label="the force begins")
axes[0].legend(loc="upper left")
plt.show()

# %% [markdown]
# ## Energy balance
#
# The work of the force is dissipated by the drag of the grains and by the dashpot of the machine.
# The energy ledger records the two contributions separately.

# %%
late = data.isel(time=[int(0.7 * data.sizes["time"]), -1])
taken = {
    name: float(late[column][1] - late[column][0])
    for name, column in (("the grains", "drag_loss"), ("the dashpot", "host_loss"))
}
grains_share = taken["the grains"] / sum(taken.values())
for name, energy in taken.items():
    print(f"{name} dissipated {1e3 * energy:.0f} mJ, {100 * energy / sum(taken.values()):.0f} %")

# %% [markdown]
# ## In motion
#
# The movie shows three quarters of a second of the same run at half speed. The colour of a grain
# shows its speed relative to the cell.

# %%
stages = [
    {"kind": "free", "name": "before", "duration": "5 s"},
    {"kind": "free", "name": "shown", "duration": "0.75 s"},
]
seen = simulate(SCENE.replace(**{"output.frames": "15 ms", "protocol": stages}), "auto*4", progress=False)
movie(seen, folder / "bed.gif", colour="speed", stage="shown", speed=0.5, fps=16, progress=False)
Image(folder / "bed.gif")

# %% [markdown]
# ## The frequency response
#
# One run is made for each frequency and for each of two force amplitudes. For comparison, the
# picture shows two analytical curves for the larger force: the machine without a damper, and the
# machine with an optimal tuned mass damper of the same weight (Den Hartog), which has a spring and
# a dashpot instead of grains.

# %%
FORCES = (10.0, 30.0)
if QUICK:
    frequencies, duration = [3.4, 3.8, 4.0, 4.2, 4.8, 5.2, 5.6], 7.0
else:
    frequencies, duration = list(np.linspace(2.5, 3.7, 25)), 20.0
found = frequency_response(
    SCENE, frequencies, amplitudes=FORCES, duration=duration, dt="auto*4", progress=False
)
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
found.plot(axes)
axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))  # next to the curves
plt.show()
print(found.table)

# %% [markdown]
# The last two columns are ratios: the peak without a damper divided by the peak with the bed, and
# the peak with the bed divided by the peak with the optimal tuned mass damper. The amplitudes are
# steady-state amplitudes; `unsteady` is their change within the measured part of a run. If this
# change is large, the runs should be longer.

# %%
weak, strong = found.peaks()
unsteady = np.round(found.dataset["unsteady"].sel(amplitude=10.0).values, 2)
print(dict(zip(frequencies, unsteady.tolist(), strict=True)))

# %% [markdown]
# ## Three times the force
#
# With a linear damper the displacement would be three times as large at every frequency. A bed
# stiffens under compression, and dissipates more as its grains rearrange. At three times the force,
# the displacement divided by the force has a much lower peak below the machine's natural frequency.
# The higher of the two peaks is then above this frequency.

# %%
figure, axes = plt.subplots(figsize=(7, 3.0), layout="constrained")
for force, marker in zip(FORCES, ("o-", "s--"), strict=True):
    shares = 1e3 * found.dataset["displacement"].sel(amplitude=force) / force
    axes.plot(frequencies, shares, marker, label=f"{force:g} N")
axes.axvline(own_frequency, color="0.6", linestyle=":", label="the machine alone")
axes.set(xlabel="frequency [Hz]", ylabel="displacement over force [mm/N]")
axes.legend()
plt.show()

# %% [markdown]
# ## The law in place of the bed
#
# For beds of 250 grains or more, the simulated grains can be replaced by a law of the bed, an
# ordinary differential equation that is solved in milliseconds per frequency. For moderate forces
# the law agrees with simulations within about 10 %, but not for strong forces (see the table in the
# guide page on machines, made by `python docs/pictures.py machine-law`). The response by this law
# is computed here for the packaged machine.

# %%
packaged = load_scene("machine")
dense = np.linspace(2.6, 3.6, 81)
said = predicted_response(packaged, dense)
figure, axes = plt.subplots(figsize=(7, 3.0), layout="constrained")
axes.plot(dense, 1e3 * said.displacement, label="law of the bed")
axes.plot(dense, 1e3 * said.linear, "--", label="its small swing, linear")
axes.set(xlabel="frequency [Hz]", ylabel="displacement [mm]")
axes.legend()
plt.show()

# %% [markdown]
# ## A better damper
#
# With this law, all dampers of a given mass can be compared within a second: `design_for` optimises
# the number of grains, the mass of the piston and the drag. The proposed damper is a scene that can
# be simulated.

# %%
better = design_for(packaged.effects.host, packaged.effects.host.excitation, limit=7.75)
is_worthwhile = better.is_worthwhile
print(better)

# %% [markdown]
# ## Results

# %%
print(f"The damper reduces {1e3 * weak['alone']:.1f} mm to {1e3 * weak['peak']:.2f} mm; ", end="")
print(f"the grains dissipated {100 * grains_share:.0f} % of the energy.")
print("Under three times the force the peak is ", end="")
print(f"{strong['peak'] / weak['peak']:.2f} times as high, at {strong['frequency']:g} Hz.")

# %% [markdown]
# ## Exercises
#
# 1. Double the drag of the grains, and halve it. For which of the three drags is the peak lowest,
#    and why is there an optimum?
# 2. Attach the piston to the machine instead of the cell (`"effects.host.mount": "piston"`, with a
#    `"effects.host.cell_mass"` of your choice). Which frequency must the bed have now?
