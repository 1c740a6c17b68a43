"""What writes evidence, on a real disk, without a process."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from madrob_console.archive.evidence import settled_account
from madrob_console.common.errors import MadrobError
from madrob_console.config import Settings, load_settings
from madrob_console.engine.evidence_client import EvidencePlace
from madrob_console.engine.evidence_status import EvidenceNews, RecordInto
from madrob_console.engine.evidence_worker import QUEUE_BYTES, EvidenceFile
from madrob_console.referee.evidence_account import EvidenceAccount, EvidenceLoss, EvidenceTopic
from madrob_console.testbeds.ros.evidence_intake import TakenEvidence
from recorder.bag import RawMessage, Topic, evidence_file_name
from recorder.reader import read_bag
from recorder.writer import BagWriter
from tests.watching import until

LEFT, RIGHT = (Topic(f"/camera/{side}", "a/msg/B", "") for side in ("left", "right"))
PLENTY = 10**12
QUEUE = 3_000_000
MB = 1_000_000


def message(topic: Topic, number: int, size: int = 100_000) -> RawMessage:
    data = b"\0\1\0\0" + number.to_bytes(4, "little") + os.urandom(size)
    return RawMessage(topic.name, topic.type, data, number + 1, number + 1)


class Recorded:
    """A file of evidence, and what its process would report of it."""

    def __init__(self, order: RecordInto, queue_bytes: int = QUEUE_BYTES) -> None:
        self.file = EvidenceFile(order, queue_bytes, held=False)

    def take(self, *numbers: int, topic: Topic = LEFT, size: int = 100_000) -> None:
        for number in numbers:
            self.file.record(TakenEvidence(topic, [message(topic, number, size)]))

    @property
    def news(self) -> EvidenceNews:
        self.file.advance()
        topics = tuple(EvidenceTopic(topic.name, topic.type) for topic in (LEFT, RIGHT))
        return self.file.told(EvidenceNews(topics=topics))

    def topic(self, topic: Topic = LEFT) -> EvidenceTopic:
        return next(one for one in self.news.topics if one.topic == topic.name)

    def came(self, topic: Topic = LEFT) -> int:
        return self.topic(topic).messages + self.topic(topic).lost_count

    def hold(self) -> None:
        """Once the file is there nothing more of it is written."""
        until(lambda: self.news.size)
        self.file.hold_writing(held=True)

    def end(self) -> None:
        self.file.hold_writing(held=False)
        self.file.end()
        until(lambda: self.news.finished)


@contextmanager
def recording(
    folder: Path,
    most_bytes: int = PLENTY,
    least_free: int = 0,
    number: int = 0,
    queue_bytes: int = QUEUE_BYTES,
) -> Iterator[Recorded]:
    with BagWriter(folder, [], {}):
        place = EvidencePlace(str(folder), 0, 0, most_bytes, least_free)
        recorded = Recorded(RecordInto(1, number, place), queue_bytes)
        yield recorded
        recorded.end()
    recorded.file.close(time.monotonic() + 30.0)


def published(folder: Path, topic: Topic = LEFT) -> list[int]:
    bag = read_bag(folder, evidence=True)
    return [m.publish_ns for m in bag.messages() if m.topic == topic.name]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "run"


def test_what_comes_before_the_file_is_there_is_in_it(folder: Path) -> None:
    with recording(folder) as run:
        run.take(0)
        assert (run.topic().messages, run.news.unwritten) == (1, 1)
        run.take(1)
    assert published(folder) == [1, 2]
    assert (run.topic().messages, run.topic().bytes, run.news.unwritten) == (2, 200_016, 0)
    assert run.topic().first == 1e-9


def test_nothing_is_written_while_the_score_needs_the_disk_and_all_of_it_then(
    folder: Path,
) -> None:
    with recording(folder) as run:
        run.hold()
        before = run.news.size
        run.take(*range(20))
        until(lambda: run.news.unsynced > 1)  # who looks sees that nothing is taken
        assert (run.news.size, run.news.unwritten) == (before, 20)
        assert run.news.queued > 2 * MB
        run.file.end()
        assert run.news.ended
        assert run.news.unwritten == 20  # told until it is in the file
    assert published(folder) == list(range(1, 21))
    assert (run.news.unwritten, run.news.failed) == (0, "")


def test_memory_is_bounded_and_what_finds_no_room_is_counted(folder: Path) -> None:
    with recording(folder, queue_bytes=QUEUE) as run:
        run.hold()
        run.take(*range(100))
        assert run.news.queued <= QUEUE
        assert run.came() == 100
    assert list(run.topic().lost) == [EvidenceLoss.BEHIND]
    assert len(published(folder)) == run.topic().messages > 20
    assert run.news.failed == ""


def test_the_budget_ends_the_evidence_and_what_is_in_the_file_is_whole(folder: Path) -> None:
    number = 0
    with recording(folder, most_bytes=1_500_000) as run:
        while not run.news.failed:
            run.take(number)
            number += 1
        run.take(number)
        assert run.news.failed == "the budget is used up: raise `recording.budget`"
    assert run.came() == number + 1
    assert run.topic().lost[EvidenceLoss.DISK]
    assert len(published(folder)) == run.topic().messages


@pytest.mark.parametrize("size", [200, 100_000, 2_500_000])
def test_evidence_that_fills_the_disk_stops_before_the_room_of_the_score(
    folder: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    disk, keeps = 12 * MB, 5 * MB

    def free() -> int:
        return disk - sum(file.stat().st_size for file in folder.iterdir())

    monkeypatch.setattr(
        os, "fstatvfs", lambda _fd: SimpleNamespace(f_bavail=max(0, free()), f_frsize=1)
    )
    with recording(folder, least_free=keeps) as run:
        number = 0
        while not run.news.failed:
            if run.news.queued < MB:
                run.take(*range(number, number + max(1, MB // (10 * size))), size=size)
                number += max(1, MB // (10 * size))
    assert run.news.failed.startswith("no more evidence is recorded: ")
    assert run.news.failed.endswith(
        " MB free, the score keeps 5.0 MB for itself; make room by `madrob tidy`"
    )
    assert keeps < free() < keeps + 3 * MB + size
    assert len(published(folder)) == run.topic().messages


def test_the_largest_message_that_settings_allow_is_recorded(folder: Path) -> None:
    with pytest.raises(MadrobError):
        settings_with_largest(folder.parent, 91)
    largest = settings_with_largest(folder.parent, 90).recording.choice.largest
    with recording(folder) as run:
        huge = RawMessage(LEFT.name, LEFT.type, bytes(largest), 1, 1)
        run.file.record(TakenEvidence(LEFT, [huge]))
    assert (run.topic().messages, run.topic().lost) == (1, {})


def settings_with_largest(folder: Path, megabytes: int) -> Settings:
    file = folder / "hall.toml"
    file.write_text(f"[recording]\nlargest = {megabytes}\n")
    return load_settings(file)


def test_a_folder_that_takes_no_file_ends_the_evidence_and_nothing_else(folder: Path) -> None:
    folder.mkdir()
    taken = folder / evidence_file_name("run", 0)
    taken.touch()
    run = Recorded(RecordInto(1, 0, EvidencePlace(str(folder), 0, 0, PLENTY, 0)))
    run.take(0)
    until(lambda: run.news.failed)
    assert "exists already" in run.news.failed
    assert (run.topic().messages, run.topic().lost) == (0, {EvidenceLoss.DISK: 1})
    run.end()
    assert taken.stat().st_size == 0


def test_what_the_disk_refuses_after_the_end_was_never_told_as_written(folder: Path) -> None:
    with recording(folder, most_bytes=1_500_000) as run:
        run.hold()
        run.take(*range(25))
        run.file.end()
        told = EvidenceAccount((run.topic().recorded(0.0),), unwritten=run.news.unwritten)
    assert told.unwritten == 25
    account = settled_account(folder, told)
    assert account is not None
    (one,) = account.topics
    in_file = len(published(folder))
    assert 0 < in_file < 25
    assert (one.messages, one.lost) == (in_file, {EvidenceLoss.DISK: 25 - in_file})
    assert account.unwritten == 0


# What a process that was killed left is repaired after the run.
