"""The recorder never stops its caller, and accounts for every message."""

from __future__ import annotations

import resource
import shutil
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import NoReturn

import pytest
from msgspec.structs import replace

from recorder.bag import MAX_NS, Topic
from recorder.errors import RecorderError
from recorder.mcap_file import McapFile
from recorder.reader import read_bag
from recorder.stats import DropReason, RecorderState
from recorder.writer import BagWriter
from tests.recorder.samples import strings, talk
from tests.watching import until


class StuckDisk:
    """A clock that holds up the recorder's thread, as a disk that does not answer would."""

    def __init__(self) -> None:
        self.answers = threading.Event()

    def __call__(self) -> float:
        if threading.current_thread().name == "recorder":
            self.answers.wait()
        return time.monotonic()


@pytest.fixture
def stuck() -> Iterator[StuckDisk]:
    disk = StuckDisk()
    yield disk
    disk.answers.set()


def wait_for(writer: BagWriter, state: RecorderState) -> None:
    until(lambda: writer.stats().state is state)


def test_recording_starts_only_when_the_bag_is_on_disk(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {"madrob_run": {"n": "1"}})
    assert writer.stats().state is RecorderState.CLOSED
    assert not writer.put(strings(["too early"])[0])
    writer.open()
    made = sorted(path.name for path in (tmp_path / "bag").iterdir())
    assert made == ["bag_0.mcap", "metadata.yaml"]
    unfinished = read_bag(tmp_path / "bag")
    assert unfinished.records == {"madrob_run": {"n": "1"}}
    assert not unfinished.complete
    assert writer.stats().state is RecorderState.RECORDING
    writer.close()
    assert writer.stats().state is RecorderState.FINISHED


def test_messages_reach_the_disk_while_recording(tmp_path: Path) -> None:
    messages = strings(["a", "b", "c"])
    with BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02) as writer:
        for message in messages:
            writer.put(message)
        until(lambda: writer.stats().written == len(messages))
        stats = writer.stats()
        assert list(read_bag(tmp_path / "bag").messages()) == messages
        assert stats.queued_bytes == 0
        assert stats.file_bytes == (tmp_path / "bag" / "bag_0.mcap").stat().st_size
        assert stats.seconds_since_sync is not None
        assert 0 <= stats.seconds_since_sync < 10


def test_the_summary_tells_what_the_bag_holds(tmp_path: Path) -> None:
    messages = strings(["a", "b", "c"])
    writer = BagWriter(tmp_path / "bag", [talk(), Topic("/other", talk().type, "")], {})
    writer.open()
    for message in messages:
        writer.put(message)
    summary = writer.close()
    assert summary.folder == tmp_path / "bag"
    assert summary.counts == {"/talk": 3, "/other": 0}
    assert summary.dropped == {}
    assert summary.start_ns == messages[0].receive_ns
    assert summary.end_ns == messages[2].receive_ns
    assert summary.file_bytes == (tmp_path / "bag" / "bag_0.mcap").stat().st_size
    assert summary.error is None
    assert writer.close() == summary


def test_a_full_queue_drops_at_once_and_counts(tmp_path: Path, stuck: StuckDisk) -> None:
    messages = strings([f"{number:04}" for number in range(1000)])
    writer = BagWriter(tmp_path / "bag", [talk()], {}, queue_bytes=20_000, clock=stuck)
    writer.open()
    taken = [message for message in messages if writer.put(message)]
    stats = writer.stats()
    assert 0 < len(taken) < len(messages)
    assert stats.received == {"/talk": 1000}
    assert stats.dropped == {"/talk": 1000 - len(taken)}
    assert stats.drop_reasons == {DropReason.QUEUE_FULL: 1000 - len(taken)}
    assert stats.queued_bytes <= 20_000
    stuck.answers.set()
    assert writer.close().counts == {"/talk": len(taken)}
    assert list(read_bag(tmp_path / "bag").messages()) == taken


def test_with_back_pressure_nothing_is_dropped(tmp_path: Path) -> None:
    messages = strings([f"{number:04}" * 100 for number in range(2000)])
    writer = BagWriter(tmp_path / "bag", [talk()], {}, queue_bytes=10_000, block_when_full=True)
    writer.open()
    assert all(writer.put(message) for message in messages)
    assert writer.close().dropped == {}
    assert list(read_bag(tmp_path / "bag").messages()) == messages


def test_messages_of_several_threads_keep_the_order_of_each(tmp_path: Path) -> None:
    topics = [Topic(f"/talk{number}", talk().type, talk().definition) for number in range(4)]
    sent = {
        topic.name: strings([str(number) for number in range(500)], topic.name) for topic in topics
    }
    with BagWriter(tmp_path / "bag", topics, {}) as writer, ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda messages: [writer.put(m) for m in messages], sent.values()))
    read = list(read_bag(tmp_path / "bag").messages())
    assert len(read) == 2000
    for name, messages in sent.items():
        assert [message for message in read if message.topic == name] == messages


def test_a_message_larger_than_the_queue_is_dropped_and_never_waited_for(tmp_path: Path) -> None:
    with BagWriter(
        tmp_path / "bag", [talk()], {}, queue_bytes=1000, block_when_full=True
    ) as writer:
        assert not writer.put(strings(["x" * 1000])[0])
        assert writer.stats().drop_reasons == {DropReason.TOO_LARGE: 1}


def test_a_disk_that_does_not_answer_ends_neither_the_run_nor_the_close(
    tmp_path: Path, stuck: StuckDisk
) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {}, clock=stuck)
    writer.open()
    assert writer.put(strings(["a"])[0])
    summary = writer.close(timeout=0.05)
    assert summary.error is not None
    assert "the disk did not answer within 0.05 s" in summary.error
    assert summary.counts == {"/talk": 0}
    assert summary.dropped == {"/talk": 1}
    assert writer.stats().state is RecorderState.FAILED
    assert writer.stats().queued_bytes == 0


def test_a_bag_deleted_while_recording_is_reported(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02) as writer:
        shutil.rmtree(tmp_path / "bag")
        wait_for(writer, RecorderState.FAILED)
        assert not writer.put(strings(["a"])[0])
        error = writer.stats().error
        assert error is not None
        assert "the file was deleted" in error
        assert writer.close().dropped == {"/talk": 1}


def test_a_folder_renamed_while_recording_stays_a_bag(tmp_path: Path) -> None:
    messages = strings(["a", "b"])
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        writer.put(messages[0])
        (tmp_path / "bag").rename(tmp_path / "moved")
        writer.put(messages[1])
    read = read_bag(tmp_path / "moved")
    assert list(read.messages()) == messages
    assert read.complete


def test_what_does_not_fit_the_bag_is_counted_with_its_reason(tmp_path: Path) -> None:
    good = strings(["good"])[0]
    odd = {
        replace(good, topic="/unknown"): DropReason.UNKNOWN_TOPIC,
        replace(good, type="std_msgs/msg/Bool"): DropReason.OTHER_TYPE,
        replace(good, receive_ns=-1): DropReason.BAD_TIME,
        replace(good, publish_ns=MAX_NS): DropReason.BAD_TIME,
    }
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        for message, reason in odd.items():
            before = writer.stats().drop_reasons.get(reason, 0)
            assert not writer.put(message)
            assert writer.stats().drop_reasons[reason] == before + 1
        assert writer.put(good)
        assert writer.stats().dropped == {"/unknown": 1, "/talk": 3}
    assert list(read_bag(tmp_path / "bag").messages()) == [good]


def test_after_the_close_everything_is_refused_and_counted(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {})
    writer.open()
    writer.close()
    assert not writer.put(strings(["late"])[0])
    assert not writer.add_topic(talk())
    assert not writer.add_record("note", {})
    assert writer.stats().drop_reasons == {DropReason.NOT_RECORDING: 1}
    with pytest.raises(RecorderError, match="make a new recorder"):
        writer.open()


@pytest.mark.parametrize(
    ("late", "recorded"),
    [
        (Topic("/late", "std_msgs/msg/Bool", "bool data\n"), True),
        (talk(), True),
        (Topic("/talk", "std_msgs/msg/Bool", "bool data\n"), False),
        (Topic("late", "std_msgs/msg/Bool", "bool data\n"), False),
        (Topic("/late", "std_msgs/Bool", "bool data\n"), False),
        (Topic("/late", "std_msgs/msg/Bool", "\ud800"), False),
    ],
)
def test_a_late_topic_never_ends_the_recording(
    tmp_path: Path, late: Topic, *, recorded: bool
) -> None:
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        assert writer.add_topic(late) is recorded
        assert writer.put(strings(["a"])[0])
    assert read_bag(tmp_path / "bag").complete


def test_an_existing_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("precious")
    with pytest.raises(RecorderError, match=r"bag exists already; move it away or record under"):
        BagWriter(tmp_path / "bag", [talk()], {}).open()
    assert (tmp_path / "bag" / "metadata.yaml").read_text() == "precious"


def test_no_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "bag").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RecorderError, match="exists already"):
        BagWriter(tmp_path / "bag", [talk()], {}).open()
    assert not any((tmp_path / "elsewhere").iterdir())


def test_a_folder_that_cannot_be_made_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "missing" / "bag", tmp_path / "file" / "bag"):
        with pytest.raises(RecorderError, match=r"cannot record to .*; choose a folder") as caught:
            BagWriter(folder, [talk()], {}).open()
        assert "\n" not in str(caught.value)


def test_a_recording_without_a_thread_to_write_it_is_refused_and_can_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: threading.Thread) -> NoReturn:
        raise RuntimeError("can't start new thread")

    writer = BagWriter(tmp_path / "bag", [talk()], {})
    with monkeypatch.context() as short:
        short.setattr(threading.Thread, "start", refuse)
        with pytest.raises(RecorderError, match="can't start new thread; end other programs"):
            writer.open()
    assert list(tmp_path.iterdir()) == []
    assert writer.put(strings(["a"])[0]) is False
    writer.open()
    assert writer.close().error is None


def test_a_recording_that_wants_memory_says_that_it_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> NoReturn:
        raise MemoryError

    writer = BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02)
    writer.open()
    with monkeypatch.context() as short:
        short.setattr(McapFile, "add_message", fail)
        short.setattr(writer, "_report", fail)  # nor is there any to say how far it came
        writer.put(strings(["a"])[0])
        until(lambda: writer.stats().state is RecorderState.FAILED)
    assert "MemoryError" in (writer.close().error or "")


def test_without_file_handles_a_recording_is_refused_with_that_remedy(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    try:
        with pytest.raises(RecorderError, match=r"Too many open files; raise `ulimit -n`$"):
            BagWriter(tmp_path / "bag", [talk()], {}).open()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("topics", "problem"),
    [
        ([talk(), Topic("/talk", "std_msgs/msg/Bool", "")], "/talk is both"),
        ([Topic("talk", "std_msgs/msg/Bool", "")], "no full topic name"),
        ([Topic("/talk", "Bool", "")], "no full type name"),
    ],
)
def test_topics_that_no_bag_can_hold_are_refused_before_anything_is_made(
    tmp_path: Path, topics: list[Topic], problem: str
) -> None:
    with pytest.raises(RecorderError, match=problem):
        BagWriter(tmp_path / "bag", topics, {}).open()
    assert not (tmp_path / "bag").exists()


def test_stats_are_a_picture_of_one_instant(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        before = writer.stats()
        writer.put(strings(["a"])[0])
        assert before.received == {}
        with pytest.raises(FrozenInstanceError):
            before.written = 1  # type: ignore[misc]
