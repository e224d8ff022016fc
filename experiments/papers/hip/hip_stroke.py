"""Stroke, temperature cycle and dead time of the hip of ali2026, from its physics.

    python experiments/papers/hip/hip_stroke.py [--quick] [--json FILE] [--out DIR]

Source: ali2026, sections 2 and 6. Two groups of six helical springs turn a link: wire 0.5 mm, 3.5 mm outside, 25 coils,
a group in series. As in figure 13 of the paper the duty of group B rises slowly until the springs are at 120 degC, then
they cool; from 400 s on group A does the same. The paper prints neither the springs' material, nor their stretch as
installed, nor convection, pulley radius, link, or the rate at which the duty rises. Assumed are Flexinol's numbers
(dynalloy), 40 mm, h = 50 W/m^2/K, 28 mm, 0.2 kg at 0.1 m, and 0.4 % of duty a second. So a stroke in degrees can only
show which pulley would give the published one, a time which power, and a temperature which convection. The dead time,
which the paper identifies as a constant, is here the time to the springs' austenite start, and falls with the power.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw

import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.plant.drive import resistance
from smajax.plant.materials.base import Fractions
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate

HOTTEST = 120.0  # degC
SECOND_GROUP, END = 400.0, 800.0  # s
RAMP = 0.004  # duty a second
CONVECTION = {"heat.h0": 50.0, "heat.h2": 0.0}
PUBLISHED_RANGE, DEAD_TIMES = 220.0, {"flexion identified": 6.46, "step at 20 V": 2.09}
DEAD_TIME_ANGLE = 1.0  # degrees at which a dead time ends
STEP = 0.25


@dataclass(frozen=True)
class Cycle:
    """One cycle of the hip.

    Attributes:
        time: Time, s, shape ``(n,)``.
        duty: Duties of both groups, shape ``(2, n)``.
        temperature: Temperatures of both groups, degC, shape ``(2, n)``.
        angle: Angle, degrees, shape ``(n,)``.
    """

    time: np.ndarray
    duty: np.ndarray
    temperature: np.ndarray
    angle: np.ndarray


def make_hip(supply: float) -> Plant:
    """Return the hip of the shipped template, its groups driven by a pulsed supply of some volts."""
    text = (ROOT / "data" / "templates" / "hip.toml").read_text("utf-8")
    text = text.replace('control = "voltage"', 'control = "duty"') + f'\n[drive]\nsupply = "{supply} V"\n'
    return parameters.replace(parse_rig(text, "hip.toml").plant, CONVECTION)


def simulate_hip(plant: Plant, time: np.ndarray, duty: np.ndarray) -> Cycle:
    """Simulate the hip under two duties, held from row to row.

    Args:
        plant: The hip.
        time: Times, s, shape ``(n,)``.
        duty: Duties, shape ``(2, n)``.
    """
    channels = {"duty_1": duty[0], "duty_2": duty[1]}
    simulated = simulate(
        plant, Recording("made", time, channels, dict.fromkeys(channels, "1"), "0" * 64, True, ()), step=0.05
    ).channels
    temperature = np.stack([np.asarray(simulated[f"temperature_{i}"]) for i in (1, 2)])
    return Cycle(time, duty, temperature, np.degrees(np.asarray(simulated["angle"])))


def run_cycle(plant: Plant) -> Cycle:
    """Simulate a cycle: each group's duty rises from its begin until the group is at the hottest temperature."""
    time = np.arange(round(END / STEP) + 1) * STEP
    begins = np.array([[0.0], [SECOND_GROUP]])
    duty = np.clip(RAMP * (time - begins), 0.0, 1.0) * (time < begins + SECOND_GROUP)
    hot = simulate_hip(plant, time, duty).temperature >= HOTTEST
    ends = np.array([time[np.argmax(row)] if row.any() else END for row in hot])[:, None]
    return simulate_hip(plant, time, duty * (time < ends))


def dead_time(plant: Plant, duty: float) -> tuple[float, Cycle]:
    """Return the time in s until a step of group B's duty has turned the link visibly, and the run; NaN if never."""
    time = np.arange(round(60.0 / 0.05) + 1) * 0.05
    run = simulate_hip(plant, time, np.stack([np.full(len(time), duty), np.zeros(len(time))]))
    if run.angle.max() < DEAD_TIME_ANGLE:
        return float("nan"), run
    row = int(np.argmax(run.angle >= DEAD_TIME_ANGLE))
    before, after = run.angle[row - 1], run.angle[row]
    return float(time[row - 1] + 0.05 * (DEAD_TIME_ANGLE - before) / (after - before)), run


def group_resistance(plant: Plant, martensite: float = 1.0) -> float:
    """Return the resistance of a group in ohm, in martensite or at another fraction of it."""
    fractions = Fractions(jnp.zeros(()), jnp.asarray(martensite))
    return float(resistance(plant.material.resistivity(fractions), plant.wire))


def cooling_time(run: Cycle, wire: int, target: float) -> float:
    """Return the time in s from a group's hottest row until it is at a temperature; NaN if it does not get there.

    Args:
        run: The cycle.
        wire: Index of the group.
        target: The temperature, degC.
    """
    top = int(np.argmax(run.temperature[wire]))
    cool = run.temperature[wire, top:] <= target
    return float(run.time[top + int(np.argmax(cool))] - run.time[top]) if cool.any() else float("nan")


def pulley_for(plant: Plant, mass: float, count: int) -> float:
    """Return the radius in m at which the range of the angle is the published one; NaN if no radius tried gives it.

    Args:
        plant: The hip.
        mass: Mass of the link, kg.
        count: Number of radii.
    """
    radii = np.geomspace(0.005, 0.03, count)
    ranges = [
        np.ptp(run_cycle(parameters.replace(plant, {"pulley.radius": float(r), "link.mass": mass})).angle)
        for r in radii
    ]
    # The range grows from the largest pulley down, until the link is too heavy for the short lever.
    most = int(np.argmax(ranges))
    if ranges[most] < PUBLISHED_RANGE:
        return float("nan")
    return float(np.interp(-PUBLISHED_RANGE, -np.array(ranges[most:]), radii[most:]))


def pulley_row(plant: Plant, count: int) -> Row:
    """Return the pulleys that would give the published range, by the link's mass."""
    pulleys = {mass: 1e3 * pulley_for(plant, mass, count) for mass in (0.0, 0.05, 0.2)}
    text = ", ".join(f"{'none' if np.isnan(r) else f'{r:.1f} mm'} with a link of {m:g} kg" for m, r in pulleys.items())
    return Row(
        "pulley for the published range",
        "not printed, nor the link's mass",
        text,
        None,
        {"radius_mm_by_mass_kg": pulleys},
    )


def cycle_rows(supply: float, plant: Plant, run: Cycle) -> list[Row]:
    """Return the rows of one supply.

    Args:
        supply: Voltage of the supply, V.
        plant: The hip.
        run: Its cycle.
    """
    radius = float(plant.mechanism.wire_motion_per_coordinate)
    swing = float(np.ptp(run.angle))
    stroke = 1e3 * radius * np.radians(swing)
    hot = [float(run.time[np.argmax(t)]) - b for t, b in zip(run.temperature, (0.0, SECOND_GROUP), strict=True)]
    peak = run.temperature.max(axis=1)
    cool = [cooling_time(run, i, 30.0) for i in (0, 1)]
    lasts = [END - SECOND_GROUP - h for h in hot]
    return [
        Row(
            f"{supply:g} V: range of the angle",
            "-20 to 200 deg, at 10 V",
            f"{run.angle.min():.0f} to {run.angle.max():.0f} deg, {stroke:.1f} mm of stroke on a pulley of "
            f"{1e3 * radius:g} mm",
            None,
            {"lowest": run.angle.min(), "highest": run.angle.max(), "stroke_mm": stroke},
        ),
        Row(
            f"{supply:g} V: heating slowly to 120 degC",
            "reached",
            f"{peak[0]:.0f} and {peak[1]:.0f} degC after {hot[0]:.0f} and {hot[1]:.0f} s, at a duty of "
            f"{run.duty[0].max():.2f}",
            bool(np.all(peak >= HOTTEST - 0.5)),
            {"seconds": hot, "duty": run.duty.max(axis=1), "peak_degC": peak},
        ),
        Row(
            f"{supply:g} V: cooling from there to 30 degC",
            "ends by 400 s (B), by 733 or 800 s (A), heating included",
            f"{cool[0]:.0f} and {cool[1]:.0f} s: heating may take {min(lasts) - max(cool):.0f} s more than ours "
            "(the ramp is not printed)",
            bool(cool[0] < lasts[0] and cool[1] < lasts[1]),
            {"seconds": cool},
        ),
    ]


def convection_row(plant: Plant) -> Row:
    """Return the largest convection with which 10 V can hold 120 degC: the hot group's power over its surface."""
    wire = plant.wire
    surface = float(jnp.pi * wire.diameter * wire.length)
    power = 100.0 / group_resistance(plant, 0.0)
    largest = power / (surface * (HOTTEST - float(plant.environment.ambient)))
    text = (
        f"{power:.1f} W of a hot group on {1e4 * surface:.1f} cm^2 hold 120 degC up to h = {largest:.0f} "
        "W/m^2/K, so h was below"
    )
    return Row("convection that 10 V allows", "h is not printed", text, None, {"largest": largest})


def dead_time_rows(quick: bool) -> tuple[list[Row], list[Curve]]:
    """Return the dead time by power, the powers at which it is the published one, and its curves."""
    watts, seconds = [], []
    plant = make_hip(20.0)
    full = 400.0 / group_resistance(plant)
    for duty in np.geomspace(0.1, 1.0, 7 if quick else 13):
        delay, _ = dead_time(plant, float(duty))
        if np.isfinite(delay):
            watts.append(full * float(duty))
            seconds.append(delay)
    falls = bool(np.all(np.diff(seconds) < 0.0))
    full_duty = {supply: dead_time(make_hip(supply), 1.0)[0] for supply in (10.0, 20.0)}
    ends = f"{seconds[0]:.1f} s at {watts[0]:.1f} W to {seconds[-1]:.2f} s at {watts[-1]:.0f} W"
    volts = (
        f"at full duty {full_duty[10.0]:.2f} s at 10 V and {full_duty[20.0]:.2f} s at 20 V, "
        f"{full_duty[10.0] / full_duty[20.0]:.1f} times less"
    )
    rows = [
        Row(
            "dead time falls with power",
            "a constant, 6.46 s (B), identified at one input",
            f"{ends}; {volts}",
            falls and full_duty[20.0] < full_duty[10.0] / 3.0,
            {"watts": watts, "seconds": seconds, "full_duty": full_duty},
        )
    ]
    for name, published in DEAD_TIMES.items():
        power = float(np.exp(np.interp(-published, [-s for s in seconds], np.log(watts))))
        inside = seconds[-1] < published < seconds[0]
        text = (
            f"{power:.1f} W would make it so: duty {power / full:.2f} at 20 V, {4 * power / full:.2f} at 10 V "
            "(the duty is not printed)"
        )
        rows.append(Row(f"dead time, {name}", f"{published:g} s", text, inside, {"watts": power}))
    published = [
        Curve(f"published, {name}", [watts[0], watts[-1]], [s, s], dashed=True) for name, s in DEAD_TIMES.items()
    ]
    return rows, [Curve("ours", watts, seconds), *published]


def held_row() -> Row:
    """Return the final angle under a duty that the identified gain maps to 100 degrees."""
    _, run = dead_time(make_hip(20.0), 0.154)
    text = f"{run.angle[-1]:.0f} deg at {run.temperature[0, -1]:.0f} degC after 60 s at 20 V, on our pulley"
    return Row(
        "a duty of 0.154 held",
        "100 deg (identified gain; its voltage is not printed)",
        text,
        None,
        {"angle": run.angle[-1]},
    )


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="five pulleys in place of nine, seven powers in place of thirteen")
    first = make_hip(10.0)
    spring = group_resistance(first) / float(first.wire.springs)
    group = group_resistance(first)
    rows = [
        Row(
            "a group's resistance, cold",
            "not printed",
            f"{spring:.2f} ohm a spring, {group:.2f} in series: {100 / group:.1f} W at 10 V",
            None,
        ),
        convection_row(first),
    ]
    angles, temperatures = [], []
    for supply in (10.0, 20.0):
        say(f"the cycle at {supply:g} V")
        plant = make_hip(supply)
        run = run_cycle(plant)
        rows += cycle_rows(supply, plant, run)
        angles.append(Curve(f"{supply:g} V", run.time, run.angle))
        temperatures += [
            Curve(f"{supply:g} V, group {g}", run.time, t) for g, t in zip("BA", run.temperature, strict=True)
        ]
    say("pulleys")
    rows.append(pulley_row(first, 5 if args.quick else 9))
    say("dead times")
    new_rows, dead_time_curves = dead_time_rows(args.quick)
    rows += [held_row(), *new_rows]
    if args.out:
        draw(Chart("Hip: slow heating and cooling", "time [s]", "angle [deg]", angles), args.out, "hip_stroke_angle")
        draw(
            Chart("Hip: slow heating and cooling", "time [s]", "temperature [degC]", temperatures),
            args.out,
            "hip_stroke_temperature",
        )
        draw(
            Chart(
                "Hip: dead time", "power into a group [W]", "dead time [s]", dead_time_curves, log_x=True, log_y=True
            ),
            args.out,
            "hip_stroke_dead_time",
        )
    finish(rows, args)


if __name__ == "__main__":
    main()
