"""The public functions and their result objects; ``import smajax as sma`` has all of them.

Each function of a study takes objects, paths, or tables in memory, and returns a study: a frozen dataclass with
``summary()``, ``plot()``, ``save(folder)`` and a representation for notebooks. A command of the command line reads its
options, calls the function, and saves the study. ``load(folder)`` gives a saved study again.
"""
