"""Cooling time of a flexural actuator, by diameter and number of its wires: figures 4 and 5 of dauksher2021.

    python experiments/papers/flexural/flexural_cooling.py [--quick] [--json FILE] [--out DIR]

Source: dauksher2021. Half the cross-section cools from the paper's start (wires at 80 degC, elastomers at 50 degC)
until the hottest wire is at 55 degC. The paper shows its curves only as pictures, so its statements are compared, and
the numbers are compared with an independent finite-element program (tests/reference). The elasticities show what the
cooling time depends on: percent of cooling time for each percent of a parameter.
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

from smajax import parameters
from smajax.actuators.cooling_curve import CoolingCurve
from smajax.actuators.cross_section import CrossSection
from smajax.actuators.flexural import FlexuralActuator
from smajax.actuators.section_grid import SpacedWires
from smajax.files import actuator_file
from smajax.numerics.loop_kernels import jit_with_kernels
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


@jit_with_kernels
def cool_section(section: CrossSection) -> tuple[CoolingCurve, jax.Array, jax.Array]:
    """Return the cooling curve, the time to the target (s), and the hottest temperature after the pause (degC)."""
    curve = section.cool(jnp.asarray(DURATION))
    return curve, curve.time_to_reach(TARGET), curve.temperature_at(PAUSE)


def cool_actuator(actuator: FlexuralActuator, **values: float) -> tuple[CoolingCurve, float, float]:
    """As ``cool_section``, with other values of the actuator (``wire_diameter`` for ``wire.diameter``)."""
    changed = parameters.replace(actuator, {name.replace("_", ".", 1): value for name, value in values.items()})
    curve, seconds, later = cool_section(changed.section)
    return curve, float(seconds), float(later)


def elasticities(actuator: FlexuralActuator) -> tuple[dict[str, float], dict[str, float]]:
    """Return d ln t / d ln p of the cooling time, and wall seconds of a simulation without and with all derivatives."""
    nominal = jnp.stack([parameters.get(actuator, name) for name in NAMES])

    def seconds(factors: jax.Array) -> jax.Array:
        changed = parameters.replace(actuator, {name: factors[i] * nominal[i] for i, name in enumerate(NAMES)})
        return changed.section.cool(DURATION).time_to_reach(TARGET)

    value = jit_with_kernels(seconds)
    slopes = jit_with_kernels(jax.jacfwd(seconds))
    ones = jnp.ones(len(NAMES))
    walls = medians(
        5, {"value": lambda: value(ones).block_until_ready(), "jacobian": lambda: slopes(ones).block_until_ready()}
    )
    return dict(zip(NAMES, np.asarray(slopes(ones) / value(ones)).tolist(), strict=True)), walls


def cycle_rows(actuator: FlexuralActuator, base: float) -> list[Row]:
    """Return the cooling time of two wires of 300 um, and the frequency of the cycle with it."""
    rows: list[Row] = []
    frequency = float(jit_with_kernels(lambda m: m.metrics()["bandwidth"])(actuator))
    rows.append(
        Row("300 um, 2 wires: time to 55 degC", "order of 1 s", f"{base:.3f} s", 0.3 < base < 3.0, {"seconds": base})
    )
    text = (
        f"{frequency:.2f} Hz: heated by 3.5 A without losses, then cooled without the latent heat, which the "
        "paper leaves out, too"
    )
    rows.append(Row("and the cycle", "did not reach 1 Hz", text, None, {"hertz": frequency}))

    return rows


def diameter_rows(actuator: FlexuralActuator) -> tuple[list[Row], dict[int, float]]:
    """Return the rows of the cooling time against the wire's diameter, and the times (s) by diameter (um)."""
    rows: list[Row] = []
    say("diameters")
    by_diameter = {d: cool_actuator(actuator, wire_diameter=d * 1e-6)[1] for d in DIAMETERS}
    listed = ", ".join(f"{d} um {t:.3f} s" for d, t in by_diameter.items())
    rising = bool(np.all(np.diff(list(by_diameter.values())) > 0.0))
    rows.append(
        Row("time to 55 degC against diameter", "rises with the diameter", listed, rising, {"seconds": by_diameter})
    )

    return rows, by_diameter


def count_rows(actuator: FlexuralActuator) -> tuple[list[Row], dict[int, tuple]]:
    """Return the rows of the temperature after 2 s against the number of wires, and the cooling curves by number."""
    rows: list[Row] = []
    say("numbers of wires")
    curves_by_count = {n: cool_actuator(actuator, body_count=float(n)) for n in COUNTS}
    later = {n: curves_by_count[n][2] for n in COUNTS}
    few_difference = later[5] - later[2]
    many_difference = later[25] - later[5]
    listed = ", ".join(f"{n}: {t:.2f}" for n, t in later.items())
    rows.append(
        Row(
            "degC after 2 s against wires",
            "to 5 wires as 1, beyond 5 slower",
            listed,
            few_difference < 0.1 < 1.0 < many_difference,
            {"degC": later},
        )
    )
    listed = ", ".join(f"{n}: {curves_by_count[n][1]:.3f}" for n in COUNTS)
    explanation = "the wires feel each other only after they are down at 55 degC, up to some 12 of them"
    rows.append(
        Row(
            "s to 55 degC against wires",
            "as above",
            f"{listed}; {explanation}",
            None,
            {"seconds": {n: curves_by_count[n][1] for n in COUNTS}},
        )
    )
    narrow = dataclasses.replace(actuator.section, placement=SpacedWires(25, 13e-3 / 24))
    narrow_seconds = float(cool_section(narrow)[1])
    rows.append(
        Row(
            "25 wires within the 13 mm of the U",
            "-",
            f"{narrow_seconds:.2f} s to 55 degC",
            None,
            {"seconds": narrow_seconds},
        )
    )

    return rows, curves_by_count


def element_rows(actuator: FlexuralActuator, quick: bool) -> list[Row]:
    """Compare cooling times with those of the independent finite-element program."""
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
        expected = reference.cooled(time, hottest, TARGET)
        _, seconds, after = cool_actuator(actuator, **{ours[key]: value for key, value in changes.items()})
        text = (
            f"{seconds:.4f} s, {after:.3f} degC: {100 * (seconds / expected - 1):+.2f} %, {after - hottest[-1]:+.3f} K"
        )
        is_close = abs(seconds / expected - 1) < 0.01 and abs(after - hottest[-1]) < 0.05
        numbers = {"seconds": seconds, "reference": expected, "degC": after, "reference_degC": float(hottest[-1])}
        rows.append(
            Row(
                f"{name}, finite elements",
                f"{expected:.4f} s, {hottest[-1]:.3f} degC, within 1 % and 0.05 K",
                text,
                is_close,
                numbers,
            )
        )

    return rows


def grid_rows(actuator: FlexuralActuator, curve: Any, quick: bool) -> list[Row]:
    """Check convergence with the number of cells across a wire, and conservation of heat.

    Args:
        actuator: The actuator.
        curve: Its cooling curve.
        quick: Fewer grids.
    """
    rows: list[Row] = []
    say("grids")
    grids = {}
    for cells in (8, 12, 16) if quick else (8, 10, 12, 16, 24, 40):
        grids[cells] = cool_actuator(dataclasses.replace(actuator, cells=cells))[1]
    fine = [seconds for cells, seconds in grids.items() if cells >= actuator.cells]
    spread = max(fine) / min(fine) - 1.0
    listed = ", ".join(f"{cells}: {seconds:.4f} s" for cells, seconds in grids.items())
    target = f"within 1 % from {actuator.cells}, the default, on"
    rows.append(
        Row("cells across a wire", target, f"{listed}; {100 * spread:.2f} %", spread < 0.01, {"seconds": grids})
    )
    heat = np.asarray(curve.stored + curve.lost)
    leak = float(np.max(np.abs(heat / heat[0] - 1.0)))
    rows.append(
        Row(
            "heat in the section and lost to the air, of the heat at the start",
            "all of it to 1e-6",
            f"all but {leak:.1e}",
            leak < 1e-6,
        )
    )

    return rows


def derivative_rows(actuator: FlexuralActuator) -> list[Row]:
    """Return the elasticities of the cooling time, its change with the elastomers' start, and a simulation's cost."""
    rows: list[Row] = []
    say("derivatives")
    slopes, walls = elasticities(actuator)
    listed = ", ".join(f"{NAMES[name]} {slope:+.3f}" for name, slope in slopes.items())
    rows.append(Row("percent of cooling time for a percent of", "-", listed, None, {"elasticities": slopes}))
    starts = {t: cool_actuator(actuator, cooling_elastomer_start=t)[1] for t in (45.0, 50.0, 52.0)}
    start_text = (
        ", ".join(f"{t:.0f} degC: {seconds:.3f} s" for t, seconds in starts.items())
        + "; the assumed 50 degC are 5 K below the target"
    )
    rows.append(
        Row(
            "time to 55 degC against the elastomers' temperature",
            "50 degC assumed",
            start_text,
            None,
            {"seconds": starts},
        )
    )
    speed_text = (
        f"{1e3 * walls['value']:.1f} ms, with its {len(NAMES)} derivatives "
        f"{walls['jacobian'] / walls['value']:.2f} times that"
    )
    rows.append(Row("one simulation", "-", speed_text, None, walls))

    return rows


def pictures(by_diameter: dict[int, float], curves_by_count: dict[int, tuple], folder: Path) -> None:
    """Draw the cooling time over the diameter, the hottest wire over time, and its temperature after 2 s.

    Args:
        by_diameter: Cooling times (s) by diameter (um).
        curves_by_count: Cooling curves, times and temperatures by number of wires.
        folder: Where the pictures go.
    """
    later = {n: curves_by_count[n][2] for n in COUNTS}
    d = list(by_diameter)
    curve = Curve("time to 55 degC", d, list(by_diameter.values()))
    draw(
        Chart("Cooling time of two wires", "wire diameter [um]", "time to 55 degC [s]", [curve]),
        folder,
        "flexural_cooling_diameter",
    )
    shown = [
        Curve(f"{n} wires", np.asarray(curves_by_count[n][0].time), np.asarray(curves_by_count[n][0].hottest))
        for n in (2, 10, 15, 25)
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
    """Print the table."""
    args = arguments(__doc__)
    actuator = actuator_file.read_actuator(ROOT / "data" / "actuators" / "flexural" / "rig.toml")
    assert isinstance(actuator, FlexuralActuator)
    curve, base, _ = cool_actuator(actuator)
    rows = cycle_rows(actuator, base)
    diameters, by_diameter = diameter_rows(actuator)
    counts, curves_by_count = count_rows(actuator)
    rows += diameters + counts
    rows += element_rows(actuator, args.quick)
    rows += grid_rows(actuator, curve, args.quick)
    rows += derivative_rows(actuator)
    if args.out:
        pictures(by_diameter, curves_by_count, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
