"""What is wrong with a settings file, in words."""

from __future__ import annotations

import re
from collections.abc import Sequence

import msgspec
from msgspec import inspect

from madrob_console.config.shape import fields, plain, text_words, type_at
from madrob_console.names import terminal_safe

_PLACE = re.compile(r"(?P<what>.*?)(?: - at `\$\.?(?P<key>.*)`)?")
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`")
_KEY_PART = re.compile(r"[^.\[\]]+")
_OTHERWISE = "Expected `str` matching regex"
_SHOWN = 60
_WORDS = {
    " | null": "",
    "Object missing required field": "missing",
    "`float`": "a number",
    "`int`": "a whole number",
    "`str`": "text",
    "`bool`": "true or false",
    "`object`": "a table",
    "`array`": "a list",
}


def explain(message: str, settings: type[msgspec.Struct], content: object) -> str:
    """What msgspec finds wrong with a file of settings, for the person who wrote it.

    Args:
        message: of its ValidationError.
        settings: the type of all settings.
        content: of the file.

    Returns:
        One line that begins with the key.
    """
    message = terminal_safe(message)
    place = _PLACE.fullmatch(message)
    what, key = (place["what"], place["key"] or "") if place else (message, "")
    parts = _KEY_PART.findall(key)
    limited = type_at(inspect.type_info(settings), parts)
    found = plain(limited)
    if what.startswith(_OTHERWISE):
        written = terminal_safe(repr(_value_at(content, parts)))
        return f"{key}: {written[:_SHOWN]} is no {text_words(limited)}"
    if unknown := _UNKNOWN.fullmatch(what):
        known = ", ".join(f.encode_name for f in fields(found))
        name = f"{key}.{unknown[1]}".lstrip(".")
        return f"{name!r}: no such setting; there are {known}"
    if isinstance(found, inspect.EnumType):
        what += "; use " + ", ".join(repr(member.value) for member in found.cls)
    for word, ours in _WORDS.items():
        what = what.replace(word, ours)
    return f"{key or 'settings'}: {what[:1].lower()}{what[1:]}"


def _value_at(content: object, parts: Sequence[str]) -> object:
    """What stands at a place of a file."""
    for part in parts:
        match content:
            case dict():
                content = content[part]
            case list():
                content = content[int(part)]
    return content
