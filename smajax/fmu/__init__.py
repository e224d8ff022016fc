"""Plants and controllers as functional mock-up units (FMI 2.0, co-simulation), in plain NumPy."""
