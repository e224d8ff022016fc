"""Two wires on a light pulley with hidden effects: those of ``hidden`` with a second wire.

Heun's rule in the heat taken up, each of its two ends with temperatures, fractions and the common stress solved by bracketing; friction
of the pulley is rigid: it stays where it is while the wires' stresses differ by less. Nothing here is shared with the package.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference.hidden import Hidden, _behind, _fractions, _rho, _strain
from tests.reference.rig_file import RigFile
from tests.reference.wire import _interpolate, _narrow, area, convection

Floats = NDArray[np.float64]


class _Wire(NamedTuple):
    """State and memory of one wire."""

    temperature: float
    stress: float
    detwinned: float
    twinned: float
    travel: float
    sleeve: float
    crimps: float
    slow: float
    left: float


@njit(cache=True)
def _reached(m, hidden, x, temperature, stress):
    """Return the fractions of a wire at a temperature and a stress; its history has shifted its transformation temperatures."""
    shift = hidden.shift * 0.5 * x.travel
    return _fractions(m, hidden, x.detwinned, x.twinned, x.temperature - shift, x.stress, temperature - shift, stress)


@njit(cache=True)
def _missing(m, heat, hidden, x, added, stress, temperature):
    d, w = _reached(m, hidden, x, temperature, stress)
    before = x.detwinned + x.twinned
    capacity = heat.capacity_austenite * (1.0 + hidden.capacity_change * before)
    return capacity * (temperature - x.temperature) - hidden.latent_heat * (d + w - before) - added


@njit(cache=True)
def _taken_up(m, heat, hidden, x, added, stress):
    """Return temperature and fractions of a wire after it absorbed ``added`` J/m^3 while the stress changed."""
    if hidden.latent_heat == 0.0:
        after = x.temperature + added / (
            heat.capacity_austenite * (1.0 + hidden.capacity_change * (x.detwinned + x.twinned))
        )
    else:
        low, high = x.temperature - 1e-9, x.temperature + 1e-9
        reach = 1e-9 + abs(added) / heat.capacity_austenite
        f_low = _missing(m, heat, hidden, x, added, stress, low)
        while f_low > 0.0:
            low -= reach
            f_low = _missing(m, heat, hidden, x, added, stress, low)
            reach *= 2.0
        f_high = _missing(m, heat, hidden, x, added, stress, high)
        while f_high < 0.0:
            high += reach
            f_high = _missing(m, heat, hidden, x, added, stress, high)
            reach *= 2.0
        after = low if f_low == 0.0 else high
        for _ in range(60):
            if f_low == 0.0 or f_high == 0.0 or high - low < 1e-11:
                break
            after = _interpolate(low, f_low, high, f_high)
            f_after = _missing(m, heat, hidden, x, added, stress, after)
            if abs(f_after) < 1e-5:
                break
            low, f_low, high, f_high = _narrow(low, f_low, high, f_high, after, f_after)
    d, w = _reached(m, hidden, x, after, stress)
    return after, d, w


@njit(cache=True)
def _strain_after(m, heat, hidden, wire, x, added, stress):
    t, d, w = _taken_up(m, heat, hidden, x, added, stress)
    strain = _strain(m, hidden, d, w, t, stress, wire.ambient, hidden.fatigue * 0.5 * x.travel)
    return (
        strain
        + hidden.ratchet * x.travel
        + hidden.creep * (x.slow - d - w)
        + hidden.set_strain * (_left(x, d + w) - 1.0)
    )


@njit(cache=True)
def _left(x, xi):
    """Return the remaining fraction of the initial martensite."""
    before = x.detwinned + x.twinned
    return x.left * xi / before if xi < before else x.left


@njit(cache=True)
def _surplus(m, heat, hidden, wire, first, second, q1, q2, s1, lead, right, is_held):
    """Return the excess strain of both wires, with ``lead`` less stress in wire 2, or (``is_held``) of wire 1 alone."""
    value = _strain_after(m, heat, hidden, wire, first, q1, max(s1, 0.0)) - right
    return value if is_held else value + _strain_after(m, heat, hidden, wire, second, q2, max(s1 - lead, 0.0))


@njit(cache=True)
def _solved(m, heat, hidden, wire, first, second, q1, q2, lead, right, is_held):
    """Return the stress of wire 1; the lowest possible one if the wires are slack."""
    low = 0.0 if is_held else max(lead, 0.0)
    f_low = _surplus(m, heat, hidden, wire, first, second, q1, q2, low, lead, right, is_held)
    if f_low >= 0.0:
        return low
    high, reach = max(first.stress, low), 1e4
    f_high = _surplus(m, heat, hidden, wire, first, second, q1, q2, high, lead, right, is_held)
    while f_high < 0.0:
        low, f_low = high, f_high
        high += reach
        f_high = _surplus(m, heat, hidden, wire, first, second, q1, q2, high, lead, right, is_held)
        reach *= 8.0
    if f_high == 0.0:
        return high
    for _ in range(100):
        middle = _interpolate(low, f_low, high, f_high)
        f_middle = _surplus(m, heat, hidden, wire, first, second, q1, q2, middle, lead, right, is_held)
        if abs(f_middle) < 1e-14 or high - low < 1e-3:
            return middle
        low, f_low, high, f_high = _narrow(low, f_low, high, f_high, middle, f_middle)
    return 0.5 * (low + high)


@njit(cache=True)
def _balanced(m, heat, hidden, wire, first, second, q1, q2, lean):
    """Return the stresses of both wires after they absorbed heat, and the position of the pulley as strain of a wire."""
    right = 2.0 * wire.prestrain
    if hidden.friction == 0.0:
        s = _solved(m, heat, hidden, wire, first, second, q1, q2, 0.0, right, False)
        s1, s2 = s, s
    else:
        s1 = _solved(m, heat, hidden, wire, first, first, q1, 0.0, 0.0, wire.prestrain - lean, True)
        s2 = _solved(m, heat, hidden, wire, second, second, q2, 0.0, 0.0, wire.prestrain + lean, True)
        if abs(s1 - s2) <= hidden.friction:
            return s1, s2, lean
        lead = math.copysign(hidden.friction, s1 - s2)
        s1 = _solved(m, heat, hidden, wire, first, second, q1, q2, lead, right, False)
        s2 = max(s1 - lead, 0.0)
    e1 = _strain_after(m, heat, hidden, wire, first, q1, s1)
    e2 = _strain_after(m, heat, hidden, wire, second, q2, s2)
    return s1, s2, min(max(lean, wire.prestrain - e1), e2 - wire.prestrain)


@njit(cache=True)
def _heating(m, heat, hidden, wire, x, other, current, air, instant, most):
    """Net heat into a wire in W/m^3."""
    section, over = area(wire), x.temperature - wire.ambient
    rho = _rho(m, hidden, x.detwinned, x.twinned, x.temperature, x.stress, wire.ambient)
    i = current * (1.0 - hidden.saturation * current * current / (most * most))
    i = min(i, hidden.ceiling / (rho * wire.length / section))
    h = convection(heat, x.temperature) * (1.0 + hidden.convection_slope * over / 50.0)
    if instant >= hidden.draught_instant:
        h *= 1.0 + hidden.draught
    lost = h * (x.temperature - air)
    lost += convection(heat, wire.ambient) * (
        hidden.coating * (over - x.sleeve)
        + hidden.ends * (over - x.crimps)
        + hidden.crosstalk * (x.temperature - other.temperature)
    )
    return rho * (i / section) ** 2 - 4.0 / wire.diameter * lost


@njit(cache=True)
def _moved(m, heat, hidden, wire, x, added, stress, step):
    t, d, w = _taken_up(m, heat, hidden, x, added, stress)
    xi = d + w
    over = 0.5 * (x.temperature + t) - wire.ambient
    return _Wire(
        t, stress, d, w, x.travel + abs(xi - x.detwinned - x.twinned),
        x.sleeve + (1.0 - math.exp(-step / hidden.coating_time)) * (over - x.sleeve),
        x.crimps + (1.0 - math.exp(-step / hidden.ends_time)) * (0.5 * over - x.crimps),
        x.slow + (1.0 - math.exp(-step / hidden.creep_time)) * (0.5 * (x.detwinned + x.twinned + xi) - x.slow),
        _left(x, xi),
    )  # fmt: skip


@njit(cache=True)
def _run(m, heat, wire, hidden, time, current, substeps, most):
    count = (time.size - 1) * substeps + 1
    fine, leans = np.empty(count), np.empty(count)
    drawn = min(wire.prestrain / m.max_transformation_strain, 1.0)
    first = second = _Wire(wire.ambient, 0.0, drawn, 1.0 - drawn, 0.0, 0.0, 0.0, 1.0, 1.0)
    lean, n = 0.0, 0
    fine[0], leans[0] = time[0], 0.0
    for k in range(time.size - 1):
        step = (time[k + 1] - time[k]) / substeps
        i1, i2 = current[k, 0], current[k, 1]
        for j in range(substeps):
            now = time[k] + j * step
            air, later = (
                wire.ambient + hidden.drift * (now - time[0]),
                wire.ambient + hidden.drift * (now + step - time[0]),
            )
            q1 = step * _heating(m, heat, hidden, wire, first, second, i1, air, now, most)
            q2 = step * _heating(m, heat, hidden, wire, second, first, i2, air, now, most)
            s1, s2, _ = _balanced(m, heat, hidden, wire, first, second, q1, q2, lean)
            there1 = _moved(m, heat, hidden, wire, first, q1, s1, step)
            there2 = _moved(m, heat, hidden, wire, second, q2, s2, step)
            q1 = 0.5 * (q1 + step * _heating(m, heat, hidden, wire, there1, there2, i1, later, now, most))
            q2 = 0.5 * (q2 + step * _heating(m, heat, hidden, wire, there2, there1, i2, later, now, most))
            s1, s2, lean = _balanced(m, heat, hidden, wire, first, second, q1, q2, lean)
            first, second = (
                _moved(m, heat, hidden, wire, first, q1, s1, step),
                _moved(m, heat, hidden, wire, second, q2, s2, step),
            )
            n += 1
            fine[n], leans[n] = time[k] + (j + 1) * step, lean
    return fine, leans


@njit(cache=True)
def _loose(x, play):
    """Return the output of a play of width ``2 play``, which starts in its middle."""
    y = np.empty(x.size)
    out = x[0]
    for k in range(x.size):
        out = min(max(out, x[k] - play), x[k] + play)
        y[k] = out
    return y


def angle(
    rig: RigFile, hidden: Hidden, time: Floats, current: Floats, substeps: int = 20, rated: float = 0.47
) -> Floats:
    """Angle in rad at the samples, shape ``(n,)``, under currents in A, shape ``(n, 2)``, held between samples.

    ``play`` is in rad, as ``encoder_drift`` is in rad/s; ``friction`` the difference of the wires' stresses that moves the pulley;
    ``saturation`` the share of the current that is lost at ``rated`` A.
    """
    hidden = Hidden(*map(float, hidden))
    fine, lean = _run(rig.material, rig.heat, rig.wire, hidden, time, np.ascontiguousarray(current), substeps, rated)
    y = _behind(fine, _loose(lean * rig.wire.length / rig.mechanism["radius"], hidden.play), hidden._replace(play=0.0))
    read = np.interp(time - hidden.skew, fine, y) + hidden.encoder_drift * (time - time[0])
    return read * (1.0 + hidden.cubic * (read / 0.5) ** 2)
