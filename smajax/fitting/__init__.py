"""Fits of a plant's parameters, and of input-output models, to recordings.

``problem`` builds the weighted residual, measurement minus model, as a function of one vector; ``levenberg_marquardt``
is the bounded least-squares solver, ``multi_start`` runs it from several starts, and ``optimistix_search`` runs any
other optimistix solver, with ``bound_transformation``; ``fit`` puts these together and returns a ``result.FitResult``.
``intervals`` computes confidence intervals under autocorrelated noise (``autoregression``), ``collinearity`` finds
parameters that the data cannot distinguish, ``profile`` computes profile likelihoods, ``evaluation`` the warnings of a
fit, ``noise`` estimates the noise of a column, and ``input_noise`` the bias by noise in prescribed inputs;
``plateaus``, ``electrical_noise`` and ``noisy_inputs`` correct for noise of the electrical input. ``baselines/`` has
population searches to compare the gradient with, ``io_models/`` the fits of ``smajax.laws``. ``compilation`` has what
serves the compiler only.
"""
