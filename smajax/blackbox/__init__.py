"""Black boxes: input-output laws that know nothing of the wire."""

from smajax import jax_options  # noqa: F401
