"""The Bouc-Wen law in its normalised form, and the seven-parameter form that it stands for.

    y = k_x x + k_w w,      dw = rho ( 1 - sigma sgn(dx) |w|^(n-1) w + (sigma - 1) |w|^n ) dx

(Ikhouane, Rodellar 2007; flexible-actuator paper eq. 4-5). Written by increments of the input it does not depend on the rate. |w| stays
below 1. The seven parameters of the older form, y = alpha k x + (1 - alpha) D k z, are two too many: different sets are one law.
"""

from typing import Any

import jax
import jax.numpy as jnp

from smajax.hysteresis.operator import AbstractOperator


class BoucWen(AbstractOperator):
    """The law's five parameters: ``kx``, ``kw``, ``rho`` > 0 (one over the input), ``sigma`` >= 1/2 and ``n`` >= 1.

    ``simulate.respond`` integrates it; ``slope`` is its differential equation.
    """

    kx: jax.Array
    kw: jax.Array
    rho: jax.Array
    sigma: jax.Array
    n: jax.Array

    def slope(self, w: jax.Array, direction: jax.Array) -> jax.Array:
        """dw/dx while the input goes up (``direction`` 1) or down (-1)."""
        size = jnp.abs(w)
        some = jnp.where(size > 0.0, size, 1.0)
        power = jnp.where(size > 0.0, some**self.n, 0.0)
        return self.rho * (1.0 - self.sigma * direction * power * jnp.sign(w) + (self.sigma - 1.0) * power)

    def start(self, first: jax.Array) -> jax.Array:
        """See ``AbstractOperator.start``: nothing is stored yet."""
        return jnp.zeros(())

    def output(self, state: Any, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``; ``state`` is w."""
        return self.kx * value + self.kw * state

    @classmethod
    def from_seven(cls, alpha: Any, k: Any, d: Any, a: Any, beta: Any, gamma: Any, n: Any) -> "BoucWen":
        """The law of z' = (A x' - beta |x'| |z|^(n-1) z - gamma x' |z|^n) / D, y = alpha k x + (1 - alpha) D k z.

        z_0 = (A / (beta + gamma))^(1/n) is the largest value that z comes near to.
        """
        alpha, k, d, a, beta, gamma, n = (jnp.asarray(v, jnp.float64) for v in (alpha, k, d, a, beta, gamma, n))
        largest = (a / (beta + gamma)) ** (1.0 / n)
        return cls(alpha * k, (1.0 - alpha) * d * k * largest, a / (d * largest), beta / (beta + gamma), n)

    def to_seven(self, d: float = 1.0, a: float = 1.0) -> dict[str, jax.Array]:
        """alpha, k, beta, gamma, n of the older form with ``d`` and ``a`` chosen, and these two."""
        largest = a / (d * self.rho)
        both = a / largest**self.n
        k = self.kx + self.kw / (d * largest)
        beta = self.sigma * both
        chosen = {"d": jnp.asarray(d), "a": jnp.asarray(a)}
        return {"alpha": self.kx / k, "k": k, "beta": beta, "gamma": both - beta, "n": self.n} | chosen
