"""Comparison of several models on one recording, by their predictions of another one.

Material laws are fitted in the rig, with the rig's law replaced (``material_models``). Input-output models see one
input and the first observed channel only (``input_output_models``); ``driving_input`` finds that input. ``compare``
runs all models and keeps the reason where one cannot be fitted, ``scores`` computes RMSE, fit percentage and BIC.
Results are plain data; the document and the report of ``smajax compare`` are made in ``smajax.report``.
"""
