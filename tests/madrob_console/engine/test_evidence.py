"""Evidence as the core sees it, with somebody who only says that it is recorded."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from madrob_console.cli.repairing import repair_all
from madrob_console.engine.core import DISK_WAITS, Engine
from madrob_console.engine.engine_config import STEADY_FOR
from madrob_console.engine.evidence_client import (
    EvidenceClient,
    EvidencePlace,
    EvidencePlan,
    EvidenceStatus,
)
from madrob_console.engine.journal_writer import Recording
from madrob_console.referee.acts import Start, Waive
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    EvidenceTopic,
)
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import CheckName
from recorder.bag import evidence_file_name
from tests.madrob_console.engine.drive import Drive, make_setup, signed
from tests.madrob_console.engine.test_opening import cut_off
from tests.recorder.samples import add_evidence, strings

LEFT = "/camera/left"
COMES = EvidenceTopic(LEFT, "sensor_msgs/msg/CompressedImage", rate=30.0, byte_rate=6e6)
RECORDED = EvidenceTopic(LEFT, COMES.type, 600, 120_000_000)
HOUR = 3600.0


class ToldWitness(EvidenceClient):
    """Says what a test tells it to."""

    status = EvidenceStatus(ready=True, topics=(COMES,))

    def __init__(self) -> None:
        self.places: list[EvidencePlace] = []
        self.held: list[bool] = []
        self.counted: dict[str, Any] = {}  # what it says when it is asked to the end

    def begin_recording(self, place: EvidencePlace) -> None:
        self.places.append(place)
        self.status = replace(self.status, recording=True, recorded=(RECORDED,))

    def end_recording(self) -> None:
        self.status = replace(self.status, recording=False)

    def await_account(self, limit: float) -> None:
        assert limit <= 0.5
        assert not self.status.recording
        self.status = replace(self.status, **self.counted)

    def hold_writing(self, *, held: bool) -> None:
        self.held.append(held)

    def lose(self, number: int) -> None:
        self.tell(recorded=(replace(RECORDED, lost={EvidenceLoss.BEHIND: number}),))

    def tell(self, **changes: Any) -> None:  # noqa: ANN401  fields of the status
        self.status = replace(self.status, **changes)


class Watched(Drive):
    """A run with evidence."""

    def __init__(self, results: Path, *, budget: int = 10**12, least_room: float = HOUR) -> None:
        super().__init__(results)
        self.evidence_client = ToldWitness()
        plan = EvidencePlan(budget, least_room)
        config = replace(self.engine.config, evidence=plan)
        types = self.engine._engine_context.types
        self.engine = Engine(
            self.source, self.clock, config, types, evidence_client=self.evidence_client
        )
        self.engine.open()


@pytest.fixture
def drive(tmp_path: Path) -> Watched:
    return Watched(tmp_path / "runs")


def test_evidence_begins_and_ends_with_the_recording_and_stands_in_the_result(
    drive: Watched,
) -> None:
    drive.start(make_setup())
    (place,) = drive.evidence_client.places
    assert place.folder == str(drive.folder)
    assert place.steady_ns >= drive.engine.run.countdown_began * 1e9 - 1e8  # type: ignore[operator]
    assert drive.engine.snapshot().evidence is not None
    assert drive.engine.snapshot().evidence.recording  # type: ignore[union-attr]
    drive.finish()
    assert not drive.evidence_client.status.recording
    stored = json.loads((drive.folder / "result.json").read_text())
    assert stored["evidence"] == {
        "topics": [
            {
                "topic": LEFT,
                "type": COMES.type,
                "messages": 600,
                "bytes": 120_000_000,
                "left_out": 0,
                "lost": {},
                "problem": "",
            }
        ],
        "problems": [],
        "unwritten": 0,
        "gaps": [],
        "file_bytes": None,
    }
    assert stored["quality"]["remarks"] == []
    texts = [line.text for line in drive.engine.log.lines]
    assert "evidence recorded: 1 topic, 600 messages, 120.0 MB" in texts


def test_the_result_has_all_that_came_up_to_the_end(drive: Watched) -> None:
    drive.start(make_setup())
    drive.evidence_client.counted = {"recorded": (replace(RECORDED, messages=613),)}
    drive.finish()
    stored = json.loads((drive.folder / "result.json").read_text())
    assert stored["evidence"]["topics"][0]["messages"] == 613


STILL_WRITTEN = {"recorded": (replace(RECORDED, messages=5),), "unwritten": 3}


def ended_while_it_was_written(drive: Watched, run_number: int = 1) -> dict[str, Any]:
    """A run whose evidence was not all in its file when its result was made; the result."""
    drive.start(make_setup(run_number=run_number))
    drive.evidence_client.counted = STILL_WRITTEN
    drive.finish()
    return told_in(drive.folder)


def told_in(folder: Path) -> dict[str, Any]:
    told = json.loads((folder / "result.json").read_text())["evidence"]
    assert isinstance(told, dict)
    return told


def write_rest(folder: Path) -> None:
    """Four of the five reached the disk."""
    add_evidence(folder, strings(["a", "b", "c", "d"], LEFT))


def test_a_result_that_was_made_before_all_was_written_is_made_again_by_what_is_in_the_file(
    drive: Watched,
) -> None:
    told = ended_while_it_was_written(drive)
    assert told["unwritten"] == 3
    drive.wait(3.0)
    assert told_in(drive.folder) == told
    score = json.loads((drive.folder / "result.json").read_text())["indicators"]
    write_rest(drive.folder)
    drive.wait(3.0)
    assert told_in(drive.folder)["unwritten"] == 0
    (topic,) = told_in(drive.folder)["topics"]
    assert (topic["messages"], topic["lost"]) == (4, {"disk": 1})
    stored = json.loads((drive.folder / "result.json").read_text())
    assert (stored["issue"], stored["indicators"]) == (1, score)
    entries, _ = read_journal(drive.folder / "journal.jsonl")
    assert sum(entry.what == Change.EVIDENCE_RECORDED for entry in entries) == 2
    before = len(entries)
    drive.wait(3.0)
    assert len(read_journal(drive.folder / "journal.jsonl")[0]) == before


def test_a_signed_result_stays_as_it_was_signed_and_the_journal_says_the_rest(
    drive: Watched,
) -> None:
    ended_while_it_was_written(drive)
    drive.act(signed(drive.engine.snapshot()))
    drive.wait(3.0)
    before = (drive.folder / "result.json").read_bytes()
    write_rest(drive.folder)
    drive.wait(3.0)
    assert drive.engine.run.evidence is not None
    assert drive.engine.run.evidence.unwritten == 0
    assert (drive.folder / "result.json").read_bytes() == before
    assert told_in(drive.folder)["unwritten"] == 3
    drive.engine.close()
    assert list(repair_all(drive.folder.parents[1])) == []
    assert (drive.folder / "result.json").read_bytes() == before


def test_a_run_that_was_left_meanwhile_is_looked_after_with_the_result_of_the_next_one(
    drive: Watched,
) -> None:
    asked: list[int] = []
    drive.engine.on_left_unsettled = lambda: asked.append(drive.engine.run.setup.run_number)  # type: ignore[union-attr]
    ended_while_it_was_written(drive)
    left = drive.folder
    drive.evidence_client.counted = {"unwritten": 0}
    drive.whole_run(make_setup(run_number=2))
    assert asked == [2]
    write_rest(left)
    assert list(repair_all(left.parents[1])) == []
    assert told_in(left)["topics"][0]["messages"] == 4
    drive.whole_run(make_setup(run_number=3))
    assert asked == [2]


def test_an_engine_that_ends_looks_once_more(drive: Watched) -> None:
    ended_while_it_was_written(drive)
    write_rest(drive.folder)
    drive.engine.close()
    assert told_in(drive.folder)["unwritten"] == 0


def test_what_is_lost_is_told_once_when_it_begins_and_doubts_nothing(drive: Watched) -> None:
    drive.start(make_setup())
    for number in (3, 40, 500):
        drive.evidence_client.lose(number)
        drive.wait(1.0)
    drive.finish()
    told = f"evidence: {LEFT}: messages are lost (behind)"
    assert [line.text for line in drive.engine.log.lines].count(told) == 1
    stored = json.loads((drive.folder / "result.json").read_text())
    assert stored["evidence"]["topics"][0]["lost"] == {"behind": 500}
    assert not [flag for flag in stored["flags"] if "camera" in json.dumps(flag)]
    assert stored["quality"]["remarks"] == []
    assert not any(indicator["doubts"] for indicator in stored["indicators"].values())


def test_when_nothing_was_recorded_is_a_fault_until_it_is_and_stands_in_journal_and_result(
    drive: Watched,
) -> None:
    drive.start(make_setup())
    drive.wait(2.0)
    start = drive.engine.run.start
    assert start is not None
    killed = "it was ended by SIGKILL"
    begun = EvidenceGap(start + 5.62, None, killed)
    drive.evidence_client.lose(4)
    drive.evidence_client.tell(gaps=(begun,), topics=(), problem=killed)
    drive.wait(1.0)
    drive.evidence_client.tell(problem=None)
    drive.wait(5.0)
    fault = f"evidence: nothing is recorded since +5.6 s, it is starting again: {killed}"
    assert fault in drive.engine.snapshot().faults
    evidence = drive.engine.snapshot().evidence
    assert evidence is not None
    assert evidence.problem == fault.removeprefix("evidence: ")
    over = replace(begun, end=start + 8.31)
    drive.evidence_client.tell(gaps=(over,), topics=(COMES,))
    drive.wait(1.0)
    assert fault not in drive.engine.snapshot().faults
    drive.finish()
    texts = [line.text for line in drive.engine.log.lines]
    assert texts.count(f"evidence: nothing is recorded since +5.6 s: {killed}") == 1
    assert texts.count("evidence: recorded again, missing from +5.6 s to +8.3 s") == 1
    assert not any(killed in text and "recording" in text for text in texts)
    stored = told_in(drive.folder)
    assert stored["gaps"] == [{"begin": 5.62, "end": 8.31, "why": killed}]
    account = drive.engine.run.evidence
    assert account is not None
    assert account.words.endswith(", at least 4 lost, missing from +5.6 s to +8.3 s")
    assert account.remarks() == [f"{LEFT}: at least 4 lost (4 behind)"]
    entries, _ = read_journal(drive.folder / "journal.jsonl")
    assert rebuild(entries).evidence == account


def test_of_topics_that_lack_the_same_one_line_tells(drive: Watched) -> None:
    drive.start(make_setup())
    lost = tuple(
        replace(RECORDED, topic=f"/c{number}", lost={EvidenceLoss.ON_THE_WAY: 1})
        for number in range(5)
    )
    drive.evidence_client.tell(recorded=lost)
    drive.wait(3.0)
    told = [one.text for one in drive.engine.log.lines if one.text.startswith("evidence: ")]
    assert told == ["evidence: /c0, /c1 and 3 more: messages are lost (on the way)"]


def test_a_run_whose_engine_was_ended_is_scored_with_what_is_in_its_files(
    tmp_path: Path,
) -> None:
    folder = cut_off(tmp_path)
    add_evidence(folder, strings(["a", "b", "c", "d"], LEFT))
    drive = Drive(tmp_path)
    told: list[str | None] = []
    drive.engine.open_run(drive.engine.read_run(folder).result(), told.append)
    assert told == [None]
    assert "what was lost is not known" in told_in(folder)["problems"][0]
    drive.wait(3.0)
    account = told_in(folder)
    assert [one["messages"] for one in account["topics"]] == [4]
    assert account["unwritten"] == 0
    assert "what was lost is not known" in account["problems"][0]
    drive.engine.close()
    assert list(repair_all(tmp_path)) == []
    assert told_in(folder) == account


def test_a_run_that_is_read_back_has_its_evidence(drive: Watched) -> None:
    drive.whole_run(make_setup())
    entries, _ = read_journal(drive.folder / "journal.jsonl")
    account = EvidenceAccount((RECORDED.recorded(0.0),))
    assert rebuild(entries).evidence == drive.engine.run.evidence == account


def test_what_goes_wrong_after_the_result_is_said_and_the_result_stands(drive: Watched) -> None:
    drive.whole_run(make_setup())
    before = (drive.folder / "result.json").read_bytes()
    drive.evidence_client.tell(problem="not complete on disk")
    drive.wait(1.0)
    assert "evidence: not complete on disk" in drive.engine.snapshot().faults
    assert (drive.folder / "result.json").read_bytes() == before


def test_evidence_that_left_the_disk_to_the_score_is_written_when_the_bag_is_closed(
    drive: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive.start(make_setup())
    monkeypatch.setattr(Recording, "silent", property(lambda _self: 2 * DISK_WAITS))
    drive.finish()
    assert True in drive.evidence_client.held
    drive.wait(1.0)
    assert not drive.evidence_client.held[-1]


def test_the_check_says_how_long_evidence_can_be_recorded(drive: Watched) -> None:
    drive.prepare(make_setup())
    free = shutil.disk_usage(drive.engine.config.results.parent).free
    said = drive.check(CheckName.EVIDENCE)
    assert said.startswith("ok: 1 topic, room for ")
    assert said.endswith(" at the rate of now")
    room = drive.engine.snapshot().evidence.room  # type: ignore[union-attr]
    assert room == pytest.approx(min(10**12, free) / COMES.byte_rate, rel=0.1)


def test_too_little_room_blocks_a_start_and_can_be_waived(tmp_path: Path) -> None:
    results = tmp_path / "runs"
    drive = Watched(results, budget=6_000_000 * 600)
    drive.prepare(make_setup())
    said = drive.check(CheckName.EVIDENCE)
    assert said.startswith(
        "failed: `madrob tidy` makes room for evidence: room for 10 min at the rate of now, 60 min"
    )
    assert "evidence" in str(drive.engine.perform(Start()))
    drive.act(Waive(CheckName.EVIDENCE, "the last run of the day"), Start())
    drive.finish()
    assert drive.evidence_client.places[0].most_bytes == 6_000_000 * 600


def test_room_for_less_than_a_run_is_a_warning_and_told_in_seconds(tmp_path: Path) -> None:
    drive = Watched(tmp_path / "runs", budget=6_000_000 * 8, least_room=0.0)
    drive.prepare(replace(make_setup(), timeout=90.0))
    said = drive.check(CheckName.EVIDENCE)
    told = "warning: 1 topic, room for 8 s at the rate of now: a run may take 90 s"
    assert said == told
    drive.act(Start())
    assert drive.engine.run.active


def test_the_room_does_not_jump_while_rates_begin_and_end(drive: Watched) -> None:
    def room_at(byte_rate: float, after: float) -> float | None:
        topic = replace(COMES, byte_rate=byte_rate)
        drive.evidence_client.tell(topics=(topic,))
        drive.wait(after)
        evidence = drive.engine.snapshot().evidence
        assert evidence is not None
        return evidence.room

    drive.prepare(make_setup())
    usual = room_at(6e6, 1.0)
    assert usual is not None
    assert room_at(2e6, 1.0) == pytest.approx(usual, rel=0.02)  # its process was just started
    assert room_at(0.0, 3.0) == pytest.approx(usual, rel=0.02)
    assert room_at(12e6, 1.0) == pytest.approx(usual / 2, rel=0.02)
    assert room_at(3e6, STEADY_FOR + 1.0) == pytest.approx(2 * usual, rel=0.02)


def test_evidence_of_earlier_runs_counts_against_the_budget(tmp_path: Path) -> None:
    results = tmp_path / "runs"
    first = Watched(results, budget=6_000_000 * 7200)
    first.whole_run(make_setup())
    with (first.folder / evidence_file_name(first.folder.name, 0)).open("wb") as file:
        file.truncate(6_000_000 * 5400)  # a hole, of 32 GB
    first.engine.close()
    second = Watched(results, budget=6_000_000 * 7200)
    second.prepare(make_setup(run_number=2))
    assert second.check(CheckName.EVIDENCE).startswith(
        "failed: `madrob tidy` makes room for evidence: room for 30 min"
    )


FOUR = (COMES, *(EvidenceTopic(topic, "a/msg/B") for topic in ("/a", "/b", "/c")))


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (
            EvidenceStatus(unseen=("/camera/**",)),
            "no data: wait: the evidence's topics are not all seen yet",
        ),
        (EvidenceStatus(ready=True), "warning: 0 topics, room for "),  # all are excluded
        (
            EvidenceStatus(ready=True, topics=(COMES,), problem="it hangs"),
            "failed: evidence: it hangs",
        ),
        (
            EvidenceStatus(ready=True, topics=(replace(COMES, rate=0.0, byte_rate=0.0),)),
            f"warning: {LEFT}: nothing comes now; 0 topics, room for ",
        ),
        (
            EvidenceStatus(ready=True, topics=FOUR),
            "warning: /a, /b and 1 more: nothing comes now; 1 topic, room for ",
        ),
        (
            EvidenceStatus(ready=True, topics=(COMES,), unseen=("/camera/front", "/robot/**")),
            "warning: nobody publishes /camera/front, /robot/**; 1 topic, room for ",
        ),
        (
            EvidenceStatus(ready=True, unseen=("/rosout",), scored=("/madrob/**",)),
            "warning: nobody publishes /rosout; /madrob/**: recorded with the score, remove the ",
        ),
        (
            EvidenceStatus(ready=True, unseen=("/camera/**",)),
            "warning: nobody publishes /camera/**; 0 topics, room for ",
        ),
    ],
)
def test_missing_evidence_is_never_ok(drive: Watched, status: EvidenceStatus, said: str) -> None:
    drive.prepare(make_setup())
    drive.evidence_client.status = status
    assert drive.check(CheckName.EVIDENCE).startswith(said)


def test_what_does_not_come_is_a_fault_and_stands_in_no_start_s_way(drive: Watched) -> None:
    quiet = replace(COMES, topic="/camera/quiet", rate=0.0, byte_rate=0.0)
    dead = replace(quiet, topic="/camera/dead")
    drive.evidence_client.tell(topics=(COMES, dead, quiet), unseen=("/camera/front",))
    drive.start(make_setup())
    assert drive.engine.run.start is not None
    since = drive.engine.run.start + 3.9
    drive.evidence_client.tell(topics=(COMES, replace(dead, silent_since=since), quiet))
    assert drive.engine.run.active
    assert [fault for fault in drive.engine.snapshot().faults if "evidence" in fault] == [
        "evidence: nobody publishes /camera/front",
        "evidence: /camera/dead: silent since +3.9 s",  # the other may have nothing to say
    ]


@pytest.mark.parametrize("budget", [10**12, 0])
def test_without_any_camera_a_run_starts_and_only_too_little_room_is_in_its_way(
    tmp_path: Path, budget: int
) -> None:
    drive = Watched(tmp_path / "runs", budget=budget)
    drive.evidence_client.status = EvidenceStatus(ready=True, unseen=("/camera/**",))
    drive.prepare(make_setup())
    said = drive.check(CheckName.EVIDENCE)
    if not budget:
        words = (
            "failed: `madrob tidy` makes room for evidence: nobody publishes /camera/**; 0 topics"
        )
        assert said.startswith(words)
    else:
        assert said.startswith("warning: ")
        drive.start(make_setup())
        assert drive.engine.run.active


def test_a_simulated_testbed_says_that_it_has_none_and_without_a_wish_there_is_no_check(
    tmp_path: Path,
) -> None:
    plain = Drive(tmp_path / "plain")
    plain.prepare(make_setup())
    assert CheckName.EVIDENCE not in {check.name for check in plain.engine.snapshot().checks}
    wished = replace(plain.engine.config, evidence=EvidencePlan(10**9, HOUR))
    engine = Engine(plain.source, plain.clock, wished, plain.engine._engine_context.types)
    plain.engine = engine
    assert plain.check(CheckName.EVIDENCE).startswith("ok: none: a testbed simulated in this")
    assert engine.snapshot().evidence is None


START = 1000.0


def test_a_camera_s_times_stand_in_journal_and_result_from_the_start_on(tmp_path: Path) -> None:
    drive = Watched(tmp_path / "runs")
    drive.start(make_setup())
    start = drive.engine.run.start
    assert start is not None
    drive.wait(2.0)
    gone = replace(RECORDED, silent_since=start + 1.9)
    drive.evidence_client.tell(recorded=(gone, replace(gone, topic="/camera/late")))
    drive.wait(1.0)
    dead = replace(gone, topic="/camera/late", silent_since=start + 4.2)
    drive.evidence_client.tell(recorded=(RECORDED, dead))
    drive.wait(1.0)
    drive.finish()
    texts = [line.text for line in drive.engine.log.lines]
    for told in (
        f"{LEFT}, /camera/late: silent since +1.9 s",
        f"{LEFT}: comes again, silent since +1.9 s",
    ):
        assert texts.count(f"evidence: {told}") == 1
    topics = json.loads((drive.folder / "result.json").read_text())["evidence"]["topics"]
    assert [one["problem"] for one in topics] == ["", "silent since +4.2 s"]
