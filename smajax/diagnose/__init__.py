"""What the residual of a fit says the plant lacks."""
