"""Names of the leaves of a pytree, for the constants and the state of an exported controller."""

import re
from collections import Counter
from typing import Any

import jax

# Words that cannot be the name of a variable in C.
_KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if int long register "
)
_KEYWORDS += (
    "return short signed sizeof static struct switch typedef union unsigned void volatile while inline restrict"
)


def leaf_names(tree: Any, alone: str = "state") -> list[str]:
    """Return a name for each leaf of a pytree that is an identifier: its field, or its path if that is not unique.

    Args:
        tree: The pytree.
        alone: Name of a tree that is a leaf, and of the leaves of tuples without names, which get numbers.
    """
    paths = [
        [part for part in (_identifier(key) for key in path) if part]
        for path, _ in jax.tree_util.tree_flatten_with_path(tree)[0]
    ]
    paths = [path if path and not path[-1].isdigit() else [*path[:-1], alone, *path[-1:]] for path in paths]
    short = ["_".join(path[-2:] if path[-1].isdigit() else path[-1:]) for path in paths]
    counts = Counter(short)
    names = [name if counts[name] == 1 else "_".join(path) for name, path in zip(short, paths, strict=True)]
    return [f"{name}_" if name in _KEYWORDS.split() else name for name in names]


def _identifier(key: Any) -> str:
    """The part of a path as letters, digits and underscores."""
    text = str(getattr(key, "name", getattr(key, "key", getattr(key, "idx", ""))))
    return re.sub(r"\W+", "_", text).strip("_")
