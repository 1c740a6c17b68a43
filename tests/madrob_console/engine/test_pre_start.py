"""What the pre-start checks say of disk, testbed, handle and lists, on the real engine."""

from __future__ import annotations

import json
import os
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
from madrob_console.config import Settings
from madrob_console.engine.runtime.list_watch import ListWatch, follow_lists
from madrob_console.messages.codec import encode_text
from madrob_console.messages.types import Message, MessageTypes
from madrob_console.pages.tally import overall
from madrob_console.referee.acts import ConfirmPose, SetUp, Start, Waive, ZeroHandle
from madrob_console.referee.checks import blocking
from madrob_console.referee.competition_plan import Plan, PlanSource
from madrob_console.referee.flags import FlagKind
from madrob_console.referee.journal import read_journal
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.team_list import TeamList, TeamSource
from madrob_console.testbeds.announcement import (
    INFO_TOPIC,
    INFO_TYPE,
    SILENT,
    Announcement,
    info_text,
)
from madrob_console.testbeds.simulated import SensorSettings
from recorder.bag import RawMessage
from tests.madrob_console.engine.drive import Drive, FaultyDrive, document, make_setup
from tests.madrob_console.engine.held_disk import HeldDisk
from tests.madrob_console.engine.spoilt import Edit
from tests.madrob_console.small_disk import disk_image, lock_folder
from tests.watching import until

READY = "ok: ready to open a file"
LOOKED = 2.1
"""By then the disk was asked again, s."""


def spoil(root: Path, how: str) -> None:
    """Put something in the way of the results folder."""
    practice = root / PRACTICE_FOLDER
    match how:
        case "a file":
            root.write_text("a file, not a folder")
        case "a file above":
            root.parent.rmdir()
            root.parent.write_text("a file, not a folder")
        case "a link to nowhere":
            root.symlink_to(root / "nowhere")
        case "numbers are a folder":
            (practice / NUMBERS_FILE).mkdir(parents=True)
        case "numbers are a link":
            practice.mkdir(parents=True)
            (practice / NUMBERS_FILE).symlink_to("/dev/zero")
        case "practice is a link":
            root.mkdir()
            practice.symlink_to(root)  # its runs would be found by nobody


SPOILT = (
    *("a file", "a file above", "a link to nowhere"),
    *("numbers are a folder", "numbers are a link", "practice is a link"),
)


@pytest.mark.parametrize("how", SPOILT)
def test_a_recorder_that_can_make_no_folder_is_found_before_the_start(
    how: str, tmp_path: Path
) -> None:
    root = tmp_path / "place" / "results"
    root.parent.mkdir()
    drive = Drive(root)
    drive.prepare(make_setup())
    assert drive.check(CheckName.RECORDER) == READY
    spoil(root, how)
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER).startswith(f"failed: {root.parent}")
    blocked = blocking(drive.engine.snapshot().checks)
    drive.act(*(Waive(check.name, "I know better") for check in blocked))
    assert str(root.parent) in str(drive.engine.perform(Start()))  # the disk refuses all the same
    shutil.rmtree(root.parent) if root.parent.is_dir() else root.parent.unlink()
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER) == READY
    drive.act(Start())
    drive.engine.close()


def test_a_disk_that_says_nothing_is_no_recorder_that_is_ready(tmp_path: Path) -> None:
    disk = HeldDisk()
    disk.held = True
    drive = Drive(tmp_path, disk=disk.threads())

    def say_nothing() -> bool:
        drive.wait(LOOKED)
        drive.check(CheckName.RECORDER)  # it is asked again
        drive.wait(LOOKED)
        both = drive.check(CheckName.DISK), drive.check(CheckName.RECORDER)
        return all(said.startswith("no data: ") for said in both)

    assert say_nothing()
    drive.prepare(make_setup())
    assert "free space unknown" in str(drive.engine.perform(Start()))
    disk.come_back()
    drive.wait(LOOKED)
    assert drive.check(CheckName.RECORDER) == READY
    disk.held = True
    assert say_nothing()


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
        assert hall.engine.snapshot().practice == one.practice
        assert check_run(RunPath(hall.folder)).differences == ()
    next_numbers = [hall.engine.next_run_number(3, 1, practice=one) for one in (False, True)]
    assert [number.result() for number in next_numbers] == [2, 3]
    runs = History(tmp_path).refresh()
    assert [(run.official, run.practice) for run in runs] == [(True, False), *[(False, True)] * 2]
    assert {one.path for one in runs_at(tmp_path)} == {tmp_path / run.folder for run in runs}
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
    assert (hall.engine.run.practice, hall.folder.parent.name) == (True, "practice")
    hall.give_up()
    (run,) = History(tmp_path).refresh()
    assert (run.source, run.practice, run.official) == ("simulated", True, False)
    assert hall.recorded(INFO_TOPIC) == [SAID.data]
    assert check_run(RunPath(hall.folder)).differences == ()


def test_what_is_announced_in_an_official_run_is_a_fault_of_it(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    words = f"{INFO_TOPIC}: the testbed is simulated (nominal): void this run after its stop"
    hall.start(setup())
    hall.source.announcement = OVER_ROS
    hall.wait(1.0)
    assert words in hall.engine.snapshot().all_faults
    hall.give_up()
    assert hall.folder.parent == tmp_path  # what it is was set before it started
    assert [fault.text for fault in hall.engine.run.faults] == [words]
    hall.act(SetUp(setup(2)))
    hall.source.announcement = SILENT  # it has gone: what is set up stays as it is
    hall.wait(1.0)
    assert (hall.engine.run.practice, hall.engine.run.phase) == (True, Phase.READY)
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
    assert astuple(zeroed)[:4] == pytest.approx((50, 5.9, 0.02, 0.09), abs=0.05)
    assert zeroed.end - zeroed.begin == pytest.approx(0.98, abs=0.03)
    told, stored = msgspec.to_builtins(zeroed), document(folder)
    (line,) = (e for e in read_journal(folder / "journal.jsonl")[0] if e.what == ZeroHandle.name)
    assert line.details == {"samples": told}
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
    assert hall.scored_result().rest.drift == pytest.approx(by, abs=0.1)  # type: ignore[union-attr]
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
        assert hall.check(CheckName.HANDLE_ZERO).startswith("failed: zero the handle again: it was")
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
    hall.scored_result()
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


def test_a_zero_of_an_unsteady_force_stands_in_the_way_of_a_start(hall: FaultyDrive) -> None:
    hall.act(SetUp(make_setup()))
    hall.wait(1.5)
    hall.source.fake(HANDLE, shifted(1.2))
    hall.wait(0.5)
    hall.act(ZeroHandle())
    said = hall.check(CheckName.HANDLE_ZERO)
    assert re.fullmatch("failed: zero the .* span 1.* N, steady up to 0.98 N", said)
    hall.source.fake(HANDLE, shifted(14.0))
    hall.wait(0.5)
    refused = hall.engine.perform(ZeroHandle())
    assert refused == "the handle force is not steady: let go of it, wait a second"
    hall.wait(1.0)
    hall.act(ZeroHandle())
    assert not asked_for_a_zero(hall)


def test_there_is_no_zero_of_a_few_samples(drive: Drive) -> None:
    drive.wait_until(lambda: drive.engine.snapshot().handle.force is not None)
    assert drive.engine.snapshot().refusals[ZeroHandle.name] == "no handle force comes now"
    drive.wait(0.5)
    assert ZeroHandle.name not in drive.engine.snapshot().refusals


def watching(
    file: Path | None, told: list[TeamList], on_change: Callable[[], None] = lambda: None
) -> Callable[[], None]:
    """Looks at a list of teams, as often as a test calls it."""
    watch = ListWatch(file, TeamSource({9: "Own"}, file).read, told.append, on_change)
    watch.read_if_changed()
    assert len(told) == 1
    return watch.read_if_changed


def test_a_list_that_changes_is_told_when_it_rests_and_the_engine_knows_it_first(
    tmp_path: Path,
) -> None:
    file, told, changes = tmp_path / "teams.csv", list[TeamList](), list[int]()
    file.write_text("3,Walkers\n")
    look = watching(file, told, lambda: changes.append(len(told)))
    for text in ("3,Wal", "3,Walkers\n4,Runn", "3,Walkers\n4,Runners\n"):
        file.write_text(text)
        look()  # it has changed: it may change again
    assert (len(told), changes) == (1, [])
    look()
    look()
    assert told[1:] == [TeamList({3: "Walkers", 4: "Runners", 9: "Own"}, (), str(file))]
    assert changes == [2]


def test_a_file_that_goes_is_told_and_its_list_stays_until_another_one_is_there(
    tmp_path: Path,
) -> None:
    file, told = tmp_path / "teams.csv", list[TeamList]()
    file.write_text("3,Walkers\n")
    look = watching(file, told)
    file.unlink()
    for _ in range(5):
        look()
    assert len(told) == 2
    assert told[1].names == told[0].names
    assert "the list stays as it was" in told[1].problems[0]
    for name in ("day 1", "day 2"):
        (tmp_path / name).write_text(f"4,{name}\n")
        (tmp_path / "new").symlink_to(tmp_path / name)
        os.replace(tmp_path / "new", file)  # noqa: PTH105  as `ln -sf` does
        look()
        look()
        assert (told[-1].names, told[-1].problems) == ({4: name, 9: "Own"}, ())


@pytest.mark.machine
def test_the_lists_are_there_before_the_engine_goes_on_and_are_followed(tmp_path: Path) -> None:
    told, plans = list[TeamList](), list[Plan]()
    teams, plan = tmp_path / "teams.csv", tmp_path / "plan.csv"
    teams.write_text("3,Walkers\n")
    plan.write_text("3,1,2\n")
    close = follow_lists(
        (
            ListWatch(teams, TeamSource({9: "Own"}, teams).read, told.append),
            ListWatch(plan, PlanSource((), plan).read, plans.append),
        ),
        0.02,
    )
    try:
        assert [teams.names for teams in told] == [{3: "Walkers", 9: "Own"}]
        assert len(plans) == 1
        teams.write_text("3,Walkers\n4,Late\n")
        plan.write_text("3,1,3\n")
        until(lambda: told[-1].names.get(4) == "Late" and len(plans) == 2)
    finally:
        close()


REASON = "renamed since"


def test_the_reason_for_another_name_stands_with_the_run(drive: Drive, tmp_path: Path) -> None:
    setup = replace(make_setup(timeout=1.0), team="Runners", team_reason=REASON)
    listed = {setup.subject: "Delft Walkers"}
    drive.engine.set_teams(TeamList(listed))
    drive.whole_run(setup)
    drive.engine.close()
    first, *_ = read_journal(drive.folder / "journal.jsonl")[0]
    assert (first.what, first.reason) == (SetUp.name, REASON)
    result = json.loads((drive.folder / "result.json").read_text())
    assert (result["team"], result["setup"]["team_reason"]) == ("Runners", REASON)
    (run,) = History(tmp_path).refresh()
    (flag,) = (flag for flag in run.flags if flag.kind is FlagKind.OTHER_NAME)
    assert flag.words == f"team's name other than the list's: {REASON}"
    (team,) = overall([run], official=run.official, listed=listed)
    assert (team.team, team.other_names) == ("Delft Walkers", ("Runners",))


UNLISTED = "correct the team, or waive the check: 9 is not in the list"
NINE = replace(make_setup(timeout=1.0), subject=9, team="")


def test_an_official_run_of_nobody_in_the_list_starts_only_waived(hall: FaultyDrive) -> None:
    hall.prepare(NINE)
    for names in ({9: "Ghent"}, {3: "Delft Walkers"}):  # the list counts as it is now
        hall.engine.set_teams(TeamList(names))
        checked = [check.name for check in hall.engine.snapshot().checks]
        assert (CheckName.TEAM in checked) is (9 not in names)
    assert hall.engine.perform(Start()) == UNLISTED
    hall.act(Waive(CheckName.TEAM, "a guest"))
    assert hall.check(CheckName.TEAM) == "waived: waived, a guest (9 is not in the list)"
    hall.act(Start())
    hall.finish()
    (waived,) = document(hall.folder)["waivers"]
    assert (waived["check"], waived["reason"]) == ("team", "a guest")


@pytest.mark.parametrize(
    ("lines", "practice", "words"),
    [
        ('7,"push, from CCW",1\n', False, "None"),
        ('3,"push, from CCW",1\n', False, "plan.csv line 1: condition 'push, from CCW': benchmark"),
        ('3,"push, from CCW",1\n', True, "None"),
        ("3,1,1\nseven,1,1\n", False, "plan.csv line 2: subject 'seven' is no number"),
        ("3,1,1\n", False, "None"),
    ],
)
def test_an_unusable_line_of_the_plan_blocks_the_official_runs_of_its_team(
    hall: FaultyDrive, tmp_path: Path, lines: str, practice: bool, words: str
) -> None:
    file = tmp_path / "plan.csv"
    file.write_text(lines)
    hall.engine.set_plan(PlanSource(file=file).read())
    hall.prepare(replace(make_setup(), practice=practice))
    refused = str(Start.impossible(hall.engine.situation()))
    assert refused.removeprefix("correct the plan, or waive the check: ").startswith(words)


def test_what_differs_from_the_settings_is_said_before_the_start(tmp_path: Path) -> None:
    drive, usual = Drive(tmp_path, usual_setup=Settings().usual_setup), Settings().usual_setup
    pose = replace(usual(make_setup()).start_pose, x=1.25)
    drive.prepare(replace(usual(make_setup()), countdown=2.0, start_pose=pose))
    said = "warning: countdown 2 s, the settings say 5 s; start pose 1.25 0 180, the settings say "
    assert drive.check(CheckName.SETTINGS) == f"{said}1.5 0 180: change it in the set-up"
    assert Start.impossible(drive.engine.situation()) is None
    drive.prepare(usual(make_setup()))
    assert CheckName.SETTINGS not in [check.name for check in drive.engine.snapshot().checks]
