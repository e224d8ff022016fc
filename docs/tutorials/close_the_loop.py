# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Close the loop: from measured cycles to a controller
#
# This page does all steps in Python: read measured recordings, fit a model, look at the residual, find what the
# model lacks, compare before and after on a recording that nothing was fitted to, tune a controller on a better model,
# and export it.
#
# The recordings are thermal cycles of a Flexinol wire under five constant stresses, published by the MAESTRO
# laboratory (GitHub repository `maestrolab/calibration_matlab`, folder `data/flexinol`). No licence is stated there, so
# they do not ship with smajax: `get` fetches them once from the commit that `smajax datasets list` shows, and compares
# their checksums. `SMAJAX_DATA=FOLDER` reads `FOLDER/tamu-flexinol-isobaric` instead, without a network.

# %% [markdown]
# `prepare_jax` is not needed. It sets JAX up as the command line does: compiled programs are kept between runs, and
# compile faster. It has to be called before JAX compiles anything.

# %%
from smajax.numerics.process import prepare_jax

prepare_jax()

# %%
import tomllib
from pathlib import Path

import numpy as np

import smajax as sma
from smajax.recordings.datasets import data_path, get

folder, unavailable = get("tamu-flexinol-isobaric")
sorted(path.name for path in folder.glob("*.txt"))

# %% [markdown]
# ## Read
#
# Each file has the columns temperature, strain and stress, without headers. Three things have to be said about them:
#
# - The stress column is the noise of the load cell about a constant; the nominal stress of the file's name is used.
# - Each recording was zeroed at its hottest row, where the wire is austenite. The elastic strain that it has there,
#   stress over modulus, is added again, with the usual 60 GPa.
# - The authors have filtered the curves, so that their noise cannot be estimated from them. 0.05 % of strain is taken
#   as the standard deviation of what a model need not explain.
#
# There is no clock, so the rows are a path of temperature and stress. A recording can be a dictionary of columns, a
# pandas DataFrame or a file; it is checked in the same way. Every second row is enough.

# %%
MODULUS = 60e9  # Pa


def read_cycles(*stresses):
    """One thermal cycle at each stress in MPa, one after the other."""
    cycles = []
    for stress in stresses:
        temperature, strain, _ = np.loadtxt(folder / f"isobaric_{stress}MPa.txt")[::2].T
        strain = strain + 1e6 * stress / MODULUS
        cycles.append((temperature, np.full(len(temperature), float(stress)), 100 * strain))
    temperature, stress, strain = (np.concatenate(columns) for columns in zip(*cycles, strict=True))
    columns = {"temperature [degC]": temperature, "stress [MPa]": stress, "strain [%]": strain}
    return sma.read_recording(columns, clock=False, name=", ".join(map(str, stresses)) + " MPa")


train = read_cycles(50, 100, 200)
select = read_cycles(172)
holdout = read_cycles(150)
print(train)

# %% [markdown]
# ## Fit
#
# The rig is a material point that follows the recorded temperature and stress. It is written as a dictionary here; a
# file `rig.toml` has the same sections. The start values are read off the curves, roughly.

# %%
rig = sma.read_rig(
    {
        "schema": 1,
        "rig": {"kind": "path"},
        "material": {
            "martensite_start": "65 degC",
            "martensite_finish": "10 degC",
            "austenite_start": "70 degC",
            "austenite_finish": "85 degC",
            "clausius_clapeyron_austenite": "8 MPa/K",
            "clausius_clapeyron_martensite": "7.5 MPa/K",
            "modulus_austenite": "60 GPa",
            "modulus_martensite": "30 GPa",
            "detwinning_start_stress": "0 MPa",
            "detwinning_finish_stress": "110 MPa",
            "max_transformation_strain": "4.5 %",
        },
        "fit": {
            "model": "brinson",
            "observe": ["strain"],
            "noise": {"strain": "0.05 %"},
            "starts": 4,
            "free": [
                "material.martensite_start",
                "material.austenite_start",
                "material.austenite_finish",
                "material.clausius_clapeyron_austenite",
                "material.clausius_clapeyron_martensite",
                "material.modulus_martensite",
                "material.detwinning_finish_stress",
                "material.max_transformation_strain",
            ],
            "bounds": {
                "material.martensite_start": ["40 degC", "110 degC"],
                "material.austenite_start": ["20 degC", "78 degC"],
                "material.austenite_finish": ["78 degC", "140 degC"],
                "material.clausius_clapeyron_austenite": ["4 MPa/K", "16 MPa/K"],
                "material.clausius_clapeyron_martensite": ["4 MPa/K", "16 MPa/K"],
                "material.modulus_martensite": ["5 GPa", "200 GPa"],
                "material.detwinning_finish_stress": ["5 MPa", "400 MPa"],
            },
        },
    }
)
result = sma.fit(rig, train, holdout=holdout)
print(result)

# %% [markdown]
# ## See the residual
#
# The figure shows measured and modelled strain, and their difference (measured minus model) below. The difference is
# not noise: the measured curves have a steep middle and long tails on either side, and the cosine between start and
# finish temperatures of the fitted law has neither. The intervals in the table above take the autocorrelation of this
# residual into account, but no interval contains an error of the equations. (The noise floor in that table is the
# scatter from row to row, which is small because the curves are filtered.)

# %% figure="Strain of the fitted cycles row by row, measured and modelled, their difference, and the inputs"
result.plot()

# %%
error = result.rmse["strain"]
stroke = 100 * np.ptp(holdout.channels["strain"])  # channels are in SI units
for role in ("train", "holdout"):
    print(f"{role}: RMSE {error[role]:.3f} {error['unit']} strain, {error[role] / stroke:.1%} of the stroke")

# %% [markdown]
# ## Diagnose
#
# The diagnosis asks which of the known effects explains the residual. It fits to `train`, adds an effect only if it
# lowers the error on `select`, and predicts `holdout` once, at the end.

# %%
found = sma.diagnose(rig, train, select=select, holdout=holdout)
print(found)

# %% [markdown]
# ## Before and after
#
# What counts is the recording at 150 MPa, to which nothing was fitted.

# %% figure="Strain at 150 MPa row by row, measured, and modelled before and after the diagnosis"
found.plot()

# %%
print("effects:", ", ".join(found.effects) or "none")
for effect, others in found.equivalent.items():
    print(f"as good as {effect}:", ", ".join(others) or "none")
error = found.rmse["strain"]
for role in ("train", "select", "holdout"):
    print(f"{role}: RMSE {error[role + '_before']:.3f} {error['unit']} before, {error[role + '_after']:.3f} after")

# %% [markdown]
# An effect that is named here is one that these recordings support. Where others are listed as equally good, these
# recordings cannot distinguish them, and the name must not be taken for the mechanism. The summary also says what the
# diagnosis makes of the residual that remains: where it is still above the noise, the model still lacks something, and
# the effect is an improved description of these cycles, not a proven mechanism.

# %% [markdown]
# ## From the cycles to an actuator
#
# The effect that was added acts on a material point whose stress or strain is prescribed; a wire that moves a load does
# not have it. But the diagnosis points to a law that has rounded corners by itself: that of Lagoudas, whose hardening
# exponents below 1 draw the curve out at the start and at the finish of each transformation. It is fitted to the same
# cycles and asked for the same prediction.

# %%
data = tomllib.loads(rig.to_toml())
shared = ("clausius_clapeyron_austenite", "clausius_clapeyron_martensite", "modulus_austenite", "modulus_martensite")
exponents = {f"n{k}": "0.4" for k in (1, 2, 3, 4)}
data["material"] = {key: data["material"][key] for key in shared} | exponents
data["material"] |= {
    "martensite_start": "70 degC",
    "martensite_finish": "40 degC",
    "austenite_start": "65 degC",
    "austenite_finish": "100 degC",
    "max_transformation_strain": "4.3 %",
}
free = [key for key in data["material"] if key != "modulus_austenite"]
data["fit"] = {
    "model": "lagoudas",
    "observe": ["strain"],
    "noise": {"strain": "0.05 %"},
    "starts": 1,
    "free": [f"material.{key}" for key in free],
    "bounds": {
        "material.martensite_start": ["50 degC", "130 degC"],
        "material.martensite_finish": ["-30 degC", "58 degC"],
        "material.austenite_start": ["0 degC", "75 degC"],
        "material.austenite_finish": ["80 degC", "150 degC"],
        **{f"material.{key}": ["0.1", "1"] for key in exponents},
    },
}
smooth = sma.fit(sma.read_rig(data), train, holdout=holdout)
print(smooth)

# %%
print(f"RMSE at 150 MPa, in {error['unit']} strain")
print(f"Brinson's law:   {error['holdout_before']:.3f}")
print(f"with its effect: {error['holdout_after']:.3f}")
print(f"Lagoudas' law:   {smooth.rmse['strain']['holdout']:.3f}")
print("at a bound:", ", ".join(name for name, entry in smooth.parameters.items() if entry.at_bound) or "none")

# %% [markdown]
# A parameter at its bound is not a property of the wire: here the bounds keep the start and finish temperatures, which
# trade against the exponents, within the range of the recording.
#
# ## Tune
#
# The cycles say how the material transforms, and nothing about heat: they have no current and no clock. The controller
# is therefore tuned on a rig that takes the material from the fit, and everything else from the template of a 0.15 mm
# wire that lifts 200 g: its convection and heat capacity are values of data sheets and the literature. Brinson's law
# is taken, whose rollouts are faster. Before gains from this page are used on a real wire, record a step of current on
# it and fit `heat.h0` and `heat.capacity`.

# %%
actuator = tomllib.loads(data_path("templates", "dead-weight.toml").read_text("utf-8"))
actuator["material"] |= tomllib.loads(result.rig.to_toml())["material"]
lift = sma.read_rig(actuator)

# %%
Path("controller.toml").write_text("""
schema = 1

[controller]
kind = "pid"
period = "100 ms"
output = ["0 A", "0.5 A"]

[gains]                           # where the search starts
kp = "30 A/m"
ki = "10 A/m/s"

[reference]
kind = "staircase"
duration = "24 s"
levels = ["3 mm", "5 mm", "2 mm"]
hold = "8 s"

[tune]
objective = "tracking"
starts = 1

[limits]
temperature = "150 degC"

[sensor]
noise = "5 um"
""")
tuned = sma.tune(lift, "controller.toml")
print(tuned)

# %% figure="Displacement of the closed loop over time with start and tuned gains, and its reference"
tuned.plot()

# %%
print("gains, in SI units:", {name: round(value, 3) for name, value in tuned.gains.items()})
print("margins, as medians:", {name: round(value, 2) for name, value in tuned.margins.items()})

# %% [markdown]
# ## Export
#
# The folder has the controller as a C header and as a JSON document, plant and controller as FMUs, and a report. The
# diagnosis is saved likewise, with the rig that has its effect, if it named one.

# %%
found.save("diagnosis")
tuned.save("controller")
for folder in ("diagnosis", "controller"):
    print(f"{folder}:", *sorted(path.name for path in Path(folder).iterdir()), sep="\n  ")
