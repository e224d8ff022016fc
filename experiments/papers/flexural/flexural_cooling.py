"""How fast a flexural actuator cools, against the diameter and the number of its wires.

Figures 4 and 5 of dauksher2021.

    python experiments/papers/flexural/flexural_cooling.py [--quick] [--json FILE] [--out DIR]

Half the cross-section is cooled from the paper's start (wires at 80 degC, elastomers at 50 degC) until the hottest
wire is down at 55 degC. The paper's curves are pictures only, so that its sentences are compared, and the numbers
with an independent finite-element program (tests/reference). What the answer hinges on is told by its derivatives:
percent of cooling time for each percent of a parameter.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, medians, say
from experiments.common.charts import Chart, Curve, draw

import jax
import jax.numpy as jnp
import numpy as np
from equinox import filter_jit

from smajax import parameters
from smajax.actuators.cooling_curve import CoolingCurve
from smajax.actuators.cross_section import CrossSection
from smajax.actuators.flexural import FlexuralActuator
from smajax.actuators.section_grid import SpacedWires
from smajax.files import actuator_file
from tests.reference import cross_section as reference

TARGET, PAUSE, DURATION = 55.0, 2.0, 10.0
DIAMETERS = (100, 125, 150, 200, 250, 300, 350, 400, 450, 500)
COUNTS = (2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 25)
NAMES = {
    "wire.diameter": "diameter",
    "body.count": "count",
    "silicone.conductivity": "conductivity of the silicone",
    "wire.heat_capacity": "heat capacity of the wires",
    "silicone.heat_capacity": "heat capacity of the silicone",
    "silicone.thickness": "thickness of the silicone",
    "tape.conductivity": "conductivity of the tape",
    "cooling.convection": "convection",
}


@filter_jit
def course_of(section: CrossSection) -> tuple[CoolingCurve, jax.Array, jax.Array]:
    """The course of the cooling, when it is down at the target, and the hottest temperature after the pause."""
    course = section.cool(jnp.asarray(DURATION))
    return course, course.time_to_reach(TARGET), course.temperature_at(PAUSE)


def cooled(machine: FlexuralActuator, **values: float) -> tuple[CoolingCurve, float, float]:
    """As ``course_of``, of the machine with other values (``wire_diameter`` for ``wire.diameter``)."""
    changed = parameters.replace(machine, {name.replace("_", ".", 1): value for name, value in values.items()})
    course, seconds, later = course_of(changed.section)
    return course, float(seconds), float(later)


def elasticities(machine: FlexuralActuator) -> tuple[dict[str, float], dict[str, float]]:
    """d ln t / d ln p of the cooling time, and wall seconds of a simulation without and with all derivatives."""
    nominal = jnp.stack([parameters.get(machine, name) for name in NAMES])

    def seconds(factors: jax.Array) -> jax.Array:
        at = parameters.replace(machine, {name: factors[i] * nominal[i] for i, name in enumerate(NAMES)})
        return at.section.cool(DURATION).time_to_reach(TARGET)

    value, slopes = jax.jit(seconds), jax.jit(jax.jacfwd(seconds))
    one = jnp.ones(len(NAMES))
    walls = medians(
        5, {"value": lambda: value(one).block_until_ready(), "jacobian": lambda: slopes(one).block_until_ready()}
    )
    return dict(zip(NAMES, np.asarray(slopes(one) / value(one)).tolist(), strict=True)), walls


def cycle_rows(machine: FlexuralActuator, base: float) -> list[Row]:
    """The cooling time of two wires of 300 um, and the cycle that follows from it."""
    rows: list[Row] = []
    frequency = float(filter_jit(lambda m: m.metrics()["bandwidth"])(machine))
    rows.append(
        Row("300 um, 2 wires: time to 55 degC", "order of 1 s", f"{base:.3f} s", 0.3 < base < 3.0, {"seconds": base})
    )
    told = (
        f"{frequency:.2f} Hz: heated by 3.5 A without losses, then cooled without the latent heat, which the "
        "paper leaves out, too"
    )
    rows.append(Row("and the cycle", "did not reach 1 Hz", told, None, {"hertz": frequency}))

    return rows


def diameter_rows(machine: FlexuralActuator) -> tuple[list[Row], dict[int, float]]:
    """Cooling times against the wire's diameter, and these times (s) by diameter (um)."""
    rows: list[Row] = []
    say("diameters")
    by_diameter = {d: cooled(machine, wire_diameter=d * 1e-6)[1] for d in DIAMETERS}
    listed = ", ".join(f"{d} um {t:.3f} s" for d, t in by_diameter.items())
    rising = bool(np.all(np.diff(list(by_diameter.values())) > 0.0))
    rows.append(
        Row("time to 55 degC against diameter", "rises with the diameter", listed, rising, {"seconds": by_diameter})
    )

    return rows, by_diameter


def count_rows(machine: FlexuralActuator) -> tuple[list[Row], dict[int, tuple]]:
    """Temperatures after 2 s against the number of wires, and the courses by number."""
    rows: list[Row] = []
    say("numbers of wires")
    courses = {n: cooled(machine, body_count=float(n)) for n in COUNTS}
    later = {n: courses[n][2] for n in COUNTS}
    alike, slower = later[5] - later[2], later[25] - later[5]
    listed = ", ".join(f"{n}: {t:.2f}" for n, t in later.items())
    rows.append(
        Row(
            "degC after 2 s against wires",
            "to 5 wires as 1, beyond 5 slower",
            listed,
            alike < 0.1 < 1.0 < slower,
            {"degC": later},
        )
    )
    listed = ", ".join(f"{n}: {courses[n][1]:.3f}" for n in COUNTS)
    why = "the wires feel each other only after they are down at 55 degC, up to some 12 of them"
    rows.append(
        Row(
            "s to 55 degC against wires",
            "as above",
            f"{listed}; {why}",
            None,
            {"seconds": {n: courses[n][1] for n in COUNTS}},
        )
    )
    squeezed = dataclasses.replace(machine.section, placement=SpacedWires(25, 13e-3 / 24))
    tight = float(course_of(squeezed)[1])
    rows.append(Row("25 wires within the 13 mm of the U", "-", f"{tight:.2f} s to 55 degC", None, {"seconds": tight}))

    return rows, courses


def element_rows(machine: FlexuralActuator, quick: bool) -> list[Row]:
    """Cooling times next to those of the independent finite-element program."""
    rows: list[Row] = []
    say("finite elements")
    sections = {"300 um": {}, "500 um": {"diameter": 500e-6}}
    sections |= (
        {}
        if quick
        else {"150 um": {"diameter": 150e-6}, "10 wires": {"count": 10}, "0.1 mm off the midplane": {"offset": 1e-4}}
    )
    ours = {"diameter": "wire_diameter", "count": "body_count", "offset": "wire_offset"}
    for name, changes in sections.items():
        time, hottest = reference.cool(reference.Section(**changes), PAUSE, rings=5 if quick else 8)
        wanted = reference.cooled(time, hottest, TARGET)
        _, seconds, after = cooled(machine, **{ours[key]: value for key, value in changes.items()})
        text = f"{seconds:.4f} s, {after:.3f} degC: {100 * (seconds / wanted - 1):+.2f} %, {after - hottest[-1]:+.3f} K"
        fine = abs(seconds / wanted - 1) < 0.01 and abs(after - hottest[-1]) < 0.05
        numbers = {"seconds": seconds, "reference": wanted, "degC": after, "reference_degC": float(hottest[-1])}
        rows.append(
            Row(
                f"{name}, finite elements",
                f"{wanted:.4f} s, {hottest[-1]:.3f} degC, within 1 % and 0.05 K",
                text,
                fine,
                numbers,
            )
        )

    return rows


def grid_rows(machine: FlexuralActuator, course: Any, quick: bool) -> list[Row]:
    """Convergence with the cells across a wire, and conservation of heat."""
    rows: list[Row] = []
    say("grids")
    grids = {}
    for cells in (8, 12, 16) if quick else (8, 10, 12, 16, 24, 40):
        grids[cells] = cooled(dataclasses.replace(machine, cells=cells))[1]
    fine = [seconds for cells, seconds in grids.items() if cells >= machine.cells]
    spread = max(fine) / min(fine) - 1.0
    listed = ", ".join(f"{cells}: {seconds:.4f} s" for cells, seconds in grids.items())
    target = f"within 1 % from {machine.cells}, the default, on"
    rows.append(
        Row("cells across a wire", target, f"{listed}; {100 * spread:.2f} %", spread < 0.01, {"seconds": grids})
    )
    held = np.asarray(course.stored + course.lost)
    leak = float(np.max(np.abs(held / held[0] - 1.0)))
    rows.append(
        Row(
            "heat in the section and lost to the air, of the heat at the start",
            "all of it to 1e-6",
            f"all but {leak:.1e}",
            leak < 1e-6,
        )
    )

    return rows


def derivative_rows(machine: FlexuralActuator) -> list[Row]:
    """Elasticities of the cooling time, its dependence on the elastomers' start, and the cost of a simulation."""
    rows: list[Row] = []
    say("derivatives")
    slopes, walls = elasticities(machine)
    listed = ", ".join(f"{NAMES[name]} {slope:+.3f}" for name, slope in slopes.items())
    rows.append(Row("percent of cooling time for a percent of", "-", listed, None, {"elasticities": slopes}))
    starts = {t: cooled(machine, cooling_elastomer_start=t)[1] for t in (45.0, 50.0, 52.0)}
    hinge = (
        ", ".join(f"{t:.0f} degC: {seconds:.3f} s" for t, seconds in starts.items())
        + "; the assumed 50 degC are 5 K below the target"
    )
    rows.append(
        Row("time to 55 degC against the elastomers' temperature", "50 degC assumed", hinge, None, {"seconds": starts})
    )
    speed = (
        f"{1e3 * walls['value']:.1f} ms, with its {len(NAMES)} derivatives "
        f"{walls['jacobian'] / walls['value']:.2f} times that"
    )
    rows.append(Row("one simulation", "-", speed, None, walls))

    return rows


def pictures(by_diameter: dict[int, float], courses: dict[int, tuple], folder: Path) -> None:
    """Draw the cooling time over the diameter, the hottest wire over time, and its temperature after 2 s."""
    later = {n: courses[n][2] for n in COUNTS}
    d = list(by_diameter)
    curve = Curve("time to 55 degC", d, list(by_diameter.values()))
    draw(
        Chart("Cooling time of two wires", "wire diameter [um]", "time to 55 degC [s]", [curve]),
        folder,
        "flexural_cooling_diameter",
    )
    shown = [
        Curve(f"{n} wires", np.asarray(courses[n][0].time), np.asarray(courses[n][0].hottest)) for n in (2, 10, 15, 25)
    ]
    shown = [Curve(c.name, *(np.asarray(v)[np.asarray(c.x) <= PAUSE] for v in (c.x, c.y))) for c in shown]
    draw(
        Chart("Hottest wire of 300 um", "time [s]", "temperature [degC]", shown),
        folder,
        "flexural_cooling_course",
    )
    curve = Curve("after 2 s", list(later), list(later.values()))
    draw(
        Chart("Hottest wire of 300 um after 2 s", "number of wires", "temperature [degC]", [curve]),
        folder,
        "flexural_cooling_count",
    )


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__)
    machine = actuator_file.read_actuator(ROOT / "data" / "actuators" / "flexural" / "rig.toml")
    assert isinstance(machine, FlexuralActuator)
    course, base, _ = cooled(machine)
    rows = cycle_rows(machine, base)
    diameters, by_diameter = diameter_rows(machine)
    counts, courses = count_rows(machine)
    rows += diameters + counts
    rows += element_rows(machine, args.quick)
    rows += grid_rows(machine, course, args.quick)
    rows += derivative_rows(machine)
    if args.out:
        pictures(by_diameter, courses, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
