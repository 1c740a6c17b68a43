"""Official or practice: what an engine makes of a testbed that says of itself what it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from madrob_console.archive.check import check_run
from madrob_console.archive.history import History
from madrob_console.archive.run_paths import RunPath, runs_at
from madrob_console.kinds import SourceKind
from madrob_console.messages.codec import MessageTypes, encode_text
from madrob_console.referee.acts import ConfirmPose, SetUp, Start
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.standings.tally import overall
from madrob_console.testbeds.announcement import (
    INFO_TOPIC,
    INFO_TYPE,
    SILENT,
    Announcement,
    info_text,
)
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import Topic
from recorder.message import RawMessage
from recorder.reader import read_bag
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import without_digests

TYPES = MessageTypes()
SAID = RawMessage(INFO_TOPIC, INFO_TYPE, encode_text(TYPES, info_text("nominal")), 1, 2)
OVER_ROS = Announcement("nominal", None, (SAID,))


class Hall(SimulatedSource):
    """A testbed over ROS that says of itself what a test lets it say."""

    told: Announcement = SILENT

    @property
    def kind(self) -> SourceKind:
        return SourceKind.ROS

    @property
    def announcement(self) -> Announcement:
        return self.told

    def topics(self) -> tuple[Topic, ...]:
        said = (Topic(INFO_TOPIC, INFO_TYPE, TYPES.definition(INFO_TYPE), ""),)
        return (*super().topics(), *(said if self.told.messages else ()))


class Rehearsal(Drive):
    """A referee in such a hall."""

    source: Hall

    SOURCE = Hall

    def __init__(self, results: Path, told: Announcement = SILENT) -> None:
        super().__init__(results)
        self.source.told = told

    @property
    def folder(self) -> Path:
        assert self.engine.folder is not None
        return self.engine.folder


def setup(number: int = 1, *, practice: bool = False) -> RunSetup:
    return replace(make_setup(run_number=number), practice=practice)


def test_official_and_practice_runs_lie_apart_and_have_numbers_of_their_own(
    tmp_path: Path,
) -> None:
    hall = Rehearsal(tmp_path)
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
    hall.engine.close()


def test_a_practice_run_opens_again_from_where_it_lies(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    hall.whole_run(setup(practice=True))
    (run,) = History(tmp_path).refresh()
    hall.whole_run(setup())
    assert hall.open(tmp_path / run.folder) is None
    assert hall.engine.snapshot().practice
    hall.engine.close()


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


def test_what_is_announced_before_the_start_refuses_an_official_one(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    hall.prepare(setup())
    hall.source.told = OVER_ROS
    refused = hall.engine.perform(Start())
    assert refused == "the testbed is simulated, a run on it is practice: set it up again"
    hall.act(SetUp(setup()), ConfirmPose(), Start())
    assert hall.engine.run.practice
    hall.engine.close()


def test_what_is_announced_in_an_official_run_is_a_fault_of_it(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path)
    hall.start(setup())
    hall.source.told = OVER_ROS
    hall.wait(1.0)
    words = f"{INFO_TOPIC}: the testbed is simulated (nominal): void this run after its stop"
    assert words in hall.engine.snapshot().faults
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
    hall.engine.close()


def test_what_cannot_be_understood_is_said_and_makes_no_run_practice(tmp_path: Path) -> None:
    hall = Rehearsal(tmp_path, Announcement(problem="what is that?"))
    hall.start(setup())
    assert f"{INFO_TOPIC}: what is that?" in hall.engine.snapshot().faults
    hall.finish()
    assert not hall.engine.run.practice
    assert [fault.text for fault in hall.engine.run.faults] == [f"{INFO_TOPIC}: what is that?"]
    hall.engine.close()


def test_a_practice_run_of_an_older_version_is_found_where_it_lies(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    drive.engine.close()
    assert drive.engine.folder is not None
    (tmp_path / "older").mkdir()
    folder = drive.engine.folder.rename(tmp_path / "older" / drive.engine.folder.name)
    result = folder / "result.json"
    result.write_text(result.read_text().replace('"practice": true', '"later": true'))
    without_digests(folder)
    (run,) = History(tmp_path / "older").refresh()
    assert (run.folder, run.practice) == (folder.name, True)
