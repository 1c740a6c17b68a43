from __future__ import annotations

import unicodedata

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from madrob_console.errors import MadrobError
from madrob_console.names import LONGEST_NAME, clean_name, terminal_safe

ANYTHING = st.text(st.characters(codec=None, exclude_categories=()), max_size=40)
BIDI = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


@pytest.mark.parametrize(
    "name",
    [
        "Walk-Man",
        "R&D Team no. 7 (Zürich)",
        "東京ロボット部",
        "로봇 연구소",
        "فريق الروبوت",
        "تیم نمی\u200cدانم",  # noqa: RUF001  the joiner is the point
        "Team 🤖",
        "👩\u200d🔬 Lab",
        "🏴\U000e0067\U000e0062\U000e0073\U000e0063\U000e0074\U000e007f Scotland",
    ],
)
def test_names_of_all_scripts_stay_as_they_are(name: str) -> None:
    assert clean_name(name, "team") == name


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        ("  Walk \t Man\n", "Walk Man"),
        ("../../etc/passwd", "etc passwd"),
        ("/abs", "abs"),
        ("a\\..\\b", "a .. b"),
        ("..", "?"),
        (". . .", "?"),
        ("\x00\x07", "?"),
        ("\u200d \u0301", "?"),
        ("", "?"),
        ("\x1b[31mRed\x1b[0m", "Red"),
        ("\x9b2JGone", "Gone"),
        ("\x1b]0;title\x07Team", "Team"),
        ("\x1b]8;;http://x\x1b\\Team\x1b]8;;\x1b\\", "Team"),
        ("\x1bPq#0\x1b\\Six", "Six"),
        ("\x1bcReset", "Reset"),
        ("open \x1b] end", "open end"),
        ("abc\u202egpj.exe", "abcgpj.exe"),
        ("e\u0301quipe", "équipe"),
        ("half \ud83e", "half \ufffd"),
    ],
)
def test_what_would_move_or_mislead_is_removed(typed: str, name: str) -> None:
    assert clean_name(typed, "team", fallback="?") == name


def test_a_name_that_is_too_long_is_refused_not_cut() -> None:
    assert clean_name("x" * LONGEST_NAME, "team") == "x" * LONGEST_NAME
    with pytest.raises(MadrobError, match=r"^team has 61 characters: use at most 60"):
        clean_name("x" * (LONGEST_NAME + 1), "team")


@given(ANYTHING)
@example("\x1b\x1b[[mm")
@example("\x1b\x9b")
def test_no_text_can_steer_the_terminal(text: str) -> None:
    safe = terminal_safe(text)
    assert not {unicodedata.category(c) for c in safe} & {"Cc", "Cs", "Zl", "Zp"}
    assert not BIDI & set(safe)
    assert terminal_safe(safe) == safe
    assert safe.encode().decode() == safe


@given(st.text(st.characters(categories=["L", "N", "P", "S"])))
def test_visible_text_is_shown_unchanged(text: str) -> None:
    assert terminal_safe(text) == text


@given(ANYTHING)
@example("\u1fef./x")
@example("a\u0301\u0301/..")
def test_a_clean_name_is_one_part_of_a_path_and_stays_clean(text: str) -> None:
    name = clean_name(text, "team", fallback="nobody")
    assert name
    assert not set("/\\\0") & set(name)
    assert not name.startswith(".")
    assert len(name.encode()) <= 255
    assert name == " ".join(name.split())
    assert clean_name(name, "team") == name
