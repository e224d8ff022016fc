"""Versions of the packages on which the numbers of a result depend."""

import contextlib
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("jax", "diffrax", "optimistix", "equinox", "numpy", "scipy", "pint")


def package_versions() -> dict[str, str]:
    """Return the versions of the installed ones by package."""
    installed = {}
    for name in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            installed[name] = version(name)
    return installed
