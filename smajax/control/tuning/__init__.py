"""Tuning: gains in the closed loop, within limits or without, for one plant or several at once.

``objective`` defines terms and limits, ``problem`` maps a point of the unit box (logarithms of the gains) to them, and
``search`` evaluates points and has the local searches. ``tune`` chooses the search: ``unconstrained`` without limits
(by gradients in a trust region, ``trust_region``), ``constrained`` within limits, ``minimise_settling_time`` (by
``settling_slp``) for the shortest settling time; ``population`` may follow. ``retuning`` repeats a search until its
gains are stable, keep the limits and follow the reference, ``case_retuning`` until they also do so in cases that no
search has used, and ``margin_backoff`` reduces the loop gain.

``task`` holds what a tuning needs, ``controller_problem`` builds the problem of a controller file with ``plant_draws``,
which samples uncertain parameters, ``feedforward_identification`` fits the operator of a feedforward, and
``tuning_study`` is the tuning of a controller from start to end.
"""
