"""Files and folders that are there whole or not at all."""

from __future__ import annotations

import fcntl
import os
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold, is_held
from madrob_console.common.files import write_new_folder
from madrob_console.common.names import LONGEST_NAME, clean_name, terminal_safe


def held(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_folder_has_all_of_its_files(tmp_path: Path) -> None:
    files = {"one": b"1", "two": b"22"}
    write_new_folder(tmp_path / "far" / "it", files)
    assert held(tmp_path / "far" / "it") == files
    assert [path.name for path in (tmp_path / "far").iterdir()] == ["it"]


def test_of_a_folder_that_cannot_be_written_nothing_stays(tmp_path: Path) -> None:
    with pytest.raises(MadrobError, match="not written"):
        write_new_folder(tmp_path / "new", {"one": b"1", "no/two": b"2"})
    assert list(tmp_path.iterdir()) == []


KINDS: dict[str, Callable[[Path], object]] = {
    "file": lambda path: path.write_text("mine"),
    "folder": Path.mkdir,
    "link": lambda path: path.symlink_to(path.parent / "precious"),
    "pipe": os.mkfifo,
}


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_there_stays_as_it_is(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine"
    KINDS[kind](path)
    with pytest.raises(MadrobError, match="is there already; move it away"):
        write_new_folder(path, {"one": b"1"})
    assert [found.name for found in tmp_path.iterdir()] == ["mine"]
    assert path.is_symlink() or path.is_file() or not list(path.iterdir())


@pytest.fixture
def lock(tmp_path: Path) -> Path:
    return tmp_path / ".lock"


def test_only_one_holds_and_the_file_is_there_meanwhile(lock: Path) -> None:
    assert is_held(lock) is None
    with Hold(lock) as hold:
        assert (is_held(lock), hold.stands) == (True, True)
        with pytest.raises(BlockingIOError):
            Hold(lock)
        assert lock.stat().st_mode & 0o777 == 0o600
    assert not lock.exists()
    hold = Hold(lock)
    hold.share().release()
    assert is_held(lock) is True
    hold.release()  # by everybody who shares it
    assert is_held(lock) is None


def test_what_a_killed_process_leaves_is_not_held(lock: Path) -> None:
    lock.touch(0o600)
    assert is_held(lock) is False
    Hold(lock).release()
    assert not lock.exists()


def test_a_lock_whose_file_is_gone_takes_no_other_file_along(lock: Path) -> None:
    hold = Hold(lock)
    lock.unlink()
    assert not hold.stands
    with Hold(lock):
        hold.release()
        assert is_held(lock) is True


@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_what_is_no_plain_file_is_refused_at_once(lock: Path, kind: str) -> None:
    if kind == "link":
        (lock.parent / "precious").touch()
    KINDS[kind](lock)
    with pytest.raises(OSError, match=r"no plain file|symbolic links|directory"):
        Hold(lock)
    assert is_held(lock) is None
    assert (lock.parent / "precious").exists() == (kind == "link")


def test_a_reader_of_another_file_of_the_run_holds_nothing(tmp_path: Path) -> None:
    path, other = tmp_path / ".lock", tmp_path / "journal.jsonl"
    path.touch(0o600)
    other.touch()
    with other.open("rb") as stranger:
        fcntl.flock(stranger, fcntl.LOCK_EX)
        assert is_held(path) is False


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
