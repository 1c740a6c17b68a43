"""Tables whose rows cannot be forgotten: enums, each member of which is a name with its row."""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol, Self


class Named(Protocol):
    """A row of a table."""

    @property
    def name(self) -> str:
        """As files have it."""


class NamedRow(StrEnum):
    """The name of a row, with the row as `spec`; a name without one cannot be imported."""

    _value_: str
    spec: Named

    def __new__(cls, spec: Named) -> Self:
        """A name with its row."""
        member = str.__new__(cls, spec.name)
        member._value_ = spec.name
        member.spec = spec
        return member
