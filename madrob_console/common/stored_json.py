"""Decodes JSON that was stored, whatever has become of it."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from madrob_console.common.errors import MadrobError

_Item = TypeVar("_Item")


def decode(data: bytes | memoryview | str, kind: type[_Item]) -> _Item:
    """Return the document as a `kind`; MadrobError says why it is none."""
    try:
        return msgspec.json.decode(data, type=kind)
    except RecursionError:
        raise MadrobError("nested without bounds") from None
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise MadrobError(str(error)[:120]) from None
