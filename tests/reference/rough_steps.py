"""Balance of forces of one rough wire under a load, or of two on a pulley, and the loop over the fine steps.

One wire: sigma = load(x) + lead, with the load of a weight or a spring in Pa of the wire and x its contraction. Two wires on a pulley that
has no inertia: sigma_1 = sigma_2 + lead, and their strains add up to twice the prestrain. Rigid Coulomb friction makes the lead: +friction
while the coordinate rises, -friction while it falls, and between them the coordinate stays where it is. Each equation is monotone in
one stress, solved by Newton's rule inside a bracket.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from tests.reference.rough_wire import accept, heat_up, resistance, stored, strain_after

UNDER_LOAD, HELD, PAIR = 0, 1, 2
SCALE = 2e10  # Pa, makes stresses of strains: about the wire's modulus
TOLERANCE = 20.0  # Pa of the balance: 1e-9 of strain


class Load(NamedTuple):
    """What pulls: stress of the wire at the start (Pa), its rise with the contraction (Pa/m), and the strain counted from."""

    stress: float
    stiffness: float
    arm: float
    start_strain: float
    prestrain: float


@njit(cache=True)
def _pull(c, hidden, load, x):
    """Stress that the load puts on the wire at the contraction ``x``, and its derivative."""
    factor = 1.0 + hidden.arm * x / (0.04 * c.length)
    base = load.stress + load.stiffness * x
    return base * factor, load.stiffness * factor + base * hidden.arm / (0.04 * c.length)


@njit(cache=True)
def _excess(mode, c, hidden, load, wires, first, stress, lead, target, s1):
    """Excess of the balance in Pa, its derivative with respect to the stress of the first wire, and the strains of both wires."""
    strain, by_stress = strain_after(c, wires[first], stress[first], s1)
    if mode == HELD:
        return SCALE * (strain - target), SCALE * by_stress, strain, 0.0
    if mode == UNDER_LOAD:
        pull, rise = _pull(c, hidden, load, c.length * (load.start_strain - strain))
        return s1 - pull - lead, 1.0 + rise * c.length * by_stress, strain, 0.0
    other, by_other = strain_after(c, wires[1], stress[1], max(s1 - lead, 0.0))
    return SCALE * (strain + other - 2.0 * load.prestrain), SCALE * (by_stress + by_other), strain, other


@njit(cache=True)
def _solve(mode, c, hidden, load, wires, first, stress, lead, target, guess):
    """Return the stress of wire ``first`` at the end of the step, the lowest possible one if the wires are slack, and the strains there."""
    low = max(lead, 0.0) if mode == PAIR else 0.0
    high, s, last = np.inf, max(guess, low), np.inf
    strain = other = 0.0
    for _ in range(80):
        value, rise, strain, other = _excess(mode, c, hidden, load, wires, first, stress, lead, target, s)
        if abs(value) < TOLERANCE or high - low < 1e-3 or (value > 0.0 and s <= low):
            break
        if value > 0.0:
            high = s
        else:
            low = s
        trial = s - value / rise
        # Half of the bracket where Newton's rule leaves it or hardly gains.
        if np.isfinite(high) and (trial <= low or trial >= high or abs(value) > 0.5 * last):
            trial = 0.5 * (low + high)
        last, s = abs(value), max(trial, low)
    return s, strain, other


@njit(cache=True)
def _balance_one(c, hidden, load, wires, stress, guess, x, out):
    """Write the stress of a wire under a load into ``out`` and return its contraction."""
    if hidden.friction == 0.0:
        out[0], strain, _ = _solve(UNDER_LOAD, c, hidden, load, wires, 0, stress, 0.0, 0.0, guess[0])
        return c.length * (load.start_strain - strain)
    for sign in (1.0, -1.0):
        lead = sign * hidden.friction
        out[0], strain, _ = _solve(UNDER_LOAD, c, hidden, load, wires, 0, stress, lead, 0.0, guess[0])
        moved = c.length * (load.start_strain - strain)
        if (moved - x) * sign > 0.0:
            return moved
    target = load.start_strain - x / c.length
    out[0], _, _ = _solve(HELD, c, hidden, load, wires, 0, stress, 0.0, target, guess[0])
    return x


@njit(cache=True)
def _balance_pair(c, hidden, load, wires, stress, guess, lean, out):
    """Write the stresses of two wires into ``out`` and return the pulley's position as a strain of a wire."""
    lead = 0.0
    if hidden.friction > 0.0:
        out[0], _, _ = _solve(HELD, c, hidden, load, wires, 0, stress, 0.0, load.prestrain - lean, guess[0])
        out[1], _, _ = _solve(HELD, c, hidden, load, wires, 1, stress, 0.0, load.prestrain + lean, guess[1])
        if abs(out[0] - out[1]) <= hidden.friction:
            return lean
        lead = hidden.friction if out[0] > out[1] else -hidden.friction
    out[0], first, second = _solve(PAIR, c, hidden, load, wires, 0, stress, lead, 0.0, guess[0])
    out[1] = max(out[0] - lead, 0.0)
    # Between two slack wires the pulley stays where it is.
    return min(max(lean, load.prestrain - first), second - load.prestrain)


@njit(cache=True)
def _note(row, number, c, hidden, wires, stress, temperature, stresses, xi, energy):
    """Write the state at a sample into the results."""
    for k in range(number):
        stresses[row, k] = stress[k]
        temperature[row, k] = wires[k].temperature
        xi[row, k] = wires[k].xi
        energy[row, :3] += wires[k].energy
        energy[row, 3] += stored(c, hidden, wires[k])


@njit(cache=True)
def _supplied(c, hidden, wires, k, current, largest):
    """Current that a driver with a saturation and a highest voltage gives, A."""
    current *= 1.0 - hidden.saturation * (current / largest) ** 2
    return min(current, hidden.ceiling / resistance(c, wires[k]))


@njit(cache=True)
def _step(number, c, hidden, load, wires, stress, last, out, amps, air, wind, step, ratio, place, scratch):
    """Advance all wires by a step and return the coordinate at its end."""
    flow, clamp_flow, guess = scratch
    pair = number == 2
    for i in range(number):
        wires[i].before[:] = wires[i].temperature
    for i in range(number):
        other = wires[1 - i] if pair else wires[i]
        heat_up(c, hidden, wires[i], other, amps[i], air, wind, step, ratio, flow, clamp_flow)
        guess[i] = max(stress[i] + 2.0 * ratio * (stress[i] - last[i]), 0.0)
    if pair:
        place = _balance_pair(c, hidden, load, wires, stress, guess, place, out)
    else:
        place = _balance_one(c, hidden, load, wires, stress, guess, place, out)
    for i in range(number):
        accept(wires[i])
    last[:] = stress
    stress[:] = out
    return place


@njit(cache=True)
def run(c, hidden, load, wires, start_stress, time, current, is_linear, substeps, largest, results):
    """Run one wire or two over all samples, from their start state.

    Args:
        c: Constants of the wires.
        hidden: Hidden effects.
        load: What pulls.
        wires: States of both wires; of a single wire, its own twice.
        start_stress: Stress at the start, Pa.
        time: Times of the samples, shape ``(n,)``.
        current: Currents, A, shape ``(n, wires)``.
        is_linear: Whether the currents run straight between the samples, or hold.
        substeps: Number of fine steps between two samples.
        largest: Current to which the saturation refers, A.
        results: Arrays to fill: temperature, stress, fractions and energies at the samples.

    Returns:
        Times and coordinate at the ends of the fine steps: contraction in m, or the pulley's position as a strain.
    """
    temperature, stresses, xi, energy = results
    number = current.shape[1]
    count = (time.size - 1) * substeps + 1
    fine, place = np.empty(count), np.zeros(count)
    stress, last = np.full(2, start_stress), np.full(2, start_stress)
    out, amps, scratch = np.zeros(2), np.zeros(2), (np.zeros(xi.shape[2]), np.zeros(2), np.zeros(2))
    fine[0], n, before = time[0], 0, np.inf
    for k in range(time.size):
        _note(k, number, c, hidden, wires, stress, temperature, stresses, xi, energy)
        if k == time.size - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        for j in range(substeps):
            start, part = time[k] + j * step, (j + 0.5) / substeps if is_linear else 0.0
            for i in range(number):
                demand = current[k, i] + part * (current[k + 1, i] - current[k, i])
                amps[i] = _supplied(c, hidden, wires, i, demand, largest)
            air = c.ambient + hidden.drift * (start - time[0])
            wind = 1.0 + (hidden.draught if start + 0.5 * step >= hidden.draught_instant else 0.0)
            ratio = 0.5 * step / before
            args = (amps, air, wind, step, ratio, place[n], scratch)
            place[n + 1] = _step(number, c, hidden, load, wires, stress, last, out, *args)
            before = step
            n += 1
            fine[n] = start + step
    return fine, place
