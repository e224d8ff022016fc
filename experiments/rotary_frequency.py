"""The antagonistic rotary actuator from 0.1 to 10 Hz (rotary paper, figure 9): peak-to-peak angle over frequency and current.

The rig is the paper's, with its Table 1 and the convection of its Table 4 for the fastest fan; two currents take turns. The paper prints 4
degrees at 5 Hz and 1 degree at 10 Hz, and not the current. So each of them is looked for: which current gives it, without latent heat as
the paper has it, and with the latent heat of the wire's data sheet. Every point is one design of a sweep.
"""

import numpy as np
from _common import ROOT, Row, arguments, finish, say
from _figures import Chart, Curve, draw

from smajax.rig import parse_rig
from smajax.sweep import chunks
from smajax.sweep.study import RigStudy
from smajax.sweep.wave import Wave

RIG = """
[rig]
kind = "antagonistic-rotary"
control = "current"
[material]
set = "rotary-table1"
[heat]
h0 = "377.375 W/m^2/K"
h2 = "0.050 W/m^2/K^3"
capacity = "2.046 MJ/m^3/K"
[wire]
diameter = "0.2 mm"
length = "500 mm"
prestrain = "2 %"
[pulley]
radius = "20 mm"
[environment]
ambient = "20 degC"
[fit]
observe = ["angle"]
"""
LATENT = '[effects.latent-heat]\nstrength = "156 MJ/m^3"\n'  # 24.2 kJ/kg (Flexinol's data sheet) at 6450 kg/m^3
FREQUENCIES = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0)
CURRENTS = (1.0, 1.2, 1.5, 2.0)
PUBLISHED = {5.0: (4.0, 0.5, (1.1, 1.6)), 10.0: (1.0, 0.25, (1.4, 1.7))}
NAMES = ("input.amplitude",)
# The swing is that of the last cycle: fast ones take long to come to the same, and a cycle has no fewer steps than this.
FAST, FEWEST = 2.0, 200


def swing(latent: bool, currents: np.ndarray, frequency: float, step: float) -> np.ndarray:
    """Peak-to-peak angle in degrees at each current, NaN where a step was not solved."""
    rig = parse_rig(RIG + (LATENT if latent else ""), "rotary", ROOT / "data")
    cycles = 20 if frequency >= FAST else 6
    which = RigStudy(NAMES, rig.plant, ("stroke",), Wave("square", 1.0, frequency, 0.5, cycles), cycles, "hold", 0.0)
    steps = max(FEWEST, round(1.0 / frequency / step))
    return np.degrees(chunks.evaluate(which, currents[:, None], steps, workers=chunks.threads(), new=True)["stroke"])


def main() -> None:
    args = arguments(__doc__ or "")
    step, fine = (2e-3, 13) if args.quick else (5e-4, 51)
    rows, table = [], {}
    for latent in (False, True):
        words = "with latent heat" if latent else "without latent heat, as printed"
        say(words)
        table[words] = np.column_stack([swing(latent, np.array(CURRENTS), f, step) for f in FREQUENCIES])
        for current, degrees in zip(CURRENTS, table[words], strict=True):
            falls = bool(np.all(np.diff(degrees[1:]) <= 0.02 * degrees[1]))
            told = [f"{d:.1f}" if np.isfinite(d) else "not solved" for d in degrees]
            text = ", ".join(f"{f:g} Hz {d}" for f, d in zip(FREQUENCIES, told, strict=True))
            rows.append(Row(f"{current} A, {words}: degrees", "falls from 0.5 Hz on", text, falls, {"degrees": degrees.tolist()}))
        for frequency, (wanted, room, (low, high)) in PUBLISHED.items():
            currents = np.linspace(low, high, fine)
            degrees = swing(latent, currents, frequency, step)
            best = int(np.nanargmin(np.abs(degrees - wanted)))
            near = np.abs(degrees - wanted) <= room
            text = f"{degrees[best]:.2f} degrees at {currents[best]:.3f} A"
            text += f"; within {room} degrees at {near.sum()} of {fine} currents" if near.any() else "; at none within the tolerance"
            target = f"{wanted:g} degrees at some current from {low} to {high} A"
            told = {"currents": currents.tolist(), "degrees": degrees.tolist()}
            rows.append(Row(f"{frequency:g} Hz, {words}", target, text, bool(near.any()), told))
    rows.append(
        Row(
            "why they differ", "-", "the paper prints no current for these tests, and neither friction nor latent heat: the two figures are"
            " a choice of current, which without latent heat has to be met within a few milliamperes", None,
        )
    )  # fmt: skip
    if args.out:
        draw(chart(table), args.out, "rotary_frequency")
    finish("rotary_frequency", rows, args, step_s=step)


def chart(table: dict[str, np.ndarray]) -> Chart:
    """Swing over frequency for each current, dashed with latent heat."""
    curves = [
        Curve(f"{current} A, {words.split(',')[0]}", FREQUENCIES, degrees[i], dashed=k == 1)
        for k, (words, degrees) in enumerate(table.items())
        for i, current in enumerate(CURRENTS)
    ]
    return Chart("Two wires on a pulley: peak-to-peak angle", "frequency [Hz]", "peak to peak [deg]", curves, log_x=True)


if __name__ == "__main__":
    main()
