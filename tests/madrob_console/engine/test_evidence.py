"""Evidence as the engine sees it, as its processes tell of it, and as it is written; no process."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from madrob_console.cli.repairing import repair_all
from madrob_console.engine.core.engine_config import EvidencePlan
from madrob_console.engine.core.engine_core import DISK_WAITS
from madrob_console.engine.runtime.disk import DiskJobs
from madrob_console.engine.runtime.evidence_budget import STEADY_FOR, EvidenceBudget
from madrob_console.engine.runtime.evidence_client import EvidenceClient, EvidencePlace
from madrob_console.engine.runtime.evidence_file import QUEUE_BYTES, EvidenceFile, stuck_words
from madrob_console.engine.runtime.evidence_order import RecordInto
from madrob_console.engine.runtime.evidence_process import live_state
from madrob_console.engine.runtime.evidence_recording import COMES_BACK, EvidenceRecording
from madrob_console.engine.runtime.recording import Recording
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import Start, Waive
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
)
from madrob_console.referee.evidence_state import EvidenceState, EvidenceTopic
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import CheckName
from madrob_console.testbeds.ros.evidence_intake import TakenEvidence
from recorder.bag import RawMessage, Topic, evidence_file_name
from recorder.reader import Bag
from recorder.writer import BagWriter
from tests.madrob_console.engine.drive import Drive, document, make_setup, signed
from tests.recorder.samples import add_evidence, strings
from tests.watching import until

LEFT = "/camera/left"
COMES = EvidenceTopic(LEFT, "sensor_msgs/msg/CompressedImage", rate=30.0, byte_rate=6e6)
RECORDED = EvidenceTopic(LEFT, COMES.type, 600, 120_000_000)
MB = 1_000_000
PLENTY = 10**12
BUDGET = 2 * 60 * 60 * 6 * MB  # two hours of it
HOUR = 3600.0
KILLED = "it was ended by SIGKILL"

# ------------------------------------------------- as the engine sees it


class ToldEvidence(EvidenceClient):
    """Says what a test tells it to."""

    state = EvidenceState(ready=True, topics=(COMES,))

    def __init__(self) -> None:
        self.places: list[EvidencePlace] = []
        self.held: list[bool] = []
        self.counted: dict[str, Any] = {}  # what it says when it is asked to the end

    def begin_recording(self, place: EvidencePlace) -> None:
        self.places.append(place)
        self.tell(recording=True, recorded=(RECORDED,))

    def end_recording(self) -> None:
        self.tell(recording=False)

    def await_account(self, limit: float) -> None:
        assert limit <= 0.5
        assert not self.state.recording
        self.tell(**self.counted)

    def hold_writing(self, *, held: bool) -> None:
        self.held.append(held)

    def tell(self, **changes: Any) -> None:  # noqa: ANN401  fields of the state
        self.state = replace(self.state, **changes)


def told_in(folder: Path) -> dict[str, Any]:
    evidence: dict[str, Any] = document(folder)["evidence"]
    return evidence


def write_rest(folder: Path) -> None:
    """Four messages reached the disk."""
    add_evidence(folder, strings(["a", "b", "c", "d"], LEFT))


class Watched(Drive):
    """A run with evidence."""

    def __init__(self, results: Path) -> None:
        super().__init__(results)
        self.evidence = ToldEvidence()
        config = replace(self.engine.config, evidence=EvidencePlan(BUDGET, HOUR))
        types = MessageTypes()
        self.engine = Engine(self.source, self.clock, config, types, evidence_client=self.evidence)
        self.engine.open()

    def log(self) -> list[str]:
        lines = [line.text.partition("evidence: ") for line in self.engine.log.lines]
        return [text for before, _, text in lines if text and not before]

    def faults(self) -> list[str]:
        return [fault for fault in self.engine.snapshot().faults if "evidence" in fault]


@pytest.fixture
def drive(tmp_path: Path) -> Watched:
    return Watched(tmp_path / "runs")


def test_what_is_told_of_evidence_is_said_once_is_in_the_result_and_doubts_nothing(
    drive: Watched,
) -> None:
    drive.start(make_setup(timeout=5.0))
    start, late = drive.start_time, replace(RECORDED, topic="/camera/late")
    (place,) = drive.evidence.places
    assert place.folder == str(drive.folder)
    assert place.steady_ns >= drive.engine.run.countdown_began * 1e9 - 1e8  # type: ignore[operator]
    loses = replace(RECORDED, lost={EvidenceLoss.BEHIND: 3})
    silent, gap = replace(late, silent_since=start + 1.9), EvidenceGap(start + 5.62, None, KILLED)
    for changes in (
        {"recorded": (loses, silent)},
        {"recorded": (replace(loses, lost={EvidenceLoss.BEHIND: 500}), late), "gaps": (gap,)},
        {"gaps": (replace(gap, end=start + 8.31),)},
    ):
        drive.evidence.tell(**changes)
        drive.wait(1.0)
    counted = drive.evidence.state.recorded
    drive.evidence.counted = {"recorded": tuple(replace(one, messages=613) for one in counted)}
    drive.finish()
    assert drive.log() == [
        "/camera/late: silent since +1.9 s",
        f"{LEFT}: messages are lost (behind)",
        f"nothing is recorded since +5.6 s: {KILLED}",
        "/camera/late: comes again, silent since +1.9 s",
        "recorded again, missing from +5.6 s to +8.3 s",
    ]
    result, account = document(drive.folder), drive.engine.run.evidence
    assert account is not None
    assert [(t.messages, t.lost, t.problem) for t in account.topics] == [
        (613, {EvidenceLoss.BEHIND: 500}, ""),
        (613, {}, ""),
    ]
    assert account.gaps == (EvidenceGap(5.62, 8.31, KILLED),)
    assert rebuild(read_journal(drive.folder / "journal.jsonl")[0]).evidence == account
    assert result["evidence"] == json.loads(msgspec.json.encode(account))
    assert result["quality"]["remarks"] == []
    assert "camera" not in json.dumps(result["flags"])
    assert not any(indicator["doubts"] for indicator in result["indicators"].values())


def test_evidence_that_a_run_loses_is_a_fault_below_all_others_and_stops_no_run(
    drive: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive.evidence.tell(missing=("nobody publishes /camera/front",), problem="none")
    drive.wait(2.5)
    assert drive.faults() == []  # before a run it is a matter of the check
    drive.evidence.tell(problem=None)
    drive.start(make_setup(timeout=5.0))
    dead = EvidenceTopic("/camera/dead", COMES.type, 7, silent_since=drive.start_time + 3.9)
    drive.evidence.tell(topics=(COMES, dead))
    lost = "evidence: /camera/dead: silent since +3.9 s"
    assert drive.faults() == [lost]
    doubled = [replace(one, publishers=2) for one in drive.source.status()]
    with monkeypatch.context() as patched:
        patched.setattr(drive.source, "status", lambda: doubled)
        several, *others = drive.engine.snapshot(None, ["the report fails"]).all_faults
    assert several.endswith("2 publishers: keep one")
    assert others == ["the report fails", lost]
    drive.finish()
    before = (drive.folder / "result.json").read_bytes()
    drive.evidence.tell(problem="not complete on disk", finishing=True)
    drive.wait(1.0)
    assert drive.faults() == ["evidence: not complete on disk"]
    assert (drive.folder / "result.json").read_bytes() == before


@pytest.mark.parametrize("run", ["stays", "is signed", "is left", "ends with its engine"])
def test_evidence_written_after_a_result_gets_into_it_unless_it_is_signed(
    drive: Watched, run: str
) -> None:
    drive.start(make_setup(timeout=1.0))
    drive.evidence.counted = {"recorded": (replace(RECORDED, messages=5),), "unwritten": 3}
    drive.finish()
    folder = drive.folder
    if run == "is signed":
        drive.act(signed(drive.engine.snapshot()))
    if run == "is left":
        drive.evidence.counted = {"unwritten": 0}
        drive.whole_run(make_setup(run_number=2, timeout=1.0))
    drive.wait(3.0)
    before = document(folder)
    assert before["evidence"]["unwritten"] == 3
    write_rest(folder)
    if run == "stays":
        drive.wait(3.0)
        assert told_in(folder)["unwritten"] == 0
    if run != "is left":
        drive.engine.close()
    assert list(repair_all(folder.parents[1])) == []
    after = document(folder)
    if run == "is signed":
        assert after == before
        return
    (topic,) = after["evidence"]["topics"]
    assert (topic["messages"], topic["lost"], after["evidence"]["unwritten"]) == (4, {"disk": 1}, 0)
    assert (after["issue"], after["indicators"]) == (1, before["indicators"])
    lines = [entry.what for entry in read_journal(folder / "journal.jsonl")[0]]
    assert lines[-1] == "result written"
    assert run != "stays" or lines.count(Change.EVIDENCE_RECORDED) == 2


def test_a_run_whose_engine_was_ended_is_scored_with_what_is_in_its_files(
    drive: Watched, tmp_path: Path
) -> None:
    drive.start(make_setup())
    drive.wait(6.0)
    folder = drive.cut_off_copy(tmp_path / "later")
    drive.engine.close()
    write_rest(folder)
    later = Drive(tmp_path / "later")
    assert later.open(folder) is None
    later.wait(3.0)
    account = told_in(folder)
    assert ([one["messages"] for one in account["topics"]], account["unwritten"]) == ([4], 0)
    assert "what was lost is not known" in account["problems"][0]
    later.engine.close()
    assert list(repair_all(tmp_path / "later")) == []
    assert told_in(folder) == account


def test_evidence_that_left_the_disk_to_the_score_is_written_when_the_bag_is_closed(
    drive: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive.start(make_setup(timeout=1.0))
    monkeypatch.setattr(Recording, "silent", property(lambda _self: 2 * DISK_WAITS))
    drive.finish()
    assert True in drive.evidence.held
    drive.wait(1.0)
    assert not drive.evidence.held[-1]


def test_the_room_is_what_earlier_runs_leave_of_the_budget_and_a_failure_is_waived(
    drive: Watched,
) -> None:
    earlier = drive.engine.config.results / "practice/subject_003_cond_001_run_009_20260101_100000"
    earlier.mkdir(parents=True)
    held = BUDGET // 2 + 400 * MB
    with (earlier / evidence_file_name(earlier.name, 0)).open("wb") as file:
        file.truncate(held)  # a hole
    drive.prepare(make_setup())
    said = "make room for evidence (`madrob guide testbed`): room for 59 min at the rate of now"
    assert drive.check(CheckName.EVIDENCE).startswith(f"failed: {said}")
    assert "evidence" in str(drive.engine.perform(Start()))
    drive.act(Waive(CheckName.EVIDENCE, "the last run of the day"), Start())
    assert drive.evidence.places[0].most_bytes == BUDGET - held


def test_the_room_does_not_jump_while_rates_begin_and_end(drive: Watched) -> None:
    budget = EvidenceBudget(replace(drive.engine.config, disk_needed=3 * MB), DiskJobs())
    rates = {0.0: 6 * MB, 1.0: 2 * MB, 3.0: 0, 5.0: 12 * MB, 5.0 + STEADY_FOR: 3 * MB}
    rooms = {
        now: budget.with_room(EvidenceState(topics=(replace(COMES, byte_rate=rate),)), 39 * MB, now)
        for now, rate in rates.items()
    }
    lasts = [room.lasts for room in rooms.values()]
    assert lasts == [6.0, 6.0, 6.0, 3.0, 12.0]


# ------------------------------------------------- through all the processes that record it


class Told:
    """A recording of which its process tells; s of a monotonic clock, which is steady time here."""

    def __init__(self) -> None:
        self.recording = EvidenceRecording(1, EvidencePlace("run", 0, 0, 10**9, 0))

    def told(self, at: float, *topics: EvidenceTopic, **more: Any) -> EvidenceState:  # noqa: ANN401  fields
        """Its process says this of the recording."""
        told = EvidenceState(ready=True, topics=topics, number=1, recording=True)
        told = replace(told, **more)
        self.recording.add_report(told, at)
        return self.recording.merged_into(told)

    def comes(self, at: float, saved: float | None = None, **first: float) -> EvidenceState:
        """Topics that come since then, and up to when there is something in the file."""
        topics = (told_topic(f"/{name}", first=when) for name, when in first.items())
        return self.told(at, *topics, saved=saved)

    def is_killed(self) -> None:
        self.recording.lose_process(KILLED)

    def account(self) -> EvidenceAccount:
        return self.recording.merged_into(EvidenceState()).account_since(0.0)


def told_topic(name: str = LEFT, silent_since: float | None = None, **more: Any) -> EvidenceTopic:  # noqa: ANN401  fields
    return EvidenceTopic(
        name, "a/msg/B", rate=10.0, byte_rate=1e6, silent_since=silent_since, **more
    )


@pytest.fixture
def run() -> Told:
    return Told()


def test_what_ended_a_recording_is_told_while_it_lasts_and_a_later_fault_for_good(
    run: Told,
) -> None:
    used_up: dict[str, Any] = {"problem": "used up", "problems": ("used up",)}
    assert run.told(1.0, **used_up).problem == "used up"
    run.recording.ended = 2.0
    over = run.told(2.5, **used_up, recording=False)
    assert (over.problem, over.problems) == (None, ("used up",))  # it holds up no next run
    failed: dict[str, Any] = {"problem": "torn", "problems": ("torn",), "recording": False}
    assert run.told(9.5, **failed).problem is not None


@pytest.mark.parametrize(
    ("spoil", "unwritten", "problem"),
    [
        ("nothing", 0, ""),
        ("killed", None, f"the evidence process had to be started again: {KILLED}"),
        ("silent", None, "said nothing in the last 13 s of the recording"),
    ],
)
def test_what_a_process_had_on_its_way_is_known_only_if_it_has_counted_all(
    run: Told, spoil: str, unwritten: int | None, problem: str
) -> None:
    told = run.told(1.0, told_topic())
    assert (told.unwritten, told.problems) == (0, ())
    if spoil == "killed":
        run.is_killed()
    run.recording.ended = 14.0
    if spoil != "silent":
        run.told(14.1, told_topic(), recording=False, finishing=True)
    account = run.account()
    assert account.unwritten == unwritten
    assert problem in "".join(account.problems)


def test_what_was_told_before_a_process_fell_silent_is_not_told_as_what_comes_now(
    run: Told,
) -> None:
    fresh = run.told(1.0, told_topic())
    old = run.recording.merged_into(live_state(fresh, 3.0))
    assert old.problem == "the evidence process is silent for 3 s"
    assert (fresh.byte_rate, old.topics, old.byte_rate, old.ready) == (1e6, (), 0, False)
    assert old.recorded == fresh.recorded


def test_a_disk_that_takes_nothing_is_told_after_a_while() -> None:
    words = "the disk has taken nothing for 10 s, 31.4 MB wait in memory"
    assert (stuck_words(1.0, 3 * MB), stuck_words(9.8, 31_400_000)) == ("", words)


def test_of_several_topics_the_worst_is_told_a_silent_one_before_others(run: Told) -> None:
    losing = [told_topic(f"/c{n}", lost={EvidenceLoss.BEHIND: n}) for n in range(9)]
    assert run.told(1.0, *losing).worst(0.0) == "/c8 8 lost and 7 more"
    worst = run.told(1.0, *losing, told_topic("/hall", 0.5)).worst(0.0)
    assert worst == "/hall silent since +0.5 s and 8 more"


def test_what_all_processes_counted_until_the_end_is_in_the_account(run: Told) -> None:
    run.told(20.0, told_topic(LEFT, 13.9, messages=10, bytes=100))
    run.is_killed()
    second = told_topic(messages=5, bytes=50)
    (both,) = run.told(23.0, second).recorded
    assert both == replace(second, messages=15, bytes=150, silent_since=13.9)
    run.recording.ended = 26.0
    (whole,) = run.told(26.1, replace(second, first=25.2), recording=False).recorded
    assert (whole.messages, whole.silent_since) == (15, None)
    after = run.told(60.0, told_topic(LEFT, 45.0), recording=False)
    assert after.recorded == (whole,)  # what comes after the recording is none of it


def test_what_nobody_published_stands_in_the_account_and_a_dead_topic_is_silent(run: Told) -> None:
    topics = (
        EvidenceTopic("/camera/live", "a/msg/B", rate=30.0, byte_rate=6e6),
        EvidenceTopic("/camera/dead", "a/msg/B", 4, publishers=0, silent_since=0.2),
        EvidenceTopic("/tf_static", "a/msg/C", durable=True),
        EvidenceTopic("/map", "a/msg/C", publishers=0, durable=True),
    )
    missing = ("nobody publishes /camera/front, /robot/a",)
    begun = run.told(0.5, *topics, missing=missing, ready=False)
    assert begun.problems == ()  # it has only begun to look
    status = run.told(1.0, *topics, missing=missing)
    assert (status.problems, [t.topic for t in status.topics if t.silent]) == (
        missing,
        ["/camera/dead", "/map"],
    )


def test_a_gap_lasts_from_what_is_in_the_file_until_all_that_comes_back_is_there(
    run: Told,
) -> None:
    run.comes(6.0, 5.62, left=0.1, right=0.2)
    run.is_killed()
    assert run.comes(8.0).gap == EvidenceGap(5.62, None, KILLED)
    assert run.comes(8.5, left=8.2).gap is not None
    assert run.comes(9.0, 10.0, left=8.2, right=8.75).gap is None
    run.is_killed()
    run.comes(12.0, left=12.0)
    later = run.comes(12.1 + COMES_BACK, 20.0, left=12.0)  # the other never comes back
    first, second = EvidenceGap(5.62, 8.75, KILLED), EvidenceGap(10.0, 12.0, KILLED)
    assert later.gaps == (first, second)
    run.is_killed()
    run.recording.ended = 30.0
    assert run.account().gaps == (first, second, EvidenceGap(20.0, None, KILLED))


def test_a_recording_that_begins_before_its_process_listens_says_what_is_missing(
    run: Told,
) -> None:
    run.recording.open_gap("its process was only being started")
    assert run.comes(2.0, left=1.5).gaps[0].end == 1.5


# ------------------------------------------------- as it is written

CAMERA = Topic(LEFT, "a/msg/B", "")


class Written:
    """A file of evidence, and what its process would report of it."""

    def __init__(self, folder: Path, most: int, free: int, queue_bytes: int = QUEUE_BYTES) -> None:
        place = EvidencePlace(str(folder), 0, 0, most, free)
        self.file = EvidenceFile(RecordInto(1, 0, place), queue_bytes, held=False)

    def take(self, *numbers: int, size: int = 100_000) -> None:
        for number in numbers:
            data = b"\0\1\0\0" + number.to_bytes(4, "little") + os.urandom(size)
            message = RawMessage(LEFT, CAMERA.type, data, number + 1, number + 1)
            self.file.record(TakenEvidence(CAMERA, [message]))

    @property
    def state(self) -> EvidenceState:
        return self.file.with_counts(EvidenceState(topics=(EvidenceTopic(LEFT, CAMERA.type),)))

    @property
    def failed(self) -> str:
        return "".join(self.state.problems)

    @property
    def topic(self) -> EvidenceTopic:
        return self.state.topics[0]

    def hold(self) -> None:
        """Once the file is there nothing more of it is written."""
        until(lambda: self.file.stats.file_bytes)
        self.file.hold_writing(held=True)

    def end(self) -> None:
        self.file.hold_writing(held=False)
        self.file.end()
        until(lambda: self.file.finished)


@contextmanager
def written(
    folder: Path, most: int = PLENTY, free: int = 0, queue_bytes: int = QUEUE_BYTES
) -> Iterator[Written]:
    with BagWriter(folder, [], {}):
        written = Written(folder, most, free, queue_bytes)
        yield written
        written.end()
    written.file.close(time.monotonic() + 30.0)
    assert published(folder) == written.topic.messages


def published(folder: Path) -> int:
    return len(list(Bag(folder, evidence=True).messages()))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "run"


def test_nothing_is_written_while_the_score_needs_the_disk_and_all_of_it_then(
    folder: Path,
) -> None:
    with written(folder) as run:
        run.hold()
        before = run.file.stats.file_bytes
        run.take(*range(20))
        until(lambda: run.state.stuck)  # who looks sees that nothing is taken
        assert (run.file.stats.file_bytes, run.state.unwritten) == (before, 20)
        assert run.file.stats.memory_bytes > 2 * MB
        run.file.end()
        assert not run.state.recording
        assert run.state.stuck == ""  # it is waited for
        assert run.state.unwritten == 20  # told until it is in the file
    assert run.topic.messages == 20
    assert (run.state.unwritten, run.failed) == (0, "")


def test_memory_is_bounded_and_what_finds_no_room_is_counted(folder: Path) -> None:
    with written(folder, queue_bytes=3 * MB) as run:
        run.hold()
        came = 0
        while (
            EvidenceLoss.BEHIND not in run.topic.lost
        ):  # what is being written goes on for a while
            run.take(*range(100))
            came += 100
            assert run.file.stats.memory_bytes <= 3 * MB
        assert run.topic.messages + run.topic.lost[EvidenceLoss.BEHIND] == came
    assert list(run.topic.lost) == [EvidenceLoss.BEHIND]
    assert run.topic.messages > 20
    assert run.failed == ""


@pytest.mark.parametrize("size", [2_000, 100_000, 2_500_000])
def test_evidence_that_fills_the_disk_stops_before_the_room_of_the_score(
    folder: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    disk, keeps = 12 * MB, 5 * MB

    def free() -> int:
        return disk - sum(file.stat().st_size for file in folder.iterdir())

    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=max(0, free())))
    with written(folder, free=keeps) as run:
        while not run.failed:
            if run.file.stats.memory_bytes < MB:
                run.take(*range(max(1, MB // (10 * size))), size=size)
    assert run.failed.startswith("no more evidence is recorded: ")
    assert "MB free, the score keeps 5.0 MB for itself; make room" in run.failed
    assert keeps < free() < keeps + 3 * MB + size


def test_the_largest_message_that_settings_allow_is_recorded(folder: Path) -> None:
    with written(folder) as run:
        run.take(0, size=90 * MB - 8)
    assert (run.topic.messages, run.topic.lost) == (1, {})


def test_a_folder_that_takes_no_file_ends_the_evidence_and_nothing_else(folder: Path) -> None:
    folder.mkdir()
    taken = folder / evidence_file_name("run", 0)
    taken.touch()
    run = Written(folder, PLENTY, 0)
    run.take(0)
    assert "exists already" in until(lambda: run.failed)
    assert (run.topic.messages, run.topic.lost) == (0, {EvidenceLoss.DISK: 1})
    run.end()
    assert taken.stat().st_size == 0
