"""Plants and controllers as functional mock-up units (FMI 2.0, co-simulation) whose equations are plain NumPy.

``models`` (``model``, ``plant_model``, ``controller_model``) describes variables and equations, ``numpy_source`` writes
JAX functions as NumPy text, ``pack`` writes the FMU, and ``slave`` runs inside of it.
"""
