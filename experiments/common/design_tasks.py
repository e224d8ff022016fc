"""Twelve design tasks, and the exact simulator of a design (tests/reference), which shares no code with smajax."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from experiments.common.base import ROOT
from experiments.common.reference import reference_material

import numpy as np

from smajax import parameters
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from tests.reference import rigs
from tests.reference.wire import Heat, Wire

_RECORDINGS = ROOT / "data" / "recordings"
_AMBIENT = 'vary = { "environment.ambient" = "3 K" }'
_LENGTHS = 'wire.length = ["150 mm", "500 mm"]'
_CURRENT = 'input.amplitude = { from = "0.15 A", to = "3 A", scale = "log" }'
_VOLTAGE = 'input.amplitude = { from = "0.8 V", to = "12 V", scale = "log" }'
_SPRING = 'spring.stiffness = ["0.1 N/mm", "1 N/mm"]\nspring.preload = ["1 N", "4 N"]'
_PULLEY = 'wire.prestrain = ["1 %", "3 %"]\npulley.radius = ["10 mm", "30 mm"]\nwire.length = ["300 mm", "600 mm"]'


class DesignTask(NamedTuple):
    """A design task.

    Attributes:
        title: What is asked for.
        rig: Folder of the rig in data/recordings.
        axes: Lines of [parameters].
        frequency: Frequency of the input.
        goal: Line of [objectives].
        constraints: Lines of [constraints].
        margin: Line of [margins].
        wave: Shape of the input.
        changes: Replacements in the text of the rig file.
    """

    title: str
    rig: str
    axes: str
    frequency: str
    goal: str
    constraints: str
    margin: str = _AMBIENT
    wave: str = "square"
    changes: tuple[tuple[str, str], ...] = ()

    def rig_text(self) -> str:
        """Return the text of the rig file."""
        text = (_RECORDINGS / self.rig / "rig.toml").read_text("utf-8")
        for old, new in self.changes:
            text = text.replace(old, new)
        return text

    def sweep_text(self, designs: int) -> str:
        """Return the text of the sweep file.

        Args:
            designs: Number of designs that are sampled.
        """
        amplitude = "2 V" if self.rig == "bias-spring" else "0.5 A"
        return f"""
[sweep]
rig = "rig.toml"
designs = {designs}
limits = "flexinol"
sensitivity = false
[parameters]
{self.axes}
[input]
wave = "{self.wave}"
amplitude = "{amplitude}"
frequency = "{self.frequency}"
cycles = 3
[objectives]
{self.goal}
[constraints]
{self.constraints}
[margins]
{self.margin}
[refine]
starts = 3
"""


def _mass(mass: str) -> tuple[tuple[str, str], ...]:
    return (('mass = "0.2 kg"', f'mass = "{mass}"'),)


_DIAMETERS = 'wire.diameter = ["0.1 mm", "0.4 mm"]'
_STOCK = 'wire.diameter = { catalogue = "smartflex", from = "0.1 mm", to = "0.4 mm" }'
_HOT = 'peak_temperature = { at_most = "110 degC" }'
TASKS = (
    DesignTask(
        "500 g by 8 mm at 0.3 Hz, least energy",
        "dead-weight",
        f"{_DIAMETERS}\n{_LENGTHS}\n{_CURRENT}",
        "0.3 Hz",
        'energy_per_cycle = "min"',
        f'stroke = {{ at_least = "8 mm" }}\n{_HOT}',
        changes=_mass("0.5 kg"),
    ),
    DesignTask(
        "200 g at 0.1 Hz, largest stroke of at most 250 mm of wire",
        "dead-weight",
        f'{_DIAMETERS}\nwire.length = ["100 mm", "250 mm"]\n{_CURRENT}',
        "0.1 Hz",
        'stroke = "max"',
        _HOT,
    ),
    DesignTask(
        "5 mm at 0.2 Hz, best efficiency over the weight",
        "dead-weight",
        f'{_DIAMETERS}\n{_LENGTHS}\nload.mass = ["0.1 kg", "1 kg"]\n{_CURRENT}',
        "0.2 Hz",
        'efficiency = "max"',
        f'stroke = {{ at_least = "5 mm" }}\n{_HOT}',
    ),
    DesignTask(
        "200 g by 6 mm at 0.2 Hz with a stock wire, least energy",
        "dead-weight",
        f"{_STOCK}\n{_LENGTHS}\n{_CURRENT}",
        "0.2 Hz",
        'energy_per_cycle = "min"',
        f'stroke = {{ at_least = "6 mm" }}\n{_HOT}',
    ),
    DesignTask(
        "500 g by 8 mm at 0.3 Hz over the duty, least energy",
        "dead-weight",
        f'{_DIAMETERS}\n{_LENGTHS}\n{_CURRENT}\ninput.duty = ["0.1", "0.6"]',
        "0.3 Hz",
        'energy_per_cycle = "min"',
        f'stroke = {{ at_least = "8 mm" }}\n{_HOT}',
        changes=_mass("0.5 kg"),
    ),
    DesignTask(
        "200 g by 6 mm at 0.1 Hz, lowest peak temperature with a triangle and an offset",
        "dead-weight",
        f'{_DIAMETERS}\n{_LENGTHS}\n{_CURRENT}\ninput.offset = ["0 A", "0.1 A"]',
        "0.1 Hz",
        'peak_temperature = "min"',
        'stroke = { at_least = "6 mm" }',
        wave="triangle",
    ),
    DesignTask(
        "4 mm against a spring at 0.2 Hz, least energy",
        "bias-spring",
        f"{_DIAMETERS}\n{_LENGTHS}\n{_SPRING}\n{_VOLTAGE}",
        "0.2 Hz",
        'energy_per_cycle = "min"',
        f'stroke = {{ at_least = "4 mm" }}\n{_HOT}',
    ),
    DesignTask(
        "most work against a spring at 0.2 Hz with at most 250 mm of wire",
        "bias-spring",
        f'wire.diameter = ["0.1 mm", "0.25 mm"]\nwire.length = ["100 mm", "250 mm"]\n{_SPRING}\n{_VOLTAGE}',
        "0.2 Hz",
        'work_per_cycle = "max"',
        _HOT,
    ),
    DesignTask(
        "4 mm against a spring at 0.2 Hz with a stock wire, least energy",
        "bias-spring",
        f"{_STOCK}\n{_LENGTHS}\n{_SPRING}\n{_VOLTAGE}",
        "0.2 Hz",
        'energy_per_cycle = "min"',
        f'stroke = {{ at_least = "4 mm" }}\n{_HOT}',
    ),
    DesignTask(
        "largest angle of a pulley at 0.2 Hz",
        "rotary",
        f'wire.diameter = ["0.15 mm", "0.3 mm"]\n{_PULLEY}\n{_CURRENT}',
        "0.2 Hz",
        'stroke = "max"',
        _HOT,
    ),
    DesignTask(
        "30 degrees of a pulley at 0.2 Hz, least energy",
        "rotary",
        f'wire.diameter = ["0.15 mm", "0.3 mm"]\n{_PULLEY}\n{_CURRENT}',
        "0.2 Hz",
        'energy_per_cycle = "min"',
        f'stroke = {{ at_least = "30 deg" }}\n{_HOT}',
    ),
    DesignTask(
        "20 degrees of a pulley at 0.3 Hz with a stock wire of +-3 um in diameter, lowest peak temperature",
        "rotary",
        f"{_STOCK}\n{_PULLEY}\n{_CURRENT}",
        "0.3 Hz",
        'peak_temperature = "min"',
        'stroke = { at_least = "20 deg" }',
        margin='vary = { "wire.diameter" = "0.003 mm", "environment.ambient" = "2 K" }',
    ),
)


def exact_metrics(
    plant: Plant, recording: Recording, interpolation: str, cycles: int, substeps: int
) -> dict[str, float]:
    """Return the metrics of the last cycle of a design by the exact simulator.

    Args:
        plant: The plant of the design.
        recording: Its input.
        interpolation: Interpolation of the input between rows.
        cycles: Number of cycles of the recording.
        substeps: Number of steps of the simulator from row to row.
    """
    heat = Heat(
        *(float(getattr(plant.heat, key)) for key in ("h0", "h1", "h2")),
        2.0,
        float(plant.heat.capacity_austenite),
        float(plant.heat.capacity_martensite),
        0.0,
    )
    wire = Wire(*(float(getattr(plant.wire, key)) for key in ("diameter", "length", "prestrain")), _ambient(plant))
    control = plant.drive.control
    names = [name for name in recording.channels if name.startswith(control)]
    signal = np.column_stack([recording.channels[name] for name in names])
    common = {"control": control, "interpolation": interpolation, "substeps": substeps}
    material = reference_material(plant)
    values = {n: float(parameters.get(plant, n)) for n in parameters.all_declarations(plant)}
    if len(names) == 2:
        run = rigs.rotary(material, heat, wire, values["pulley.radius"], recording.time, signal, **common)
    elif "spring.stiffness" in values:
        ends = values["spring.stiffness"], values["spring.preload"]
        run = rigs.bias_spring(material, heat, wire, *ends, recording.time, signal[:, 0], **common)
    else:
        run = rigs.dead_weight(material, heat, wire, values["load.mass"], recording.time, signal[:, 0], **common)
    return _metrics_of_run(run, recording, signal, common, cycles, wire)


def _metrics_of_run(
    run: rigs.Run, recording: Recording, signal: np.ndarray, settings: Mapping[str, Any], cycles: int, wire: Wire
) -> dict[str, float]:
    """Metrics of the last cycle of an exact response; ``settings`` are those of the simulator."""
    start = recording.time[-1] * (1.0 - 1.0 / cycles)
    cycle = recording.time >= start - 1e-9 * recording.time[-1]
    durations = np.diff(recording.time[cycle])[:, None]
    # A held input jumps at a row, but the resistance does not: its mean over a step is exact to second order.
    resistance = run.resistance[cycle]
    mean = 0.5 * (resistance[1:] + resistance[:-1])
    held = np.reshape(signal, (len(recording.time), -1))[cycle][:-1]
    if settings["interpolation"] == "hold":
        power = held**2 * mean if settings["control"] == "current" else held**2 / mean
    else:
        at_rows = (run.current * run.voltage)[cycle]
        power = 0.5 * (at_rows[1:] + at_rows[:-1])
    energy = float(np.sum(power * durations))
    pull = run.stress[cycle] * np.pi / 4.0 * wire.diameter**2
    shortened = -np.diff(run.strain[cycle], axis=0) * wire.length
    work = float(np.sum(np.maximum(0.5 * (pull[1:] + pull[:-1]) * shortened, 0.0)))
    return {
        "stroke": float(np.ptp(run.position[cycle])),
        "peak_temperature": float(run.temperature.max()),
        "peak_stress": float(run.stress.max()),
        "strain_range": float(np.max(np.ptp(run.strain[cycle], axis=0))),
        "energy_per_cycle": energy,
        "work_per_cycle": work,
        "efficiency": work / energy,
    }


def _ambient(plant: Plant) -> float:
    return float(plant.environment.ambient)


def exact_with_margins(
    plant: Plant,
    recording: Recording,
    interpolation: str,
    cycles: int,
    scenarios: list[Mapping[str, float]],
    substeps: int,
) -> list[dict[str, float]]:
    """Return the exact metrics of a design with deviations of some parameters.

    Args:
        plant: The plant of the design.
        recording: Its input.
        interpolation: Interpolation of the input between rows.
        cycles: Number of cycles of the recording.
        scenarios: Deviations by parameter, in internal units.
        substeps: Number of steps of the simulator from row to row.
    """
    results = []
    for deviations in scenarios:
        values = {name: float(parameters.get(plant, name)) + shift for name, shift in deviations.items()}
        changed = parameters.replace(plant, values)
        results.append(exact_metrics(changed, recording, interpolation, cycles, substeps))
    return results
