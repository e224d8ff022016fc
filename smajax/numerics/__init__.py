"""Numerical building blocks: JAX set-up, nonsmooth functions, Newton's method and its derivatives, linear solvers.

``jax_setup`` has compiler options; ``process`` sets them with what else belongs to the process of a command (precision,
platform, cache, cores). ``loop_kernels`` compiles programs whose loops are one machine function each. ``precision``
refuses single precision. ``nonsmooth`` has maximum, minimum and clip with
reliable derivatives. ``newton`` solves the equations of a plant's step, ``implicit_differentiation`` computes the
derivatives of such solutions, and ``derivative_order`` refuses second derivatives that do not exist. ``dense`` and
``block_tridiagonal`` solve linear systems. This file imports nothing, so that ``process`` can run before equinox is
imported.
"""
