"""Fits of input-output models (``smajax.laws``): hysteresis operators and black boxes, one input to one output.

``problem`` builds the residual of a model; ``specs/`` says, one model family a file, how each model is made of its
parameters and between which bounds they lie; ``fit`` is the search for models of few parameters and the result;
``networks`` is the search for networks, which have more weights than a recording can determine.
"""
