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
# # 9. Designing a damper
#
# A machine needs a damper of a given frequency and damping ratio. Which mass of the piston, how
# many grains, and which liquid are required? A design is proposed by scaling laws. A simulated fall
# of this design corrects the laws, and a simulated fall of the next design confirms the result.

# %%
# %matplotlib inline
# %config InlineBackend.print_figure_kwargs = {"dpi": 68, "bbox_inches": "tight"}
import warnings

from granular import InputError, simulate
from granular.render import still
from reduced_models import DesignTarget, design, fit, propose_design

QUICK = True  # False: 368 grains for the first design, the published number

# %% [markdown]
# ## A design
#
# Frequency and damping ratio are given. A damper is proposed by scaling laws, and its fall is
# simulated. The result corrects the scaling laws for the next proposal. The search ends if a
# proposal has the required frequency within 1 % and the required damping within 3 %.

# %%
wanted_frequency, wanted_damping = (3.9, 0.12) if QUICK else (3.3, 0.12)
found = design(wanted_frequency, wanted_damping, grains=184 if QUICK else None, progress=False)
print(found)

# %%
found.plot()

# %% [markdown]
# ## An independent check
#
# The scene of the design is an ordinary scene: it can be run, inspected, changed and saved. Here
# the scene is simulated from another random arrangement of the grains, and the law is fitted to
# that run. (The repeated warning that grains come close during the fall is suppressed.)

# %%
warnings.simplefilter("ignore")
run = simulate(found.damper.scene(seed=7), progress=False)
swing = fit(run.piston("release").with_time_from_zero(), law="polynomial-spring").at_rest
own_frequency, own_damping = 1.0 / swing.period, swing.damping_ratio
frequency_error = own_frequency / wanted_frequency - 1.0
damping_error = own_damping / wanted_damping - 1.0
print(f"{own_frequency:.4g} Hz ({100 * frequency_error:+.2g} %)")
print(f"damping ratio {own_damping:.4g} ({100 * damping_error:+.2g} %)")
still(run, colour="force")

# %% [markdown]
# ## A given load
#
# If the mass of the piston is given, the number of grains is chosen by the program. Here only the
# proposal is made, without a simulation to check it:

# %%
loaded = propose_design(DesignTarget(frequency=3.6, damping=0.1, mass=4.0))
print(f"{loaded.mass:g} kg on {loaded.grains} grains, {loaded.drag:.3g} kg/s each")
print(f"a liquid of {loaded.viscosity:.2g} Pa s, by Stokes's law")

# %% [markdown]
# ## Impossible designs
#
# If the target cannot be reached, `design` ends with an error message that gives the nearest
# possible values.

# %%
refusals = []
for wish in ({"frequency": 9.0, "damping": 0.1}, {"frequency": 3.3, "damping": 0.9}):
    try:
        design(**wish, progress=False)
    except InputError as error:
        refusals.append(str(error))
        print(error)

# %% [markdown]
# ## Results

# %%
one = found.damper
print(f"A piston of {one.mass:.3g} kg on {one.grains} grains of {one.drag:.3g} kg/s each oscillates at")
print(f"{own_frequency:.3g} Hz with a damping ratio of {own_damping:.3g}, as required.")

# %% [markdown]
# ## Exercises
#
# 1. Require a damping ratio of 0.3. What is the result, and which change of the cell would be
#    required?
# 2. Design the same damper with a mixture (`small_share=0.3`). What changes: the mass, the
#    drag, or both?
