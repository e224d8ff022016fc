"""Tuning: gains by gradients through the closed loop, within limits or without, for one plant or several at once.

``objective`` defines terms and limits, ``problem`` maps a point of the unit box (logarithms of the gains) to them, and
``search`` evaluates points and has the local searches. ``tune`` chooses the search: ``unconstrained`` without limits,
``augmented_lagrangian`` (with ``population``) within limits, ``minimise_settling_time`` (by ``settling_slp``) for the
shortest settling time. ``retuning`` repeats a search until its gains are stable, keep the limits and follow the
reference. ``task`` holds what a tuning needs, ``plant_draws`` samples uncertain parameters, and
``feedforward_identification`` fits the operator of a feedforward. ``trust_region`` is a quasi-Newton method in the unit
box.
"""
