"""What writes evidence, on a real disk, without a process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from madrob_console.engine.process.evidence_recorder import (
    BATCH_BYTES,
    EvidenceRecorder,
    EvidenceWritten,
)
from recorder.bag import Topic, evidence_file_name
from recorder.message import RawMessage
from recorder.reader import read_bag
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
        recorder.hold(held=False)
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
        recorder.hold(held=True)
        for number in range(20):
            recorder.put(message(LEFT, number), LEFT, 0)
        assert recorder.written.queued > 2 * BATCH_BYTES  # all of it
        held = recorder.written.size
        recorder.put(message(RIGHT, 20), RIGHT, 0)
        assert recorder.written.size == held
        recorder.hold(held=False)
        until(lambda: recorder.written.size > held)
    assert finished(recorder).messages == {LEFT.name: 20, RIGHT.name: 1}
    bag = read_bag(tmp_path / "run", evidence=True)
    assert [m.publish_ns for m in bag.messages()] == list(range(1, 22))


def test_a_disk_that_takes_too_little_costs_the_lower_priority_and_is_counted(
    tmp_path: Path,
) -> None:
    with recording(tmp_path / "run") as recorder:
        recorder.hold(held=True)
        for number in range(100):
            recorder.put(message(LEFT, 2 * number), LEFT, 1)
            recorder.put(message(RIGHT, 2 * number + 1), RIGHT, 0)
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
            recorder.put(message(LEFT, number), LEFT, 0)
            number += 1
        recorder.put(message(LEFT, number), LEFT, 0)
    written = finished(recorder)
    assert "the budget is used up" in written.problem
    counted = written.messages[LEFT.name] + written.refused[LEFT.name]
    assert counted + written.gave_way.get(LEFT.name, 0) == number + 1
    bag = read_bag(tmp_path / "run", evidence=True)
    assert len(list(bag.messages())) == written.messages[LEFT.name]


def test_the_room_that_the_score_needs_is_left_alone(tmp_path: Path) -> None:
    with recording(tmp_path / "run", least_free=10**18) as recorder:
        until(lambda: recorder.written.problem)
        recorder.put(message(LEFT, 0), LEFT, 0)
    written = finished(recorder)
    assert "the score keeps" in written.problem
    assert written.refused == {LEFT.name: 1}


def test_what_a_process_that_was_killed_left_is_whole_and_listed_after_the_run(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    with BagWriter(tmp_path / "of another process", [LEFT], {}) as writer:
        for number in range(20):
            assert writer.put(message(LEFT, number))
    (whole,) = writer.folder.glob("*.mcap")
    with recording(folder, name=evidence_file_name("run", 1)) as recorder:
        torn = folder / evidence_file_name("run", 0)
        torn.write_bytes(whole.read_bytes()[:1_000_000])
        recorder.put(message(RIGHT, 20), RIGHT, 0)
    assert finished(recorder).problem == ""
    bag = read_bag(folder, evidence=True)
    kept = [m.publish_ns for m in bag.messages() if m.topic == LEFT.name]
    assert 5 <= len(kept) < 20
    assert kept == list(range(1, len(kept) + 1))
    assert set(map(str.strip, (folder / "metadata.yaml").read_text().splitlines())) >= {
        f"- {evidence_file_name('run', number)}" for number in (0, 1)
    }
