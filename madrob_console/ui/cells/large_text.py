"""Text in large letters: a font of 3 x 5 points, each of half a cell's height, in any size.

Only capitals, digits and a few signs: letters lose their accents, and of a text in another script
there is no large one.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from functools import lru_cache

HEIGHT = 5
"""Height of a letter of size 1, points; two lie in one row of cells."""

_LETTERS = {
    "0": "### #.# #.# #.# ###",
    "1": "##. .#. .#. .#. ###",
    "2": "### ..# ### #.. ###",
    "3": "### ..# .## ..# ###",
    "4": "#.# #.# ### ..# ..#",
    "5": "### #.. ### ..# ###",
    "6": "### #.. ### #.# ###",
    "7": "### ..# ..# ..# ..#",
    "8": "### #.# ### #.# ###",
    "9": "### #.# ### ..# ###",
    "?": "### ..# .## ... .#.",
    ":": ". # . # .",
    ".": ". . . . #",
    "-": "... ... ### ... ...",
    " ": ".. .. .. .. ..",
    "A": ".#. #.# ### #.# #.#",
    "B": "##. #.# ##. #.# ##.",
    "C": "### #.. #.. #.. ###",
    "D": "##. #.# #.# #.# ##.",
    "E": "### #.. ##. #.. ###",
    "F": "### #.. ##. #.. #..",
    "G": "### #.. #.# #.# ###",
    "H": "#.# #.# ### #.# #.#",
    "I": "### .#. .#. .#. ###",
    "J": "..# ..# ..# #.# ###",
    "K": "#.# #.# ##. #.# #.#",
    "L": "#.. #.. #.. #.. ###",
    "M": "#...# ##.## #.#.# #...# #...#",
    "N": "#..# ##.# #.## #..# #..#",
    "O": "### #.# #.# #.# ###",
    "P": "### #.# ### #.. #..",
    "Q": "###. #.#. #.#. ###. ..##",
    "R": "##. #.# ##. #.# #.#",
    "S": "### #.. ### ..# ###",
    "T": "### .#. .#. .#. .#.",
    "U": "#.# #.# #.# #.# ###",
    "V": "#.# #.# #.# #.# .#.",
    "W": "#...# #...# #.#.# ##.## #...#",
    "X": "#.# #.# .#. #.# #.#",
    "Y": "#.# #.# .#. .#. .#.",
    "Z": "### ..# .#. #.. ###",
    "&": "##. ##. .#. #.# ###",
    "+": "... .#. ### .#. ...",
    "/": "..# ..# .#. #.. #..",
    "'": "# # . . .",
    ",": ". . . # #",
    "(": ".# #. #. #. .#",
    ")": "#. .# .# .# #.",
    "_": "... ... ... ... ###",
}
_CELLS = {(False, False): " ", (True, False): "▀", (False, True): "▄", (True, True): "█"}

_GAP = " "


def rows_of(size: int) -> int:
    """Rows of cells for a text of a size; 3 for size 1."""
    return (HEIGHT * size + 1) // 2


@lru_cache(256)  # a clock is drawn ten times a second
def large_text(text: str, size: int) -> Sequence[str] | None:
    """A text in large letters, `rows_of(size)` rows of one width; None if a letter has none.

    Case does not matter. In size 1, the smallest, a point is as wide as a cell.
    """
    plain = _capitals(text)
    if not plain or any(letter not in _LETTERS for letter in plain):
        return None
    letters = [_points(letter, size) for letter in plain]
    return [(_GAP * size).join(rows) for rows in zip(*letters, strict=True)]


def _capitals(text: str) -> str:
    parts = unicodedata.normalize("NFKD", text)
    return "".join(part for part in parts if not unicodedata.combining(part)).upper()


def _points(letter: str, size: int) -> list[str]:
    rows = [
        [point == "#" for point in row for _ in range(size)]
        for row in _LETTERS[letter].split()
        for _ in range(size)
    ]
    if len(rows) % 2:
        rows.append([False] * len(rows[0]))
    return [
        "".join(_CELLS[pair] for pair in zip(upper, lower, strict=True))
        for upper, lower in zip(rows[::2], rows[1::2], strict=True)
    ]
