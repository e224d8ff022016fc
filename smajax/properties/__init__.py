"""Properties of thermal cycles: transformation temperatures and strains after ASTM E3097, with 95 % intervals.

``thermal_cycles`` analyses the cycles of a recording: ``cycle_rows`` finds them, ``row_order`` and ``minor_loops``
check and clean their rows, ``branch_properties`` fits each branch by three lines (``segmented_lines``) or the
steepest tangent (``steepest_tangent``), checks it (``transformation_checks``) and draws bootstrap samples of it
(``bootstrap``). ``stress_levels`` groups the cycles of a recording by stress, and ``start_values`` turns them into a
parameter set to begin a fit with. Nothing here is differentiable: it is NumPy and SciPy.
"""
