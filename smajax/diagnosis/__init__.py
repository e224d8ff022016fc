"""Diagnosis: from the residual of a fit to the physical effect that the model lacks.

``problem`` augments the plant with every effect of the catalogue (its compile-time machinery is in ``compiled_model``).
``screening`` is the score test and ``detectability`` what an input can show at all. ``forward_selection`` refits the
best candidates (``successive_halving``), accepts one by its prediction of a second recording (``acceptance``), lists
its equivalents (``equivalence``) and goes on; ``backward_elimination`` drops what is not needed. ``outcome`` predicts a
third recording once and classifies the result; ``localisation`` and ``nonparametric_fit`` describe an unexplained
residual, ``next_experiment`` proposes the input that distinguishes equivalent effects. The modules are imported by
name, not from here, so that reading a document needs no JAX.
"""
