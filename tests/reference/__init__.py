"""Slow, exact, non-smooth simulators in plain NumPy and numba. They share no code with smajax, prove it, and make the shipped recordings."""
