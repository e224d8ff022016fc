"""Numbers of cases of a control task that a controller file may give; nothing here needs JAX."""

# Number of draws of the noise. If none of 59 independent cases fails, at least 95 % of all pass, with a confidence of
# 95 %: 0.95^59 < 0.05 (wilks1941). 64 is the next multiple of the batch size.
NOISE_CASES = 64
MIN_NOISE_CASES = 59
