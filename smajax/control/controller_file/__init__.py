"""Reader of controller.toml: the controller and its channel, the reference, the sensors, and the tuning.

``read.read_controller`` reads a file for a rig. ``schema`` lists the sections and their keys, ``renamed_keys`` the
names in older files. ``scenario`` reads [reference] and [[change]]; ``sensors``, ``estimator`` and ``instruments`` read
[sensor], [temperature_limiter], [estimator] and [instruments]; ``search_sections`` reads [feedforward], [tune],
[limits] and [robust]. The message for a mistake in a file is one sentence that names section, key and cure.
"""
