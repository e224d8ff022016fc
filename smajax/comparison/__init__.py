"""Comparison of several models on one recording, by their predictions of another one.

``compare`` fits all models and stores the reason where one cannot be fitted. Material laws are fitted in the rig, in
place of the rig's own law (``material_models``). Input-output models use one input and the first observed channel only
(``input_output_models``); ``driving_input`` finds that input. ``scores`` computes RMSE, fit percentage and BIC, by
which ``ranking`` orders the models. Results
are plain data; ``smajax.report`` makes the document and the report of ``smajax compare``.
"""
