from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
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
from madrob_console.common.files import atomic_write
from tests.madrob_console.run_folders import put_hole

START = 1_700_000_000.25
NUMBERS = st.integers(1, 999)
FIRST = RunName(subject=3, condition=7, run=1)


@pytest.fixture
def brussels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Brussels")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.usefixtures("brussels")
def test_a_folder_is_named_after_the_run_and_its_local_start_time() -> None:
    assert FIRST.folder_name(START) == "subject_003_cond_007_run_001_20231114_231320"


@given(st.builds(RunName, NUMBERS, NUMBERS, NUMBERS), st.integers(0, 4_000_000_000))
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


def test_run_numbers_count_up_for_each_subject_and_condition(tmp_path: Path) -> None:
    root = tmp_path / "new" / "results"
    assert next_run_number(root, 3, 7) == 1
    folder = reserve_run_folder(root, FIRST, START)
    assert folder == root / FIRST.folder_name(START)
    assert not folder.exists()  # the recorder makes it
    reserve_run_folder(root, RunName(3, 7, 5), START)
    (root / RunName(3, 8, 12).folder_name(START)).mkdir()  # it came from elsewhere
    following = [next_run_number(root, *whose) for whose in ((3, 7), (3, 8), (3, 9), (30, 7))]
    assert following == [6, 13, 1, 1]


def test_a_number_is_never_used_again_even_when_its_folder_is_gone(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, FIRST, START)
    assert next_run_number(tmp_path, 3, 7) == 2
    with pytest.raises(MadrobError, match="run 1 of subject 3 in condition 7 exists: use run 2"):
        reserve_run_folder(tmp_path, FIRST, START + 60)


def test_a_torn_last_line_costs_nothing_but_itself(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, FIRST, START)
    with (tmp_path / NUMBERS_FILE).open("ab") as file:
        file.write(b'{"subject":3,"condition":7,"run":99')
    assert next_run_number(tmp_path, 3, 7) == 2
    reserve_run_folder(tmp_path, RunName(3, 7, 2), START)
    assert next_run_number(tmp_path, 3, 7) == 3
    with pytest.raises(MadrobError, match="exists"):
        reserve_run_folder(tmp_path, FIRST, START)


def test_two_consoles_never_get_the_same_number(tmp_path: Path) -> None:
    def claim(start: float) -> Path | None:
        try:
            return reserve_run_folder(tmp_path, FIRST, start)
        except MadrobError:
            return None

    with ThreadPoolExecutor(8) as consoles:
        made = list(consoles.map(claim, [START + i for i in range(8)]))
    assert made.count(None) == 7
    assert next_run_number(tmp_path, FIRST.subject, FIRST.condition) == FIRST.run + 1


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


Use = Callable[[Path], object]
USES: tuple[Use, ...] = (
    lambda root: reserve_run_folder(root, FIRST, START),
    lambda root: next_run_number(root, 3, 7),
    run_folder_names,
)
NO_PLACES: dict[str, tuple[str, Use]] = {
    "a file": ("", Path.touch),
    "a pipe": (NUMBERS_FILE, os.mkfifo),
    "a link": (NUMBERS_FILE, lambda path: path.symlink_to("/dev/zero")),
    "a link outside": (NUMBERS_FILE, lambda path: path.symlink_to(path.parents[1] / "outside")),
    "a folder": (NUMBERS_FILE, Path.mkdir),
    "sparse": (NUMBERS_FILE, put_hole),
}


@pytest.mark.parametrize("case", NO_PLACES)
def test_what_is_no_results_folder_or_no_file_of_numbers_is_named_at_once(
    tmp_path: Path, case: str
) -> None:
    name, make = NO_PLACES[case]
    root, outside = tmp_path / "results", tmp_path / "outside"
    outside.write_text("precious")
    (root if name else tmp_path).mkdir(exist_ok=True)
    make(root / name)
    words = rf"{NUMBERS_FILE}: cannot be used \(.*\); put a plain"
    for use in USES[:2] if name else USES:
        with pytest.raises(
            MadrobError,
            match=words if name else r"results: cannot be used for results \(.*; choose",
        ):
            use(root)
    assert outside.read_text() == "precious"


def test_whoever_locks_the_numbers_file_keeps_nobody_from_starting(tmp_path: Path) -> None:
    reserve_run_folder(tmp_path, FIRST, START)
    with (tmp_path / NUMBERS_FILE).open("rb") as stranger:
        fcntl.flock(stranger, fcntl.LOCK_EX)
        reserve_run_folder(tmp_path, RunName(3, 7, 2), START)
        assert next_run_number(tmp_path, 3, 7) == 3


def test_of_two_that_saw_a_number_free_the_first_line_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reserve_run_folder(tmp_path, FIRST, START)
    monkeypatch.setattr(folders, "_used_numbers", lambda *_: set())
    with pytest.raises(MadrobError, match="run 1 of subject 3 in condition 7 exists"):
        reserve_run_folder(tmp_path, FIRST, START + 60)


def test_a_file_is_replaced_whole_and_what_a_link_led_to_stays(tmp_path: Path) -> None:
    path, outside = tmp_path / "result.json", tmp_path / "outside"
    outside.write_bytes(b"precious")
    path.symlink_to(outside)
    for content in (b"old", b"new and longer"):
        atomic_write(path, content)
        assert (path.read_bytes(), path.is_symlink()) == (content, False)
    assert outside.read_bytes() == b"precious"
    assert set(tmp_path.iterdir()) == {path, outside}
    assert path.stat().st_mode & 0o777 == 0o666 & ~_umask()


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    (path / "inside").mkdir(parents=True)
    with pytest.raises(MadrobError, match=r"result.json: not written \(.*choose another folder"):
        atomic_write(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["result.json"]
    with pytest.raises(MadrobError, match="not written"):
        atomic_write(tmp_path / "none" / "result.json", b"new")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
