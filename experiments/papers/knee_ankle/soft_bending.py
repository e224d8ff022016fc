"""The soft bending actuator of hybrid_knee_ankle_orthosis: its pseudo-rigid body, corrected, against the elastica.

    python experiments/papers/knee_ankle/soft_bending.py [--quick] [--json FILE] [--out DIR]

Source: hybrid_knee_ankle_orthosis; howell2001. The paper derives the position of the hinge of a rigid rod that replaces
the bending actuator, and measures the rotation of the actuator. Neither its wires' memory shape nor its cable is
published, so that any moment fits the rotation: the equations are compared.
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

from smajax.actuators import pseudo_rigid_body
from smajax.actuators.elastica import solve_elastica
from smajax.actuators.soft_bending import SoftBending
from smajax.files import actuator_file
from smajax.numerics.loop_kernels import jit_with_kernels

MEASURED = 44.04
# Slopes at the tip in rad, and lambda there by an independent evaluation of the corrected eq. 23.
RADIUS_FACTORS = {0.05: 0.883061, 0.3: 0.907853, 0.7: 1.021186}


@jax.jit
@jax.vmap
def balance_beam(force: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return slope, rod's angle and lambda of a unit beam under a force with the moment F L / 3 against it (eq. 20)."""
    bent = solve_elastica(-force, -force / 3.0, jnp.ones(()), jnp.ones(()))
    return (bent.slope, *pseudo_rigid_body.rigid_rod(bent.x, bent.y, 1.0))


def share_rows() -> list[Row]:
    """Return lambda by the paper's equation 23, corrected, and the consistency of its equations."""
    rows: list[Row] = []
    factors = {theta: float(pseudo_rigid_body.radius_factor(theta)) for theta in RADIUS_FACTORS}
    text = ", ".join(f"{theta} rad: {share:.6f}" for theta, share in factors.items())
    is_close = all(abs(factors[theta] - share) < 1e-6 for theta, share in RADIUS_FACTORS.items())
    expected = ", ".join(f"{share:.6f}" for share in RADIUS_FACTORS.values())
    explanation = "as printed, 21 F theta^2 / 110, it would have the unit of a force and be 0 for a straight beam"
    rows.append(Row("lambda by eq. 23, corrected", expected, f"{text}; {explanation}", is_close, {"lambda": factors}))
    error = max(_residuals(theta) for theta in (0.05, 0.2, 0.44, 0.7))
    rows.append(Row("eqs. 18 to 25 fit together", "1e-12", f"{error:.1e}", error < 1e-12))
    return rows


def elastica_rows(forces: np.ndarray, slopes: np.ndarray, angles: np.ndarray, shares: np.ndarray) -> list[Row]:
    """Return lambda of the elastica under a force with M = F L / 3, and whether it reaches the measured angle.

    Args:
        forces: Forces in E I / L^2, shape ``(n,)``.
        slopes: Slopes at the tip in rad, shape ``(n,)``.
        angles: The rod's angles in rad, shape ``(n,)``.
        shares: lambda, shape ``(n,)``.
    """
    rows: list[Row] = []
    top = int(np.argmax(slopes))
    rising = {d: float(np.interp(np.radians(d), slopes[: top + 1], shares[: top + 1])) for d in (5, 10, 20)}
    text = ", ".join(
        f"{d} degrees: {share:.4f}, by eq. 23 {pseudo_rigid_body.radius_factor(np.radians(d)):.4f}"
        for d, share in rising.items()
    )
    rows.append(Row("lambda of the elastica with M = F L / 3", "-", text, None, {"lambda": rising}))
    reached = float(np.interp(MEASURED, np.degrees(angles), forces))
    text = (
        f"the tip's slope passes {np.degrees(slopes[top]):.1f} degrees at no force; the rod's angle is "
        f"{MEASURED} degrees "
    )
    text += f"at {reached:.2f} E I / L^2, with lambda {np.interp(reached, forces, shares):.4f}"
    rows.append(
        Row(
            "can it turn by 44.04 degrees so?",
            "-",
            text,
            None,
            {"degrees": float(np.degrees(slopes[top])), "force": reached},
        )
    )
    return rows


def actuator_rows(actuator: SoftBending, metrics: dict[str, float]) -> list[Row]:
    """Return the metrics of the free actuator next to the paper's figures."""
    rows: list[Row] = []
    rotation = np.degrees(metrics["tip_slope"])
    text = (
        f"{rotation:.2f} degrees at the tip, {np.degrees(metrics['rod_angle']):.2f} of the rod, without a cable and "
        "with a memory shape of "
    )
    curvature = float(actuator.wires.memory_curvature)
    text += f"{curvature:.3f} 1/m chosen for the first: a moment of {metrics['moment']:.3f} N m"
    rows.append(
        Row("largest rotation", f"{MEASURED} degrees", f"{text}; any moment can be fitted", None, {"degrees": rotation})
    )
    howell = pseudo_rigid_body.END_MOMENT.radius_factor
    text = f"{metrics['rod_share']:.4f} by the elastica, 3/4 for a small moment, {howell} by Howell"
    rows.append(Row("lambda of the free actuator, a moment alone", "-", text, None, {"lambda": metrics["rod_share"]}))
    per_length = metrics["rigidity"] / float(actuator.bar.length)
    stiffnesses = {
        "eq. 25": float(pseudo_rigid_body.hinge_stiffness(metrics["rod_share"], 1.0, per_length)),
        "Howell": pseudo_rigid_body.END_MOMENT.stiffness * per_length,
    }
    text = (
        f"{metrics['rod_stiffness']:.3f} N m/rad, its moment over the rod's angle; {stiffnesses['Howell']:.3f} by "
        "Howell's end moment; "
    )
    text += f"eq. 25, derived for M = F L / 3, would have {stiffnesses['eq. 25']:.3f}"
    is_close = abs(metrics["rod_stiffness"] / stiffnesses["Howell"] - 1.0) < 0.02
    rows.append(
        Row(
            "hinge's stiffness, free actuator",
            "Howell's within 2 %",
            text,
            is_close,
            {"ours": metrics["rod_stiffness"], **stiffnesses},
        )
    )
    silicone = float(actuator.bar.modulus * actuator.bar.width * actuator.bar.thickness**3) / 12.0
    parts = [metrics[name] / silicone for name in ("rigidity", "cold_rigidity")]
    text = (
        f"{metrics['rigidity']:.4f} N m^2 hot, {metrics['cold_rigidity']:.4f} cold, {parts[0]:.0f} and "
        f"{parts[1]:.0f} times the silicone's"
    )
    rows.append(Row("what carries the bend", "'the elasticity of PDMS' straightens it", text, None, {"ratios": parts}))
    rows.append(Row("strain at the surface of a straightened wire", "-", f"{100 * metrics['cold_strain']:.2f} %", None))
    return rows


def pictures(forces: np.ndarray, slopes: np.ndarray, angles: np.ndarray, folder: Path) -> None:
    """Draw slope and angle of the beam over the force.

    Args:
        forces: Forces in E I / L^2, shape ``(n,)``.
        slopes: Slopes at the tip in rad, shape ``(n,)``.
        angles: The rod's angles in rad, shape ``(n,)``.
        folder: Where the pictures go.
    """
    small = forces[forces < 7.2]
    curves = [
        Curve("slope at the tip", forces, np.degrees(slopes)),
        Curve("rod's angle", forces, np.degrees(angles)),
    ]
    curves.append(Curve("slope by eq. 19", small, np.degrees(small / 6.0), dashed=True))
    draw(
        Chart("A beam with M = F L / 3", "force [E I / L^2]", "angle [deg]", curves),
        folder,
        "soft_bending_angles",
    )


def main() -> None:
    """Print the table."""
    args = arguments(__doc__)
    actuator = actuator_file.read_actuator(ROOT / "data" / "actuators" / "soft-bending" / "rig.toml")
    assert isinstance(actuator, SoftBending)
    metrics = {name: float(value) for name, value in jit_with_kernels(lambda m: m.metrics())(actuator).items()}
    forces = np.linspace(0.05, 12.0, 60 if args.quick else 240)
    slopes, angles, shares = (np.asarray(v) for v in balance_beam(jnp.asarray(forces)))
    rows = [*share_rows(), *elastica_rows(forces, slopes, angles, shares), *actuator_rows(actuator, metrics)]
    if args.out:
        pictures(forces, slopes, angles, args.out)
    finish(rows, args)


def _residuals(theta: float) -> float:
    """Return the largest relative contradiction between the corrected equations."""
    length, rigidity = 0.12, 0.031
    force = pseudo_rigid_body.balanced_force(theta, length, rigidity)
    state = (force, force * length / 3.0, length, rigidity)
    deflection = pseudo_rigid_body.deflection(*state)
    shortening = pseudo_rigid_body.shortening(*state)
    share = pseudo_rigid_body.radius_factor(theta)
    angle, radius_factor = pseudo_rigid_body.rigid_rod(
        jnp.asarray(length - shortening), jnp.asarray(deflection), length
    )
    spring = pseudo_rigid_body.driving_force(theta, length, rigidity) * share * length / (theta / share)
    pairs = [
        (pseudo_rigid_body.slope(*state), theta),
        (deflection, theta * length),
        (shortening, 17 / 30 * theta**2 * length),
    ]
    pairs += [
        (pseudo_rigid_body.driving_force(theta, length, rigidity), force - state[1] / length),
        (float(radius_factor), share),
    ]
    pairs += [
        (theta / float(jnp.sin(angle)), share),
        (pseudo_rigid_body.hinge_stiffness(share, length, rigidity), spring),
    ]
    return max(abs(a / b - 1.0) for a, b in pairs)


if __name__ == "__main__":
    main()
