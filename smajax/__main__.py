"""Run the command line as ``python -m smajax``."""

from smajax.app.cli import main

main()
