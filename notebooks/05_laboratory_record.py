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
# # 5. A laboratory record
#
# A record of a real damper is a table of times and heights, with sensor noise, an unknown offset,
# and a gap in which the sensor lost the piston. Here such a table is generated from a known law, so
# that every result can be checked. The table is then treated like laboratory data.

# %%
# %matplotlib inline
# %config InlineBackend.figure_format = "retina"
# %config InlineBackend.print_figure_kwargs = {"dpi": 144, "bbox_inches": "tight"}
import tempfile
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

from granular import GranularError
from reduced_models import PistonRecord, fit, load_model
from reduced_models.records.envelope import envelope

plt.style.use("tableau-colorblind10")  # lines that colour-blind readers can distinguish
warnings.simplefilter("ignore")  # relevant notes are printed below

QUICK = True  # False: a record four times as long

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The table
#
# The law describes a bed that rearranges under compression: a power-law spring with drag, z″ + 2λz′
# = w((r/z)ⁿ − 1). The piston is released 4 mm above its equilibrium. Samples are irregular, 400 per
# second on average. The sensor has noise of 20 µm and an offset of 4 mm. The file has the format of
# LabVIEW (`.lvm`): a header in two parts, tabs, and a column of times.

# %%
TRUTH = {"lam": 0.6, "weight": 9.8, "rest": 0.059, "power": 2.5}
NOISE, OFFSET, LIFT = 20e-6, 4e-3, 4e-3
DURATION = 5.0 if QUICK else 20.0


def acceleration(z: float, v: float) -> float:
    """Return the acceleration of the true law."""
    spring = TRUTH["weight"] * ((TRUTH["rest"] / z) ** TRUTH["power"] - 1.0)
    return spring - 2.0 * TRUTH["lam"] * v


def true_height(times: np.ndarray, lift: float) -> np.ndarray:
    """Return the true motion after a lift [m]."""
    start = [TRUTH["rest"] + lift, 0.0]
    solved = solve_ivp(
        lambda _, y: (y[1], acceleration(*y)), (0.0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12
    )
    return solved.y[0]


random = np.random.default_rng(7)
times = np.cumsum(random.uniform(1e-3, 4e-3, int(400 * DURATION)))
times = times[(times < 1.0) | (times > 1.3)]
heights = true_height(times, LIFT) + OFFSET + random.normal(0.0, NOISE, len(times))
HEADER = f"""LabVIEW Measurement
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t.
Multi_Headings\tNo
X_Columns\tOne
Time_Pref\tRelative
***End_of_Header***

Channels\t1
Samples\t{len(times)}
Y_Unit_Label\tmm
X_Dimension\tTime
***End_of_Header***\t\t
X_Value\tHeight\tComment"""
rows = [f"{t:.5f}\t{1e3 * z:.3f}" for t, z in zip(times, heights, strict=True)]
lab = folder / "lab.lvm"
lab.write_text("\n".join([HEADER, *rows]) + "\n")
print(*lab.read_text().splitlines()[9:18], sep="\n")

# %% [markdown]
# ## Reading the record
#
# The unit of the height is given in the header, and the times are in seconds. The gap and the
# irregular sampling require no special treatment.

# %%
record = PistonRecord.from_file(lab)
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
axes.plot(record.time, 1e3 * record.height, ".", markersize=2)
axes.set(xlabel="time [s]", ylabel="height as read [mm]", xlim=(0, 2.5))
plt.show()
print(f"{len(record)} samples over {record.time[-1] - record.time[0]:.2f} s,")
print(f"the longest gap is {np.diff(record.time).max():.2f} s")

# %% [markdown]
# ## Before any law: the envelope
#
# The amplitude, frequency and damping of each cycle can be determined without a law and without
# knowing the equilibrium. The logarithm of the amplitude decreases linearly, so the damping is
# viscous. Within the errors the frequency does not depend on the amplitude, and therefore does not
# reveal the curvature of the spring. The gap may hide an extremum, so the envelope begins after the
# gap.

# %%
swing = record.between(1.3, record.time[-1])
cycles = envelope(swing)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
left.errorbar(cycles.time, 1e3 * cycles.amplitude, 2e3 * cycles.amplitude_noise, fmt=".")
left.set(xlabel="time [s]", ylabel="amplitude [mm]", yscale="log")
right.errorbar(1e3 * cycles.amplitude, cycles.frequency, 2 * cycles.frequency_noise, fmt=".")
right.set(xlabel="amplitude [mm]", ylabel="angular frequency [rad/s]")
plt.show()
strong = cycles.amplitude > 10 * NOISE
envelope_decay = -np.polyfit(cycles.time[strong], np.log(cycles.amplitude[strong]), 1)[0]
print(f"decay of the amplitude: {envelope_decay:.3f} 1/s (true: {TRUTH['lam']} 1/s)")

# %% [markdown]
# ## Fit
#
# The fitted law is a polynomial spring about the equilibrium. This law does not depend on the
# origin of the height.

# %%
about_rest = fit(record, law="polynomial-spring")
print(about_rest)

# %% [markdown]
# ## Residuals
#
# The residuals should look like the noise of the sensor: they should have the same size, and should
# not oscillate. For comparison the output also gives the noise that `fit` estimates from the
# record.

# %%
left_over = record.height - about_rest.simulate_record(record).height
figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
axes.plot(record.time, 1e6 * left_over, ".", markersize=2)
axes.set(xlabel="time [s]", ylabel="height less model [µm]")
plt.show()
residual, noise_seen = about_rest.quality.residual, about_rest.quality.noise
print(f"residual {1e6 * residual:.1f} µm, noise in the record {1e6 * noise_seen:.1f} µm, ", end="")
print(f"put in {1e6 * NOISE:g} µm")

# %% [markdown]
# ## Effect of the offset
#
# In the power law the force of the bed vanishes at large heights and diverges at height zero, so
# the law requires the height above the bottom. If the law is fitted to the uncorrected readings of
# the sensor, the exponent is wrong and its interval does not contain the true value; the residuals
# do not reveal this error. If the offset is measured and subtracted (here it is known), the
# exponent is correct.

# %%
as_read = fit(record, law="power-law-spring")
corrected = fit(record.mapped(OFFSET, 1.0), law="power-law-spring")
for what, model in (("as read", as_read), ("corrected", corrected)):
    low, high = model.intervals["power"]
    share = 1e6 * model.quality.residual
    power = model.parameters["power"]
    print(f"{what:10} power {power:.3f} [{low:.3f}, {high:.3f}], residual {share:.1f} µm")
print(f"true       power {TRUTH['power']}")

# %% [markdown]
# ## Do the intervals contain the truth?
#
# For the corrected fit the true value of every parameter is known. A 95 % interval does not contain
# the true value in one case out of twenty, so a single miss would not be surprising. Weight and
# power are correlated, so their intervals would miss together. An interval twice as wide should
# nearly always contain the true value.

# %%
inside, far = {}, []
for name, value in TRUTH.items():
    low, high = corrected.intervals[name]
    inside[name] = bool(low <= value <= high)
    found = corrected.parameters[name]
    if abs(value - 0.5 * (low + high)) > high - low:
        far.append(name)
    print(f"{name:7} {found:9.5f}  [{low:9.5f}, {high:9.5f}]  true {value:7}  {inside[name]}")

# %% [markdown]
# ## When the usual interval is wrong
#
# The first half second of the record contains hardly two cycles, and with sixty times the noise the
# damping is hardly measurable. The linearised interval of the damping, which must be positive, has
# a lower bound above zero. For the profile interval the damping is fixed at successive values, and
# all other parameters are fitted again. The profile shows that a law without damping fits nearly as
# well.

# %%
short = record.between(0.0, 0.5)
noisy = PistonRecord(short.time, short.height + random.normal(0.0, 60 * NOISE, len(short)))
dampings = {}
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    for how in ("linear", "profile"):
        model = fit(noisy, law="linear", intervals=how, test_fraction=0.0)
        dampings[how] = model.intervals["lam"]
        low, high = dampings[how]
        print(f"{how:9} lam = {model.parameters['lam']:.3f} [{low:.3g}, {high:.3g}] 1/s")
print(f"true      lam = {TRUTH['lam']}")

# %% [markdown]
# ## Predict
#
# The model predicts a lift of 6 mm, which is 1.5 times the lift of the record. It warns of
# extrapolation; its error is determined by comparison with the true law.

# %%
ahead = np.linspace(0.0, 2.0, 800)
truth = true_height(ahead, 6e-3)
predicted = corrected.simulate(ahead, z0=TRUTH["rest"] + 6e-3, v0=0.0)
prediction_error = float(np.abs(predicted.height - truth).max())
figure, axes = plt.subplots(figsize=(7, 2.8), layout="constrained")
axes.plot(ahead, 1e3 * truth, color="#999999", linewidth=4, label="true")
axes.plot(ahead, 1e3 * predicted.height, "--", label="predicted")
axes.set(xlabel="time [s]", ylabel="height [mm]")
axes.legend()
plt.show()
print(corrected.outside_range_text(predicted))
print(f"maximum error of the prediction: {1e6 * prediction_error:.0f} µm")

# %% [markdown]
# ## Saving the model
#
# A model is saved as a small text file, from which it is restored bitwise exactly.

# %%
corrected.save(folder / "model.json")
again = load_model(folder / "model.json")
same_prediction = np.array_equal(again.predict(ahead), corrected.predict(ahead))
print(f"the same prediction: {same_prediction}")
print(again.fitted_equation)

# %% [markdown]
# ## Bad records
#
# Unusable records are rejected with a one-line message that gives the position of the fault.

# %%
lines = ["time [s];height [mm]", *(row.replace("\t", ";") for row in rows)]
bad = {
    "a word for a number": [*lines[:9], "0.0173;lost", *lines[9:]],
    "a time twice": [*lines[:9], lines[8], *lines[9:]],
    "a unit of another kind": ["time [s];height [kg]", *lines[1:]],
    "no height": [line.split(";")[0] for line in lines],
    "too few samples": lines[:12],
}
refused = {}
for what, text in bad.items():
    path = folder / "bad.csv"
    path.write_text("\n".join(text) + "\n")
    try:
        fit(PistonRecord.from_csv(path), law="linear")
    except GranularError as error:
        refused[what] = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}, ")
        print(f"{what}: {refused[what]}")

# %% [markdown]
# For doubtful records the fit adds a note. The examples are a record of pure noise, and a record
# with heights in millimetres but without a unit.

# %%
alone = PistonRecord(record.time, TRUTH["rest"] + random.normal(0.0, 1e-4, len(record)))
metres = PistonRecord(record.time, 1e3 * record.height)
doubts = {}
for what, odd in (("noise alone", alone), ("millimetres", metres)):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        doubts[what] = fit(odd, law="linear").notes
    print(f"{what}:")
    for note in doubts[what]:
        print(f"  {note}")

# %% [markdown]
# ## Results

# %%
power_as_read, power_corrected = as_read.parameters["power"], corrected.parameters["power"]
missed = [name for name, holds in inside.items() if not holds]
print(f"Of {len(inside)} true parameters {len(inside) - len(missed)} are inside their intervals.")
print(f"An offset of {1e3 * OFFSET:g} mm gives an exponent of {power_as_read:.2f} instead of ", end="")
print(f"{TRUTH['power']}; corrected it is {power_corrected:.2f}.")
print(f"An amplitude 1.5 times as large is predicted to {1e6 * prediction_error:.0f} µm.")

# %% [markdown]
# ## Exercises
#
# 1. Multiply the noise by ten. Which interval increases most, and which parameter can no longer be
#    distinguished from zero?
# 2. Take every tenth sample only. At which sampling rate does the fit begin to fail, and which
#    notes does it give?
