"""The command line of smajax.

``cli`` is the ``smajax`` command, ``command_line`` has its options and one function for each command, and
``commands`` has the jobs of the long commands: read the files, call the library, save the result folder. ``console``
turns errors into sentences and exit codes, and ``loading`` lets Ctrl-C end the process while packages are imported.
No module that computes imports this package, and large packages are imported only when a command needs them.
"""
