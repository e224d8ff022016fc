"""Files that people write, read and checked key by key, and the folders that results are written to.

- ``rig_file``: rig.toml as a ``Rig``, built with ``rig_schema`` (sections), ``rig_kinds`` (stages of each kind),
    ``rig_values`` (values and where they come from), ``rig_plant``, ``rig_checks`` and ``rig_text`` (writing).
- ``actuator_file``, ``parameter_sets``, ``fit_settings``, ``channel_settings``: other files and sections.
- ``toml`` and ``validators``: parsing, and one sentence with the cure for every mistake; ``renamed_keys``: old keys.
- ``train_and_holdout``, ``warm_start``: inputs of a fit; ``templates``: files of ``smajax init``.
- ``result_folder``, ``documents``, ``versions``: results.
"""
