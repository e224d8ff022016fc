"""Design sweeps: many designs of one rig or actuator simulated at once, the best of them refined by gradients.

A ``SWEEP.toml`` (``sweep_file``) names the rig or actuator (``subject``), the parameters that vary (``space``), the
input (``excitation``), the ``metrics`` of each response, the objectives and the constraints. ``problem`` maps a
design to its metrics in one compiled program; ``chunks`` runs it over all designs in this process, ``dask`` on a
cluster, and ``checkpoint`` keeps finished chunks on disk. ``pareto`` and ``sobol`` read the table; ``refinement`` and
``feasibility`` improve single designs by the metrics' derivatives.
"""
