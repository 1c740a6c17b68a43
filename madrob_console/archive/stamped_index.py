"""What was read of many files, kept with their stamps in one file: only a cache."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from madrob_console.errors import MadrobError
from madrob_console.files.bounded import Stamp, read_bounded
from madrob_console.files.whole import atomic_write

_Item = TypeVar("_Item")

Stamps = tuple[Stamp | None, ...]
"""Of all files that an item was read from, each time in the same order; None = there is none."""

_Kept = tuple[tuple[int, int, int] | None, ...]  # equal to stamps, and decoded sooner

_LARGEST = 100_000_000  # bytes; a larger index is none


class StampedIndex(Generic[_Item]):
    """Items by name, each good as long as its files have the same stamps.

    An index that is missing, damaged or of another version is empty; one that cannot be written
    is not kept.

    Args:
        path: the file.
        kind: the type of the items; msgspec must be able to read it.
        version: of what the items mean.
    """

    def __init__(self, path: Path, kind: type[_Item], version: tuple[int, int]) -> None:
        self._path = path
        self._version = version
        layout: Any = tuple[tuple[int, int], dict[str, tuple[_Kept, kind]]]  # type: ignore[valid-type]
        self._decoder = msgspec.json.Decoder(layout)
        self._items = self._read()
        self._changed = False

    def get(self, name: str, stamps: Stamps) -> _Item | None:
        """The item of files that have these stamps; None if there is none."""
        kept = self._items.get(name)
        return kept[1] if kept is not None and kept[0] == stamps else None

    def put(self, name: str, stamps: Stamps, item: _Item) -> None:
        """Keep an item."""
        self._items[name] = (stamps, item)
        self._changed = True

    def keep_only(self, names: Iterable[str]) -> None:
        """Forget the items of all other names."""
        for name in self._items.keys() - set(names):
            del self._items[name]
            self._changed = True

    def save(self) -> None:
        """Write the file if anything changed; a folder that refuses is no problem."""
        if self._changed:
            self._changed = False
            with suppress(MadrobError):
                atomic_write(self._path, msgspec.json.encode((self._version, self._items)))

    def _read(self) -> dict[str, tuple[Stamps, _Item]]:
        try:
            data, _ = read_bounded(str(self._path), _LARGEST)
            version, items = self._decoder.decode(data)
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            return {}
        return items if version == self._version else {}
