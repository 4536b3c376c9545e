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
# A machine wants a damper of a certain frequency and damping. Which piston, how many grains, what
# liquid? Scaling laws propose one; its own fall corrects them, and the fall of the next one confirms it.

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
# A frequency and a damping ratio are wished for. Scaling laws propose a damper, which falls; its figures
# correct the laws, and the next proposal falls, until one is within 1 % in frequency and 3 % in damping.

# %%
wanted_frequency, wanted_damping = (3.9, 0.12) if QUICK else (3.3, 0.12)
found = design(wanted_frequency, wanted_damping, grains=184 if QUICK else None, progress=False)
print(found)

# %%
found.plot()

# %% [markdown]
# ## Checked once more, by hand
#
# The scene of the design is a scene as any other: it can be run, looked at, changed and saved. From
# one more random start, with the law fitted here. (That grains come close in the fall is said once
# more, as a warning, which is not shown again.)

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
# ## Where the load is given
#
# With the mass fixed, the number of grains is what is free. Only the proposal, without a check:

# %%
loaded = propose_design(DesignTarget(frequency=3.6, damping=0.1, mass=4.0))
print(f"{loaded.mass:g} kg on {loaded.grains} grains, {loaded.drag:.3g} kg/s each")
print(f"a liquid of {loaded.viscosity:.2g} Pa s, by Stokes's law")

# %% [markdown]
# ## What cannot be had
#
# Outside of the limits `design` says no, and what can be had instead.

# %%
refusals = []
for wish in ({"frequency": 9.0, "damping": 0.1}, {"frequency": 3.3, "damping": 0.9}):
    try:
        design(**wish, progress=False)
    except InputError as error:
        refusals.append(str(error))
        print(error)

# %% [markdown]
# ## What came out

# %%
one = found.damper
print(f"A piston of {one.mass:.3g} kg on {one.grains} grains of {one.drag:.3g} kg/s each swings at")
print(f"{own_frequency:.3g} Hz with a damping ratio of {own_damping:.3g}, as was wished.")

# %% [markdown]
# ## Exercises
#
# 1. Ask for a damping ratio of 0.3. What does the answer say, and what would have to change in
#    the cell?
# 2. Design the same damper with a mixture (`small_share=0.3`). What changes: the mass, the
#    drag, or both?
