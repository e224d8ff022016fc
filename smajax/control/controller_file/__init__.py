"""Reader of controller.toml: which controller controls which channel, what it shall follow, and what is tuned.

``read.read_controller`` reads a file for a rig. Its sections: ``schema`` lists their keys; ``renamed_keys`` the names
that older files have; ``scenario`` reads [reference] and [[change]]; ``sensors``, ``estimator`` and ``instruments``
read what is measured; ``search_sections`` reads [feedforward], [tune], [limits] and [robust]. Every mistake in a file
is one sentence that names section, key and cure.
"""
