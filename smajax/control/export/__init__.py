"""Export of a controller: C header (``c_header``), JSON document (``json_document``) and FMUs (``fmu``).

All three contain the controller, the allocation to the wires, the temperature limiter and the thermal observer; a
Kalman filter of the whole plant cannot be exported. ``c_templates`` has the C texts.
"""
