"""Diagnosis: from the residual of a fit to the physical effect that the model lacks.

Where to look, in the order of the algorithm:

- ``outcome``: ``diagnose``, the whole algorithm; ``verdict``: its verdict.
- ``problem``: the plant with every effect of the catalogue; ``compiled_model`` keeps all simulations on two programs.
- ``detectability``: what an input can show of each effect: testable, absorbed or blind.
- ``base_fit``, ``residual_checks``: the fit without further effects, its noise and its correlations.
- ``screening``: the score test (``score_test``), on the derivatives of ``sensitivities``.
- ``forward_selection``: ``select_effects``; candidates are refitted by ``successive_halving``, with onsets by
  ``onset_times``, and accepted by their prediction of a second recording (``acceptance``).
- ``equivalence``, ``confusable_effects``: effects that explain the recordings as well.
- ``backward_elimination``: effects that are no longer needed next to the others are dropped.
- ``structured_selection``, ``structure``: cells and grains; ``support``: facts and candidates; ``error_budget``.
- ``other_laws``: whether the material law is wrong or an effect is missing.
- ``localisation``, ``nonparametric_fit``: the stage and the form of an unexplained residual.
- ``next_experiment``: the input that distinguishes equivalent effects.
- ``result``: the numbers of a diagnosis.

The modules are imported by name, not from here, so that reading a document needs no JAX.
"""
