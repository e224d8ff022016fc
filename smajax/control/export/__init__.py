"""Export of a controller: C header (``c_header``), JSON document (``json_document``) and FMUs (``fmu``).

C header and FMU contain the controller, the allocation to the wires, the temperature limiter and the thermal observer,
and the JSON document their numbers; a Kalman filter cannot be exported. ``c_templates`` has the C texts.
"""
