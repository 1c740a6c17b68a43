"""How the settings are built, as their types tell it."""

from __future__ import annotations

from msgspec import Meta, inspect

_WORDS = "words"


def description(kind: inspect.Type) -> str:
    """What a setting means, in its own words."""
    if isinstance(kind, inspect.UnionType):
        kind = _without_none(kind)
    schema = kind.extra_json_schema if isinstance(kind, inspect.Metadata) else None
    return str((schema or {})["description"])


def text_words(kind: inspect.Type) -> str:
    """What a text that has to match a pattern is, in words; see `written_as`."""
    if isinstance(kind, inspect.UnionType):
        kind = _without_none(kind)
    extra = kind.extra if isinstance(kind, inspect.Metadata) else None
    return str((extra or {})[_WORDS])


def written_as(pattern: str, words: str) -> Meta:
    """A text that matches a pattern.

    Args:
        pattern: of the whole text.
        words: what it is and how it is written, for somebody who wrote it otherwise.
    """
    return Meta(pattern=rf"^({pattern})$", extra={_WORDS: words})


def plain(kind: inspect.Type) -> inspect.Type:
    """The type itself, without its limits and without `| None`."""
    if isinstance(kind, inspect.Metadata):
        return plain(kind.type)
    return plain(_without_none(kind)) if isinstance(kind, inspect.UnionType) else kind


def fields(kind: inspect.Type) -> tuple[inspect.Field, ...]:
    """The fields of a table; none for anything else."""
    return kind.fields if isinstance(kind, inspect.StructType) else ()


def type_at(kind: inspect.Type, parts: list[str]) -> inspect.Type:
    """The type at a place in the settings, with its limits; a number is a place in a list."""
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
