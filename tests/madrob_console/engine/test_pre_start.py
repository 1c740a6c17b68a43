"""What the pre-start checks say of the disk, on the real engine: what they say is so."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path

import msgspec
import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import NUMBERS_FILE, PRACTICE_FOLDER
from madrob_console.archive.history import History
from madrob_console.archive.run_paths import RunPath, runs_at
from madrob_console.archive.scored import read_recorded_run
from madrob_console.messages.codec import encode_text
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.pages.tally import overall
from madrob_console.referee.acts import ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import read_journal
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.testbeds.announcement import (
    INFO_TOPIC,
    INFO_TYPE,
    SILENT,
    Announcement,
    info_text,
)
from madrob_console.testbeds.simulated import SensorSettings
from recorder.bag import RawMessage
from recorder.reader import Bag
from tests.madrob_console.engine.drive import Drive, FaultyDrive, document, make_setup
from tests.madrob_console.engine.held_disk import HeldDisk
from tests.madrob_console.engine.spoilt import Edit
from tests.madrob_console.small_disk import disk_image, lock_folder

READY = "ok: ready to open a file"
LOOKED = 2.1
"""By then the disk was asked again, s."""


def no_parent(root: Path) -> None:
    shutil.rmtree(root.parent)
    root.parent.write_text("a file, not a folder")


def practice_is_a_link(root: Path) -> None:
    root.mkdir()
    (root / PRACTICE_FOLDER).symlink_to(root)  # its runs would be found by nobody


def numbers_are_a_link(root: Path) -> None:
    (root / PRACTICE_FOLDER).mkdir(parents=True)
    (root / PRACTICE_FOLDER / NUMBERS_FILE).symlink_to("/dev/zero")


SPOILT: dict[str, Callable[[Path], object]] = {
    "a file": lambda root: root.write_text("a file, not a folder"),
    "a file above": no_parent,
    "a link to nowhere": lambda root: root.symlink_to(root / "nowhere"),
    "numbers are a folder": lambda root: (root / PRACTICE_FOLDER / NUMBERS_FILE).mkdir(
        parents=True
    ),
    "numbers are a link": numbers_are_a_link,
    "practice is a link": practice_is_a_link,
}


@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
def test_a_recorder_that_can_make_no_folder_is_found_before_the_start(
    spoil: Callable[[Path], object], tmp_path: Path
) -> None:
    root = tmp_path / "place" / "results"
    root.parent.mkdir()
    drive = Drive(root)
    drive.prepare(make_setup())
    assert drive.check(CheckName.RECORDER) == READY
    spoil(root)
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER).startswith(f"failed: {root.parent}")
    blocked = {check.name for check in blocking(drive.engine.snapshot().checks)}
    assert CheckName.RECORDER in blocked
    drive.act(*(Waive(name, "I know better") for name in blocked))
    assert str(root.parent) in str(drive.engine.perform(Start()))  # the disk refuses all the same
    assert drive.engine.run.phase is Phase.READY
    shutil.rmtree(root.parent) if root.parent.is_dir() else root.parent.unlink()
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER) == READY
    drive.act(Start())
    drive.engine.close()


def test_a_disk_that_says_nothing_is_no_recorder_that_is_ready(tmp_path: Path) -> None:
    disk = HeldDisk()
    disk.held = True
    drive = Drive(tmp_path, disk=disk.threads())
    drive.prepare(make_setup())
    for name in (CheckName.DISK, CheckName.RECORDER):
        assert drive.check(name).startswith("no data: ")
    assert "free space unknown" in str(drive.engine.perform(Start()))
    disk.come_back()
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER) == READY
    disk.held = True
    drive.wait(LOOKED)
    drive.check(CheckName.RECORDER)  # it is asked again
    drive.wait(LOOKED)
    for name in (CheckName.DISK, CheckName.RECORDER):
        assert drive.check(name).startswith("no data: ")


def test_a_disk_with_too_little_room_is_a_fault_as_long_as_nobody_waived_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "madrob_console.engine.runtime.disk_watch.free_space", lambda _root: 2_200_000
    )
    drive = Drive(tmp_path, disk_needed=5_000_000)
    drive.wait(LOOKED)
    said = "make room on the disk: 2.2 MB free, 5.0 MB needed"
    assert f"disk space: {said}" in drive.engine.snapshot().all_faults
    drive.prepare(make_setup())
    assert drive.check(CheckName.DISK) == f"failed: {said}"
    drive.act(Waive(CheckName.DISK, "more is on its way"))
    assert not any(fault.startswith("disk space") for fault in drive.engine.snapshot().all_faults)


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
    hall: FaultyDrive, tmp_path: Path
) -> None:
    for one in (setup(1), setup(1, practice=True), setup(2, practice=True)):
        hall.start(one)
        hall.give_up()
        assert (hall.folder.parent == tmp_path / "practice") == one.practice
        snapshot = hall.engine.snapshot()
        assert (snapshot.practice, snapshot.simulated) == (one.practice, None)
    assert hall.engine.next_run_number(3, 1).result() == 2
    assert hall.engine.next_run_number(3, 1, practice=True).result() == 3
    runs = History(tmp_path).refresh()
    assert [run.official for run in runs] == [True, False, False]
    assert [run.practice for run in runs] == [False, True, True]
    folders = {tmp_path / run.folder for run in runs}
    assert {one.path for one in runs_at(tmp_path)} == folders
    assert [found for folder in folders for found in check_run(RunPath(folder)).differences] == []
    tallies = [overall(runs, official=one) for one in (True, False)]
    assert [[team.counted for team in teams] for teams in tallies] == [[1], [2]]
    hall.act(SetUp(setup(2)))
    assert hall.open(tmp_path / runs[1].folder) is None  # from where it lies
    assert hall.engine.snapshot().practice


def test_a_simulated_testbed_over_ros_makes_every_run_practice_and_is_in_the_bag(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    hall.prepare(setup())
    hall.source.announcement = OVER_ROS
    refused = hall.engine.perform(Start())
    assert refused == "the testbed is simulated, a run on it is practice: set it up again"
    hall.act(SetUp(setup()), ConfirmPose(), Start())
    assert hall.engine.run.practice
    assert hall.folder.parent.name == "practice"
    hall.give_up()
    (run,) = History(tmp_path).refresh()
    assert (run.source, run.practice, run.official) == ("simulated", True, False)
    said = [one for one in Bag(hall.folder).messages() if one.topic == INFO_TOPIC]
    assert [one.data for one in said] == [SAID.data]
    assert check_run(RunPath(hall.folder)).differences == ()


@pytest.mark.parametrize(
    ("announced", "words", "practice"),
    [
        (OVER_ROS, "the testbed is simulated (nominal): void this run after its stop", True),
        (Announcement(problem="what is that?"), "what is that?", False),
    ],
)
def test_what_is_announced_in_an_official_run_is_a_fault_of_it(
    hall: FaultyDrive, tmp_path: Path, announced: Announcement, words: str, *, practice: bool
) -> None:
    hall.start(setup())
    hall.source.announcement = announced
    hall.wait(1.0)
    assert f"{INFO_TOPIC}: {words}" in hall.engine.snapshot().all_faults
    hall.give_up()
    assert hall.folder.parent == tmp_path  # what it is was set before it started
    assert [fault.text for fault in hall.engine.run.faults] == [f"{INFO_TOPIC}: {words}"]
    hall.act(SetUp(setup(2)))
    assert hall.engine.run.practice is practice
    hall.source.announcement = SILENT  # it has gone: what is set up stays as it is
    hall.wait(1.0)
    assert (hall.engine.run.practice, hall.engine.run.phase) == (practice, Phase.READY)
    hall.act(SetUp(setup(2)))
    assert not hall.engine.run.practice


HANDLE = "/madrob/handle/force"


def asked_for_a_zero(drive: Drive) -> bool:
    return CheckName.HANDLE_ZERO in [check.name for check in drive.engine.snapshot().checks]


def shifted(by: float) -> Edit:
    """The load cell reads more by so much, N."""

    def edit(message: Message) -> None:
        message.wrench.force.x += by

    return edit


def test_the_samples_behind_the_zero_stand_in_state_journal_bag_and_result(drive: Drive) -> None:
    drive.whole_run(make_setup())
    zeroed, folder = drive.engine.run.zero_samples, drive.folder
    assert zeroed is not None
    about = (50, 5.9, 0.02, 0.09, zeroed.begin, zeroed.begin + 0.98)
    allowed = (0.0, 0.05, 0.008, 0.045, 0.0, 0.03)
    for value, near, by in zip(astuple(zeroed), about, allowed, strict=True):
        assert value == pytest.approx(near, abs=by)
    assert zeroed.mean == drive.engine.run.handle_zero
    (line,) = (e for e in read_journal(folder / "journal.jsonl")[0] if e.what == ZeroHandle.name)
    told = msgspec.to_builtins(zeroed)
    assert line.details == {"samples": told}
    stored = document(folder)
    assert (stored["handle_zero"], stored["zero_samples"]) == (zeroed.mean, told)
    (folder / "journal.jsonl").unlink()
    assert read_recorded_run(folder).run.zero_samples == zeroed
    assert any("zero the handle: 5.9" in log.text for log in drive.engine.log.lines)


def drift(hall: FaultyDrive, by: float) -> None:
    """The load cell drifts by so much in a run, N, after its start, and the next one is set up."""
    hall.set_up()
    hall.begin()
    hall.wait(2.0)
    before, after = SensorSettings().handle_rest
    hall.source.fake(HANDLE, shifted(by + before - after))
    assert hall.result().rest.drift == pytest.approx(by, abs=0.1)  # type: ignore[union-attr]
    hall.source.heal(HANDLE)
    hall.act(SetUp(make_setup(run_number=2, countdown=1.0)))
    hall.wait(2.1)


@pytest.mark.parametrize("by", [-1.3, 0.7])
def test_a_handle_that_drifted_far_is_to_be_zeroed_before_the_next_run(
    hall: FaultyDrive, by: float
) -> None:
    drift(hall, by)
    assert asked_for_a_zero(hall) is (abs(by) > 1.0)  # half the threshold is asked about
    if asked_for_a_zero(hall):
        assert hall.check(CheckName.HANDLE).startswith("ok")
        words = "zero the handle again: it was -1."
        assert hall.check(CheckName.HANDLE_ZERO).startswith(f"failed: {words}")
        hall.act(ConfirmPose())
        assert str(hall.engine.perform(Start())).startswith("zero the handle again")
        hall.act(ZeroHandle())
        assert not asked_for_a_zero(hall)
        hall.act(Start())


def test_a_drift_can_be_waived_for_one_run_and_is_not_asked_about_later(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    drift(hall, 1.3)
    (first,) = runs_at(tmp_path)
    hall.act(Waive(CheckName.HANDLE_ZERO, "the cable was pulled"), ConfirmPose())
    hall.begin()
    assert "check waived: handle zero: the cable was pulled" in hall.result().quality.remarks
    zero = msgspec.to_builtins(hall.engine.run.zero_samples)
    assert document(hall.folder)["zero_samples"] == zero  # of the run before
    assert check_run(RunPath(hall.folder)).differences == ()
    hall.act(SetUp(make_setup(run_number=3)))
    assert not asked_for_a_zero(hall)  # that run found the zero right
    other = Drive(tmp_path)
    assert other.open(first.path) is None  # the drift of another day
    other.act(SetUp(make_setup(run_number=4)))
    assert not asked_for_a_zero(other)
    other.engine.close()


def test_a_zero_of_an_unsteady_force_stands_in_the_way_of_a_start(tmp_path: Path) -> None:
    drive = FaultyDrive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.source.fake(HANDLE, shifted(1.2))
    drive.wait(0.5)
    drive.act(ZeroHandle())
    said = drive.check(CheckName.HANDLE_ZERO)
    assert said.startswith("failed: zero the handle again: samples span 1.")
    assert said.endswith(" N, steady up to 0.98 N")
    drive.source.fake(HANDLE, shifted(14.0))
    drive.wait(0.5)
    refused = drive.engine.perform(ZeroHandle())
    assert refused == "the handle force is not steady: let go of it, wait a second"
    drive.wait(1.0)
    drive.act(ZeroHandle())
    assert not asked_for_a_zero(drive)
    drive.engine.close()


def test_there_is_no_zero_of_a_few_samples(drive: Drive) -> None:
    drive.wait_until(lambda: drive.engine.snapshot().handle.force is not None)
    assert drive.engine.snapshot().refusals[ZeroHandle.name] == "no handle force comes now"
    drive.wait(0.5)
    assert ZeroHandle.name not in drive.engine.snapshot().refusals
