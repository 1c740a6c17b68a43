from __future__ import annotations

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive import folders
from madrob_console.archive.folders import (
    NUMBERS_FILE,
    RunName,
    next_run_number,
    parse_folder_name,
    reserve_run_folder,
    run_folder_names,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import atomic_write, free_space

START = 1_700_000_000.25
RUN = RunName(subject=3, condition=7, run=1)
numbers = st.integers(1, 999)


@pytest.fixture
def brussels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Brussels")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("brussels")
def test_a_folder_is_named_after_the_run_and_its_local_start_time() -> None:
    assert RUN.folder_name(START) == "subject_003_cond_007_run_001_20231114_231320"


@given(st.builds(RunName, numbers, numbers, numbers), st.integers(0, 4_000_000_000))
def test_a_folder_name_tells_which_run_it_is(run: RunName, start: int) -> None:
    parsed = parse_folder_name(run.folder_name(start))
    assert parsed is not None
    assert parsed[0] == run
    # the hour that comes twice in autumn is the only one that a local time leaves open
    assert abs(parsed[1].timestamp() - start) in (0, 3600)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "subject_003_cond_007_run_001",
        "subject_3_cond_7_run_1_20231114_231320",
        "subject_003_cond_007_run_001_20231114_231320_0.mcap",
        "subject_003_cond_007_run_001_20231345_231320",
        "subject_00٣_cond_007_run_001_20231114_231320",
        "old/subject_003_cond_007_run_001_20231114_231320",
    ],
)
def test_other_names_are_no_run_folders(name: str) -> None:
    assert parse_folder_name(name) is None


def test_the_first_run_number_is_1_even_without_a_results_folder(tmp_path: Path) -> None:
    assert next_run_number(tmp_path / "none", 3, 7) == 1


def test_run_numbers_count_up_for_each_subject_and_condition(tmp_path: Path) -> None:
    root = tmp_path / "new" / "results"
    folder = reserve_run_folder(root, RUN, START)
    assert folder == root / RUN.folder_name(START)
    assert not folder.exists()  # the recorder makes it
    reserve_run_folder(root, RunName(3, 7, 5), START)
    assert next_run_number(root, 3, 7) == 6
    assert next_run_number(root, 3, 8) == 1
    assert next_run_number(root, 30, 7) == 1


def test_folders_that_came_from_elsewhere_count(tmp_path: Path) -> None:
    (tmp_path / RunName(3, 7, 12).folder_name(START)).mkdir()
    assert next_run_number(tmp_path, 3, 7) == 13


def test_a_number_is_never_used_again_even_when_its_folder_is_gone(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, RUN, START)
    assert next_run_number(tmp_path, 3, 7) == 2
    with pytest.raises(MadrobError, match="run 1 of subject 3 in condition 7 exists: use run 2"):
        reserve_run_folder(tmp_path, RUN, START + 60)


def test_a_torn_last_line_costs_nothing_but_itself(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, RUN, START)
    with (tmp_path / NUMBERS_FILE).open("ab") as file:
        file.write(b'{"subject":3,"condition":7,"run":99')
    assert next_run_number(tmp_path, 3, 7) == 2
    reserve_run_folder(tmp_path, RunName(3, 7, 2), START)
    assert next_run_number(tmp_path, 3, 7) == 3
    with pytest.raises(MadrobError, match="exists"):
        reserve_run_folder(tmp_path, RUN, START)


def test_two_consoles_never_get_the_same_number(tmp_path: Path) -> None:
    made: list[Path] = []

    def claim(start: float) -> None:
        try:
            made.append(reserve_run_folder(tmp_path, RUN, start))
        except MadrobError:
            return

    threads = [threading.Thread(target=claim, args=(START + i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
    assert next_run_number(tmp_path, RUN.subject, RUN.condition) == RUN.run + 1


@pytest.mark.parametrize(
    ("run", "field"),
    [
        (RunName(0, 7, 1), "subject 0"),
        (RunName(1000, 7, 1), "subject 1000"),
        (RunName(3, 7, 0), "run"),
    ],
)
def test_numbers_out_of_range_are_refused(tmp_path: Path, run: RunName, field: str) -> None:
    with pytest.raises(MadrobError, match=f"{field}.*use a number from 1 to 999"):
        reserve_run_folder(tmp_path, run, START)
    assert not list(tmp_path.iterdir())


def test_when_all_numbers_are_used_it_says_so(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, RunName(3, 7, 999), START)
    with pytest.raises(MadrobError, match="choose another results folder"):
        next_run_number(tmp_path, 3, 7)


def test_a_file_in_place_of_the_results_folder_is_one_clear_line(tmp_path: Path) -> None:
    root = tmp_path / "results"
    root.write_text("not a folder")
    for use in (
        lambda: reserve_run_folder(root, RUN, START),
        lambda: next_run_number(root, 3, 7),
        lambda: run_folder_names(root),
    ):
        with pytest.raises(MadrobError, match=r"results: cannot be used for results \(.*; choose"):
            use()
    assert root.read_text() == "not a folder"


def test_a_link_in_place_of_the_numbers_file_is_not_written_through(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("precious")
    root = tmp_path / "results"
    root.mkdir()
    (root / NUMBERS_FILE).symlink_to(outside)
    with pytest.raises(MadrobError):
        reserve_run_folder(root, RUN, START)
    assert outside.read_text() == "precious"


@pytest.mark.parametrize("kind", ["pipe", "link", "folder", "sparse"])
def test_a_numbers_file_that_is_none_is_named_at_once(tmp_path: Path, kind: str) -> None:
    numbers_file = tmp_path / NUMBERS_FILE
    match kind:
        case "pipe":
            os.mkfifo(numbers_file)
        case "link":
            numbers_file.symlink_to("/dev/zero")
        case "folder":
            numbers_file.mkdir()
        case "sparse":
            with numbers_file.open("wb") as file:
                file.truncate(20 * 10**9)
    for use in (
        lambda: reserve_run_folder(tmp_path, RUN, START),
        lambda: next_run_number(tmp_path, 3, 7),
    ):
        with pytest.raises(
            MadrobError, match=rf"{NUMBERS_FILE}: cannot be used \(.*\); put a plain"
        ):
            use()


def test_whoever_locks_the_numbers_file_keeps_nobody_from_starting(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, RUN, START)
    with (tmp_path / NUMBERS_FILE).open("rb") as stranger:
        fcntl.flock(stranger, fcntl.LOCK_EX)
        reserve_run_folder(tmp_path, RunName(3, 7, 2), START)
        assert next_run_number(tmp_path, 3, 7) == 3


def test_of_two_that_saw_a_number_free_the_first_line_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reserve_run_folder(tmp_path, RUN, START)
    monkeypatch.setattr(folders, "_used_numbers", lambda *_: set())
    with pytest.raises(MadrobError, match="run 1 of subject 3 in condition 7 exists"):
        reserve_run_folder(tmp_path, RUN, START + 60)


def test_only_run_folders_are_runs(tmp_path: Path) -> None:
    folders = {_made(tmp_path, RUN, START + 100), _made(tmp_path, RunName(9, 20, 2), START)}
    (tmp_path / "notes").mkdir()
    (tmp_path / RunName(4, 1, 1).folder_name(START)).write_text("a file")
    (tmp_path / RunName(5, 1, 1).folder_name(START)).symlink_to(min(folders))
    assert {tmp_path / name for name in run_folder_names(tmp_path)} == folders
    assert run_folder_names(tmp_path / "none") == []


def test_a_folder_name_tells_run_and_start() -> None:
    started = datetime.fromtimestamp(int(START)).astimezone()
    assert parse_folder_name(RUN.folder_name(START)) == (RUN, started)
    assert parse_folder_name("notes") is None


def test_a_file_is_replaced_whole_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    atomic_write(path, b"old")
    atomic_write(path, b"new and longer")
    assert path.read_bytes() == b"new and longer"
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o666 & ~_umask()


def test_a_link_is_replaced_and_what_it_led_to_stays(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_bytes(b"precious")
    link = tmp_path / "result.json"
    link.symlink_to(outside)
    atomic_write(link, b"new")
    assert outside.read_bytes() == b"precious"
    assert link.read_bytes() == b"new"
    assert not link.is_symlink()


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    (path / "inside").mkdir(parents=True)
    with pytest.raises(MadrobError, match=r"result.json: not written \(.*choose another folder"):
        atomic_write(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]
    with pytest.raises(MadrobError, match="not written"):
        atomic_write(tmp_path / "none" / "result.json", b"new")


def test_free_space_is_known_for_a_folder_yet_to_be_made(tmp_path: Path) -> None:
    free = free_space(tmp_path / "a" / "b")
    assert free is not None
    assert free > 0
    (tmp_path / "file").touch()
    assert free_space(tmp_path / "file" / "b") is None


def _made(root: Path, run: RunName, start: float) -> Path:
    folder = reserve_run_folder(root, run, start)
    folder.mkdir()
    return folder


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
