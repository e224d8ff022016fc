"""Plants and controllers as functional mock-up units (FMI 2.0, co-simulation) whose equations are plain NumPy.

``plant_model`` and ``controller_model`` build a ``model`` with variables and equations, ``numpy_source`` writes JAX
functions as NumPy text, ``pack`` packs the FMU, and ``slave`` is the code that runs in it.
"""
