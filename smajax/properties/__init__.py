"""Properties of thermal cycles: transformation temperatures and strains after ASTM E3097, with 95 % intervals.

``thermal_cycles`` analyses the cycles of a recording. ``cycle_rows`` finds them, ``row_order`` checks the order of the
rows, and ``minor_loops`` finds the rows to leave out. ``branch_properties`` fits each branch by three lines
(``segmented_lines``) or the steepest tangent (``steepest_tangent``), checks it (``transformation_checks``) and draws
bootstrap samples of it (``bootstrap``). ``stress_levels`` groups the cycles of a recording by stress,
``recording_analysis`` does so for several recordings, and ``refused_cycles`` words why cycles cannot be analysed.
``start_values`` makes a parameter set of the means to begin a fit with. All of it is NumPy and SciPy, not
differentiable.
"""
