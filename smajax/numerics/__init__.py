"""Numerical building blocks: JAX set-up, nonsmooth functions, Newton's method and its derivatives, linear solvers.

``jax_setup`` sets double precision and compiler options; ``process`` sets what belongs to the process of a command
(platform, cache, cores). ``nonsmooth`` has maximum, minimum and clip with reliable derivatives. ``newton`` solves the
equations of a plant's step, ``implicit_differentiation`` computes the derivatives of such solutions. ``dense`` and
``block_tridiagonal`` solve linear systems. This file imports nothing, since ``process`` has to run before anything
imports equinox.
"""
