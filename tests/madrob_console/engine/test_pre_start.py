"""What the pre-start checks say of the disk, on the real engine: what they say is so."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest

from madrob_console.archive.folders import NUMBERS_FILE, PRACTICE_FOLDER
from madrob_console.engine.live.keeper import InlineKeeper, Keepers, T
from madrob_console.referee.acts import SetUp, Start, Waive
from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import blocking
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.small_disk import disk_image, lock_folder
from tests.watching import until

READY = "ok: ready to open a file"
LOOKED = 2.1
"""By then the disk was asked again, s."""


class MuteKeeper(InlineKeeper):
    """A disk that answers when it is told to."""

    def __init__(self) -> None:
        self._jobs: list[Callable[[], object]] = []

    def ask(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        self._jobs.append(lambda: InlineKeeper.ask(self, job, done))
        return Future()

    def answer(self) -> None:
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            job()


def no_folder(root: Path) -> None:
    root.write_text("a file, not a folder")


def no_parent(root: Path) -> None:
    shutil.rmtree(root.parent)
    root.parent.write_text("a file, not a folder")


def link_to_nowhere(root: Path) -> None:
    root.symlink_to(root / "nowhere")


def numbers_are_a_folder(root: Path) -> None:
    (root / PRACTICE_FOLDER / NUMBERS_FILE).mkdir(parents=True)


def numbers_are_a_link(root: Path) -> None:
    (root / PRACTICE_FOLDER).mkdir(parents=True)
    (root / PRACTICE_FOLDER / NUMBERS_FILE).symlink_to("/dev/zero")


def practice_is_a_link(root: Path) -> None:
    root.mkdir()
    (root / PRACTICE_FOLDER).symlink_to(root)  # its runs would be found by nobody


@pytest.mark.parametrize(
    "spoil",
    [
        no_folder,
        no_parent,
        link_to_nowhere,
        numbers_are_a_folder,
        numbers_are_a_link,
        practice_is_a_link,
    ],
)
def test_a_recorder_that_can_make_no_folder_is_found_before_the_start(
    spoil: Callable[[Path], None], tmp_path: Path
) -> None:
    root = tmp_path / "place" / "results"
    root.parent.mkdir()
    drive = Drive(root)
    drive.prepare(make_setup())
    assert drive.check(CheckName.RECORDER) == READY
    spoil(root)
    drive.wait(LOOKED)
    said = drive.check(CheckName.RECORDER)
    assert said.startswith(f"failed: {root.parent}")
    blocked = {check.name for check in blocking(drive.engine.snapshot().checks)}
    assert CheckName.RECORDER in blocked
    drive.act(*(Waive(name, "I know better") for name in blocked))
    waived = drive.engine.perform(Start())  # the disk refuses all the same
    assert waived is not None
    assert str(root.parent) in waived
    assert drive.engine.run.phase is Phase.READY
    shutil.rmtree(root.parent) if root.parent.is_dir() else root.parent.unlink()
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER) == READY
    drive.act(Start())
    drive.wait_until(lambda: drive.engine.run.phase is Phase.RUNNING)


def test_a_disk_that_says_nothing_is_no_recorder_that_is_ready(tmp_path: Path) -> None:
    mute = MuteKeeper()
    drive = Drive(tmp_path, keepers=Keepers(InlineKeeper(), mute))
    drive.prepare(make_setup())
    for name in (CheckName.DISK, CheckName.RECORDER):
        assert drive.check(name).startswith("no data: ")
    refused = drive.engine.perform(Start())
    assert refused is not None
    assert "free space unknown" in refused
    mute.answer()
    drive.wait(LOOKED)
    mute.answer()
    assert drive.check(CheckName.RECORDER) == READY


def test_a_disk_with_too_little_room_is_a_fault_as_long_as_nobody_waived_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("madrob_console.engine.live.pre_start.free_space", lambda _root: 2_200_000)
    drive = Drive(tmp_path, disk_needed=5_000_000)
    drive.wait(LOOKED)
    said = "2.2 MB free, 5.0 MB needed"
    assert f"disk space: {said}" in drive.engine.snapshot().faults
    drive.prepare(make_setup())
    assert drive.check(CheckName.DISK) == f"failed: {said}"
    drive.act(Waive(CheckName.DISK, "more is on its way"))
    assert not any(fault.startswith("disk space") for fault in drive.engine.snapshot().faults)


def fill_with_files(folder: Path) -> None:
    for number in range(100_000):
        (folder / str(number)).touch()


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.machine
def test_a_disk_that_hangs_is_no_recorder_that_is_ready(tmp_path: Path) -> None:
    with disk_image(tmp_path / "disk") as disk:
        drive = Drive(disk.folder, keepers=Keepers.threads())
        drive.act(SetUp(make_setup()))
        until_said(drive, READY)
        with disk.stalled():
            until_said(drive, "no data: no answer from the disk: look at the results folder")
        until_said(drive, READY)
        drive.engine.close()


def until_said(drive: Drive, words: str) -> None:
    def said() -> bool:
        drive.wait(LOOKED)
        return drive.check(CheckName.RECORDER) == words

    until(said)


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.machine
def test_a_folder_that_takes_no_file_is_found_before_the_start(tmp_path: Path) -> None:
    with disk_image(tmp_path / "disk") as disk:
        root = disk.folder / "results"
        root.mkdir()
        drive = Drive(root)
        drive.prepare(make_setup())
        lock_folder(root, locked=True)
        drive.wait(LOOKED)
        assert "nothing can be written there" in drive.check(CheckName.RECORDER)
        lock_folder(root, locked=False)
        drive.wait(LOOKED)
        assert drive.check(CheckName.RECORDER) == READY
        many = disk.folder / "many"
        many.mkdir()
        with pytest.raises(OSError, match="No space left"):
            fill_with_files(many)
        drive.wait(LOOKED)
        assert "No space left" in drive.check(CheckName.RECORDER)
        shutil.rmtree(many)
        disk.turn_read_only()
        drive.wait(LOOKED)
        assert re.search("Read-only|nothing can be written", drive.check(CheckName.RECORDER))
        drive.engine.close()
