"""Exact, non-smooth and slow simulators in NumPy and numba. They share no code with smajax, verify it, and make the shipped recordings."""
