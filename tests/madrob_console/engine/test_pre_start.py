"""What the pre-start checks say of the disk, on the real engine: what they say is so."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import NUMBERS_FILE, PRACTICE_FOLDER, RunPath, runs_at
from madrob_console.archive.history import History
from madrob_console.archive.result_reader import read_whole_result
from madrob_console.archive.scored import read_recorded_run
from madrob_console.engine.disk import DiskJobs, DiskThreads, T
from madrob_console.messages.codec import encode_text
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.pages.tally import overall
from madrob_console.referee.acts import ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import read_journal
from madrob_console.referee.records import CheckName, RunSetup
from madrob_console.referee.run import Phase
from madrob_console.testbeds.source import INFO_TOPIC, INFO_TYPE, SILENT, Announcement, info_text
from recorder.bag import RawMessage
from recorder.reader import read_bag
from scoring.rest import HandleRest
from tests.madrob_console.engine.drive import Drive, Rehearsal, make_setup
from tests.madrob_console.engine.faulty_source import TIMEOUT, FaultyDrive
from tests.madrob_console.engine.spoilt import Edit
from tests.madrob_console.recorded_runs import without_digests
from tests.madrob_console.small_disk import disk_image, lock_folder
from tests.watching import until

READY = "ok: ready to open a file"
LOOKED = 2.1
"""By then the disk was asked again, s."""


class MuteKeeper(DiskJobs):
    """A disk that answers when it is told to."""

    def __init__(self) -> None:
        self._jobs: list[Callable[[], object]] = []

    def submit_job(
        self,
        job: Callable[[], T],
        done: Callable[[Future[T]], None] | None = None,
        *,
        first: bool = True,
    ) -> Future[T]:
        self._jobs.append(lambda: DiskJobs.submit_job(self, job, done))
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
    drive = Drive(tmp_path, keepers=DiskThreads(mute, DiskJobs()))
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
    monkeypatch.setattr("madrob_console.engine.start_checks.free_space", lambda _root: 2_200_000)
    drive = Drive(tmp_path, disk_needed=5_000_000)
    drive.wait(LOOKED)
    said = "make room on the disk: 2.2 MB free, 5.0 MB needed"
    assert f"disk space: {said}" in drive.engine.snapshot().all_faults
    drive.prepare(make_setup())
    assert drive.check(CheckName.DISK) == f"failed: {said}"
    drive.act(Waive(CheckName.DISK, "more is on its way"))
    assert not any(fault.startswith("disk space") for fault in drive.engine.snapshot().all_faults)


def fill_with_files(folder: Path) -> None:
    for number in range(100_000):
        (folder / str(number)).touch()


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.machine
def test_a_disk_that_hangs_is_no_recorder_that_is_ready(tmp_path: Path) -> None:
    with disk_image(tmp_path / "disk") as disk:
        drive = Drive(disk.folder, keepers=DiskThreads.threads())
        drive.act(SetUp(make_setup()))
        until_said(drive, READY)
        with disk.stalled():
            until_said(drive, "no data: look at the results folder: the disk does not answer")
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


TYPES = MessageTypes()
SAID = RawMessage(INFO_TOPIC, INFO_TYPE, encode_text(TYPES, info_text("nominal")), 1, 2)
OVER_ROS = Announcement("nominal", None, (SAID,))


def setup(number: int = 1, *, practice: bool = False) -> RunSetup:
    return replace(make_setup(run_number=number), practice=practice)


def test_official_and_practice_runs_lie_apart_and_have_numbers_of_their_own(
    hall: Rehearsal, tmp_path: Path
) -> None:
    for one in (setup(1), setup(1, practice=True), setup(2, practice=True)):
        hall.whole_run(one)
        assert (hall.folder.parent == tmp_path / "practice") == one.practice
        assert check_run(RunPath(hall.folder)).found == ()
        snapshot = hall.engine.snapshot()
        assert (snapshot.practice, snapshot.simulated) == (one.practice, None)
    assert hall.engine.next_run_number(3, 1).result() == 2
    assert hall.engine.next_run_number(3, 1, practice=True).result() == 3
    runs = History(tmp_path).refresh()
    assert [run.official for run in runs] == [True, False, False]
    assert [run.practice for run in runs] == [False, True, True]
    assert {one.path for one in runs_at(tmp_path)} == {tmp_path / run.folder for run in runs}
    assert [tally.completed for tally in overall(runs)] == [1]
    assert [tally.completed for tally in overall(runs, official=False)] == [2]


def test_a_practice_run_opens_again_from_where_it_lies(hall: Rehearsal, tmp_path: Path) -> None:
    hall.whole_run(setup(practice=True))
    (run,) = History(tmp_path).refresh()
    hall.whole_run(setup())
    assert hall.open(tmp_path / run.folder) is None
    assert hall.engine.snapshot().practice


def test_a_simulated_testbed_over_ros_makes_every_run_practice_and_is_in_the_bag(
    tmp_path: Path,
) -> None:
    hall = Rehearsal(tmp_path, OVER_ROS)
    hall.whole_run(setup())
    assert hall.engine.run.practice
    assert hall.folder.parent.name == "practice"
    (run,) = History(tmp_path).refresh()
    assert (run.source, run.practice, run.official) == ("simulated", True, False)
    said = [one for one in read_bag(hall.folder).messages() if one.topic == INFO_TOPIC]
    assert [one.data for one in said] == [SAID.data]
    assert check_run(RunPath(hall.folder)).found == ()
    hall.engine.close()


def test_what_is_announced_before_the_start_refuses_an_official_one(hall: Rehearsal) -> None:
    hall.prepare(setup())
    hall.source.told = OVER_ROS
    refused = hall.engine.perform(Start())
    assert refused == "the testbed is simulated, a run on it is practice: set it up again"
    hall.act(SetUp(setup()), ConfirmPose(), Start())
    assert hall.engine.run.practice


def test_what_is_announced_in_an_official_run_is_a_fault_of_it(
    hall: Rehearsal, tmp_path: Path
) -> None:
    hall.start(setup())
    hall.source.told = OVER_ROS
    hall.wait(1.0)
    words = f"{INFO_TOPIC}: the testbed is simulated (nominal): void this run after its stop"
    assert words in hall.engine.snapshot().all_faults
    hall.finish()
    assert hall.folder.parent == tmp_path  # what it is was set before it started
    assert [fault.text for fault in hall.engine.run.faults] == [words]
    hall.act(SetUp(setup(2)))
    assert hall.engine.run.practice
    hall.source.told = SILENT  # it has gone: what is set up stays as it is
    hall.wait(1.0)
    assert hall.engine.run.practice
    assert hall.engine.run.phase is Phase.READY
    hall.act(SetUp(setup(2)))
    assert not hall.engine.run.practice


def test_what_cannot_be_understood_is_said_and_makes_no_run_practice(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path, Announcement(problem="what is that?"))
    hall.start(setup())
    assert f"{INFO_TOPIC}: what is that?" in hall.engine.snapshot().all_faults
    hall.finish()
    assert not hall.engine.run.practice
    assert [fault.text for fault in hall.engine.run.faults] == [f"{INFO_TOPIC}: what is that?"]
    hall.engine.close()


def test_a_practice_run_of_an_older_version_is_found_where_it_lies(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    drive.engine.close()
    (tmp_path / "older").mkdir()
    folder = drive.folder.rename(tmp_path / "older" / drive.folder.name)
    result = folder / "result.json"
    result.write_text(result.read_text().replace('"practice": true', '"later": true'))
    without_digests(folder)
    (run,) = History(tmp_path / "older").refresh()
    assert (run.folder, run.practice) == (folder.name, True)


HANDLE = "/madrob/handle/force"


def samples(drive: Drive) -> HandleRest:
    found = drive.engine.run.zero_samples
    assert found is not None
    return found


def asked_for_a_zero(drive: Drive) -> bool:
    return CheckName.HANDLE_ZERO in [check.name for check in drive.engine.snapshot().checks]


def shifted(by: float) -> Edit:
    """The load cell reads more by so much, N."""

    def edit(message: Message) -> None:
        message.wrench.force.x += by

    return edit


def drifting_run(drive: FaultyDrive, by: float, number: int = 1) -> float | None:
    """A run in which the load cell drifts by so much, N, after the start; the drift found."""
    drive.act(SetUp(make_setup(timeout=TIMEOUT, countdown=1.0, run_number=number)))
    drive.wait(2.1)
    drive.act(ZeroHandle(), ConfirmPose())
    drive.begin()
    drive.wait(2.0)
    drive.faulty.fake(HANDLE, shifted(by))
    rest = drive.result().rest
    assert rest is not None
    return rest.drift


def test_the_samples_behind_the_zero_stand_in_state_journal_bag_and_result(drive: Drive) -> None:
    drive.whole_run(make_setup())
    kept, folder = samples(drive), drive.folder
    assert kept.mean == drive.engine.run.handle_zero == pytest.approx(5.9, abs=0.05)
    assert kept.number == 50
    assert kept.deviation == pytest.approx(0.05, rel=0.4)
    assert kept.span == pytest.approx(0.22, rel=0.5)
    assert kept.end - kept.begin == pytest.approx(0.98, abs=0.03)
    (line,) = (e for e in read_journal(folder / "journal.jsonl")[0] if e.what == ZeroHandle.name)
    told = {name: getattr(kept, name) for name in kept.__slots__}
    assert line.details == {"samples": told}
    stored = read_whole_result(str(folder))
    assert (stored["handle_zero"], stored["zero_samples"]) == (kept.mean, told)
    (folder / "journal.jsonl").unlink()
    assert read_recorded_run(folder).run.zero_samples == kept
    assert any("zero the handle: 5.9" in log.text for log in drive.engine.log.lines)


def test_a_zero_of_before_the_set_up_has_its_samples_in_the_result(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.wait(1.5)
    drive.act(ZeroHandle())
    kept = samples(drive)
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.act(ConfirmPose(), Start())
    drive.finish()
    drive.engine.close()
    assert json.loads((drive.folder / "result.json").read_text())["zero_samples"]["end"] == kept.end
    assert check_run(RunPath(drive.folder)).found == ()


def test_a_handle_that_drifted_is_to_be_zeroed_before_the_next_run(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    assert drifting_run(drive, -1.3) == pytest.approx(-1.3, abs=0.1)
    drive.faulty.heal(HANDLE)  # nobody sees it any more
    drive.act(SetUp(make_setup(run_number=2, timeout=TIMEOUT, countdown=1.0)))
    drive.wait(2.1)
    assert drive.check(CheckName.HANDLE).startswith("ok")
    said = drive.check(CheckName.HANDLE_ZERO)
    assert said.startswith("failed: F7 zeroes the handle again: it was -1.")
    drive.act(ConfirmPose())
    assert (drive.engine.perform(Start()) or "").startswith("F7 zeroes the handle again")
    drive.act(ZeroHandle())
    assert not asked_for_a_zero(drive)
    drive.act(Start())
    drive.engine.close()


def test_a_drift_can_be_waived_for_one_run(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drifting_run(drive, 1.3)
    drive.faulty.heal(HANDLE)
    drive.act(SetUp(make_setup(run_number=2, timeout=TIMEOUT, countdown=1.0)))
    drive.wait(2.1)
    drive.act(Waive(CheckName.HANDLE_ZERO, "the cable was pulled"), ConfirmPose())
    drive.begin()
    result = drive.result()
    assert "check waived: handle zero: the cable was pulled" in result.quality.remarks
    drive.act(SetUp(make_setup(run_number=3)))
    assert not asked_for_a_zero(drive)  # that run found the zero right
    drive.engine.close()


def test_a_drift_below_half_the_threshold_asks_for_nothing(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    assert drifting_run(drive, 0.7) == pytest.approx(0.7, abs=0.1)
    drive.act(SetUp(make_setup(run_number=2)))
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_an_earlier_run_that_is_opened_asks_for_no_zero(tmp_path: Path) -> None:
    first = FaultyDrive(tmp_path)
    drifting_run(first, 1.3)
    folder = first.folder
    first.engine.close()
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(SetUp(make_setup(run_number=2)))
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_a_zero_of_an_unsteady_force_stands_in_the_way_of_a_start(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.faulty.fake(HANDLE, shifted(1.2))
    drive.wait(0.5)
    drive.act(ZeroHandle())
    said = drive.check(CheckName.HANDLE_ZERO)
    assert said.startswith("failed: F7 zeroes the handle again: samples span 1.")
    assert said.endswith(" N, steady up to 0.98 N")
    drive.faulty.fake(HANDLE, shifted(14.0))
    drive.wait(0.5)
    refused = drive.engine.perform(ZeroHandle())
    assert refused == "the handle force is not steady: let go of it, wait a second"
    drive.wait(1.0)
    drive.act(ZeroHandle())
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_there_is_no_zero_of_a_few_samples(drive: Drive) -> None:
    drive.act(SetUp(make_setup()))
    drive.wait_until(lambda: drive.engine.snapshot().handle.force is not None)
    assert drive.engine.snapshot().refusals[ZeroHandle.name] == "no fresh handle force"
    drive.wait(0.5)
    assert ZeroHandle.name not in drive.engine.snapshot().refusals
