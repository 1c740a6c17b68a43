"""Tables whose rows cannot be forgotten: an enum, each member of which is a name with its row."""

from __future__ import annotations

from enum import StrEnum
from typing import Self


class NamedRow(StrEnum):
    """A name, as files have it, with what is said of it; one without a row cannot be imported.

    Attributes:
        spec: the row; a table says of which type.
    """

    spec: object

    def __new__(cls, name: str, spec: object) -> Self:
        """A name with its row."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.spec = spec
        return member
