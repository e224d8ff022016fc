"""Input files, which are checked key by key, and result folders.

- ``rig_file``: rig.toml as a ``Rig``, built with ``rig_schema`` (sections), ``rig_kinds`` (stages of each kind),
    ``rig_values`` (values and their origin), ``rig_plant``, ``rig_checks`` and ``rig_text`` (writing).
- ``actuator_file``, ``parameter_sets``, ``fit_settings``, ``channel_settings``: other files and sections.
- ``toml`` and ``validators``: parsing, with one sentence and the cure for every mistake; ``renamed_keys``: old keys.
- ``train_and_holdout``, ``warm_start``: inputs of a fit; ``templates``: files of ``smajax init``.
- ``result_folder``, ``documents``, ``versions``: results.
"""
