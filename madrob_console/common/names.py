"""Words that settings, files and screens share, and text from outside made safe.

Names that people type, and words that a testbed sends, may hold anything: escape sequences that
repaint the screen, marks that turn the direction of writing, parts of a path.
"""

from __future__ import annotations

import re
import unicodedata
from enum import StrEnum

from madrob_console.common.errors import MadrobError

LONGEST_NAME = 60
"""Characters in a name; at four bytes each it still fits into a file name."""

_ESCAPE_SEQUENCE = re.compile(
    r"(?:\x1b[\]PX^_]|[\x90\x98\x9d-\x9f]).*?(?:\x07|\x1b\\|\x9c)"  # strings, with their end
    r"|(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"  # control sequences
    r"|\x1b[ -/]*[0-~]",  # the short ones
    re.DOTALL,
)
_JOINERS = frozenset("\u200c\u200d")  # Persian and emoji need them
_FLAG_TAGS = frozenset(map(chr, range(0xE0020, 0xE0080)))  # the flag of Scotland does
_DROPPED = frozenset({"Cc", "Cf", "Co"})
_INVISIBLE = frozenset({"Cf", "Mn", "Me", "Zs"})
_FORMULA = frozenset("=+-@")
_PATH_SEPARATORS = str.maketrans("/\\", "  ")


def terminal_safe(text: str) -> str:
    """The text on one line, without anything that a terminal would obey rather than show.

    Escape sequences, control characters and direction marks are dropped. Line breaks and tabs
    become blanks, invalid characters U+FFFD. A screen library's markup is left as it is.
    """
    if text.isascii() and text.isprintable():
        return text
    plain = _ESCAPE_SEQUENCE.sub("", text)
    return "".join(map(_shown, plain))


def valid_text(text: str) -> str:
    """The text for a file: bytes of a path that are not UTF-8 become U+FFFD, the rest stays."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def table_cell(text: str) -> str:
    """The text for a cell of a table: `terminal_safe`, and no formula.

    A spreadsheet runs what begins with `=`, `+`, `-` or `@`: that gets an apostrophe.
    """
    plain = terminal_safe(text)
    return f"'{plain}" if unicodedata.normalize("NFKC", plain[:1]) in _FORMULA else plain


def clean_name(text: str, field: str, fallback: str = "") -> str:
    """A name of a person, team or competition, safe in a file name and on the terminal.

    Blanks are collapsed, path separators become blanks, leading dots go; other scripts and emoji
    stay. Cleaning a clean name changes nothing. `field` is for the message: `team`, `referee`.
    `fallback` is the name when nothing visible is left. MadrobError if it is too long.
    """
    plain = terminal_safe(text).translate(_PATH_SEPARATORS)
    name = " ".join(unicodedata.normalize("NFC", plain).split()).lstrip(". ")
    if not any(unicodedata.category(c) not in _INVISIBLE for c in name):
        return fallback
    if len(name) > LONGEST_NAME:
        raise MadrobError(
            f"{field} has {len(name)} characters: use at most {LONGEST_NAME}, nothing is cut"
        )
    return name


def _shown(char: str) -> str:
    if char.isspace():
        return " "
    category = unicodedata.category(char)
    if category == "Cs":
        return "\N{REPLACEMENT CHARACTER}"
    if category in _DROPPED and char not in _JOINERS and char not in _FLAG_TAGS:
        return ""
    return char


class ThemeName(StrEnum):
    """Look of the screens."""

    DARK = "dark"
    LIGHT = "light"
    HIGH_CONTRAST = "high-contrast"


REHEARSAL = "REHEARSAL"
"""First word of the name of a competition that is a rehearsal (protocol section 2)."""


def is_rehearsal(competition: str | None) -> bool:
    """Whether a competition is a rehearsal: each run records its competition's name for good."""
    return f"{competition} ".startswith(f"{REHEARSAL} ")


class SourceKind(StrEnum):
    """Where the messages come from."""

    ROS = "ros"
    SIMULATED = "simulated"
    REPLAY = "replay"


class Scenario(StrEnum):
    """Behaviour of a simulated robot."""

    NOMINAL = "nominal"
    SLAM = "slam"
    SLOW = "slow"
    NO_TOUCH = "no-touch"
    TOUCH_ONLY = "touch-only"
    WORN = "worn"
