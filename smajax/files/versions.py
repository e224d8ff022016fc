"""Versions of the packages that the numbers of a result depend on."""

import contextlib
from importlib.metadata import PackageNotFoundError, version

_PACKAGES = ("jax", "diffrax", "optimistix", "equinox", "numpy", "scipy", "pint")


def package_versions() -> dict[str, str]:
    """Return the version of each of these packages that is installed."""
    versions = {}
    for name in _PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions
