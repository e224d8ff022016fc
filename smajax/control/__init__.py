"""Controllers, observers, closed-loop rollouts, and the tuning of gains through them."""

from smajax import precision  # noqa: F401
