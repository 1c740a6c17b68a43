"""The types of settings: their ranges, descriptions and words for errors."""

from __future__ import annotations

import msgspec
from msgspec import Meta, inspect

_WORDS = "words"


def description(kind: inspect.Type) -> str:
    if isinstance(kind, inspect.UnionType):
        kind = _without_none(kind)
    schema = kind.extra_json_schema if isinstance(kind, inspect.Metadata) else None
    return str((schema or {})["description"])


def text_words(kind: inspect.Type) -> str:
    """Explains in words which texts match the pattern; see `written_as`."""
    if isinstance(kind, inspect.UnionType):
        kind = _without_none(kind)
    extra = kind.extra if isinstance(kind, inspect.Metadata) else None
    return str((extra or {})[_WORDS])


def written_as(pattern: str, words: str) -> Meta:
    """Limits a whole text to `pattern`; `words` explain the form to an author who missed it."""
    return Meta(pattern=rf"^({pattern})$", extra={_WORDS: words})


def plain(kind: inspect.Type) -> inspect.Type:
    """The type itself, without its limits and without `| None`."""
    if isinstance(kind, inspect.Metadata):
        return plain(kind.type)
    return plain(_without_none(kind)) if isinstance(kind, inspect.UnionType) else kind


def fields(kind: inspect.Type) -> tuple[inspect.Field, ...]:
    """The fields of a table; empty for any other type."""
    return kind.fields if isinstance(kind, inspect.StructType) else ()


def type_at(kind: inspect.Type, parts: list[str]) -> inspect.Type:
    """The type with its limits at a place in the settings; a number is an index into a list."""
    if not parts:
        return kind
    kind = plain(kind)
    first, *rest = parts
    if isinstance(kind, inspect.VarTupleType):
        return type_at(kind.item_type, rest)
    if isinstance(kind, inspect.TupleType):
        return type_at(kind.item_types[int(first)], rest)
    return type_at(next(f.type for f in fields(kind) if f.encode_name == first), rest)


def _without_none(kind: inspect.UnionType) -> inspect.Type:
    return next(t for t in kind.types if not isinstance(t, inspect.NoneType))


def within(low: float, high: float, description: str) -> Meta:
    """A number in [low, high]; NaN and infinity lie outside every range."""
    return Meta(ge=low, le=high, description=description)


class SettingsTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file; an unknown key in it is an error."""
