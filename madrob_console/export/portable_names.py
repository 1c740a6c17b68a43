"""Names that every system can unpack: somebody may have put anything into a run's folder."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from pathlib import PurePosixPath

from madrob_console.names import terminal_safe

LONGEST_FILE_NAME = 100
"""Characters of a file's or a folder's name."""

LONGEST_PATH = 200
"""Characters of a path in an archive: Windows takes 260 with where it is unpacked."""

_FORBIDDEN = re.compile(r'[<>:"/\\|?*]')  # by Windows; `C:` and `..\` lead out of the folder there
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])\s*(\..*)?$")  # devices there


def portable_names(names: Iterable[str]) -> dict[str, str]:
    """What the files and folders of one folder are called in an archive.

    Nearly always as they are. What one system takes for something else than a name is replaced by
    `_`; of two that some system cannot tell apart one gets a number: rather one that is changed
    anyhow, or has more capitals.

    Args:
        names: as they are on disk.
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in sorted(names, key=_claim):
        path = PurePosixPath(_portable(name))
        called, number = str(path), 1
        while _as_compared(called) in taken:
            number += 1
            called = f"{path.stem}_{number}{path.suffix}"
        taken.add(_as_compared(called))
        found[name] = called
    return found


def _claim(name: str) -> tuple[bool, int, str]:
    return _portable(name) != name, sum(map(str.isupper, name)), name


def _portable(name: str) -> str:
    safe = _FORBIDDEN.sub("_", unicodedata.normalize("NFC", terminal_safe(name)))
    path = PurePosixPath(safe.strip(" .") or "_")
    if len(path.name) > LONGEST_FILE_NAME:
        suffix = path.suffix if len(path.suffix) <= LONGEST_FILE_NAME // 4 else ""
        path = PurePosixPath(path.stem[: LONGEST_FILE_NAME - len(suffix)].rstrip(" .") + suffix)
    return f"_{path}" if _RESERVED.match(path.name) else path.name


def _as_compared(name: str) -> str:
    """By systems that heed neither case nor how a letter is composed."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFKC", name).casefold())
