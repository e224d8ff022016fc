"""Hysteresis operators: input-output laws without physics."""

from smajax import jax_options  # noqa: F401
