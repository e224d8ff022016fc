"""A dead weight with things that nobody wrote down: fine steps, every effect in a form of its own.

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
    """What the rig has beside its file, SI and K; all absent by default.

    ``exponent`` is an additional one of the remaining share in every transformation. ``pace`` is a wave of a transformation's pace, which
    is its own one times 1 + pace sin(2 pi share); ``load_step`` a relative change of the load from ``load_instant`` on; ``cubic`` a bend
    of the sensor per stroke squared: these three are in no catalogue. ``crosstalk`` needs a second wire (``hidden_pair``).
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


@njit(cache=True)
def _pace(hidden, left):
    """How fast what is left of a phase goes, over the law's own pace."""
    return left**hidden.exponent * (1.0 + hidden.pace * math.sin(2.0 * math.pi * left))


@njit(cache=True)
def _fractions(m, hidden, d0, w0, t0, s0, t1, s1):
    d1, w1 = advance(m, d0, w0, t0, s0, t1, s1)
    if hidden.exponent != 0.0 or hidden.pace != 0.0:
        before, after = d0 + w0, d1 + w1
        if after < before and before > 0.0:
            share = (after / before) ** _pace(hidden, before) if after > 0.0 else 0.0
            return d0 * share, w0 * share
        if after > before and before < 1.0:
            left = 1.0 - before
            share = ((1.0 - after) / left) ** _pace(hidden, left) if after < 1.0 else 0.0
            whole = 1.0 - left * share
            return d1 * whole / after, w1 * whole / after
    return d1, w1


@njit(cache=True)
def _strain(m, d, w, t, s, ambient, h):
    return strain_of(m, t, s, d, w, ambient) - h * m.max_strain * d


@njit(cache=True)
def _stress(m, hidden, wire, load, d, w, t, s, after, lost):
    """The stress within the reach of friction that keeps the length while the wire goes to a temperature, or that at the end of its reach."""
    if hidden.friction == 0.0:
        return load
    ambient = wire.ambient
    held = _strain(m, d, w, t, s, ambient, lost)
    below, above = load - hidden.friction, load + hidden.friction
    d1, w1 = _fractions(m, hidden, d, w, t, s, after, below)
    if _strain(m, d1, w1, after, below, ambient, lost) >= held:
        return below
    d1, w1 = _fractions(m, hidden, d, w, t, s, after, above)
    if _strain(m, d1, w1, after, above, ambient, lost) <= held:
        return above
    for _ in range(30):
        stress = 0.5 * (below + above)
        d1, w1 = _fractions(m, hidden, d, w, t, s, after, stress)
        if _strain(m, d1, w1, after, stress, ambient, lost) > held:
            above = stress
        else:
            below = stress
    return 0.5 * (below + above)


@njit(cache=True)
def _run(m, heat, wire, hidden, weight, time, current, substeps, most):
    section, ambient = area(wire), wire.ambient
    count = (time.size - 1) * substeps + 1
    fine, x = np.empty(count), np.empty(count)
    t, d, w, s = ambient, 1.0, 0.0, weight / section
    sleeve = crimps = travel = 0.0
    slow = 1.0
    start = _strain(m, d, w, t, s, ambient, 0.0)
    fine[0], x[0] = time[0], 0.0
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
            xi = d + w
            capacity = heat.capacity_austenite + xi * (heat.capacity_martensite - heat.capacity_austenite)
            capacity *= 1.0 + hidden.capacity_change * xi
            low, high, lost = t - 20.0, t + 20.0, hidden.fatigue * 0.5 * travel
            for _ in range(44):
                middle = 0.5 * (low + high)
                half = 0.5 * (t + middle)
                stress = _stress(m, hidden, wire, load, d, w, t, s, middle, lost)
                d1, w1 = _fractions(m, hidden, d, w, t, s, middle, stress)
                flow = resistivity(m, 0.5 * (xi + d1 + w1)) * (i / section) ** 2 - cool * h * (half - air)
                flow -= cool * base * (hidden.coating * (half - ambient - sleeve) + hidden.ends * (half - ambient - crimps))
                missing = capacity * (middle - t) + hidden.latent_heat * (xi - d1 - w1) - step * flow
                if missing > 0.0:
                    high = middle
                else:
                    low = middle
            after = 0.5 * (low + high)
            stress = _stress(m, hidden, wire, load, d, w, t, s, after, lost)
            d1, w1 = _fractions(m, hidden, d, w, t, s, after, stress)
            travel += abs(d1 + w1 - xi)
            over = 0.5 * (t + after) - ambient
            sleeve += (1.0 - math.exp(-step / hidden.coating_time)) * (over - sleeve)
            crimps += (1.0 - math.exp(-step / hidden.ends_time)) * (0.5 * over - crimps)
            slow += (1.0 - math.exp(-step / hidden.creep_time)) * (0.5 * (xi + d1 + w1) - slow)
            t, d, w, s = after, d1, w1, stress
            n += 1
            strain = _strain(m, d, w, t, s, ambient, hidden.fatigue * 0.5 * travel)
            strain += hidden.ratchet * travel + hidden.creep * (slow - d - w)
            fine[n], x[n] = time[k] + (j + 1) * step, wire.length * (start - strain)
    return fine, x


@njit(cache=True)
def _behind(fine, x, hidden):
    """Play and lag, on the fine steps; the play begins at the end at which the weight holds it."""
    y = np.empty(x.size)
    out = x[0]
    for k in range(x.size):
        out = min(max(out, x[k] - 2.0 * hidden.play), x[k])
        y[k] = out
    if hidden.lag > 0.0:
        slow, last = y[0], y[0]
        for k in range(1, x.size):
            slow += (1.0 - math.exp(-(fine[k] - fine[k - 1]) / hidden.lag)) * (0.5 * (last + y[k]) - slow)
            last, y[k] = y[k], slow
    return y


def displacement(rig: RigFile, hidden: Hidden, time: Floats, current: Floats, substeps: int = 20) -> Floats:
    """Contraction in m at the samples, shape ``(n,)``, of a dead weight under a current in A that is linear between samples."""
    weight = rig.mechanism["mass"] * 9.81
    hidden = Hidden(*map(float, hidden))
    fine, x = _run(rig.material, rig.heat, rig.wire, hidden, weight, time, current, substeps, float(np.max(current)))
    y = _behind(fine, x, hidden)
    stroke = 0.04 * rig.wire.length
    read = np.interp(time - hidden.skew, fine, y)
    read = read + hidden.encoder_drift * (time - time[0])
    return read * (1.0 + hidden.cubic * (read / stroke) ** 2)
