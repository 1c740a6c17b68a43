"""Files and folders that are there whole or not at all."""

from __future__ import annotations

import fcntl
import os
import unicodedata
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.common.files import Hold, is_held, replaced_folder, write_new_folder
from madrob_console.common.names import LONGEST_NAME, clean_name, terminal_safe


def test_a_new_folder_has_all_of_its_files(tmp_path: Path) -> None:
    write_new_folder(tmp_path / "far" / "new", {"one": b"1", "two": b"22"})
    assert {path.name: path.read_bytes() for path in (tmp_path / "far" / "new").iterdir()} == {
        "one": b"1",
        "two": b"22",
    }
    assert [path.name for path in (tmp_path / "far").iterdir()] == ["new"]


def test_of_a_folder_that_cannot_be_written_nothing_stays(tmp_path: Path) -> None:
    with pytest.raises(MadrobError, match="not written"):
        write_new_folder(tmp_path / "new", {"one": b"1", "no/two": b"2"})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_there_stays_as_it_is(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine"
    match kind:
        case "file":
            path.write_text("mine")
        case "folder":
            path.mkdir()
        case "link":
            path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(MadrobError, match="is there already; move it away"):
        write_new_folder(path, {"one": b"1"})
    assert [found.name for found in tmp_path.iterdir()] == ["mine"]
    assert path.is_symlink() or path.is_file() or not list(path.iterdir())


def test_a_folder_is_replaced_with_all_of_its_files(tmp_path: Path) -> None:
    for files in ({"one": b"1", "two": b"2"}, {"two": b"22"}):
        replaced_folder(tmp_path / "it", files)
        assert {path.name: path.read_bytes() for path in (tmp_path / "it").iterdir()} == files
        assert [path.name for path in tmp_path.iterdir()] == ["it"]


def test_a_folder_that_cannot_be_replaced_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replaced_folder(tmp_path / "it", {"one": b"1"})
    rename = Path.rename

    def refused(path: Path, target: Path) -> Path:
        if target == tmp_path / "it" and (path / "two").exists():
            raise OSError(5, "Input/output error")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", refused)
    with pytest.raises(MadrobError, match="it: not written"):
        replaced_folder(tmp_path / "it", {"two": b"2"})
    assert [path.name for path in tmp_path.iterdir()] == ["it"]
    assert (tmp_path / "it" / "one").read_bytes() == b"1"


def test_only_one_holds_and_the_file_is_there_meanwhile(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    assert is_held(path) is None
    with Hold(path) as hold:
        assert is_held(path) is True
        assert hold.stands
        with pytest.raises(BlockingIOError):
            Hold(path)
        assert path.stat().st_mode & 0o777 == 0o600
    assert not path.exists()
    with Hold(path):
        assert is_held(path) is True


def test_what_a_killed_process_leaves_is_not_held(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    path.touch(0o600)
    assert is_held(path) is False
    Hold(path).release()
    assert not path.exists()


def test_it_is_let_go_of_when_everybody_who_shares_it_has_released_it(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    hold = Hold(path)
    hold.share().release()
    assert is_held(path) is True
    hold.release()
    assert is_held(path) is None


def test_a_lock_whose_file_is_gone_takes_no_other_file_along(tmp_path: Path) -> None:
    path = tmp_path / ".lock"
    hold = Hold(path)
    path.unlink()
    assert not hold.stands
    with Hold(path):
        hold.release()
        assert is_held(path) is True


@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_what_is_no_plain_file_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ".lock"
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "link":
            (tmp_path / "precious").touch()
            path.symlink_to(tmp_path / "precious")
        case "folder":
            path.mkdir()
    with pytest.raises(OSError, match=r"no plain file|symbolic links|directory"):
        Hold(path)
    assert is_held(path) is None
    assert not (tmp_path / "precious").exists() or kind == "link"


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
