"""Controllers, observers, closed-loop rollouts, and the tuning of gains through them."""

from smajax import jax_options  # noqa: F401
