"""Moment, blocking force, work and efficiency of a flexural actuator: figures 7, 9, 11 and table 2 of dauksher2021.

    python experiments/papers/flexural/flexural_moment.py [--quick] [--json FILE] [--out DIR]

Source: dauksher2021. Blocking forces and efficiencies are measured in the paper and modelled here
(smajax.actuators.flexural), with a stress-strain curve that gives the paper's yield diameter; its own curve is only a
picture. The work on the cantilever is given by the paper's formula and as the work of the force.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish
from experiments.common.charts import Chart, Curve, draw

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad

from smajax import parameters
from smajax.actuators.bending_moment import BilinearStressStrain
from smajax.actuators.flexural import FlexuralActuator
from smajax.files import actuator_file
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.materials.brinson import Brinson

TESTED = (125, 250, 300, 375)
COUNTS = (2, 4, 6)
Tested = dict[int, dict[str, float]]  # metrics by diameter in um
# Position from the clamp, deflection of the tip, and the work that the paper prints (table 2), in m and J.
TABLE_2 = ((109.2e-3, 22e-3, 1.559e-3), (157.5e-3, 30e-3, 1.470e-3), (88.9e-3, 18e-3, 1.536e-3))


def moment_by_quadrature(law: BilinearStressStrain, diameter: float, curvature: float) -> float:
    """Return the moment as the integral over the fibres.

    Args:
        law: The stress-strain curve.
        diameter: Diameter of the wire, m.
        curvature: Curvature, 1/m.
    """
    radius = diameter / 2
    modulus, tangent, limit = (float(v) for v in (law.modulus, law.tangent_modulus, law.yield_stress / law.modulus))

    def fibre(angle: float) -> float:
        y = radius * np.sin(angle)
        yielded = max(curvature * y - limit, 0.0)
        return 4.0 * (radius * np.cos(angle)) ** 2 * y * (modulus * (curvature * y - yielded) + tangent * yielded)

    edge = np.arcsin(min(limit / curvature / radius, 1.0))
    return sum(quad(fibre, a, b, epsabs=0.0, epsrel=1e-13)[0] for a, b in ((0.0, edge), (edge, np.pi / 2)) if b > a)


@jit_with_kernels
def compute_metrics(actuator: FlexuralActuator) -> dict[str, jax.Array]:
    """Return all metrics except those that need the cooling."""
    return {
        name: value
        for name, value in actuator.metrics().items()
        if name not in ("time_to_cool", "temperature_after", "bandwidth")
    }


def metrics_with(actuator: FlexuralActuator, **values: float) -> dict[str, float]:
    """Return the metrics with other values of the actuator (``wire_diameter`` for ``wire.diameter``)."""
    changed = parameters.replace(actuator, {name.replace("_", ".", 1): value for name, value in values.items()})
    return {name: float(value) for name, value in compute_metrics(changed).items()}


def yield_row(law: BilinearStressStrain, curvature: float) -> Row:
    """Return the diameter from which a wire yields at a curvature (1/m), next to that of Brinson's wire."""
    ours = 1e6 * float(law.yield_diameter(curvature))
    brinson = Brinson(
        martensite_start=18.4,
        martensite_finish=9.0,
        austenite_start=34.5,
        austenite_finish=49.0,
        clausius_clapeyron_austenite=13.8e6,
        clausius_clapeyron_martensite=8e6,
        modulus_austenite=67e9,
        modulus_martensite=26.3e9,
        max_transformation_strain=0.067,
        detwinning_start_stress=100e6,
        detwinning_finish_stress=170e6,
    )
    other = BilinearStressStrain.from_brinson(brinson, 60.0)
    text = (
        f"{ours:.1f} um with {float(law.yield_stress) / 1e6:.0f} MPa and {float(law.modulus) / 1e9:.0f} GPa, "
        "chosen for it; "
    )
    text += (
        f"Brinson's wire at 60 degC ({float(other.yield_stress) / 1e6:.1f} MPa): "
        f"{1e6 * float(other.yield_diameter(curvature)):.1f} um"
    )
    return Row(
        "yield diameter at a radius of 1/60 m",
        "~230 um; its curve is a picture, Brinson's wire gives 215",
        text,
        215 <= ours <= 231,
        {"um": ours},
    )


def moment_rows(actuator: FlexuralActuator, quick: bool) -> list[Row]:
    """Compare the moment of one bent wire with quadrature and its limits, and show its growth with the diameter."""
    law, curvature = actuator.bending, float(actuator.body.curvature)
    rows: list[Row] = []
    grid = [(d * 1e-6, k) for d in ((100, 300, 500) if quick else range(100, 501, 25)) for k in (20.0, 60.0, 120.0)]
    error = max(abs(float(law.moment(d, k)) / moment_by_quadrature(law, d, k) - 1.0) for d, k in grid)
    text = f"{error:.1e} over {len(grid)} diameters and curvatures"
    rows.append(Row("eqs. 2 and 3 against quadrature of the fibres", "1e-12", text, error < 1e-12, {"relative": error}))
    # A yield strain far below that of the surface: the modulus is the largest that the model takes.
    hinge = BilinearStressStrain(3e11, 0.0, 6e-6 * 3e11)
    ratio = float(hinge.moment(3e-4, curvature) / (4 / 3 * hinge.yield_stress * 1.5e-4**3))
    rows.append(
        Row(
            "limit of a plastic hinge, 4/3 sigma_Y R^3",
            "1; needs B = 0, which is not said",
            f"{ratio:.8f}",
            abs(ratio - 1) < 1e-6,
        )
    )

    rows.append(yield_row(law, curvature))
    slope = jit_with_kernels(jax.vmap(jax.grad(lambda d: jnp.log(law.moment(jnp.exp(d), curvature)))))
    powers = {d: float(slope(jnp.log(jnp.asarray([d * 1e-6])))[0]) for d in (100, 200, 250, 300, 375, 500)}
    text = ", ".join(f"{d} um: {p:.2f}" for d, p in powers.items())
    explanation = (
        "a power law between the fourth (elastic) and the third (plastic), where the abstract says exponentially"
    )
    rows.append(
        Row(
            "d ln M / d ln d",
            "superlinear",
            f"{text}; {explanation}",
            min(powers.values()) > 1.0,
            {"exponents": powers},
        )
    )
    moments = {d: 1e3 * float(law.moment(d * 1e-6, curvature)) for d in (100, 125, 200, 250, 300, 375, 400, 500)}
    text = ", ".join(f"{d} um: {m:.4g}" for d, m in moments.items())
    rows.append(Row("moment of one wire, mN m", "in a picture only", text, None, {"mNm": moments}))
    return rows


def force_rows(actuator: FlexuralActuator, tested: Tested) -> list[Row]:
    """Return the blocking forces of two wires, and the ratio of the currents that heat them."""
    rows: list[Row] = []
    forces = [tested[d]["blocking_force"] for d in TESTED]
    yielding_forces = [tested[d]["blocking_force_of_yielding"] for d in TESTED]
    text = ", ".join(f"{d} um: {f:.4f}" for d, f in zip(TESTED, yielding_forces, strict=True))
    ordered = yielding_forces[0] == 0.0 and all(np.diff(yielding_forces) > 0.0)
    rows.append(
        Row(
            "blocking force of what yields, N, 2 wires",
            "125 um: none; the others rise",
            text,
            ordered,
            {"N": yielding_forces},
        )
    )
    text = ", ".join(f"{d} um: {f:.4f}" for d, f in zip(TESTED, forces, strict=True))
    is_close = 0.5 <= max(forces) / 0.25 <= 2.0
    factor = 0.25 / max(forces)
    explanation = (
        f"{factor:.2f} times lower: lever (55 mm taken), stress-strain curve and the tests' temperatures are "
        "not published"
    )
    rows.append(
        Row(
            "blocking force of the whole moment, N",
            "up to ~0.25, within a factor 2",
            f"{text}; {explanation}",
            is_close,
            {"N": forces},
        )
    )
    needed = 1e3 * 2 * float(actuator.bending.moment(375e-6, actuator.body.curvature)) / 0.25
    rows.append(Row("lever that would give 0.25 N at 375 um", "-", f"{needed:.1f} mm", None, {"mm": needed}))
    ratio = tested[250]["resistance"] / tested[375]["resistance"]
    rows.append(
        Row(
            "current at 7.5 V, 375 um to 250 um",
            "about 2.25",
            f"{ratio:.2f}, the areas' ratio: one length of wire",
            abs(ratio - 2.25) < 0.01,
        )
    )

    return rows


def work_rows(actuator: FlexuralActuator) -> list[Row]:
    """Return the work on the bench of table 2, by the printed formula and as the work of the force."""
    rows: list[Row] = []
    for position, tip, printed in TABLE_2:
        bench = parameters.replace(actuator, {"bench.position": position}).bench
        as_printed = float(bench.work_as_printed(tip))
        work = float(bench.work(tip))
        text = (
            f"{1e3 * as_printed:.3f} N mm as printed, with L = {1e3 * float(bench.length):.0f} mm; "
            f"{1e3 * work:.3f} done by the force"
        )
        is_close = abs(as_printed / printed - 1) < 0.01
        rows.append(
            Row(
                f"work at {1e3 * position:.1f} mm",
                f"{1e3 * printed:.3f} N mm within 1 %",
                text,
                is_close,
                {"printed": as_printed, "done": work},
            )
        )
    work = bench_works(actuator)
    text = f"{max(work) / min(work):.2f} times from place to place: eq. 7 takes the tip's path for the force's"
    rows.append(Row("is the work the same wherever the actuator stands?", "yes", text, None, {"joule": work}))
    return rows


def bench_works(actuator: FlexuralActuator) -> list[float]:
    """Return the work that the force does at each place of table 2, J."""
    return [float(parameters.replace(actuator, {"bench.position": p}).bench.work(t)) for p, t, _ in TABLE_2]


def efficiency_rows(actuator: FlexuralActuator, tested: Tested) -> list[Row]:
    """Return the efficiency, and its dependence on diameter and number of wires."""
    rows: list[Row] = []
    heat, work = tested[300]["energy_per_cycle"], bench_works(actuator)[0]
    measured = f"{100 * 1.559e-3 / heat:.4f} % as printed, {100 * work / heat:.4f} % with the force's work; "
    measured += f"ours {100 * tested[300]['efficiency']:.4f} %, "
    measured += f"at most {100 * tested[300]['limit_efficiency']:.4f} % if all work of yielding came out"
    explanation = (
        f"the heat is {heat:.2f} J to warm and transform {1e3 * float(actuator.wire_length):.0f} mm of wire, "
        "none of it lost to the sheets"
    )
    rows.append(
        Row(
            "efficiency, 300 um, 2 wires",
            "table 2's work over ideal heat",
            f"{measured}; {explanation}",
            None,
            {"heat": heat},
        )
    )
    by_diameter = [100 * tested[d]["efficiency"] for d in TESTED]
    limits = [100 * tested[d]["limit_efficiency"] for d in TESTED]
    text = ", ".join(
        f"{d} um: {e:.5f} % (at most {m:.4f})" for d, e, m in zip(TESTED, by_diameter, limits, strict=True)
    )
    rows.append(
        Row(
            "efficiency against diameter",
            "rises",
            text,
            all(np.diff(by_diameter) > 0.0),
            {"percent": by_diameter, "limit": limits},
        )
    )
    wide = np.unique(np.geomspace(250, 1500, 60).round())
    curve = [100 * metrics_with(actuator, wire_diameter=d * 1e-6)["efficiency"] for d in wide]
    peak = wide[int(np.argmax(curve))]
    text = f"at {peak:.0f} um, where actuator and beam are about as stiff, if no heat is lost"
    rows.append(Row("where it stops rising, by stiffness alone", "-", text, None, {"um": float(peak)}))
    rows.append(plateau_row(actuator))
    by_count = [100 * metrics_with(actuator, body_count=float(n))["efficiency"] for n in COUNTS]
    text = ", ".join(f"{n}: {e:.5f} %" for n, e in zip(COUNTS, by_count, strict=True))
    shares = [e / by_count[0] / (n / 2) for n, e in zip(COUNTS, by_count, strict=True)]
    explanation = (
        f"{', '.join(f'{s:.2f}' for s in shares)} of proportional: less as the actuator gets stiff against the beam"
    )
    rows.append(
        Row(
            "efficiency against wires",
            "rises in proportion, then less",
            f"{text}; {explanation}",
            by_count[0] < by_count[1] < by_count[2],
        )
    )

    return rows


@jit_with_kernels
def heat_loss_time_constant(actuator: FlexuralActuator) -> jax.Array:
    """Return the time constant in s of the heat flow from the wires into the silicone while they cool to the target."""
    cooling = actuator.cooling
    seconds = actuator.metrics()["time_to_cool"]
    fall = (cooling.wire_start - cooling.elastomer_start) / (actuator.test.target - cooling.elastomer_start)
    return seconds / jnp.log(fall)


def plateau_row(actuator: FlexuralActuator) -> Row:
    """Return where the efficiency stops rising if the heated wires lose heat to silicone at ambient temperature.

    The wires' heat balance has a loss to the silicone with ``heat_loss_time_constant``, and the latent heat is spread
    over
    the rise in temperature.
    """
    rise = float(actuator.cooling.wire_start - actuator.cooling.ambient)
    wire, heating = actuator.wire, actuator.heating
    storage_factor = 1.0 + float(heating.latent_heat / (wire.heat_capacity * rise))
    efficiency = {}
    for d in range(250, 451, 5):
        metrics = metrics_with(actuator, wire_diameter=d * 1e-6)
        tau = float(heat_loss_time_constant(parameters.replace(actuator, {"wire.diameter": d * 1e-6})))
        power = metrics["energy_per_cycle"] / metrics["heating_time"]
        # Steady excess temperature over the silicone under the current, K.
        steady = power * tau * storage_factor * rise / metrics["energy_per_cycle"]
        seconds = storage_factor * tau * np.log(steady / (steady - rise)) if steady > rise else np.inf
        efficiency[d] = 100 * metrics["work_per_cycle"] / (power * seconds)
    peak = max(efficiency, key=lambda d: efficiency[d])
    end = min(d for d in efficiency if efficiency[d] == 0.0)
    text = (
        f"at {peak} um: the thicker the wire, the longer {float(heating.current):g} A take, and the more goes "
        "into silicone at 20 degC;"
    )
    text += (
        f" from {end} um on they never reach 80 degC. How long each was heated, at which voltage, and how "
        "warm the silicone was by"
    )
    text += " then, is not printed"
    label = "and with what the silicone takes meanwhile"
    return Row(label, "within 250 to 375 um", text, 250 <= peak <= 375, {"um": peak, "percent": efficiency})


def pictures(actuator: FlexuralActuator, folder: Path) -> None:
    """Draw moment, blocking force and efficiency against the diameter."""
    law, diameters = actuator.bending, np.arange(100, 501, 5.0)
    curves = []
    for k in (30.0, 60.0, 120.0):
        curves.append(Curve(f"{k:.0f} 1/m", diameters, [1e3 * float(law.moment(d * 1e-6, k)) for d in diameters]))
    bends = np.linspace(28.0, 138.0, 60)
    onset = [float(law.yield_diameter(k)) for k in bends]
    yields = [1e3 * float(law.moment(d, k)) for d, k in zip(onset, bends, strict=True)]
    curves.append(Curve("yield", [1e6 * d for d in onset], yields, dashed=True))
    draw(Chart("Moment of one bent wire", "wire diameter [um]", "moment [mN m]", curves), folder, "flexural_moment")
    line = np.arange(125, 401, 5.0)
    metrics = [metrics_with(actuator, wire_diameter=d * 1e-6) for d in line]
    forces = [Curve("whole moment", line, [f["blocking_force"] for f in metrics])]
    forces.append(Curve("what yields", line, [f["blocking_force_of_yielding"] for f in metrics]))
    draw(
        Chart("Blocking force of two wires", "wire diameter [um]", "force [N]", forces),
        folder,
        "flexural_blocking_force",
    )
    efficiency = []
    for n in COUNTS:
        metrics = [metrics_with(actuator, wire_diameter=d * 1e-6, body_count=float(n))["efficiency"] for d in line]
        efficiency.append(Curve(f"{n} wires", line, [100 * e for e in metrics]))
    draw(
        Chart("Efficiency on the bench", "wire diameter [um]", "efficiency [%]", efficiency),
        folder,
        "flexural_efficiency",
    )


def main() -> None:
    """Print the table."""
    args = arguments(__doc__)
    actuator = actuator_file.read_actuator(ROOT / "data" / "actuators" / "flexural" / "rig.toml")
    assert isinstance(actuator, FlexuralActuator)
    tested = {d: metrics_with(actuator, wire_diameter=d * 1e-6) for d in TESTED}
    rows = (
        moment_rows(actuator, args.quick)
        + force_rows(actuator, tested)
        + work_rows(actuator)
        + efficiency_rows(actuator, tested)
    )
    if args.out:
        pictures(actuator, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
