"""A lock that no other user can hold, and that nobody waits for."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from madrob_console.files.held import Hold, is_held


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
