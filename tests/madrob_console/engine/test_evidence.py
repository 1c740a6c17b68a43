"""Evidence as the engine sees it, as its processes tell of it, and as it is written; no process."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from madrob_console.archive.evidence import settled_account
from madrob_console.cli.repairing import repair_all
from madrob_console.engine.core.engine_config import EvidencePlan
from madrob_console.engine.core.engine_core import DISK_WAITS
from madrob_console.engine.runtime.evidence_budget import STEADY_FOR
from madrob_console.engine.runtime.evidence_client import EvidenceClient, EvidencePlace
from madrob_console.engine.runtime.evidence_file import QUEUE_BYTES, EvidenceFile, stuck_words
from madrob_console.engine.runtime.evidence_order import RecordInto
from madrob_console.engine.runtime.evidence_process import live_state
from madrob_console.engine.runtime.evidence_recording import COMES_BACK, EvidenceRecording
from madrob_console.engine.runtime.recording import Recording
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.message_types import MessageTypes
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
HOUR = 3600.0
ALL = ("nobody publishes /camera/**",)
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

    def __init__(self, results: Path, budget: int = PLENTY, least_room: float = HOUR) -> None:
        super().__init__(results)
        self.evidence = ToldEvidence()
        config = replace(self.engine.config, evidence=EvidencePlan(budget, least_room))
        types = MessageTypes()
        self.engine = Engine(self.source, self.clock, config, types, evidence_client=self.evidence)
        self.engine.open()

    def ended_while_it_was_written(self) -> dict[str, Any]:
        """A run whose evidence was not all in its file when its result was made; what is told."""
        self.start(make_setup(timeout=1.0))
        self.evidence.counted = {"recorded": (replace(RECORDED, messages=5),), "unwritten": 3}
        self.finish()
        assert told_in(self.folder)["unwritten"] == 3
        return told_in(self.folder)

    def log(self) -> list[str]:
        return [line.text for line in self.engine.log.lines if line.text.startswith("evidence: ")]

    def faults(self) -> list[str]:
        return [fault for fault in self.engine.snapshot().faults if "evidence" in fault]


@pytest.fixture
def drive(tmp_path: Path) -> Watched:
    return Watched(tmp_path / "runs")


LATE = replace(RECORDED, topic="/camera/late")


@pytest.mark.parametrize(
    ("told", "lines", "topics"),
    [
        ([], [], [(613, {}, "")]),
        (
            [
                lambda _, number=number: {
                    "recorded": (replace(RECORDED, lost={EvidenceLoss.BEHIND: number}),)
                }
                for number in (3, 40, 500)
            ],
            [f"{LEFT}: messages are lost (behind)"],
            [(613, {"behind": 500}, "")],
        ),
        (
            [
                lambda _: {
                    "recorded": tuple(
                        replace(RECORDED, topic=f"/c{n}", lost={EvidenceLoss.ON_THE_WAY: 1})
                        for n in range(5)
                    )
                }
            ],
            ["/c0, /c1 and 3 more: messages are lost (on the way)"],
            [(613, {"on the way": 1}, "")] * 5,
        ),
        (
            [
                lambda start: {
                    "recorded": tuple(
                        replace(one, silent_since=start + 1.9) for one in (RECORDED, LATE)
                    )
                },
                lambda start: {"recorded": (RECORDED, replace(LATE, silent_since=start + 4.2))},
            ],
            [
                f"{LEFT}, /camera/late: silent since +1.9 s",
                f"{LEFT}: comes again, silent since +1.9 s",
            ],
            [(613, {}, ""), (613, {}, "silent since +4.2 s")],
        ),
        (
            [
                lambda start: {"gaps": (EvidenceGap(start + 5.62, None, KILLED),)},
                lambda start: {"gaps": (EvidenceGap(start + 5.62, start + 8.31, KILLED),)},
            ],
            [
                f"nothing is recorded since +5.6 s: {KILLED}",
                "recorded again, missing from +5.6 s to +8.3 s",
            ],
            [(613, {}, "")],
        ),
    ],
    ids=["all is well", "some is lost", "topics alike", "silent", "killed"],
)
def test_what_is_told_of_evidence_is_said_once_is_in_the_result_and_doubts_nothing(
    drive: Watched,
    told: Sequence[Callable[[float], Mapping[str, Any]]],
    lines: Sequence[str],
    topics: Sequence[tuple[int, dict[str, int], str]],
) -> None:
    drive.start(make_setup(timeout=5.0))
    (place,) = drive.evidence.places
    assert place.folder == str(drive.folder)
    assert place.steady_ns >= drive.engine.run.countdown_began * 1e9 - 1e8  # type: ignore[operator]
    start = drive.engine.run.start
    assert start is not None
    for one in told:
        drive.evidence.tell(**one(start))
        drive.wait(1.0)
    assert drive.engine.snapshot().evidence.recording  # type: ignore[union-attr]
    recorded = drive.evidence.state.recorded
    drive.evidence.counted = {"recorded": tuple(replace(one, messages=613) for one in recorded)}
    drive.finish()
    assert [text.removeprefix("evidence: ") for text in drive.log()] == lines
    account, stored = drive.engine.run.evidence, told_in(drive.folder)
    assert [(one["messages"], one["lost"], one["problem"]) for one in stored["topics"]] == topics
    gap = {"begin": 5.62, "end": 8.31, "why": KILLED}
    assert stored["gaps"] == [gap] * (KILLED in str(lines))
    entries, _ = read_journal(drive.folder / "journal.jsonl")
    assert rebuild(entries).evidence == account
    result = document(drive.folder)
    assert result["quality"]["remarks"] == []
    assert not [flag for flag in result["flags"] if "camera" in json.dumps(flag)]
    assert not any(indicator["doubts"] for indicator in result["indicators"].values())


def test_evidence_that_a_run_loses_is_a_fault_below_all_others_and_stops_no_run(
    drive: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    quiet = replace(COMES, topic="/camera/quiet", rate=0.0, byte_rate=0.0)
    dead = replace(quiet, topic="/camera/dead", messages=7)
    drive.evidence.tell(
        topics=(COMES, dead, quiet), missing=("nobody publishes /camera/front",), problem="none"
    )
    drive.wait(2.5)
    assert drive.faults() == []  # before a run it is a matter of the check
    drive.evidence.tell(problem=None)
    drive.start(make_setup(timeout=5.0))
    start = drive.engine.run.start
    assert start is not None
    drive.evidence.tell(topics=(COMES, replace(dead, silent_since=start + 3.9), quiet))
    lost = "evidence: /camera/dead: silent since +3.9 s"  # the other may have nothing to say
    assert drive.faults() == [lost]
    doubled = [replace(one, publishers=2) for one in drive.source.status()]
    with monkeypatch.context() as patched:
        patched.setattr(drive.source, "status", lambda: doubled)
        several, *others = drive.engine.snapshot(None, ["the report fails"]).all_faults
    assert several.endswith("2 publishers: keep one")
    assert others == ["the report fails", lost]
    drive.evidence.tell(gaps=(EvidenceGap(start + 5.62, None, KILLED),))
    told = f"nothing is recorded since +5.6 s, it is starting again: {KILLED}"
    assert drive.faults() == [f"evidence: {told}"]
    assert drive.engine.snapshot().evidence.trouble(start) == told  # type: ignore[union-attr]
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
    drive.ended_while_it_was_written()
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
    if run in ("stays", "is signed"):
        drive.wait(3.0)
        assert drive.engine.run.evidence.unwritten == 0  # type: ignore[union-attr]
        assert (document(folder) == before) is (run == "is signed")
    if run != "is left":
        drive.engine.close()
        assert told_in(folder)["unwritten"] == (3 if run == "is signed" else 0)
    assert list(repair_all(folder.parents[1])) == []
    if run == "is signed":
        assert document(folder) == before
        return
    after = document(folder)
    (topic,) = after["evidence"]["topics"]
    assert (topic["messages"], topic["lost"]) == (4, {"disk": 1})
    assert (after["issue"], after["indicators"]) == (1, before["indicators"])
    entries, _ = read_journal(folder / "journal.jsonl")
    assert entries[-1].what == "result written"
    if run == "stays":
        assert [entry.what for entry in entries].count(Change.EVIDENCE_RECORDED) == 2


def test_a_run_whose_engine_was_ended_is_scored_with_what_is_in_its_files(
    drive: Watched, tmp_path: Path
) -> None:
    drive.start(make_setup())
    drive.wait(6.0)
    drive.wait_for_disk()
    folder = tmp_path / "later" / drive.folder.relative_to(tmp_path / "runs")
    shutil.copytree(drive.folder, folder)
    drive.engine.close()
    write_rest(folder)
    later = Drive(tmp_path / "later")
    assert later.open(folder) is None
    later.wait(3.0)
    account = told_in(folder)
    assert [one["messages"] for one in account["topics"]] == [4]
    assert account["unwritten"] == 0
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


NOTHING_COMES = replace(COMES, rate=0.0, byte_rate=0.0)
FOUR = (COMES, *(EvidenceTopic(topic, "a/msg/B") for topic in ("/a", "/b", "/c")))
TIDY = "failed: `madrob tidy` makes room for evidence: "


@pytest.mark.parametrize(
    ("status", "minutes", "kept", "said"),
    [
        ({}, 60, 0, "ok: 1 topic, room for "),
        ({}, 10, 0, f"{TIDY}room for 10 min at the rate of now, 60 min"),
        ({}, 120, 90, f"{TIDY}room for 30 min at the rate of now"),  # of earlier runs
        ({"topics": (), "missing": ALL}, 0, 0, f"{TIDY}nobody publishes /camera/**; 0 topics"),
        ({"topics": (), "missing": ALL, "ready": False}, 60, 0, "no data: wait: the evidence's"),
        ({"topics": ()}, 60, 0, "warning: 0 topics, room for "),  # all are excluded
        ({"problem": "it hangs"}, 60, 0, "failed: evidence: it hangs"),
        (
            {"topics": (NOTHING_COMES,)},
            *(60, 0),
            f"warning: {LEFT}: nothing comes now; 0 topics, room for ",
        ),
        (
            {"topics": FOUR},
            *(60, 0),
            "warning: /a, /b and 1 more: nothing comes now; 1 topic, room for ",
        ),
        (
            {"missing": ("nobody publishes /camera/front, /robot/**",)},
            *(60, 0),
            "warning: nobody publishes /camera/front, /robot/**; 1 topic, room for ",
        ),
        (
            {"topics": (), "missing": ("nobody publishes /rosout",)},
            *(60, 0),
            "warning: nobody publishes /rosout; 0 topics, room for ",
        ),
    ],
)
def test_missing_evidence_and_too_little_room_are_named_and_a_failure_is_waived(
    tmp_path: Path, status: dict[str, Any], minutes: int, kept: int, said: str
) -> None:
    budget = minutes * 60 * 6 * MB
    earlier = tmp_path / "runs/practice/subject_003_cond_001_run_009_20260101_100000"
    earlier.mkdir(parents=True)
    with (earlier / evidence_file_name(earlier.name, 0)).open("wb") as file:
        file.truncate(kept * 60 * 6 * MB)  # a hole, of 32 GB
    drive = Watched(tmp_path / "runs", budget)
    drive.evidence.tell(**status)
    drive.prepare(make_setup())
    assert drive.check(CheckName.EVIDENCE).startswith(said)
    if not said.startswith(("ok", "warning")):
        assert "evidence" in str(drive.engine.perform(Start()))
    if said.startswith("failed"):
        drive.act(Waive(CheckName.EVIDENCE, "the last run of the day"))
    if not said.startswith("no data"):
        drive.act(Start())
        assert drive.evidence.places[0].most_bytes == budget - kept * 60 * 6 * MB


def test_room_for_less_than_a_run_is_a_warning_and_told_in_seconds(tmp_path: Path) -> None:
    drive = Watched(tmp_path / "runs", budget=8 * 6 * MB, least_room=0.0)
    drive.prepare(make_setup(timeout=90.0))
    told = "warning: 1 topic, room for 8 s at the rate of now: a run may take 90 s"
    assert drive.check(CheckName.EVIDENCE) == told
    drive.act(Start())


def test_the_room_does_not_jump_while_rates_begin_and_end(drive: Watched) -> None:
    def room_at(byte_rate: float, after: float) -> float | None:
        drive.evidence.tell(topics=(replace(COMES, byte_rate=byte_rate),))
        drive.wait(after)
        evidence = drive.engine.snapshot().evidence
        assert evidence is not None
        return evidence.lasts

    drive.prepare(make_setup())
    free = shutil.disk_usage(drive.engine.config.results.parent).free
    usual = min(PLENTY, free) / COMES.byte_rate
    assert room_at(6e6, 1.0) == pytest.approx(usual, rel=0.1)
    for byte_rate, after, share in (
        (2e6, 1.0, 1.0),  # its process was just started
        (0.0, 3.0, 1.0),
        (12e6, 1.0, 0.5),
        (3e6, STEADY_FOR + 1.0, 2.0),
    ):
        assert room_at(byte_rate, after) == pytest.approx(share * usual, rel=0.1)


def test_a_simulated_testbed_says_that_it_has_none_and_unwished_there_is_no_check(
    tmp_path: Path,
) -> None:
    plain = Drive(tmp_path / "plain")
    plain.prepare(make_setup())
    assert CheckName.EVIDENCE not in {check.name for check in plain.engine.snapshot().checks}
    wished = replace(plain.engine.config, evidence=EvidencePlan(10**9, HOUR))
    plain.engine = Engine(plain.source, plain.clock, wished, MessageTypes())
    assert plain.check(CheckName.EVIDENCE).startswith("ok: none: a testbed simulated in this")
    assert plain.engine.snapshot().evidence is None


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

    def comes(self, at: float, first: dict[str, float], saved: float | None) -> EvidenceState:
        """Topics that come since then, and up to when there is something in the file."""
        return self.told(at, *(told_topic(n, first=when) for n, when in first.items()), saved=saved)

    def is_killed(self) -> None:
        self.recording.lose_process(KILLED)


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
    account = run.recording.merged_into(EvidenceState()).account_since(0.0)
    assert account.unwritten == unwritten
    assert problem in "".join(account.problems)
    assert account.words.endswith("not known how many of them are on disk") is (unwritten is None)


def test_what_was_told_before_a_process_fell_silent_is_not_told_as_what_comes_now(
    run: Told,
) -> None:
    fresh = run.told(1.0, told_topic())
    old = run.recording.merged_into(live_state(fresh, 3.0))
    assert old.problem == "the evidence process is silent for 3 s"
    assert (fresh.byte_rate, old.topics, old.byte_rate, old.ready) == (1e6, (), 0, False)
    assert old.recorded == fresh.recorded


def test_a_disk_that_takes_nothing_is_told_beside_what_still_comes(run: Told) -> None:
    assert run.told(1.0, told_topic(), stuck=stuck_words(1.0, 3 * MB)).trouble(0.0) is None
    status = run.told(1.0, told_topic(), stuck=stuck_words(9.8, 31_400_000))
    assert status.trouble(0.0) == "the disk has taken nothing for 10 s, 31.4 MB wait in memory"
    assert status.problem is None  # it may take all of it yet


@pytest.mark.parametrize(
    ("told", "worst", "remark"),
    [
        (told_topic(), "", ""),
        (told_topic(LEFT, 13.9), "silent since +3.9 s", "silent since +3.9 s"),
        (
            told_topic(lost={EvidenceLoss.BEHIND: 3}, problem="it is also a/B"),
            *("it is also a/B, 3 lost", "3 lost (3 behind), it is also a/B"),
        ),
    ],
)
def test_the_same_is_told_of_a_topic_live_and_in_the_account(
    run: Told, told: EvidenceTopic, worst: str, remark: str
) -> None:
    status = run.told(40.0, told)
    assert status.worst(10.0) == (worst and f"{LEFT} {worst}")
    account = status.account_since(10.0)
    assert account.remarks() == ([f"{LEFT}: {remark}"] if remark else [])
    run.recording.ended = 41.0
    run.told(41.1, told, recording=False)
    after = run.told(60.0, told_topic(LEFT, 45.0), recording=False)
    assert after.account_since(10.0) == account  # what comes after the recording is none of it


def test_of_several_topics_the_worst_is_told_a_silent_one_before_others(run: Told) -> None:
    losing = [told_topic(f"/c{n}", lost={EvidenceLoss.BEHIND: n}) for n in range(9)]
    assert run.told(1.0, *losing).worst(0.0) == "/c8 8 lost and 7 more"
    worst = run.told(1.0, *losing, told_topic("/hall", 0.5)).worst(0.0)
    assert worst == "/hall silent since +0.5 s and 8 more"


def test_what_all_processes_counted_is_in_the_account(run: Told) -> None:
    lost = {EvidenceLoss.BEHIND: 2}
    run.told(20.0, told_topic(LEFT, 13.9, messages=10, bytes=100, lost=lost))
    run.is_killed()
    news: dict[str, Any] = {"messages": 5, "bytes": 50, "left_out": 1, "lost": lost}
    both = run.told(23.0, told_topic(**news))
    (one,) = both.recorded
    assert (one.messages, one.bytes, one.left_out, one.lost) == (15, 150, 1, {"behind": 4})
    assert one.silent_since == 13.9  # until something comes of it again
    assert run.told(26.0, told_topic(first=25.2, **news)).recorded[0].silent_since is None


def test_what_nobody_published_stands_in_the_account_and_a_dead_topic_is_silent(run: Told) -> None:
    topics = (
        EvidenceTopic("/camera/live", "a/msg/B", rate=30.0, byte_rate=6e6),
        EvidenceTopic("/camera/dead", "a/msg/B", 4, publishers=0, silent_since=0.2),
        EvidenceTopic("/camera/dead_before", "a/msg/B", publishers=0, silent_since=-9.0),
        EvidenceTopic("/tf_static", "a/msg/C", durable=True),
        EvidenceTopic("/map", "a/msg/C", publishers=0, durable=True),
    )
    missing = ("nobody publishes /camera/front, /robot/a",)
    begun = run.told(0.5, *topics, missing=missing, ready=False)
    assert begun.problems == ()  # it has only begun to look
    status = run.told(1.0, *topics, missing=missing)
    silent = [one.topic for one in status.topics if one.silent]
    assert silent == ["/camera/dead", "/camera/dead_before", "/map"]
    assert status.problems == ("nobody publishes /camera/front, /robot/a",)
    assert list(status.faults(0.1)) == ["/camera/dead: silent since +0.1 s"]
    assert status.account_since(0.1).remarks()[1:] == [
        "/camera/dead: silent since +0.1 s",
        "/camera/dead_before: silent since -9.1 s",
    ]


def test_a_gap_lasts_from_what_is_in_the_file_until_all_that_comes_back_is_there(
    run: Told,
) -> None:
    run.comes(6.0, {"/left": 0.1, "/right": 0.2}, saved=5.62)
    run.is_killed()
    starting = run.comes(8.0, {}, saved=None)
    assert starting.gap == EvidenceGap(5.62, None, KILLED)
    told = f"nothing is recorded since +4.6 s, it is starting again: {KILLED}"
    assert starting.trouble(1.0) == told
    assert run.comes(8.5, {"/left": 8.2}, saved=None).gap is not None
    back = run.comes(9.0, {"/left": 8.2, "/right": 8.75}, saved=10.0)
    assert (back.gap, back.trouble(1.0)) == (None, None)
    assert back.missing_words(1.0) == "missing from +4.6 s to +7.8 s"
    run.is_killed()
    run.comes(12.0, {"/left": 12.0}, saved=None)
    later = run.comes(12.1 + COMES_BACK, {"/left": 12.0}, saved=20.0)  # /right never comes back
    first, second = EvidenceGap(5.62, 8.75, KILLED), EvidenceGap(10.0, 12.0, KILLED)
    assert later.gaps == (first, second)
    run.is_killed()
    run.recording.ended = 30.0
    account = run.recording.merged_into(EvidenceState()).account_since(0.0)
    assert account.gaps[-1].words == "from +20.0 s to the end"


def test_a_recording_that_begins_before_its_process_listens_says_what_is_missing(
    run: Told,
) -> None:
    run.recording.open_gap("its process was only being started")
    assert run.comes(2.0, {"/left": 1.5}, saved=None).gaps[0].end == 1.5


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
        assert run.file.stats.queued_bytes > 2 * MB
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
            assert run.file.stats.queued_bytes <= 3 * MB
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
            if run.file.stats.queued_bytes < MB:
                run.take(*range(max(1, MB // (10 * size))), size=size)
    assert run.failed.startswith("no more evidence is recorded: ")
    assert "MB free, the score keeps 5.0 MB for itself; make room by" in run.failed
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


def test_what_the_disk_refuses_after_the_end_was_never_told_as_written(folder: Path) -> None:
    with written(folder, most=1_500_000) as run:
        run.hold()
        run.take(*range(25))
        run.file.end()
        told = EvidenceAccount((run.topic.recorded(0.0),), unwritten=run.state.unwritten)
    assert told.unwritten == 25
    assert run.failed == "the budget is used up: raise `recording.budget`"
    account = settled_account(folder, told)
    assert account is not None
    in_file = published(folder)
    assert 0 < in_file < 25
    (one,) = account.topics
    assert (one.messages, one.lost) == (in_file, {EvidenceLoss.DISK: 25 - in_file})
    assert account.unwritten == 0
