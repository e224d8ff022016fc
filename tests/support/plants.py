"""Plants and recordings that several tests use, with explicit parameters."""

from collections.abc import Callable

import numpy as np

from smajax.channels import CHANNELS, channel_of
from smajax.plant.convection import PolynomialConvection, PowerLawConvection
from smajax.plant.drive import CurrentDrive, DutyDrive, NoDrive, PowerDrive, VoltageDrive
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.materials.brinson import Brinson
from smajax.plant.mechanisms.bias_spring import BiasSpring, Spring
from smajax.plant.mechanisms.dead_weight import DeadWeight, Load
from smajax.plant.mechanisms.limb import Limb, TendonLimb, Transmission
from smajax.plant.mechanisms.pulley import Pulley
from smajax.plant.mechanisms.rotary import MasslessRotary, Rotary
from smajax.plant.mechanisms.sheath import Sheath
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine
from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor
from smajax.plant.wire import Initial, Wire
from smajax.recordings.recording import Recording

MATERIAL = {
    "martensite_start": 50.0,
    "martensite_finish": 36.0,
    "austenite_start": 64.0,
    "austenite_finish": 80.0,
    "clausius_clapeyron_austenite": 6.73e6,
    "clausius_clapeyron_martensite": 6.32e6,
    "modulus_austenite": 31.5e9,
    "modulus_martensite": 20e9,
    "resistivity_austenite": 1.0e-6,
    "resistivity_martensite": 0.8e-6,
    "detwinning_start_stress": 25e6,
    "detwinning_finish_stress": 105e6,
    "max_transformation_strain": 0.041,
    "thermal_expansion_austenite": 11e-6,
    "thermal_expansion_martensite": 6.6e-6,
}
# fast_rotary_actuator, table 1.
ROTARY_PAPER = MATERIAL | {
    "martensite_start": 48.4,
    "martensite_finish": 43.9,
    "austenite_start": 68.0,
    "austenite_finish": 73.8,
    "detwinning_finish_stress": 78e6,
    "thermal_expansion_austenite": 0.0,
    "thermal_expansion_martensite": 0.0,
}
HEAT = {"h0": 100.6, "h2": 0.001, "capacity_austenite": 2.046e6, "capacity_martensite": 2.046e6}


def _plant(mechanism, wire: Wire, drive, heat=None, material=None, initial: Initial | None = None) -> Plant:
    channels = (mechanism.coordinate, "stress") if mechanism.wires == 1 else (mechanism.coordinate,)
    return Plant(
        wire=wire,
        initial=initial or Initial(),
        drive=drive,
        heat=heat or PolynomialConvection(**HEAT),
        material=Brinson(**(material or MATERIAL)),
        mechanism=mechanism,
        sensor=Sensor.identity(channels),
    )


def dead_weight(**material: float) -> Plant:
    return _plant(DeadWeight(Load(0.2)), Wire(0.15e-3, 0.23), CurrentDrive(), material=MATERIAL | material)


def bias_spring(drive=None) -> Plant:
    return _plant(BiasSpring(Spring(300.0, 2.0)), Wire(0.15e-3, 0.23), drive or VoltageDrive())


def testing_machine(heat=None) -> Plant:
    heat = heat or PowerLawConvection(
        h0=60.0, exponent=1.5, h2=0.05, capacity_austenite=2.2e6, capacity_martensite=1.9e6
    )
    return _plant(TestingMachine(), Wire(0.4e-3, 0.1, 0.002), PowerDrive(), heat)


def stress_path() -> Plant:
    return _plant(StressPath(), Wire(1e-3, 1.0), NoDrive(), PrescribedTemperature())


def strain_path() -> Plant:
    return _plant(TestingMachine(), Wire(1e-3, 1.0), NoDrive(), PrescribedTemperature())


def light_rotary(**material: float) -> Plant:
    expansion = {"thermal_expansion_austenite": 0.0, "thermal_expansion_martensite": 0.0}
    return _plant(
        MasslessRotary(Pulley(0.02)), Wire(0.2e-3, 0.5, 0.02), CurrentDrive(), material=MATERIAL | expansion | material
    )


def rotary(inertia: float = 1e-5, damping: float = 1e-3) -> Plant:
    return _plant(
        Rotary(Pulley(0.02, inertia, damping)), Wire(0.2e-3, 0.5, 0.02), CurrentDrive(), material=ROTARY_PAPER
    )


def limb(sheathed: bool = True) -> Plant:
    """Return a forearm with thin wires, which heat and cool within seconds."""
    sheath = Sheath(0.07, 2.5, 3.0, 1.5) if sheathed else None
    mechanism = TendonLimb(Limb(0.12, 0.15, 0.3, 0.05, 0.02), Pulley(0.03, 0.004, 0.1), Transmission(2.0, 1.5), sheath)
    return _plant(mechanism, Wire(0.2e-3, 0.5, 0.041), CurrentDrive())


def duty_spring() -> Plant:
    return bias_spring(DutyDrive(supply=5.0, lead_resistance=0.3))


def recording(channels: dict[str, np.ndarray], time: np.ndarray | None = None, name: str = "made.csv") -> Recording:
    count = len(next(iter(channels.values())))
    units = {c: CHANNELS[channel_of(c) or c].unit for c in channels}
    return Recording(
        name, np.arange(count, dtype=float) if time is None else time, channels, units, "0" * 64, time is not None, ()
    )


def pulses(rows: int, low: float, high: float, *, seed: int = 0) -> np.ndarray:
    """Return ten random levels, every third of them zero, which make partial loops of all sizes."""
    levels = np.random.default_rng(seed).uniform(low, high, 10)
    levels[0], levels[1::3] = high, 0.0
    return np.repeat(levels, -(-rows // 10))[:rows]


def inputs(kind: str, rows: int = 600, step: float = 0.05) -> Recording:
    """Return inputs that exercise every branch of a kind of rig; the observed channels are zero."""
    time = np.arange(rows) * step
    zero = np.zeros(rows)
    if kind == "dead_weight":
        return recording({"current": pulses(rows, 0.0, 0.33), "displacement": zero}, time)
    if kind == "bias_spring":
        return recording({"voltage": pulses(rows, 0.0, 3.4), "displacement": zero, "stress": zero}, time)
    if kind == "duty_spring":
        return recording({"duty": pulses(rows, 0.0, 0.8), "displacement": zero, "stress": zero}, time)
    if kind == "testing_machine":
        strain = 0.01 * (1 - np.cos(2 * np.pi * time / 9.0))
        return recording({"power": pulses(rows, 0.0, 2.6), "strain": strain, "stress": zero}, time)
    if kind == "limb":
        return recording({"current": pulses(rows, 0.0, 0.75), "angle": zero}, time)
    if kind == "stress_path":
        phase = np.linspace(0, 6 * np.pi, rows)
        return recording({"temperature": 75 - 55 * np.cos(phase), "stress": 1e6 * (80 + 10 * phase), "strain": zero})
    if kind == "strain_path":
        phase = np.linspace(0, 6 * np.pi, rows)
        return recording(
            {"temperature": 75 - 55 * np.cos(phase / 3), "strain": 0.02 * (1 - np.cos(phase)), "stress": zero}
        )
    first, second = pulses(rows, 0.1, 0.6), pulses(rows, 0.1, 0.6, seed=1)
    return recording({"current_1": first, "current_2": np.roll(second, rows // 20), "angle": zero}, time)


KINDS: dict[str, Callable[[], Plant]] = {
    "dead_weight": dead_weight,
    "bias_spring": bias_spring,
    "duty_spring": duty_spring,
    "limb": limb,
    "testing_machine": testing_machine,
    "stress_path": stress_path,
    "strain_path": strain_path,
    "light_rotary": light_rotary,
    "rotary": rotary,
}
