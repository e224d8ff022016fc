"""Dead weight with hidden effects: fine steps, and every effect in an independent formulation.

The heat balance is stepped by a bisected implicit midpoint, friction is rigid (no elastic turn-around), play and lags act on the fine
steps and not on samples. Nothing here is shared with the package.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference.brinson import advance, resistivity, strain_of
from tests.reference.rig_file import RigFile
from tests.reference.wire import area, convection

Floats = NDArray[np.float64]


class Hidden(NamedTuple):
    """Hidden effects of the rig, in SI and K; all absent by default.

    ``exponent`` is an additional one of the remaining share in every transformation. ``pace`` is a wave of a transformation's pace, which
    is its own one times 1 + pace sin(2 pi share); ``load_step`` a relative change of the load from ``load_instant`` on; ``cubic`` a bend
    of the sensor per stroke squared: these three are in no catalogue. ``crosstalk`` needs a second wire (``hidden_pair``), which has no
    ``viscous``, ``arm`` and ``probe``.

    ``r_strain`` of the R-phase comes about by a normal distribution around ``r_above`` (K above the martensite start temperature, 15 MPa/K
    more under stress) of standard deviation ``r_spread``, of the martensite in the share ``r_kept``, and ``r_hump`` is the share by which
    all of it raises the resistivity. ``ceiling`` is the supply's voltage, ``shift`` what a cycle adds to the transformation temperatures,
    ``stop`` is the motion in m at which a rigid stop holds the wire, ``end_of_travel`` that at which the sensor stays behind while the wire
    goes on. ``arm`` the change of the load over the stroke, ``set_strain`` what the first heating takes away. ``probe_lag`` (s) and
    ``probe_pickup`` (K/A) are the thermocouple's.
    """

    latent_heat: float = 0.0
    drift: float = 0.0
    draught: float = 0.0
    draught_instant: float = 0.0
    coating: float = 0.0
    coating_time: float = 5.0
    ends: float = 0.0
    ends_time: float = 30.0
    capacity_change: float = 0.0
    convection_slope: float = 0.0
    saturation: float = 0.0
    friction: float = 0.0
    play: float = 0.0
    lag: float = 0.0
    skew: float = 0.0
    ratchet: float = 0.0
    fatigue: float = 0.0
    creep: float = 0.0
    creep_time: float = 15.0
    encoder_drift: float = 0.0
    crosstalk: float = 0.0
    exponent: float = 0.0
    pace: float = 0.0
    load_step: float = 0.0
    load_instant: float = 0.0
    cubic: float = 0.0
    r_strain: float = 0.0
    r_above: float = 0.0
    r_spread: float = 2.0
    r_kept: float = 0.0
    r_hump: float = 0.0
    ceiling: float = math.inf
    resistivity_slope: float = 0.0
    resistivity_strain: float = 0.0
    slack: float = 0.0
    slack_span: float = 1e-3
    viscous: float = 0.0
    shift: float = 0.0
    arm: float = 0.0
    set_strain: float = 0.0
    probe_lag: float = 0.0
    probe_pickup: float = 0.0
    stop: float = math.inf
    end_of_travel: float = math.inf


@njit(cache=True)
def _pace(hidden, remainder):
    """Return the rate of a transformation relative to that of the law, for the remaining fraction."""
    return remainder**hidden.exponent * (1.0 + hidden.pace * math.sin(2.0 * math.pi * remainder))


@njit(cache=True)
def _fractions(m, hidden, d0, w0, t0, s0, t1, s1):
    d1, w1 = advance(m, d0, w0, t0, s0, t1, s1)
    if hidden.exponent != 0.0 or hidden.pace != 0.0:
        before, after = d0 + w0, d1 + w1
        if after < before and before > 0.0:
            share = (after / before) ** _pace(hidden, before) if after > 0.0 else 0.0
            return d0 * share, w0 * share
        if after > before and before < 1.0:
            remainder = 1.0 - before
            share = ((1.0 - after) / remainder) ** _pace(hidden, remainder) if after < 1.0 else 0.0
            whole = 1.0 - remainder * share
            return d1 * whole / after, w1 * whole / after
    return d1, w1


@njit(cache=True)
def _r_share(m, hidden, xi, t, s):
    """Return the fraction of the wire with the strain of the R-phase."""
    middle = m.martensite_start + hidden.r_above + s / 15e6
    cold = 0.5 * math.erfc((t - middle) / (hidden.r_spread * math.sqrt(2.0)))
    return cold * (1.0 - xi + hidden.r_kept * xi)


@njit(cache=True)
def _strain(m, hidden, d, w, t, s, ambient, h):
    strain = strain_of(m, t, s, d, w, ambient) - h * m.max_transformation_strain * d
    if hidden.r_strain != 0.0:
        strain += hidden.r_strain * _r_share(m, hidden, d + w, t, s)
    return strain


@njit(cache=True)
def _rho(m, hidden, d, w, t, s, ambient):
    """Resistivity in ohm m."""
    more = hidden.resistivity_slope * (t - ambient) + 2.0 * hidden.resistivity_strain * m.max_transformation_strain * d
    if hidden.r_hump != 0.0:
        more += hidden.r_hump * _r_share(m, hidden, d + w, t, s)
    return resistivity(m, d + w) * (1.0 + more)


@njit(cache=True)
def _at_stop(m, hidden, wire, load, d, w, t, s, after, lost, shift, shortest):
    """Return the stress of a wire that is no shorter than the strain ``shortest``: that of the load, or more."""
    below, above = load, load + 2e9
    d1, w1 = _fractions(m, hidden, d, w, t - shift, s, after - shift, load)
    if _strain(m, hidden, d1, w1, after, load, wire.ambient, lost) >= shortest:
        return load
    for _ in range(50):
        stress = 0.5 * (below + above)
        d1, w1 = _fractions(m, hidden, d, w, t - shift, s, after - shift, stress)
        if _strain(m, hidden, d1, w1, after, stress, wire.ambient, lost) > shortest:
            above = stress
        else:
            below = stress
    return 0.5 * (below + above)


@njit(cache=True)
def _stress(m, hidden, wire, load, d, w, t, s, after, lost, shift, step, shortest):
    """Return the stress of the wire at the end of a step to a temperature.

    Under friction the one within its reach that keeps the length, or that at the end of its reach; in grease the one that is the load and
    the drag of the rate at which it contracts.
    """
    if hidden.friction == 0.0 and hidden.viscous == 0.0:
        if shortest > -math.inf:
            return _at_stop(m, hidden, wire, load, d, w, t, s, after, lost, shift, shortest)
        return load
    ambient = wire.ambient
    held_strain = _strain(m, hidden, d, w, t, s, ambient, lost)
    reach = hidden.friction if hidden.viscous == 0.0 else 3e8
    below, above = max(load - reach, 0.0), load + reach
    if hidden.viscous == 0.0:
        d1, w1 = _fractions(m, hidden, d, w, t - shift, s, after - shift, below)
        if _strain(m, hidden, d1, w1, after, below, ambient, lost) >= held_strain:
            return below
        d1, w1 = _fractions(m, hidden, d, w, t - shift, s, after - shift, above)
        if _strain(m, hidden, d1, w1, after, above, ambient, lost) <= held_strain:
            return above
    for _ in range(30 if hidden.viscous == 0.0 else 40):
        stress = 0.5 * (below + above)
        d1, w1 = _fractions(m, hidden, d, w, t - shift, s, after - shift, stress)
        longer = _strain(m, hidden, d1, w1, after, stress, ambient, lost) - held_strain
        if (longer if hidden.viscous == 0.0 else stress - load + hidden.viscous * longer / step) > 0.0:
            above = stress
        else:
            below = stress
    return 0.5 * (below + above)


@njit(cache=True)
def _run(m, heat, wire, hidden, weight, time, current, substeps, most):
    """Times, contraction, temperature and voltage on the fine steps."""
    section, ambient = area(wire), wire.ambient
    count = (time.size - 1) * substeps + 1
    fine, x, warm, volts = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    t, d, w, s = ambient, 1.0, 0.0, weight / section
    sleeve = crimps = travel = 0.0
    slow = remainder = 1.0
    start = _strain(m, hidden, d, w, t, s, ambient, 0.0) + hidden.set_strain
    shortest = start - hidden.stop / wire.length
    ohms = _rho(m, hidden, d, w, t, s, ambient) * wire.length / section
    fine[0], x[0], warm[0], volts[0] = (
        time[0],
        0.0,
        t,
        min(current[0] * (1.0 - hidden.saturation * current[0] ** 2 / (most * most)) * ohms, hidden.ceiling),
    )
    n, before = 0, t
    for k in range(time.size - 1):
        step = (time[k + 1] - time[k]) / substeps
        for j in range(substeps):
            now = time[k] + (j + 0.5) * step
            i = current[k] + (j + 0.5) / substeps * (current[k + 1] - current[k])
            i *= 1.0 - hidden.saturation * i * i / (most * most)
            air = ambient + hidden.drift * (now - time[0])
            ahead = t + 0.5 * (t - before)  # where the middle of this step will be
            before = t
            h = convection(heat, ahead) * (1.0 + hidden.convection_slope * (t - ambient) / 50.0)
            if now >= hidden.draught_instant:
                h *= 1.0 + hidden.draught
            cool, base = 4.0 / wire.diameter, convection(heat, ambient)
            load = weight / section * (1.0 + (hidden.load_step if now >= hidden.load_instant else 0.0))
            load *= 1.0 + hidden.arm * x[n] / (0.04 * wire.length)
            xi, shift = d + w, hidden.shift * 0.5 * travel
            capacity = heat.capacity_austenite + xi * (heat.capacity_martensite - heat.capacity_austenite)
            capacity *= 1.0 + hidden.capacity_change * xi
            low, high, lost = t - 20.0, t + 20.0, hidden.fatigue * 0.5 * travel
            for _ in range(44):
                middle = 0.5 * (low + high)
                half = 0.5 * (t + middle)
                stress = _stress(m, hidden, wire, load, d, w, t, s, middle, lost, shift, step, shortest)
                d1, w1 = _fractions(m, hidden, d, w, t - shift, s, middle - shift, stress)
                rho = _rho(m, hidden, 0.5 * (d + d1), 0.5 * (w + w1), half, stress, ambient)
                through = min(i, hidden.ceiling / (rho * wire.length / section))
                flow = rho * (through / section) ** 2 - cool * h * (half - air)
                flow -= (
                    cool * base * (hidden.coating * (half - ambient - sleeve) + hidden.ends * (half - ambient - crimps))
                )
                missing = capacity * (middle - t) + hidden.latent_heat * (xi - d1 - w1) - step * flow
                if missing > 0.0:
                    high = middle
                else:
                    low = middle
            after = 0.5 * (low + high)
            stress = _stress(m, hidden, wire, load, d, w, t, s, after, lost, shift, step, shortest)
            d1, w1 = _fractions(m, hidden, d, w, t - shift, s, after - shift, stress)
            travel += abs(d1 + w1 - xi)
            if d1 + w1 < xi:
                remainder *= (d1 + w1) / xi
            over = 0.5 * (t + after) - ambient
            sleeve += (1.0 - math.exp(-step / hidden.coating_time)) * (over - sleeve)
            crimps += (1.0 - math.exp(-step / hidden.ends_time)) * (0.5 * over - crimps)
            slow += (1.0 - math.exp(-step / hidden.creep_time)) * (0.5 * (xi + d1 + w1) - slow)
            t, d, w, s = after, d1, w1, stress
            n += 1
            strain = _strain(m, hidden, d, w, t, s, ambient, hidden.fatigue * 0.5 * travel)
            strain += hidden.ratchet * travel + hidden.creep * (slow - d - w) + hidden.set_strain * remainder
            ohms = _rho(m, hidden, d, w, t, s, ambient) * wire.length / section
            fine[n], x[n], warm[n] = time[k] + (j + 1) * step, wire.length * (start - strain), t
            input_now = current[k] + (j + 1) / substeps * (current[k + 1] - current[k])
            volts[n] = min(
                input_now * (1.0 - hidden.saturation * input_now * input_now / (most * most)) * ohms, hidden.ceiling
            )
    return fine, x, warm, volts


@njit(cache=True)
def _late(fine, y, lag):
    """Return a series on the fine steps after a first-order lag."""
    out, slow = np.empty(y.size), y[0]
    out[0] = slow
    for k in range(1, y.size):
        slow += (1.0 - math.exp(-(fine[k] - fine[k - 1]) / lag)) * (0.5 * (y[k - 1] + y[k]) - slow)
        out[k] = slow
    return out


@njit(cache=True)
def _behind(fine, x, hidden):
    """Apply slack, play and lag on the fine steps; the play starts at the end to which the weight pulls it."""
    y = np.empty(x.size)
    out = x[0]
    for k in range(x.size):
        seen = min(x[k], hidden.end_of_travel)
        out = min(max(out, seen - 2.0 * hidden.play), seen)
        y[k] = out - hidden.slack * out / math.sqrt(hidden.slack_span**2 + out**2)
    return _late(fine, y, hidden.lag) if hidden.lag > 0.0 else y


def channels(rig: RigFile, hidden: Hidden, time: Floats, current: Floats, substeps: int = 20) -> dict[str, Floats]:
    """Displacement (m), temperature (degC) and voltage (V) at the samples, each of shape ``(n,)``, of a dead weight under a current in A
    that is linear between samples."""
    weight = rig.mechanism["mass"] * 9.81
    hidden = Hidden(*map(float, hidden))
    fine, x, warm, volts = _run(
        rig.material, rig.heat, rig.wire, hidden, weight, time, current, substeps, float(np.max(current))
    )
    y = _behind(fine, x, hidden)
    stroke = 0.04 * rig.wire.length
    read = np.interp(time - hidden.skew, fine, y)
    read = read + hidden.encoder_drift * (time - time[0])
    seen = _late(fine, warm, hidden.probe_lag) if hidden.probe_lag > 0.0 else warm
    return {
        "displacement": read * (1.0 + hidden.cubic * (read / stroke) ** 2),
        "temperature": np.interp(time, fine, seen) + hidden.probe_pickup * current,
        "voltage": np.interp(time, fine, volts),
    }


def displacement(rig: RigFile, hidden: Hidden, time: Floats, current: Floats, substeps: int = 20) -> Floats:
    """Contraction in m of ``channels``."""
    return channels(rig, hidden, time, current, substeps)["displacement"]
