"""The versions of the packages whose numbers a result holds."""

import contextlib
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("jax", "diffrax", "optimistix", "equinox", "numpy", "scipy", "pint")


def versions() -> dict[str, str]:
    """By package, those that are installed."""
    found = {}
    for name in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
