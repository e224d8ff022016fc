"""Hints in the error messages of ``smajax properties``.

The messages of the readers of recordings name keys of a rig file; this command has no rig. Each rule replaces such a
hint by the option of this command, or the change of the file, with the same effect.
"""

import re

_TEXT_ENDINGS = (".csv", ".txt")
_COLUMNS_HINT = "--columns, as in --columns 'temperature [degC],strain [%]'"
# Rules for all files.
_RULES = (
    (r'set delimiter = " " under \[channels\] in the rig', "give --delimiter space"),
    (r", or, if it is right, give \w+ any_scale = true under \[channels\] in the rig", ""),
    (r'set delimiter = ("[^"]+") and decimal = "," under \[channels\] in the rig', r"give --delimiter \1 --decimal ,"),
    (r'set delimiter = ("[^"]+")( under \[channels\] in the rig)?', r"give --delimiter \1"),
    (r'set decimal = "," under \[channels\] in the rig', "give --decimal ,"),
    (r"set delimiter and decimal under \[channels\]", "give --delimiter and --decimal"),
    (r"begin with a row like '[^']+'", f"name the columns by {_COLUMNS_HINT}"),
    (r"correct it, or leave such rows out with --drop-bad-rows", "correct it, or remove its row"),
    (r"sort the rows by time, or leave such rows out with --drop-bad-rows", "sort the rows by time"),
    (r", or remove it from \[fit\] observe", ""),
)
_RULES_OF_TEXT = (
    (r"rename it, map it under \[channels\].*", f"rename it, or name it by {_COLUMNS_HINT}"),
    (r"or give the unit under \[channels\]", "in the file or by --columns"),
    (r"or map one to \w+ under \[channels\] in the rig", f"or name the columns by {_COLUMNS_HINT}"),
)
_RULES_OF_MAT = (
    (r"rename it, map it under \[channels\].*", "save one vector per channel, named temperature, strain and stress"),
    (
        r"write the header like '(\w+) \[([^]]+)\]', or give the unit under \[channels\]",
        r"save a struct next to it with units.\1 = '\2'",
    ),
    (
        r"so add a column '(\w+) [^']*' or map one to \w+ under \[channels\] in the rig",
        r"so save a vector \1 next to them",
    ),
    (
        r"give the file headers like 'temperature \[degC\]'",
        "name its variables temperature and strain, with a struct units: units.strain = '%'",
    ),
)
_RULES_OF_OTHERS = (
    (r"rename it, map it under \[channels\].*", "rename it in the file, or remove it"),
    (r", or give the unit under \[channels\]", ""),
    (r" or map one to \w+ under \[channels\] in the rig", ""),
)


def hints_of_this_command(message: str, ending: str) -> str:
    """Replace the hints in a message by those of this command.

    Args:
        message: Message of a reader of recordings.
        ending: Ending of the file name, such as ".csv".
    """
    format_rules = (
        _RULES_OF_TEXT if ending in _TEXT_ENDINGS else _RULES_OF_MAT if ending == ".mat" else _RULES_OF_OTHERS
    )
    for pattern, replacement in (*_RULES, *format_rules):
        message = re.sub(pattern, replacement, message)
    return message
