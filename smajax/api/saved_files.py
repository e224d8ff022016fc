"""Files of a result folder that a loaded study saves again."""

import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from smajax.api.study import PREDICTIONS, REPORT, FileContent
from smajax.errors import InputError

# Suffixes of files that are kept in memory; others are copied when the study is saved again.
_TEXTS = (".toml", ".json", ".h")


def saved_files(folder: Path, run: Mapping[str, Any], document_name: str) -> dict[str, FileContent]:
    """Return the files of a result folder that ``save`` does not build again.

    Args:
        folder: The folder.
        run: The document run.json, which lists the files.
        document_name: Name of the result document.

    Raises:
        InputError: If a file cannot be read.
    """
    built = {"run.json", document_name, PREDICTIONS, REPORT}
    files: dict[str, FileContent] = {}
    for name in run.get("files", []):
        path = folder / str(name)
        if name in built:
            continue
        try:
            files[name] = (
                path.read_bytes() if path.suffix in _TEXTS else partial(shutil.copyfile, path.resolve(strict=True))
            )
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"{path}: the file cannot be read ({reason}): run the command again") from None
    return files
