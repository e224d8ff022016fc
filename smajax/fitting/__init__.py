"""Fits of a plant's parameters, and of input-output models, to recordings.

``problem`` builds the weighted residual as a function of one vector; ``levenberg_marquardt`` is the bounded
least-squares solver and ``multi_start`` runs it from several starts; ``fit`` puts these together and gives a
``result.FitResult``; ``intervals`` holds confidence intervals under autocorrelated noise and collinear parameters;
``profile`` has profile likelihoods; ``noise`` estimates the noise of a column; ``input_noise`` tests what noise in the
inputs does. ``baselines/`` has population searches to compare the gradient with, ``io_models/`` the fits of
``smajax.laws``. What serves the compiler only is in ``compilation``.
"""
