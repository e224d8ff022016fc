"""Fits of input-output models (``smajax.laws``): hysteresis operators and black boxes, one input to one output.

``problem`` builds the residual of a model. ``specs/`` has, one model family in each file, how a model is made of its
parameters and the bounds of these. ``fit`` has the search for models of few parameters and the result, ``networks`` the
search for networks, which have more weights than a recording can determine.
"""
