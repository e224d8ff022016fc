"""Hysteresis operators: input-output laws without physics."""
