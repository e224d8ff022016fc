"""Simulation of a plant under recorded inputs, with derivatives of first order in forward and in reverse mode.

``inputs`` lays a recording's inputs on a grid of time steps (``step_size`` chooses their length); ``time_stepping``
takes the steps; ``sensitivities`` adds the tangents by the implicit function theorem; ``run`` holds the functions that
others call: trajectories, channels, batches; ``vector_field`` has the plant's rates, and ``integration`` integrates
them by diffrax; ``status`` says how a simulation ended; ``diagnostics`` shows a plant's parameters in error messages;
``argument_checks`` has what the functions take, in words. What serves the compiler only (blocks, flat states, programs
traced once) is in ``compilation``.
"""
