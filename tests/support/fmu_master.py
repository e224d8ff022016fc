"""Co-simulation of the FMUs of a plant and a controller with fmpy, in a process without JAX; used by test_fmu.py.

    python fmu_master.py FOLDER

reads FOLDER/plant.fmu, controller.fmu and wanted.npz, and writes FOLDER/found.npz.
"""

import sys
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.validation import validate_fmu


class Unit:
    """An FMU with its variables by name."""

    def __init__(self, path: Path, **start: float):
        self.description = fmpy.read_model_description(str(path))
        self.places = {v.name: v.valueReference for v in self.description.modelVariables}
        self.slave = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.slave.instantiate()
        self.begin(**start)

    def begin(self, **start: float) -> None:
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.set(**start)
        self.slave.exitInitializationMode()
        self.time = 0.0

    def set(self, **values: float) -> None:
        self.slave.setReal([self.places[n.replace("__", ".")] for n in values], [float(v) for v in values.values()])

    def get(self, *names: str) -> list[float]:
        return self.slave.getReal([self.places[n] for n in names])

    def step(self, duration: float) -> None:
        self.slave.doStep(self.time, duration)
        self.time += duration


def closed(plant: Unit, controller: Unit, reference: np.ndarray, period: float, pieces: int) -> np.ndarray:
    """Return displacement, temperature and command at the samples; a period has ``pieces`` communication steps."""
    rows = []
    for setpoint in reference:
        value, warm = plant.get("displacement", "temperature")
        for piece in range(pieces):
            controller.set(reference=setpoint, measurement=plant.get("displacement")[0])
            controller.step(period / pieces)
            (command,) = controller.get("command")
            if piece == 0:
                rows.append((value, warm, command))
            plant.set(command=command)
            plant.step(period / pieces)
    return np.array(rows)


def main(folder: Path) -> None:
    inputs = np.load(folder / "wanted.npz")
    period, reference = float(inputs["period"]), inputs["reference"]
    results: dict[str, np.ndarray] = {}
    problems = [p for name in ("plant", "controller") for p in validate_fmu(str(folder / f"{name}.fmu"))]
    assert not problems, problems

    table = np.array(list(zip(inputs["time"], inputs["current"], strict=True)), [("time", float), ("command", float)])
    alone = fmpy.simulate_fmu(
        str(folder / "plant.fmu"),
        stop_time=float(inputs["time"][-1]),
        output_interval=period,
        step_size=period,
        input=table,
    )
    results["alone"] = np.column_stack([alone[n] for n in ("displacement", "temperature", "resistance")])

    controller, rows = Unit(folder / "controller.fmu", reference=0.0, measurement=0.0), []
    for r, y in inputs["samples"]:
        controller.set(reference=r, measurement=y)
        controller.step(period)
        rows.append(controller.get("command")[0])
    results["commands"] = np.array(rows)
    controller.slave.reset()
    controller.begin(reference=2e-3, measurement=0.0)
    controller.set(kp=3.0, ki=10.0, kd=0.0)
    controller.step(2.5 * period)
    results["gains"] = np.array(controller.get("command"))
    controller.slave.reset()
    controller.begin(reference=0.0, measurement=0.0)

    plant = Unit(folder / "plant.fmu")
    results["closed"] = closed(plant, controller, reference, period, 1)
    plant.set(command=0.3)
    state = plant.slave.getFMUState()
    ends = []
    for _ in range(2):
        plant.slave.setFMUState(state)
        plant.step(period)
        ends.append(plant.get("displacement", "temperature"))
    results["twice"] = np.array(ends)
    fine = Unit(folder / "plant.fmu"), Unit(folder / "controller.fmu", reference=0.0, measurement=0.0)
    results["fine"] = closed(*fine, reference, period, 4)
    warm = Unit(folder / "plant.fmu", environment__ambient=30.0, load__mass=0.3)
    again = Unit(folder / "controller.fmu", reference=0.0, measurement=warm.get("displacement")[0])
    results["other"] = closed(warm, again, reference, period, 1)
    results["start"] = np.array(
        Unit(folder / "plant.fmu").get("environment.ambient", "load.mass", "displacement", "power")
    )
    assert not {"jax", "equinox", "smajax"} & set(sys.modules), "an FMU has to run without JAX"
    np.savez(folder / "found.npz", **results)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
