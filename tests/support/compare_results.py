"""Compare result documents and tables of experiments of two versions of smajax, field by field.

    python -m tests.support.compare_results OLD NEW [--rtol 1e-6]

OLD and NEW are folders of JSON files (result folders, or files that experiments wrote with --json), compared by their paths below
the folder; an experiment's name is that of its file. Renamed keys and parameters are read under their new names. Versions,
commands, notes, times and what depends on them are left out. Prints every field that differs; exit code 1 if one does.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from smajax.files.renamed_keys import RENAMED_PARAMETERS

RENAMED_FILES = {
    "diagnosis_bench": "hidden_effects",
    "diagnosis_catalogue": "catalogue",
    "diagnosis_other_wires": "other_wires",
    "diagnosis_rivals": "alternative_methods",
    "diagnosis_two_wires": "two_wires",
    "measured_bu_softlimb": "bu_softlimb",
    "measured_cyclic": "cyclic",
    "measured_isobaric": "isobaric",
    "measured_muscle_electric": "muscle_electric",
    "measured_superelastic": "superelastic",
    "sweep_deaths": "sweep_interruptions",
}
# Keys whose values are versions, commands, notes, times or places, or depend on how fast the machine is.
LEFT_OUT = re.compile(
    r"schema|smajax|version|versions|command|argv|note|notes|timings|started|seconds|wall|wall_s|compile\w*|machine|experiment"
    r"|path|paths|folder|out|files|sha256|hash|elapsed|took|text|why|meaning|advice|warnings|source"
)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
# Parts of sentences about time, whose numbers are not compared.
TIMING = re.compile(r"\d[\d.,]* ?(?:ms|s|us|x|min)\b|\b\d[\d.]*x\b|wall|seconds| s\b|rollouts a|a second")


def current(text: str) -> str:
    """Return a text with the current names of parameters."""
    for old, new in RENAMED_PARAMETERS.items():
        text = text.replace(old, new)
    return text


def leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a document with their places."""
    if isinstance(value, dict):
        for key, item in value.items():
            if not LEFT_OUT.fullmatch(key):
                yield from leaves(item, f"{place}/{current(key)}")
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from leaves(item, f"{place}/{k}")
    else:
        yield place, value


def same(old: Any, new: Any, rtol: float) -> bool:
    """Return whether two values agree: numbers, also in texts, to ``rtol``, and all else exactly."""
    if isinstance(old, bool) or isinstance(new, bool) or old is None or new is None:
        return old == new
    if isinstance(old, int | float) and isinstance(new, int | float):
        return math.isclose(old, new, rel_tol=rtol, abs_tol=1e-12) or (math.isnan(old) and math.isnan(new))
    old, new = current(str(old)), current(str(new))
    if old == new or TIMING.search(old):
        return True
    numbers = [[float(n) for n in NUMBER.findall(text)] for text in (old, new)]
    return len(numbers[0]) == len(numbers[1]) and all(
        math.isclose(a, b, rel_tol=rtol, abs_tol=1e-12) for a, b in zip(*numbers, strict=True)
    )


def documents(folder: Path) -> dict[str, Any]:
    """Return the JSON files below a folder, except run.json, by path with current names."""
    contents = {}
    for path in sorted(folder.rglob("*.json")):
        if path.name != "run.json":
            name = RENAMED_FILES.get(path.stem, path.stem)
            contents[path.relative_to(folder).with_name(f"{name}.json").as_posix()] = json.loads(
                path.read_text("utf-8")
            )
    return contents


def main() -> None:
    """Compare the two folders of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--rtol", type=float, default=1e-6)
    args = parser.parse_args()
    before, after = documents(args.old), documents(args.new)
    different = 0
    for name in sorted(before.keys() & after.keys()):
        old, new = dict(leaves(before[name])), dict(leaves(after[name]))
        for place in sorted(old.keys() | new.keys()):
            if place not in old or place not in new:
                where = "new" if place not in old else "old"
                print(f"{name}{place}: only in {where}: {(old | new)[place]!r}")
                different += 1
            elif not same(old[place], new[place], args.rtol):
                print(f"{name}{place}: {old[place]!r} -> {new[place]!r}")
                different += 1
    for name in sorted(before.keys() ^ after.keys()):
        print(f"{name}: only in {'old' if name in before else 'new'}")
    print(f"{len(before.keys() & after.keys())} documents compared, {different} fields differ")
    sys.exit(different > 0)


if __name__ == "__main__":
    main()
