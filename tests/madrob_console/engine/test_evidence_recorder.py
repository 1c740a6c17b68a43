"""What writes evidence, on a real disk, without a process."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.evidence import settled_account
from madrob_console.common.errors import MadrobError
from madrob_console.config import Settings, load_settings
from madrob_console.engine import evidence_recorder
from madrob_console.engine.evidence_recorder import (
    BATCH_BYTES,
    QUEUE_BYTES,
    EvidenceQueue,
    EvidenceRecorder,
    EvidenceWritten,
)
from madrob_console.referee.evidence_account import EvidenceAccount, EvidenceLoss, RecordedTopic
from recorder.bag import RawMessage, Topic, evidence_file_name
from recorder.reader import read_bag
from recorder.survey import summarised
from recorder.writer import BagWriter
from tests.watching import until

LEFT, RIGHT = (Topic(f"/camera/{side}", "a/msg/B", "") for side in ("left", "right"))
NAME = evidence_file_name("run", 0)
CAPACITY = 3_000_000


def message(topic: Topic, number: int, size: int = 100_000) -> RawMessage:
    data = b"\0\1\0\0" + number.to_bytes(4, "little") + os.urandom(size)
    return RawMessage(topic.name, topic.type, data, number + 1, number + 1)


@contextmanager
def recording(
    folder: Path, most_bytes: int = 10**12, least_free: int = 0, name: str = NAME
) -> Iterator[EvidenceRecorder]:
    with BagWriter(folder, [], {}):
        recorder = EvidenceRecorder(
            os.open(folder, os.O_DIRECTORY),
            name,
            most_bytes=most_bytes,
            least_free=least_free,
            capacity=CAPACITY,
        )
        yield recorder
        recorder.hold_writing(held=False)
        recorder.end()
        recorder.wait(30.0)


def finished(recorder: EvidenceRecorder) -> EvidenceWritten:
    assert recorder.written.finished
    return recorder.written


def test_nothing_is_written_while_the_score_needs_the_disk_and_all_of_it_then(
    tmp_path: Path,
) -> None:
    with recording(tmp_path / "run") as recorder:
        until(lambda: recorder.written.size)
        recorder.hold_writing(held=True)
        for number in range(20):
            recorder.record_message(message(LEFT, number), LEFT, 0)
        assert recorder.written.queued > 2 * BATCH_BYTES  # all of it
        held = recorder.written.size
        recorder.record_message(message(RIGHT, 20), RIGHT, 0)
        assert recorder.written.size == held
        until(lambda: recorder.written.silent > 0)  # who looks sees that nothing is taken
        recorder.hold_writing(held=False)
        until(lambda: recorder.written.size > held)
    assert finished(recorder).messages == {LEFT.name: 20, RIGHT.name: 1}
    bag = read_bag(tmp_path / "run", evidence=True)
    assert [m.publish_ns for m in bag.messages()] == list(range(1, 22))


def test_a_disk_that_takes_too_little_costs_the_lower_priority_and_is_counted(
    tmp_path: Path,
) -> None:
    with recording(tmp_path / "run") as recorder:
        recorder.hold_writing(held=True)
        for number in range(100):
            recorder.record_message(message(LEFT, 2 * number), LEFT, 1)
            recorder.record_message(message(RIGHT, 2 * number + 1), RIGHT, 0)
    written = finished(recorder)
    for topic in (LEFT, RIGHT):
        kept, lost = written.messages[topic.name], written.gave_way.get(topic.name, 0)
        assert kept + lost == 100
    assert written.messages[LEFT.name] > 20
    assert written.messages[RIGHT.name] <= BATCH_BYTES // 100_000 + 1  # those already taken
    assert written.problem == ""


def test_the_budget_ends_the_evidence_and_what_is_in_the_file_is_whole(tmp_path: Path) -> None:
    with recording(tmp_path / "run", most_bytes=1_500_000) as recorder:
        number = 0
        while not recorder.written.problem:
            recorder.record_message(message(LEFT, number), LEFT, 0)
            number += 1
        recorder.record_message(message(LEFT, number), LEFT, 0)
    written = finished(recorder)
    assert "the budget is used up" in written.problem
    counted = written.messages[LEFT.name] + written.refused[LEFT.name]
    assert counted + written.gave_way.get(LEFT.name, 0) == number + 1
    bag = read_bag(tmp_path / "run", evidence=True)
    assert len(list(bag.messages())) == written.messages[LEFT.name]


def test_the_room_that_the_score_needs_is_left_alone(tmp_path: Path) -> None:
    with recording(tmp_path / "run", least_free=10**18) as recorder:
        until(lambda: recorder.written.problem)
        recorder.record_message(message(LEFT, 0), LEFT, 0)
    written = finished(recorder)
    assert "the score keeps" in written.problem
    assert written.refused == {LEFT.name: 1}


@pytest.mark.parametrize("size", [200, 100_000, 2_500_000])
def test_evidence_that_fills_the_disk_stops_before_the_room_of_the_score(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    folder, disk, keeps = tmp_path / "run", 12_000_000, 5_000_000

    def free() -> int:
        return disk - sum(file.stat().st_size for file in folder.iterdir())

    monkeypatch.setattr(
        os, "fstatvfs", lambda _fd: SimpleNamespace(f_bavail=max(0, free()), f_frsize=1)
    )
    with recording(folder, least_free=keeps) as recorder:
        number = 0
        while not recorder.written.problem:
            if recorder.written.queued < BATCH_BYTES:
                recorder.record_message(message(LEFT, number, size), LEFT, 0)
                number += 1
    assert recorder.written.problem.startswith("no more evidence is recorded: ")
    assert " MB free, the score keeps 5.0 MB for itself" in recorder.written.problem
    assert keeps < free() < keeps + 3 * BATCH_BYTES + size
    bag = read_bag(folder, evidence=True)
    assert len(list(bag.messages())) == finished(recorder).messages[LEFT.name]


def test_the_largest_message_that_settings_allow_is_recorded(tmp_path: Path) -> None:
    with pytest.raises(MadrobError):
        settings_with_largest(tmp_path, 91)
    largest = settings_with_largest(tmp_path, 90).recording.choice.largest
    huge = RawMessage(LEFT.name, LEFT.type, bytes(largest), 1, 1)
    queue = EvidenceQueue(QUEUE_BYTES)
    assert queue.put_message(huge, 0) == []


def settings_with_largest(tmp_path: Path, megabytes: int) -> Settings:
    file = tmp_path / "hall.toml"
    file.write_text(f"[recording]\nlargest = {megabytes}\n")
    return load_settings(file)


def test_what_is_still_on_its_way_after_the_end_is_told_until_it_is_in_the_file(
    tmp_path: Path,
) -> None:
    with recording(tmp_path / "run") as recorder:
        until(lambda: recorder.written.size)
        recorder.hold_writing(held=True)
        for number in range(20):
            recorder.record_message(message(LEFT, number), LEFT, 0)
        recorder.end()
        assert recorder.written.ended
        assert recorder.written.unwritten == 20
    assert finished(recorder).unwritten == 0


def test_what_the_disk_refuses_after_the_end_was_never_told_as_written(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with recording(folder, most_bytes=1_500_000) as recorder:
        until(lambda: recorder.written.size)
        recorder.hold_writing(held=True)
        for number in range(25):
            recorder.record_message(message(LEFT, number), LEFT, 0)
        recorder.end()
        before = recorder.written
        told = EvidenceAccount(
            (RecordedTopic(LEFT.name, LEFT.type, before.messages[LEFT.name], 2_500_000),),
            unwritten=before.unwritten,
        )
    assert told.unwritten == 25
    account = settled_account(folder, told, start=0.0)
    assert account is not None
    (one,) = account.topics
    in_file = len(list(read_bag(folder, evidence=True).messages()))
    assert 0 < in_file < 25
    assert (one.messages, one.lost) == (in_file, {EvidenceLoss.DISK: 25 - in_file})
    assert account.unwritten == 0


def left_by_another(folder: Path, of_it: int = 1_000_000) -> Path:
    """What a process that was killed left in a run's folder."""
    with BagWriter(folder.parent / "of another process", [LEFT], {}) as writer:
        for number in range(20):
            assert writer.put_message(message(LEFT, number))
    (whole,) = writer.folder.glob("*.mcap")
    torn = folder / evidence_file_name("run", 0)
    torn.write_bytes(whole.read_bytes()[:of_it])
    return torn


def test_a_repair_that_would_cost_the_score_room_is_told_and_made_once_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evidence_recorder, "REPAIR_PERIOD", 0.02)
    keeps, room = 500_000_000, [502_500_000]
    monkeypatch.setattr(os, "fstatvfs", lambda _fd: SimpleNamespace(f_bavail=room[0], f_frsize=1))
    folder = tmp_path / "run"
    with recording(folder, least_free=keeps, name=evidence_file_name("run", 1)) as recorder:
        torn = left_by_another(folder, of_it=1_900_000)
        before = torn.read_bytes()
        recorder.end()
        until(lambda: recorder.written.unrepaired)
        assert recorder.written.finished  # the recording itself waits for nothing
        assert recorder.written.unrepaired == (
            "run_evidence_0.mcap is not complete and waits for its repair, which takes 2.9 MB: "
            "502 MB free, the score keeps 500 MB for itself; make room by `madrob tidy`"
        )
        assert torn.read_bytes() == before
        room[0] += 1_000_000
        until(lambda: not recorder.written.unrepaired)
        recorder.wait(30.0)
    assert len(list(read_bag(folder, evidence=True).messages())) == 18


def test_a_repair_needs_room_for_the_largest_torn_file_and_none_for_whole_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeps = 500_000_000
    monkeypatch.setattr(
        os, "fstatvfs", lambda _fd: SimpleNamespace(f_bavail=keeps + 2_500_000, f_frsize=1)
    )
    folder = tmp_path / "run"
    with recording(folder, least_free=keeps, name=evidence_file_name("run", 2)):
        torn = left_by_another(folder)
        (whole,) = (tmp_path / "of another process").glob("*.mcap")
        shutil.copy(whole, folder / evidence_file_name("run", 1))
    assert summarised(os.open(folder, os.O_DIRECTORY), torn.name) is not None


def test_a_repair_that_waits_for_room_holds_up_neither_the_next_run_nor_the_end(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    torn = folder / evidence_file_name("run", 0)
    free = shutil.disk_usage(tmp_path).free
    with (
        recording(folder, least_free=free // 2, name=evidence_file_name("run", 1)) as recorder,
        torn.open("wb") as file,
    ):
        file.truncate(free)  # a hole
        recorder.leave()
    assert not recorder.written.unrepaired
    assert torn.stat().st_size == free
    assert not list(folder.glob("*.recovering"))


def test_what_a_process_that_was_killed_left_is_whole_and_listed_after_the_run(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    with recording(folder, name=evidence_file_name("run", 1)) as recorder:
        left_by_another(folder)
        recorder.record_message(message(RIGHT, 20), RIGHT, 0)
    assert finished(recorder).problem == ""
    bag = read_bag(folder, evidence=True)
    kept = [m.publish_ns for m in bag.messages() if m.topic == LEFT.name]
    assert 5 <= len(kept) < 20
    assert kept == list(range(1, len(kept) + 1))
    assert set(map(str.strip, (folder / "metadata.yaml").read_text().splitlines())) >= {
        f"- {evidence_file_name('run', number)}" for number in (0, 1)
    }


SMALL, LARGE = 10_000, 1_000_000


def numbered(topic: str, number: int, size: int = SMALL) -> RawMessage:
    return RawMessage(topic, "a/msg/B", bytes(size), number, number)


def test_messages_come_out_in_the_order_in_which_they_came() -> None:
    queue = EvidenceQueue(LARGE)
    for number in range(10):
        assert queue.put_message(numbered(f"/{number % 3}", number), 0) == []
    assert [m.publish_ns for m in queue.take_messages(3 * SMALL)] == [0, 1, 2]
    assert [m.publish_ns for m in queue.take_messages(LARGE)] == list(range(3, 10))
    assert queue.take_messages(LARGE) == []
    assert queue.size == len(queue) == 0


def test_the_topic_that_takes_most_room_gives_way_and_no_other_pays_for_it() -> None:
    queue = EvidenceQueue(4 * LARGE)
    lost: Counter[str] = Counter()
    for number in range(100):
        for topic, size in (("/huge", LARGE), ("/left", SMALL), ("/right", SMALL)):
            lost.update(m.topic for m in queue.put_message(numbered(topic, number, size), 0))
    assert set(lost) == {"/huge"}
    assert lost["/huge"] > 95
    taken = queue.take_messages(100 * LARGE)
    assert Counter(m.topic for m in taken)["/left"] == 100
    assert [m.publish_ns for m in taken if m.topic == "/huge"][-1] == 99  # the oldest went


def test_where_not_all_finds_room_the_higher_priority_stays() -> None:
    queue = EvidenceQueue(LARGE)
    for number in range(200):
        queue.put_message(numbered("/important", number), 5)
        queue.put_message(numbered("/spare", number), -1)
    topics = Counter(m.topic for m in queue.take_messages(10 * LARGE))
    assert topics["/spare"] == 0
    assert topics["/important"] > 90
    assert queue.put_message(numbered("/important", 1, LARGE // 2), 5) == []
    assert [m.topic for m in queue.put_message(numbered("/spare", 2, LARGE), -1)] == ["/spare"]


def test_what_is_larger_than_the_queue_is_refused_and_costs_no_other_topic_anything() -> None:
    queue = EvidenceQueue(LARGE)
    queue.put_message(numbered("/small", 1), 0)
    assert [m.topic for m in queue.put_message(numbered("/huge", 2, 2 * LARGE), 0)] == ["/huge"]
    assert len(queue) == 1


@given(
    st.lists(
        st.tuples(st.integers(0, 3), st.integers(1, 300_000), st.integers(-1, 1), st.booleans())
    )
)
def test_every_message_is_taken_gives_way_or_waits_and_memory_is_bounded(
    steps: list[tuple[int, int, int, bool]],
) -> None:
    queue = EvidenceQueue(LARGE)
    came = left = 0
    for number, (topic, size, priority, takes) in enumerate(steps):
        left += len(queue.put_message(numbered(f"/{topic}", number, size), priority))
        came += 1
        assert queue.size <= LARGE
        if takes:
            left += len(queue.take_messages(size))
    assert came == left + len(queue)
