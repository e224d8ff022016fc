"""Properties of thermal cycles: transformation temperatures and strains after ASTM E3097, with 95 % intervals.

``thermal_cycles`` analyses the cycles of a recording. ``cycle_rows`` finds them, ``row_order`` checks the order of the
rows, and ``minor_loops`` finds the rows to leave out. ``branch_properties`` fits each branch by three lines
(``segmented_lines``) or the steepest tangent (``steepest_tangent``), checks it (``transformation_checks``) and draws
bootstrap samples of it (``bootstrap``). ``stress_levels`` groups the cycles of a recording by stress, and
``start_values`` makes a parameter set of them to begin a fit with. All of it is NumPy and SciPy, not differentiable.
"""
