"""Properties of thermal cycles by ASTM E3097, and start values of a fit."""
