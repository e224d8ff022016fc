"""The command line of smajax.

``cli`` is the ``smajax`` command, ``command_line`` has its options and one function for each command, and
``commands`` the long jobs behind them: read the files, call the library, save the result folder. ``console`` turns
errors into sentences and exit codes, and ``run_record`` keeps run.json. Nothing that computes imports this room, and
nothing heavy is loaded before a command needs it.
"""
