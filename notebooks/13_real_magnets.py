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
# # 13. Real magnets
#
# At a large distance a magnet acts as a point dipole. At contact, however, two discs of 6 x 3 mm
# repel each other twice as strongly as point dipoles. How does a damper change if its grains are
# discs, and which differences are visible in the laboratory?

# %%
# %matplotlib inline
# %config InlineBackend.print_figure_kwargs = {"dpi": 80, "bbox_inches": "tight"}
import warnings

import matplotlib.pyplot as plt
import numpy as np

from granular import load_scene, simulate
from granular.pairs.disc_law import Disc, disc_energy_and_force
from granular.schema import Scales
from reduced_models import fit, predict
from reduced_models.falls.predicted_law import lattice_pressure

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish
warnings.simplefilter("ignore")  # the fit notes that a linear law has systematic residuals

QUICK = True  # False: the drag of the packaged scene, 0.1 kg/s, with which the bed oscillates for ten seconds
CHANGES = {"effects.drag.coefficient": 0.4, "protocol.release.duration": 1.5} if QUICK else {}
STEP = "auto*2"
DIAMETER = 0.006  # m
KINDS = {"discs": "cylinders", "dipoles": "dipoles"}

# %% [markdown]
# ## Two magnets
#
# The scene `magnets` is the packaged damper with 368 discs of the grade N42, for which tables give
# a remanence of 1.28 to 1.32 T. At large distances r the force between discs of radius R and
# thickness h, divided by the force between dipoles, is 1 + (15/4) (R² - h²/3)/r². At short
# distances this ratio is larger.

# %%
packaged = load_scene("magnets").replace(**CHANGES)
scenes = {name: packaged.replace(**{"grains.magnets": kind}) for name, kind in KINDS.items()}
r = np.linspace(1.0, 4.0, 200)
factor = disc_energy_and_force(r, Disc(0.5, 0.5), Disc(0.5, 0.5))[1] * r**4 / 3.0
figure, axes = plt.subplots(figsize=(6, 2.6), layout="constrained")
axes.plot(r, factor)
axes.set(xlabel="distance of the axes [D]", ylabel="force over that of dipoles", ylim=(1, 2))
plt.show()
print(f"at contact {factor[0]:.3f}, at 1.37 D {np.interp(1.37, r, factor):.3f}")

# %% [markdown]
# ## Fall, equilibrium, and oscillation
#
# The piston is released at 20 D, comes to rest, is lifted by 0.2 D and released again. The dashed
# lines are not fitted, but computed by `predict` from the pressure of a lattice of these magnets.

# %%
runs = {name: simulate(scene, dt=STEP, progress=False) for name, scene in scenes.items()}
laws = {name: predict(scene) for name, scene in scenes.items()}
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
fall_errors = {}
for k, (name, run) in enumerate(runs.items()):
    motion = run.piston("drop")
    told = laws[name].simulate(motion.time)
    error = np.sqrt(np.mean((told.height - motion.height) ** 2))
    fall_errors[name] = float(error / (motion.height[0] - run.stage("drop").height))
    axes.plot(motion.time, 1e3 * motion.height, color=f"C{k}", label=name)
    axes.plot(told.time, 1e3 * told.height, "--", color=f"C{k}", linewidth=1)
axes.set(xlabel="time [s]", ylabel="height of the piston [mm]")
axes.legend()
plt.show()
print({name: f"{100 * error:.1f} % of the drop" for name, error in fall_errors.items()})

# %%
rests = {name: fit(run.piston(), "linear").at_rest for name, run in runs.items()}
for name, rest in rests.items():
    law = laws[name].at_rest
    print(
        f"{name:8s} rest {1e3 * rest.height:.2f} mm (law {1e3 * law.height:.2f}), "
        f"{1 / rest.period:.3f} Hz ({1 / law.period:.3f}), "
        f"damping ratio {rest.damping_ratio:.4f} ({law.damping_ratio:.4f})"
    )
higher = rests["discs"].height / rests["dipoles"].height
faster = rests["dipoles"].period / rests["discs"].period

# %% [markdown]
# ## Compression
#
# A piston is pushed down at 10 cm/s. For discs and for dipoles, the force on the piston is compared
# with the pressure of a lattice of the same magnets, times the width of the cell. The forces of the
# beds are larger than the forces of the lattices, by 9 and 15 %, because a bed compressed in one
# direction also resists shear. The lattices explain most of the difference between discs and
# dipoles.

# %%
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
over_lattice = {}
for k, (name, scene) in enumerate(scenes.items()):
    push = scene.replace(
        **{"piston.height": "14 D", "arrangement.height": "13 D", "output.record": None},
        protocol=[
            {"name": "settle", "kind": "hold", "duration": 0.3},
            {"name": "push", "kind": "move", "to": "8 D", "speed": 0.1},
        ],
    )
    data = simulate(push, dt=STEP, progress=False).dataset
    height, force = data["piston_height"].values, data["piston_force"].values
    pushed = data["time"].values > 0.3
    scales, width = Scales.from_grains(scene.grains), scene.cell.width
    density = scene.grains.count * DIAMETER**2 / (width * height[pushed])
    lattice = np.array([lattice_pressure(scene.grains, rho) for rho in density[::20]])
    lattice *= scales.force / scales.length * width
    axes.plot(1e3 * height[pushed], force[pushed], color=f"C{k}", label=name)
    axes.plot(1e3 * height[pushed][::20], lattice, "--", color=f"C{k}", linewidth=1)
    over_lattice[name] = float(np.mean(force[pushed][-100:]) / lattice[-5:].mean())
axes.set(xlabel="height of the piston [mm]", ylabel="force [N]")
axes.legend()
plt.show()
print({name: f"{ratio:.3f} of the lattice at the end" for name, ratio in over_lattice.items()})

# %% [markdown]
# ## On the bench
#
# - Discs hold the piston about 4 mm higher than dipoles of the same moment, which is easily seen.
# - The piston oscillates more slowly, by 6 % here, because the walls are rows of the same discs,
#   and the bed is softer next to such walls.
# - If the piston hits the bed hard, discs touch each other, whereas simulated dipoles come closer
#   than is possible for magnets.
#
# Neither simulation includes tilting of the magnets, or walls that are not magnets. The reduction
# of the moment by coating and permeability can be included, as explained in the guide page on
# parts.

# %%
print(f"higher by {100 * (higher - 1):.1f} %, faster by {100 * (faster - 1):.1f} %")
