from __future__ import annotations

import re
import time
import tracemalloc
from collections.abc import Iterable, Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.ui.keys.terminal_input import (
    MOST_KEYS,
    PAUSE,
    InputFilter,
    escape_patience,
)

F8, ESCAPE = "\x1b[19~", "\x1b[27u"
BEGIN, END = "\x1b[200~", "\x1b[201~"
PATIENCE = 0.5
SOON, LATE = PATIENCE - 0.01, PATIENCE + 0.01
"""After the piece before, s."""


class Line:
    """A terminal's line, in virtual time."""

    def __init__(self, waiting: int = 0) -> None:
        self.floods = 0
        self.now = 100.0
        self.filter = InputFilter(PATIENCE, lambda: waiting, self._flood)

    def _flood(self) -> None:
        self.floods += 1

    def send(self, *pieces: str, gap: float = 1.0) -> str:
        """What comes of pieces so far apart, and of the silence after them."""
        came = ""
        for piece in pieces:
            came += self.silence(gap) + self.filter.feed(piece, self.now)
        return came + self.silence(10.0)

    def silence(self, duration: float) -> str:
        came, end = "", self.now + duration
        while self.now + 0.05 < end:
            self.now += 0.05
            came += self.filter.tick(self.now)
        self.now = end
        return came + self.filter.tick(end)


def split(text: str, at: Iterable[int]) -> Sequence[str]:
    cuts = [0, *sorted({min(cut, len(text)) for cut in at}), len(text)]
    return [text[a:b] for a, b in pairwise(cuts) if a < b]


KEYS = [
    *(
        "a",
        "1",
        "\r",
        "\t",
        "\x03",
        "é",
        F8,
        "\x1b[15~",
        "\x1bOP",
        "\x1b[A",
        "\x1b[1;5C",
        "\x1b[[E",
    ),
    *("\x1b[Z", "\x1b[<0;20;14M", "\x1b[<0;20;14m", "\x1b[I", "\x1b[49;;49u", "\x1b[3;2~"),
    "\x1b[?2026;2$y",
]


@given(st.lists(st.sampled_from(KEYS), min_size=1, max_size=8), st.sets(st.integers(1, 60)))
def test_keys_of_a_line_that_tears_them_are_whole(keys: list[str], cuts: set[int]) -> None:
    text = "".join(keys)
    assert Line().send(*split(text, cuts), gap=SOON) == text


@pytest.mark.parametrize("gap", [0.0, SOON, LATE, 1.9])
@pytest.mark.parametrize("cut", range(1, len(F8)))
def test_f8_is_f8_wherever_the_line_tears_it(cut: int, gap: float) -> None:
    torn_off = ESCAPE if cut == 1 and gap > PATIENCE else ""  # it was taken for the key
    assert Line().send(F8[:cut], F8[cut:], gap=gap) == torn_off + F8


@given(
    st.text("0123456789;:<?", max_size=6),
    st.sampled_from(["", "~", "m", "H", "u", "z", "\x1b"]),
    st.sets(st.integers(1, 9)),
    st.sampled_from([0.0, SOON, LATE, 1.9]),
)
def test_no_digit_that_follows_escape_and_bracket_is_a_key(
    digits: str, final: str, cuts: set[int], gap: float
) -> None:
    came = Line().send(*split(f"\x1b[{digits}{final}", cuts), gap=gap)
    assert re.sub(r"\x1b\[[\d;:<?]*[A-Za-z~]", "", came) == ""


def test_escape_is_the_key_at_once_with_the_next_and_else_after_its_patience() -> None:
    line = Line()
    assert line.filter.feed("\x1by", line.now) == ESCAPE + "y"
    assert line.filter.feed("\x1b", line.now) == ""
    assert line.silence(SOON) == ""
    assert line.silence(0.1) == ESCAPE
    assert line.filter.feed("\x1b\x1b[19~", line.now) == ESCAPE + F8


@pytest.mark.parametrize(
    ("environ", "patience"),
    [({}, 0.1), ({"SSH_CONNECTION": "1 2 3 4"}, 0.5), ({"ESCDELAY": "25"}, 0.025)],
)
def test_escape_waits_longer_over_ssh(environ: dict[str, str], patience: float) -> None:
    assert escape_patience(environ) == patience


@given(st.text(st.sampled_from("ab1\n\t\x00\x1b[]m;~20\x07é\x7f"), max_size=60))
def test_a_paste_is_its_text_alone(text: str) -> None:
    came = Line().send(BEGIN + text + END)
    assert came.startswith(BEGIN)
    assert came.count("\x1b") == 2
    inside = came[len(BEGIN) : came.index(END)]
    assert all(char.isprintable() or char in "\n\t" for char in inside)
    if "\x1b" not in text:
        assert inside == "".join(char for char in text if char.isprintable() or char in "\n\t")


def test_marks_inside_a_paste_make_no_keys_of_it() -> None:
    assert Line().send(f"{BEGIN}a{BEGIN}b{END}1c{END}") == f"{BEGIN}ab{END}"
    line = Line()
    assert line.send(f"{BEGIN}x{END}", "1") == f"{BEGIN}x{END}1"  # typed after it


@pytest.mark.parametrize("urgent", [F8, "\x1b"])
def test_a_paste_without_its_end_leaves_f8_and_escape(urgent: str) -> None:
    line = Line()
    came = line.send(f"{BEGIN}abc", "def", urgent)
    assert came == f"{BEGIN}abcdef{END}" + (ESCAPE if urgent == "\x1b" else F8)
    assert line.send("1") == "1"


@given(st.integers(0, MOST_KEYS), st.integers(MOST_KEYS, 3 * MOST_KEYS))
def test_of_too_many_keys_f8_and_escape_are_left(waiting: int, count: int) -> None:
    line = Line(waiting)
    came = line.send("1" * count + "\x1b1" + F8 + "2")
    kept = MOST_KEYS - waiting
    assert came == "1" * min(kept, count) + ESCAPE * (count >= kept) + F8 + "2"
    assert line.floods == 1
    assert line.send("3") == "3" * (waiting < MOST_KEYS)


@given(st.lists(st.sampled_from(["a", "y", "\r", "\x1b[A"]), max_size=3 * MOST_KEYS), st.booleans())
def test_y_behind_f8_survives_every_flood(keys: list[str], torn: bool) -> None:
    line = Line(waiting=MOST_KEYS)
    pieces = ["".join(keys) + F8, "y"] if torn else ["".join(keys) + F8 + "y"]
    assert line.send(*pieces, gap=PAUSE / 2).endswith(f"{F8}y")


def test_a_key_that_is_held_down_is_no_flood() -> None:
    line = Line()
    assert line.send(*["j"] * 1000, gap=PAUSE * 1.5) == "j" * 1000
    assert line.floods == 0


@pytest.mark.parametrize(
    "text",
    ["1c y", BEGIN + "\x1b[31m1c2d\x1b[0m\n", "\x1b[31mred\x1b[0m", "\x1b", "\x1b[1", "é\x00", F8],
    ids=["keys", "colours in a paste", "colours", "escapes", "torn", "binary", "f8"],
)
def test_a_megabyte_of_anything_costs_less_than_a_second_and_20_mb(text: str) -> None:
    chunk = (text * (1 << 16))[: 1 << 16]

    def send() -> int:
        line = Line()
        return sum(len(line.filter.feed(chunk, line.now)) for _ in range(16))

    began = time.process_time()
    assert send() < 20_000
    assert time.process_time() - began < 1.0
    tracemalloc.start()
    send()
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
