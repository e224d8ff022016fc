"""Bouc-Wen hysteresis model in its normalised form, and its conversion from and to the seven-parameter form.

    y = k_x x + k_w w,      dw = rho (1 - sigma sgn(dx) |w|^(n-1) w + (sigma - 1) |w|^n) dx

x is the input, y the output, and w the hysteretic state. The model is written in increments of the input, so it does
not depend on the rate; |w| stays below 1. The older form has seven parameters, y = alpha k x + (1 - alpha) D k z. Two
of them are redundant: different sets give the same model.

While the input is monotonic, v = sgn(dx) w increases along one curve, which depends neither on rho nor on the starting
point:

    dv / d(rho |x|) = 1 - v^n  for v >= 0,      1 + (2 sigma - 1) |v|^n  for v < 0

So the curve is integrated once (``smajax.laws.response``), and each row moves along it
(``smajax.laws.bouc_wen_curve``).

Source: ikhouane2007 (normalised form); copaci2020, equations 4 and 5.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from smajax.errors import InputError
from smajax.laws.base import AbstractSeriesModel
from smajax.laws.bouc_wen_curve import CURVE_GRID, hermite_pieces, level_at, move_along_curve
from smajax.numerics.nonsmooth import maximum


class BoucWen(AbstractSeriesModel):
    """Normalised Bouc-Wen model: y = rest + k_x x + k_w w.

    For ``sigma`` below 1/2, which fits exclude, w curves away from its limit on unloading, as no material does.
    ``smajax.laws.response.compute_response`` evaluates the model.

    Attributes:
        kx: Output per input, k_x.
        kw: Output per hysteretic state, k_w.
        rho: Rate of the hysteretic state per input, positive, one over the unit of the input.
        sigma: Shape parameter, positive.
        n: Exponent, at least 1.
        rest: Output at x = w = 0, the offset of the sensor.
    """

    kx: jax.Array
    kw: jax.Array
    rho: jax.Array
    sigma: jax.Array
    n: jax.Array
    rest: jax.Array = eqx.field(default_factory=lambda: jnp.zeros(()))

    def init(self, first: Float[Array, ""]) -> Float[Array, ""]:
        """Return w at the first row: 0."""
        return jnp.zeros(())

    def output(self, state: Any, value: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the output k_x x + k_w w plus its offset; ``state`` is w."""
        return self.rest + self.kx * value + self.kw * state

    def response_along_curve(
        self, lengths: Float[Array, " grid"], values: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the outputs at all rows by moving along the integrated curve.

        Args:
            lengths: Path lengths rho |x| from the start of the curve to the points of ``CURVE_GRID``: the integral of
                ``curve_slope``.
            values: Inputs at the rows.
        """
        slopes = jax.vmap(self.curve_slope)(jnp.asarray(CURVE_GRID))
        curve = hermite_pieces(CURVE_GRID, lengths, slopes), hermite_pieces(lengths, CURVE_GRID, 1.0 / slopes)
        first = self.init(values[0])
        w = move_along_curve(first, curve, self.rho, lengths[-1], jnp.diff(values))
        return jax.vmap(self.output)(jnp.append(first, w), values)

    def curve_slope(self, coordinate: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the slope d(rho |x|) / d(coordinate) of the curve, from the differential equation of v.

        Args:
            coordinate: Coordinate of the curve (``smajax.laws.bouc_wen_curve``).
        """
        size = jnp.abs(level_at(coordinate))
        nonzero = jnp.where(size > 0.0, size, 1.0)
        power = jnp.where(size > 0.0, nonzero**self.n, 0.0)
        gap = jnp.where(coordinate > 0.0, jnp.exp(-maximum(coordinate, 0.0)), 0.5)
        # (1 - v^n) / (1 - v) without cancellation.
        above = -jnp.expm1(self.n * jnp.log1p(-gap)) / gap
        return 1.0 / jnp.where(coordinate > 0.0, above, 1.0 + (2.0 * self.sigma - 1.0) * power)

    @classmethod
    def from_seven_parameters(cls, alpha: Any, k: Any, d: Any, a: Any, beta: Any, gamma: Any, n: Any) -> "BoucWen":
        """Return the normalised form of a seven-parameter model.

            z' = (A x' - beta |x'| |z|^(n-1) z - gamma x' |z|^n) / D,     y = alpha k x + (1 - alpha) D k z

        The limit of |z| is z_0 = (A / (beta + gamma))^(1/n). Then w = z / z_0 and

            k_x = alpha k,   k_w = (1 - alpha) D k z_0,   rho = A / (D z_0),   sigma = beta / (beta + gamma)

        Args:
            alpha: Ratio of the elastic stiffness to k.
            k: Stiffness.
            d: D, scale of z.
            a: A, initial rate of z.
            beta: Shape parameter.
            gamma: Shape parameter.
            n: Exponent.

        Raises:
            InputError: If there is no limit, if z diverges from it, if n is below 1, or if a parameter is not finite.

        Source: ikhouane2007.
        """
        parameters = [jnp.asarray(v, jnp.float64) for v in (alpha, k, d, a, beta, gamma, n)]
        alpha, k, d, a, beta, gamma, n = parameters
        if not all(isinstance(v, Tracer) or bool(jnp.all(jnp.isfinite(v))) for v in parameters):
            raise InputError(
                "one of the seven parameters is not a finite number: give alpha, k, D, A, beta, gamma and n as numbers"
            )
        traced = any(isinstance(v, Tracer) for v in (d, a, beta, gamma, n))
        if not traced and not bool(jnp.all((a * (beta + gamma) > 0.0) & (a * beta > 0.0) & (a * d > 0.0) & (n >= 1.0))):
            raise InputError(
                "these seven parameters have no normalised form: give A, D, beta and beta + gamma of one sign, "
                "and n of at least 1"
            )
        limit = (a / (beta + gamma)) ** (1.0 / n)
        return cls(alpha * k, (1.0 - alpha) * d * k * limit, a / (d * limit), beta / (beta + gamma), n)

    def to_seven_parameters(self, d: float = 1.0, a: float = 1.0) -> dict[str, jax.Array]:
        """Return the seven parameters of the older form for a choice of two of them.

        Args:
            d: Chosen value of D.
            a: Chosen value of A.

        Returns:
            The seven parameters by name, as in ``from_seven_parameters``.

        Raises:
            InputError: If k is 0, so that no alpha gives k_x.
        """
        limit = a / (d * self.rho)
        beta_plus_gamma = a / limit**self.n
        k = self.kx + self.kw / (d * limit)
        if not isinstance(k, Tracer) and bool(jnp.any(k == 0.0)):
            raise InputError("kx and kw cancel with this a, and the older form has no stiffness k: choose another a")
        beta = self.sigma * beta_plus_gamma
        chosen = {"d": jnp.asarray(d), "a": jnp.asarray(a)}
        return {"alpha": self.kx / k, "k": k, "beta": beta, "gamma": beta_plus_gamma - beta, "n": self.n} | chosen
