"""The Bouc-Wen law in its normalised form, and the seven-parameter form that it stands for.

    y = k_x x + k_w w,      dw = rho ( 1 - sigma sgn(dx) |w|^(n-1) w + (sigma - 1) |w|^n ) dx

(Ikhouane, Rodellar 2007; flexible-actuator paper eq. 4-5). Written by increments of the input it does not depend on the rate. |w| stays
below 1. The seven parameters of the older form, y = alpha k x + (1 - alpha) D k z, are two too many: different sets are one law.

While the input goes one way, v = sgn(dx) w rises along one and the same curve, whatever rho and wherever it begins:

    dv / d(rho |x|) = 1 - v^n  for v >= 0,      1 + (2 sigma - 1) |v|^n  for v < 0

So this curve is integrated once, as the way rho |x| that it takes to come to a place, and each row goes its way along it. The place is v
itself below 0 and -log(1 - v) above, where v nears 1 for ever: there the way goes straight, so that a step of the input is as exact as a
small one, and |w| <= 1 holds by construction.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from smajax.errors import InputError
from smajax.hysteresis.operator import AbstractOperator
from smajax.kinks import larger, within

_FULL = 36.0  # the place at which 1 - v is a rounding error
_BELOW, _ABOVE = 112, 108
# Closer around 0, where |v|^n with n below 2 is least smooth, and at -1, where a large n bends most.
_FALLING = -0.5 * (1.0 + np.cos(np.pi * np.arange(_BELOW) / _BELOW))
PLACES = np.concatenate([_FALLING, _FULL * np.linspace(0.0, 1.0, _ABOVE + 1) ** 3])


class BoucWen(AbstractOperator):
    """The law's five parameters: ``kx``, ``kw``, ``rho`` > 0 (one over the input), ``sigma`` > 0 and ``n`` >= 1.

    ``rest`` is what the output's sensor reads where x and w are 0; the law itself has none.
    Below a ``sigma`` of 1/2, where fits do not look, w bends away from its end as it comes back, as no material does.
    ``simulate.respond`` integrates the curve and follows it.
    """

    kx: jax.Array
    kw: jax.Array
    rho: jax.Array
    sigma: jax.Array
    n: jax.Array
    rest: jax.Array = eqx.field(default_factory=lambda: jnp.zeros(()))

    def start(self, first: jax.Array) -> jax.Array:
        """See ``AbstractOperator.start``: nothing is stored yet."""
        return jnp.zeros(())

    def output(self, state: Any, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``; ``state`` is w."""
        return self.rest + self.kx * value + self.kw * state

    def follow(self, ways: jax.Array, values: jax.Array) -> jax.Array:
        """Outputs for the inputs ``values``, shape ``(n,)`` each; ``ways`` to the ``PLACES``, shape ``(m,)``, come from ``slowness``."""
        slownesses = jax.vmap(self.slowness)(jnp.asarray(PLACES))
        curve = _pieces(PLACES, ways, slownesses), _pieces(ways, PLACES, 1.0 / slownesses)
        first = self.start(values[0])
        rest = _walk(first, curve, self.rho, ways[-1], jnp.diff(values))
        return jax.vmap(self.output)(jnp.append(first, rest), values)

    def slowness(self, place: jax.Array) -> jax.Array:
        """The curve's differential equation: d(rho |x|) / d(place)."""
        size = jnp.abs(_level(place))
        some = jnp.where(size > 0.0, size, 1.0)
        power = jnp.where(size > 0.0, some**self.n, 0.0)
        gap = jnp.where(place > 0.0, jnp.exp(-larger(place, 0.0)), 0.5)
        above = -jnp.expm1(self.n * jnp.log1p(-gap)) / gap  # (1 - v^n) / (1 - v) without differences of what is almost the same
        return 1.0 / jnp.where(place > 0.0, above, 1.0 + (2.0 * self.sigma - 1.0) * power)

    @classmethod
    def from_seven(cls, alpha: Any, k: Any, d: Any, a: Any, beta: Any, gamma: Any, n: Any) -> "BoucWen":
        """The law of z' = (A x' - beta |x'| |z|^(n-1) z - gamma x' |z|^n) / D, y = alpha k x + (1 - alpha) D k z.

        z_0 = (A / (beta + gamma))^(1/n) is the largest value that z comes near to. Raises ``InputError`` where there is none, where z runs
        away from it, where n is below 1, or where one of the seven is no finite number.
        """
        seven = [jnp.asarray(v, jnp.float64) for v in (alpha, k, d, a, beta, gamma, n)]
        alpha, k, d, a, beta, gamma, n = seven
        if not all(isinstance(v, Tracer) or bool(jnp.all(jnp.isfinite(v))) for v in seven):
            raise InputError("one of the seven parameters is no finite number: give alpha, k, D, A, beta, gamma and n as numbers")
        traced = any(isinstance(v, Tracer) for v in (d, a, beta, gamma, n))
        if not traced and not bool(jnp.all((a * (beta + gamma) > 0.0) & (a * beta > 0.0) & (a * d > 0.0) & (n >= 1.0))):
            raise InputError("no normalised form has these: give A, D, beta and beta + gamma of one sign, and n of at least 1")
        largest = (a / (beta + gamma)) ** (1.0 / n)
        return cls(alpha * k, (1.0 - alpha) * d * k * largest, a / (d * largest), beta / (beta + gamma), n)

    def to_seven(self, d: float = 1.0, a: float = 1.0) -> dict[str, jax.Array]:
        """alpha, k, beta, gamma, n of the older form with ``d`` and ``a`` chosen, and these two.

        Raises ``InputError`` where k is 0, so that no alpha makes k_x of it.
        """
        largest = a / (d * self.rho)
        both = a / largest**self.n
        k = self.kx + self.kw / (d * largest)
        if not isinstance(k, Tracer) and bool(jnp.any(k == 0.0)):
            raise InputError("kx and kw cancel with this a, and the older form has no stiffness k: choose another a")
        beta = self.sigma * both
        chosen = {"d": jnp.asarray(d), "a": jnp.asarray(a)}
        return {"alpha": self.kx / k, "k": k, "beta": beta, "gamma": both - beta, "n": self.n} | chosen


def _level(place: jax.Array) -> jax.Array:
    """v at a place of the curve."""
    return jnp.where(place < 0.0, place, -jnp.expm1(-larger(place, 0.0)))


def _place(level: jax.Array) -> jax.Array:
    """The place of v on the curve."""
    gap = larger(1.0 - larger(level, 0.0), np.exp(-_FULL))
    return jnp.where(level < 0.0, larger(level, -1.0), -jnp.log(gap))


def _pieces(knots: Any, values: Any, slopes: jax.Array) -> jax.Array:
    """What Hermite's cubic needs between knots, shape ``(m - 1, 6)``."""
    knots, values = jnp.asarray(knots), jnp.asarray(values)
    return jnp.stack([knots[:-1], jnp.diff(knots), values[:-1], jnp.diff(values), slopes[:-1], slopes[1:]], axis=1)


def _found(at: jax.Array, pieces: jax.Array) -> jax.Array:
    """The row of the piece in which a scalar lies."""
    return jnp.sum(at >= pieces[1:, 0])


def _between(at: jax.Array, piece: jax.Array) -> jax.Array:
    """Hermite's cubic on a piece, shape ``(6,)``; scalar."""
    knot, wide, value, rise, slope, next_slope = piece
    share = (at - knot) / wide
    bend = (1.0 - share) * (slope * wide - rise) - share * (next_slope * wide - rise)
    return value + share * rise + share * (1.0 - share) * bend


def _way(w: jax.Array, side: jax.Array, piece: jax.Array, rho: jax.Array, end: jax.Array, moved: jax.Array) -> jax.Array:
    """How far along the curve w is after the input has ``moved``, up to the curve's ``end``."""
    return within(_between(_place(side * w), piece) + rho * jnp.abs(moved), 0.0, end)


def _reached(w: jax.Array, side: jax.Array, way: jax.Array, piece: jax.Array, moved: jax.Array) -> jax.Array:
    """The new w."""
    place = within(_between(way, piece), PLACES[0], PLACES[-1])
    return jnp.where(moved == 0.0, w, side * _level(place))


def _steps(first: jax.Array, curve: tuple, rho: jax.Array, end: jax.Array, moved: jax.Array) -> tuple[jax.Array, jax.Array]:
    """w after each change of the input, shape ``(k,)``, and the rows of the pieces that it went by, shape ``(k, 2)``."""

    def one(w: jax.Array, moved: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        side = jnp.where(moved < 0.0, -1.0, 1.0)
        start = _found(_place(side * w), curve[0])
        way = _way(w, side, curve[0][start], rho, end, moved)
        stop = _found(way, curve[1])
        w = _reached(w, side, way, curve[1][stop], moved)
        return w, (w, jnp.stack([start, stop]))

    return jax.lax.scan(one, first, moved)[1]


@jax.custom_jvp
def _walk(first: jax.Array, curve: tuple, rho: jax.Array, end: jax.Array, moved: jax.Array) -> jax.Array:
    return _steps(first, curve, rho, end, moved)[0]


@_walk.defjvp
def _walk_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    """Along the pieces that the walk went by, picked for all its steps at once.

    Picked within the loop, each step's tangent would cost a sum over all pieces, or a scattered sum once reversed: that comes out wrong
    where XLA compiles the loop around it as one function.
    """
    rows = _steps(*primals)[1]

    def again(first: jax.Array, curve: tuple, rho: jax.Array, end: jax.Array, moved: jax.Array) -> jax.Array:
        def one(w: jax.Array, step: tuple) -> tuple[jax.Array, jax.Array]:
            moved, start, stop = step
            side = jnp.where(moved < 0.0, -1.0, 1.0)
            w = _reached(w, side, _way(w, side, start, rho, end, moved), stop, moved)
            return w, w

        return jax.lax.scan(one, first, (moved, curve[0][rows[:, 0]], curve[1][rows[:, 1]]))[1]

    return jax.jvp(again, primals, tangents)
