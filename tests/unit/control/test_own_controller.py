"""An own controller without a PID inside: in a controller file, tuned, and exported as JSON, C header and FMU."""

import ctypes
import json
import shutil
import subprocess
import sys
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.controller_file.read import read_controller
from smajax.control.controllers import AbstractController, register_controller
from smajax.control.controllers.registry import CONTROLLERS
from smajax.control.export.c_header import c_header
from smajax.control.export.files import export_files
from smajax.control.export.json_document import controller_document
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gains, unit_of
from smajax.control.tuning.tuning_study import tune_controller
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter
from tests.conftest import ROOT

RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
PERIOD = 0.05


# What a user writes.
class DeadBandState(NamedTuple):
    integral: jax.Array


class DeadBandPI(AbstractController):
    """PI controller that ignores errors within a dead band."""

    kp: jax.Array = parameter("u/y", "proportional gain", 0.0)
    ki: jax.Array = parameter("u/y/s", "integral gain", 0.0)
    dead_band: jax.Array = parameter("y", "error that is ignored", 0.0)
    lower: jax.Array = parameter("u", "least output", default=0.0)
    upper: jax.Array = parameter("u", "largest output", default=1.0)
    period: float = eqx.field(static=True, kw_only=True)
    leak: float = eqx.field(static=True, kw_only=True, default=1.0)

    def reset(self, reference, value):
        return DeadBandState(jnp.zeros(()))

    def step(self, state, reference, value):
        error = reference - value
        error = jnp.where(jnp.abs(error) > self.dead_band, error, 0.0)
        integral = clip(self.leak * state.integral + self.ki * error * self.period, self.lower, self.upper)
        return DeadBandState(integral), clip(self.kp * error + integral, self.lower, self.upper)


register_controller("dead-band-pi", DeadBandPI)

FILE = """
schema = 1
[controller]
kind = "dead-band-pi"
period = "50 ms"
output = ["0 A", "0.5 A"]
leak = 0.999
[gains]
kp = "150 A/m"
ki = "60 A/m/s"
dead_band = "20 um"
[reference]
kind = "step"
duration = "6 s"
high = "2 mm"
[tune]
objective = { tracking = 1 }
starts = 1
free = ["kp", "ki"]
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The controller tuned on a small rig."""
    path = tmp_path_factory.mktemp("own") / "controller.toml"
    path.write_text(FILE)
    rig = read_rig(RIG)
    return tune_controller(rig, read_controller(path, rig), seed=1)


def commands_of(controller, references, values):
    """Commands after rest at the first reference and value."""

    def sample(state, row):
        return controller.step(state, *row)

    first = controller.reset(jnp.asarray(references[0]), jnp.asarray(values[0]))
    return np.asarray(jax.lax.scan(sample, first, (jnp.asarray(references), jnp.asarray(values)))[1])


def series():
    return 2e-3 + 1e-4 * np.cumsum(np.random.default_rng(0).standard_normal((2, 200)), axis=1)


@pytest.mark.slow
def test_it_is_tuned_from_its_file(study):
    controller = study.tuned.loop.controller
    assert isinstance(controller, DeadBandPI) and controller.leak == 0.999
    assert set(study.gains) == {"kp", "ki", "dead_band"} and study.gains["dead_band"] == 2e-5
    # An idle rig has an error of 2 mm.
    assert study.tuned.metrics["rmse"] < 1.5e-3 and 1.5 < study.gains["kp"] < 15000.0 and study.gains["kp"] != 150.0
    assert not study.tuned.unstable and not study.margins.unstable and study.rollouts > 1


def check_in_c(tmp_path, controller, text):
    """Compile a C header, and compare its commands with those of the controller."""
    (tmp_path / "controller.h").write_text(text)
    (tmp_path / "c.c").write_text(
        '#include "controller.h"\nvoid run(int n, const double *r, const double *y, double *u) {\n'
        "    smajax_state s; smajax_reset(&s, r[0], y[0]);\n"
        "    for (int k = 0; k < n; k++) u[k] = smajax_step(&s, r[k], y[k]);\n}\n"
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", "c.so", "c.c", "-lm"], cwd=tmp_path, check=True)
    (r, y), u = series(), np.empty(200)
    pointer = ctypes.POINTER(ctypes.c_double)
    ctypes.CDLL(str(tmp_path / "c.so")).run(200, *(a.ctypes.data_as(pointer) for a in (r, y, u)))
    np.testing.assert_allclose(u, commands_of(controller, r, y), rtol=1e-12, atol=1e-15)
    assert np.ptp(u) > 1e-3


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
def test_its_c_header_does_the_same(tmp_path, study):
    text = export_files(study).contents["controller.h"].decode()
    assert "#define SMAJAX_DEAD_BAND ((smajax_real)2e-05)" in text and "#define SMAJAX_LEAK" in text
    check_in_c(tmp_path, study.tuned.loop.controller, text)


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
def test_a_static_number_on_which_python_branches_is_a_literal_in_c(tmp_path):
    class Branching(DeadBandPI):
        """PI controller with or without a leak."""

        def step(self, state, reference, value):
            state, command = super().step(state, reference, value)
            return state, command if self.leak == 1.0 else 0.5 * command

    branching = Branching(*map(jnp.asarray, (150.0, 60.0, 2e-5, -0.5, 0.5)), period=PERIOD)
    text = c_header(ClosedLoop(branching, channel="displacement"), ("A", "m"), "0")
    assert text.count("SMAJAX_PERIOD") > 2 and "SMAJAX_LEAK" not in text
    check_in_c(tmp_path, branching, text)


@pytest.mark.slow
def test_its_fmu_does_the_same(tmp_path, study):
    pytest.importorskip("fmpy")
    exports = export_files(study)
    assert not exports.missing and set(exports.contents) == {
        "controller.json",
        "controller.h",
        "plant.fmu",
        "controller.fmu",
    }
    (tmp_path / "controller.fmu").write_bytes(exports.contents["controller.fmu"])
    r, y = series()
    np.savez(tmp_path / "samples.npz", r=r, y=y, period=PERIOD)
    program = (
        "import sys; from pathlib import Path; import numpy as np; from tests.support.fmu_master import Unit\n"
        "folder = Path(sys.argv[1]); inputs = np.load(folder / 'samples.npz'); rows = []\n"
        "unit = Unit(folder / 'controller.fmu', reference=inputs['r'][0], measurement=inputs['y'][0])\n"
        "for r, y in zip(inputs['r'], inputs['y']):\n"
        "    unit.set(reference=r, measurement=y); unit.step(float(inputs['period'])); rows.append(unit.get('command')[0])\n"
        "np.save(folder / 'commands.npy', rows)\n"
    )
    subprocess.run([sys.executable, "-c", program, str(tmp_path)], cwd=ROOT, check=True)
    expected = commands_of(study.tuned.loop.controller, r, y)
    np.testing.assert_allclose(np.load(tmp_path / "commands.npy"), expected, rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_its_document_has_kind_gains_constants_and_state(study):
    document = json.loads(export_files(study).contents["controller.json"])
    assert document["kind"] == "dead-band-pi" and document["period_s"] == PERIOD and document["output"] == [0.0, 0.5]
    assert document["gains"]["kp"] == {"value": study.gains["kp"], "unit": "A/m"}
    assert document["constants"] == {"leak": 0.999} and document["state"] == ["integral"]


def small(**options) -> DeadBandPI:
    return DeadBandPI(*map(jnp.asarray, (30.0, 10.0, 0.0, 0.0, 0.5)), period=PERIOD, **options)


def test_a_class_that_is_not_registered_has_its_own_name():
    class Other(DeadBandPI):
        pass

    other = Other(*map(jnp.asarray, (30.0, 10.0, 0.0, 0.0, 0.5)), period=PERIOD)
    units = {name: unit_of(name, other, "A", "m") for name in gains(other)}
    assert units == {"kp": "A/m", "ki": "A/m/s", "dead_band": "m"}
    assert controller_document(other, units)["kind"] == "Other"
    with pytest.raises(InputError, match="the gain 'dead_band' has no unit"):
        controller_document(other, {"kp": "A/m", "ki": "A/m/s"})


def test_an_operation_that_c_cannot_do_is_named():
    class Sorting(DeadBandPI):
        def step(self, state, reference, value):
            return state, jnp.sort(jnp.stack([reference, value]))[0]

    sorting = Sorting(*map(jnp.asarray, (30.0, 10.0, 0.0, 0.0, 0.5)), period=PERIOD)
    with pytest.raises(InputError, match="the operation 'sort' cannot be written in C yet: leave out the part"):
        c_header(ClosedLoop(sorting, channel="displacement"), ("A", "m"), "0")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("leak = 0.999", "leek = 0.999"), "controller.leek is not known"),
        (("leak = 0.999", 'derivative_on = "value"'), "controller.derivative_on belongs to kind = "),
        (("leak = 0.999", 'leak = "much"'), "controller.leak = 'much' is not possible: give a value like 1.0"),
        (('kind = "dead-band-pi"', 'kind = "dead-band"'), "'dead-band' is not known .did you mean 'dead-band-pi'"),
        (
            ('kp = "150 A/m"\nki = "60 A/m/s"\n', ""),
            "tune: kp starts at 0 A/m and is to be tuned between 0 and 0: start above 0",
        ),
    ],
)
def test_a_mistake_in_its_file_is_one_sentence(tmp_path, change, sentence):
    text = FILE if "leak" in change[0] else FILE.replace("leak = 0.999\n", "")
    (tmp_path / "c.toml").write_text(text.replace(*change))
    with pytest.raises(InputError, match=sentence):
        read_controller(tmp_path / "c.toml", read_rig(RIG))


class Stepped(DeadBandPI):
    """PI controller whose option has no default."""

    levels: int = eqx.field(static=True, kw_only=True)


class Named(DeadBandPI):
    """PI controller with an option that has the name of a key."""

    channel: str = eqx.field(static=True, kw_only=True, default="fast")


@pytest.mark.parametrize(
    ("cls", "sentence"),
    [
        (Stepped, "controller.levels is missing: own-options needs a line like levels = "),
        (Named, "'own-options': its option 'channel' has the name of another key of .controller.: rename the field"),
    ],
)
def test_options_that_a_file_cannot_give_are_named(tmp_path, cls, sentence):
    (tmp_path / "c.toml").write_text(FILE.replace("dead-band-pi", "own-options"))
    register_controller("own-options", cls)
    try:
        with pytest.raises(InputError, match=sentence):
            read_controller(tmp_path / "c.toml", read_rig(RIG))
    finally:
        CONTROLLERS.unregister("own-options")


@pytest.mark.parametrize(
    ("state", "result", "sentence"),
    [
        (0.0, lambda state: state, "step has to return two things: write return state, command"),
        (
            0.0,
            lambda state: ((state, state), 0.1),
            r"one of shapes \(\(\), \(\)\) in place of one of shapes \(\): make",
        ),
        (np.zeros(2), lambda state: (jnp.zeros(3), 0.1), r"one of shapes \(3,\) in place of one of shapes \(2,\)"),
        ("off", lambda state: (state, 0.1), "reset returns a state with a str: give numbers, flags or arrays"),
        (0.0, lambda state: (state, jnp.zeros(1)), r"step returns a command of shape \(1,\): return one number"),
        (0.0, lambda state: (state, None), "step returns None: return one number as the command"),
    ],
)
def test_what_a_controller_returns_is_checked_in_words(state, result, sentence):
    class Wrong(DeadBandPI):
        def reset(self, reference, value):
            return state

        def step(self, state, reference, value):
            return result(state)

    with pytest.raises(InputError, match=f"^Wrong: .*{sentence}"):
        ClosedLoop(Wrong(1.0, 1.0, 0.0, period=PERIOD), channel="displacement")
