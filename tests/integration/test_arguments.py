"""Arguments that cannot be: one sentence that names the argument and the cure, before anything is computed."""

import pytest

from tests.conftest import ROOT
from tests.integration.test_python_api import python

RECORDINGS = ROOT / "data" / "recordings"
A_RIG = "give the path of a rig file, a dictionary with its sections, or a Rig"
A_SOURCE = "give a path, a DataFrame, a dictionary of columns, an array with headers, or a Recording"

# Calls, and the sentences that refuse them.
SENTENCES = {
    # studies
    "sma.fit(None, train)": f"read_rig: rig is of type NoneType: {A_RIG}",
    "sma.fit(plant, train)": f"read_rig: rig is of type Plant: {A_RIG}",
    "sma.fit(rig, [])": "fit: train has no recording: give at least one",
    "sma.fit(rig, train, holdout=3)": f"holdout: a recording cannot be read from an object of type int: {A_SOURCE}",
    "sma.fit(rig, train, seed='a')": "fit: seed = 'a' is not possible: give a whole number from 0 to 4294967295",
    "sma.fit(rig, train, seed=-1)": "fit: seed = -1 is not possible: give a whole number from 0 to 4294967295",
    "sma.fit(rig, train, starts=0)": "fit: starts = 0 is not possible: give a whole number from 1 to 10000",
    "sma.fit(rig, train, starts=1.5)": "fit: starts = 1.5 is not possible: give a whole number from 1 to 10000",
    "sma.fit(rig, train, max_steps='many')": "fit: max_steps = 'many' is not possible: give a whole number from 1 to "
    "9223372036854775807",
    "sma.fit(rig, train, profile=3)": "fit: profile = 3 is not possible: give a list of names",
    "sma.fit(rig, train, profile='h0')": "profile h0: this parameter is not free: the free ones are heat.h0",
    "sma.fit(rig, train, start=3)": "start is of type int: give the path of a parameter set, such as the fit.toml "
    "of an earlier fit",
    "sma.fit(rig, train, progress=3)": "progress is of type int: give a function that takes a ProgressEvent, or None",
    "sma.diagnose(rig, train, select=None, holdout=train)": "diagnose: select is missing: give --select (select=), or "
    "--split (split=True) to cut one recording",
    "sma.diagnose(rig, train, select=3, holdout=train)": "select: a recording cannot be read from an object of type "
    f"int: {A_SOURCE}",
    "sma.diagnose(rig, train, select=train, holdout=train, seed=[1])": "diagnose: seed = [1] is not possible: give a "
    "whole number from 0 to 4294967295",
    "sma.compare(rig, train, holdout=train, models=3)": "compare: models = 3 is not possible: give a list of names",
    "sma.compare(rig, train, holdout=train, models='brinsn')": "models: 'brinsn' is not known (did you mean "
    "'brinson'?): the models are brinson",
    "sma.tune(rig, {})": "tune: controller is of type dict: give the path of a controller file",
    "sma.sweep(None)": "sweep: file is of type NoneType: give the path of a sweep file, or of the table sweep.parquet "
    "of a sweep",
    "sma.sweep('a.toml', scheduler=3)": "sweep: scheduler is of type int: give the address of a Dask scheduler, or "
    "'local'",
    "sma.thermal_cycle_properties(cycles, tangent='steep')": "tangent = 'steep' is not known (did you mean "
    "'steepest'?): it is 'lines' or 'steepest'",
    "sma.thermal_cycle_properties(cycles, smooth='x')": "thermal_cycle_properties: smooth = 'x' is not possible",
    "sma.load(3)": "load: folder is of type int: give the path of a result folder",
    "sma.import_recording(None)": "import_recording: path is of type NoneType: give the path of a file",
    "rig.write(3)": "write: path is of type int: give the path of a rig file",
    # recordings
    "sma.read_recording(table, skip_rows='x')": "skip_rows = 'x': give the number of rows before the header",
    "sma.read_recording(table, delimiter=3)": "delimiter = 3 is of type int: give a text",
    "sma.Recording.from_arrays('x', None, {})": "x: there is no channel: give a dictionary with the array of each "
    "channel",
    "sma.Recording.from_arrays('x', None, {'current': ['a']})": "x: channel 'current': the values are not numbers: give an "
    "array of floats",
    "sma.Recording.from_arrays('x', None, {'current': [1.0]}, {'curent': 'A'})": "'curent' is not a known channel (did "
    "you mean 'current'?)",
    # loops of one's own
    "sma.simulate(plant, rows([0.0, 2.0, 1.0], [0.1, 0.1, 0.1]))": "x: row 2: time does not increase, from 2 s to 1 s",
    "sma.simulate(plant, rows([0.0, 1.0], [0.1, np.nan]))": "x: row 1: channel 'current', which drives the plant, is "
    "nan: give a number, or leave out the row",
    "sma.simulate(plant, rows([0.0], [0.1]))": "x: the number of rows is 1: a simulation needs at least two",
    "sma.simulate(plant, rows([], []))": "x: the number of rows is 0: a simulation needs at least two",
    "sma.discretise(plant, recording, step=-1.0)": "discretise: step = -1 s is not possible: give a time above 0 s",
    "sma.simulate(plant, recording, step=float('nan'))": "discretise: step = nan s is not possible: give a time",
    "sma.simulate(plant, recording, step='x')": "discretise: step = 'x' is not possible: give a time above 0 s",
    "sma.simulate(plant, inputs, solver=diffrax.Tsit5(), adjoint='x')": "simulate: adjoint = 'x' is not an adjoint of "
    "diffrax: give one, such as diffrax.ForwardMode()",
    "inputs.scale('x')": "scale: factor is of type str: give a number, or one for each signal of the plant",
    "inputs.scale(np.ones(5))": "scale: factor has shape (5,): give a number, or an array of shape (1,)",
    "sma.step(plant, state, signal, -0.1)": "step: dt = -0.1 s is not possible: give a duration of at least 0 s",
    "sma.step(plant, state, signal, 'x')": "step: dt is of type str: give the duration of the step in s",
    "sma.step(plant, state, signal, np.ones(2))": "step: dt has shape (2,): give one duration, and map over several by "
    "jax.vmap",
    "sma.simulate(several, inputs)": "simulate: heat.h0 has shape (3,): give one number, and map over several values",
    "sma.init(several, signal)": "init: heat.h0 has shape (3,): give one number, and map over several values by",
    "sma.rollout(several, loop, [1e-3])": "rollout: heat.h0 has shape (3,): give one number, and map over several",
    "sma.rollout(plant, loop, None)": "rollout: reference is of type NoneType: give one value for each sample, or a "
    "Scenario",
    "sma.rollout(plant, loop, [1e-3], step=-1.0)": "rollout: step = -1 s is not possible: give a time above 0 s",
    "sma.ClosedLoop(loop.controller, channel='displacement', limits=3)": "limits = 3: give two numbers, the smallest "
    "and the largest command",
    # plants
    "sma.Wire(1e-4, None)": "Wire.length is None: give a number in m",
    "sma.mechanisms.DeadWeight(0.2)": "DeadWeight: load cannot be a float: give a Load",
    "dataclasses.replace(plant, effects=None)": "Plant: effects is of type NoneType: give a tuple, such as "
    "(LatentHeat(strength=1e8),) with a comma, or () for none",
    "dataclasses.replace(plant, effects=latent)": "Plant: effects is of type LatentHeat: give a tuple",
    "dataclasses.replace(plant, effects=(latent, latent))": "Plant: effects has 'latent-heat' twice: give each effect "
    "once",
    "parameters.replace(plant, {3: 1.0})": "there is no parameter '3' in this plant",
    "parameters.replace(plant, None)": "parameters are set by a dictionary such as {'heat.h0': 100.0}, not by an "
    "object of type NoneType",
    "sma.parameter('m', 'length', 1.0, 0.0)": "parameter: length: the lower bound 1 is not below the upper one 0",
    "sma.parameter('m', 'length', 0.0, 1.0, 5.0)": "parameter: length: the default 5 is not between the bounds: give "
    "one from 0 to 1",
    "sma.parameter('m', 3)": "parameter('m', 3): give unit and meaning as strings, such as 'W/m^2/K'",
}
CODE = f"""
import dataclasses
import diffrax
import numpy as np
import smajax as sma
from smajax import parameters
rig = sma.read_rig({str(RECORDINGS / "dead-weight" / "rig.toml")!r})
train, cycles = {str(RECORDINGS / "dead-weight" / "train.csv")!r}, {str(RECORDINGS / "isobaric" / "cycles.csv")!r}
plant, signal = rig.plant, np.asarray([0.2])
several = parameters.replace(plant, {{"heat.h0": np.asarray([80.0, 90.0, 100.0])}})
table = {{"time [s]": 0.1 * np.arange(3), "current [A]": np.full(3, 0.2)}}
recording = rig.read(table, observed=False)
inputs, state, latent = sma.discretise(plant, recording), sma.init(plant, signal), sma.effects.LatentHeat(strength=1e8)
pid = sma.controllers.PID(kp=400.0, ki=50.0, lower=0.0, upper=0.4, period=0.1)
loop = sma.ClosedLoop(pid, channel="displacement")


def rows(time, current):
    return sma.Recording.from_arrays("x", np.asarray(time), {{"current": np.asarray(current)}})


for call in {list(SENTENCES)!r}:
    try:
        print("accepted:", eval(call))
    except sma.InputError as error:
        print(error)
    except Exception as error:
        print(type(error), str(error).splitlines()[:1])
"""


@pytest.mark.slow
def test_arguments_that_cannot_be_are_named_with_the_cure():
    """In a new process, since the tests' own checks of types would come first."""
    result = python(CODE)
    lines = result.stdout.splitlines()
    assert len(lines) == len(SENTENCES), result.stderr + result.stdout
    assert [line for line, start in zip(lines, SENTENCES.values(), strict=True) if not line.startswith(start)] == []
