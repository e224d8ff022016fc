"""The commands as functions of their options; ``smajax.app.cli`` registers them.

``models`` has simulate, fit, diagnose and compare; ``designs`` has tune and sweep; ``properties`` has properties;
``importing`` has import; ``files`` has demo, init, check, effects, explain, sets, report and datasets. ``options`` has
the options that several commands share, and ``run`` starts and ends a long command. Large packages are imported inside
the functions: ``smajax --help`` loads typer only.
"""
