"""The commands as functions of their options, see ``smajax.app.cli``.

``models`` has simulate, fit, diagnose and compare; ``designs`` tune and sweep; ``properties`` properties; ``files``
demo, init, check, report and datasets. ``options`` are the options that several commands share, and ``run`` starts
and ends a long command. Everything heavy is imported inside the functions: ``smajax --help`` loads typer only.
"""
