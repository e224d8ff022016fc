"""``python -m smajax`` is the ``smajax`` command."""

from smajax.cli import main

main()
