"""Margins, loops and step figures against python-control."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.analysis.margins import stability_margins
from smajax.control.analysis.step_response import find_jumps, step_responses
from smajax.control.loop.rollout import Scenario, rollout
from smajax.control.sampled_plant import SampledTransferFunction
from smajax.laws.transfer_function import TransferFunction
from tests.unit.control.test_control import loop_of, pid

control = pytest.importorskip("control")

DT = 0.02
FILTER = 0.2
# Gain, damping ratio and time constant of a pair, and the gains of a PID: well damped, fast, and nearly unstable.
CASES = {
    "damped": ((3.0, 0.7, 2.0), (2.0, 0.5, 1.5)),
    "fast": ((3.0, 0.4, 2.0), (6.0, 2.0, 6.0)),
    "oscillating": ((1.0, 0.1, 0.5), (0.4, 0.3, 0.02)),
}


def transfer_functions(plant, gains):
    """Plant with held input and PID, both of the sampled loop, for python-control."""
    (gain, damping, tau), (kp, ki, kd) = plant, gains
    continuous = control.tf([gain], [tau**2, 2.0 * damping * tau, 1.0])
    z = control.tf([1.0, 0.0], [1.0], DT)
    controller = kp + ki * DT * z / (z - 1.0) + kd * (z - 1.0) / ((FILTER + DT) * z - FILTER)
    return control.c2d(continuous, DT, "zoh"), controller


def sampled_loop(plant, gains):
    (gain, damping, tau), (kp, ki, kd) = plant, gains
    values = map(jnp.asarray, (gain, 0.0, tau, 1.0, damping, 0.0))
    system = SampledTransferFunction.of(TransferFunction(*values, structure="underdamped"), "angle", DT)
    return system, loop_of(pid(kp, ki, kd, tf=FILTER, low=-1e9, high=1e9, dt=DT))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_margins(case):
    plant, controller = transfer_functions(*CASES[case])
    system, loop = sampled_loop(*CASES[case])
    margins = stability_margins(system, loop, Scenario.noiseless(np.ones(4000)))
    response = control.frd(controller * plant, np.geomspace(1e-3, 0.999 * np.pi / DT, 20_000))
    gain, phase, distance = control.stability_margins(response)[:3]
    # Ours take the nearest of their frequencies; near a sharp resonance the phase changes most between two of them.
    assert margins.phase == pytest.approx(phase, abs=2.5 if case == "oscillating" else 0.5)
    assert margins.sensitivity == pytest.approx(1.0 / distance, rel=0.03)
    assert margins.gain == pytest.approx(gain, rel=0.02)


@pytest.mark.parametrize("case", CASES)
def test_closed_loop_and_its_step_figures(case):
    plant, controller = transfer_functions(*CASES[case])
    count = 6000
    time = DT * np.arange(count)
    expected = control.step_response(control.feedback(controller * plant, 1), time).outputs
    scenario = Scenario.noiseless(np.ones(count))
    value = np.asarray(eqx.filter_jit(rollout)(*sampled_loop(*CASES[case]), scenario).channels["angle"])
    np.testing.assert_allclose(value, expected, atol=1e-8)
    reference = np.asarray(scenario.reference)
    (response,) = step_responses(value, reference, find_jumps(reference, 0.0, DT), DT)
    info = control.step_info(expected, time, SettlingTimeThreshold=0.02, yfinal=1.0)
    # python-control takes the nearest sample, and ours interpolate.
    assert response.rise == pytest.approx(info["RiseTime"], abs=DT)
    assert response.settling == pytest.approx(info["SettlingTime"], abs=DT)
    assert 100.0 * response.overshoot == pytest.approx(info["Overshoot"], abs=1e-6)
