"""Fitting: parameters of a plant from recordings, by gradients and by the population methods to compare with."""
