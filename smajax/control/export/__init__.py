"""Export of a controller: C header (``c_header``), JSON document (``json_document``), FMUs (``fmu``), all (``files``).

C header and FMU contain the controller, the allocation to the wires, the temperature limiter and the thermal observer,
and the JSON document their numbers; a Kalman filter cannot be exported. Header and FMU are written from traces of the
functions that a rollout calls: ``source_writer`` walks through a trace, ``fmu.numpy_source`` writes it with NumPy, and
``c_source`` in C (with ``c_values``, ``c_operations``, ``c_loops``). ``c_functions`` writes C functions with a state,
``named_leaves`` and ``static_numbers`` name its members and constants, ``c_templates`` has the texts around them.
"""
