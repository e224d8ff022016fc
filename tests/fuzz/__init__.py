"""Fuzzing of everything that reads a file: small valid files are damaged by seeded mutations, and read.

For any bytes a reader returns or raises ``InputError`` with one line; it raises nothing else, ends within
some seconds, and needs no more memory than it states. ``test_readers.py`` makes some hundred tries a format in every
run of the tests, and ``pytest -m fuzz -n 2 tests/fuzz`` makes as many as fit into an hour, in processes of their own.
"""
