"""Which software it is."""

from __future__ import annotations


def software_version() -> str:
    """The installed version of the console."""
    from importlib.metadata import PackageNotFoundError, version  # half the time of a `--help`

    try:
        return version("madrob-console")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "0+unknown"
