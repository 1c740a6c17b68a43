"""The libraries that compute results: their versions decide the last digits (section 11)."""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import import_module
from typing import Annotated

from msgspec import Meta

NAMES = {"python": "Python", "numpy": "NumPy", "scipy": "SciPy", "pandas": "pandas"}
"""Of the libraries, as people write them."""

VersionText = Annotated[str, Meta(max_length=100)]


@dataclass(frozen=True, slots=True)
class Libraries:
    """The versions of Python and of the libraries that computed a result (section 11).

    Attributes:
        python: of the interpreter.
        numpy: of NumPy.
        scipy: of SciPy.
        pandas: of pandas.
    """

    python: VersionText
    numpy: VersionText
    scipy: VersionText
    pandas: VersionText

    @property
    def words(self) -> str:
        return ", ".join(f"{NAMES[key]} {version}" for key, version in asdict(self).items())


@cache
def libraries_here() -> Libraries:
    """The versions loaded in this process; installed ones may have been upgraded since."""
    versions = {
        each.name: str(import_module(each.name).__version__)
        for each in fields(Libraries)
        if each.name != "python"
    }
    return Libraries(python=platform.python_version(), **versions)
