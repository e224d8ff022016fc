"""Hysteresis operators: input-output laws without physics."""

from smajax import precision  # noqa: F401
