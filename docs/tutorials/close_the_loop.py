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
# This page goes the whole way in Python: read a measured recording, fit a model, look at the residual, find what the
# model lacks, compare before and after on a recording that nothing was fitted to, tune a controller on the better
# model, and export it.
#
# The recordings are thermal cycles of a Flexinol wire under five constant stresses, published by the MAESTRO
# laboratory (GitHub repository `maestrolab/calibration_matlab`, folder `data/flexinol`). No licence is stated there, so
# they do not ship with smajax: `get` fetches them once from the commit that `smajax datasets list` shows, and compares
# their checksums. `SMAJAX_DATA=FOLDER` reads `FOLDER/tamu-flexinol-isobaric` instead, without a network.

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

# %%
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

# %%
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
# the effect is a better description of these cycles rather than the whole truth.

# %% [markdown]
# ## Tune
#
# The cycles say how the material transforms, and nothing about heat: they have no current and no clock. The controller
# is therefore tuned on a rig that takes the material with its effects from the diagnosis, and everything else from the
# template of a 0.15 mm wire that lifts 200 g: convection, heat capacity and resistivity are values of data sheets and
# the literature there. Before gains from this page are used on a real wire, record a step of current on it and fit
# `heat.h0` and `heat.capacity`, as the first tutorial does.

# %%
actuator = tomllib.loads(data_path("templates", "dead-weight.toml").read_text("utf-8"))
diagnosed = tomllib.loads(found.rig.to_toml())
actuator["material"] |= diagnosed["material"]
actuator["effects"] = diagnosed.get("effects", {})
del actuator["fit"]
lift = sma.read_rig(actuator, drop_misplaced=True)
print("effects that a current-driven wire does not have:", dict(lift.misplaced) or "none")

# %%
Path("controller.toml").write_text("""
schema = 1

[controller]
kind = "pid"
period = "50 ms"
output = ["0 A", "0.5 A"]

[gains]                           # where the search starts
kp = "30 A/m"
ki = "10 A/m/s"

[reference]
kind = "staircase"
duration = "45 s"
levels = ["3 mm", "5 mm", "2 mm"]
hold = "15 s"

[tune]
objective = "tracking"
starts = 1

[limits]
temperature = "130 degC"

[sensor]
noise = "5 um"
""")
tuned = sma.tune(lift, "controller.toml")
print(tuned)

# %%
tuned.plot()

# %%
print("gains:", tuned.gains)
print("margins:", tuned.margins)

# %% [markdown]
# ## Export
#
# The folder has the controller as a C header and as a JSON document, plant and controller as FMUs, and a report. The
# diagnosis is saved likewise, with the rig that has its effects.

# %%
found.save("diagnosis")
exported = tuned.save("controller")
for path in sorted(exported.iterdir()):
    print(f"{path.name}: {path.stat().st_size} bytes")
