"""The recorder never stops its caller, and accounts for every message."""

from __future__ import annotations

import math
import os
import random
import re
import resource
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from io import BytesIO
from itertools import count, pairwise
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import Mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import SeekingReader, make_reader
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from msgspec.structs import replace
from rosbags.highlevel import AnyReader

from recorder.bag import MAX_NS, RawMessage, Topic, evidence_file_name
from recorder.bag_folder import FurtherFile
from recorder.errors import RecorderError
from recorder.mcap_file import McapFile
from recorder.mcap_writer import CHUNK_BYTES, McapWriter
from recorder.reader import Bag
from recorder.recorder_stats import DropReason, RecorderState
from recorder.recovery import recover
from recorder.writer import BagWriter
from tests.recorder.samples import (
    add_evidence,
    by_mcap,
    door_messages,
    door_topics,
    limited,
    strings,
    talk,
)
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


def test_messages_reach_the_disk_while_recording(tmp_path: Path) -> None:
    messages, file = strings(["a", "b", "c"]), tmp_path / "bag" / "bag_0.mcap"
    topics = [talk(), Topic("/other", talk().type, "")]
    with BagWriter(tmp_path / "bag", topics, {}, flush_period=0.02) as writer:
        before = writer.stats()
        assert writer.put_all(messages) == 3
        until(lambda: writer.stats().written == len(messages))
        stats = writer.stats()
        assert list(Bag(tmp_path / "bag").messages()) == messages
        assert (stats.queued_bytes, stats.file_bytes) == (0, file.stat().st_size)
        assert stats.seconds_since_sync is not None
        assert 0 <= stats.seconds_since_sync < 10
    assert (before.received, stats.received) == ({}, {"/talk": 3})  # each is of one instant
    summary = writer.close()
    assert summary.counts == writer.close().counts
    assert (summary.folder, summary.error, summary.dropped) == (tmp_path / "bag", None, {})
    assert summary.counts == {"/talk": 3, "/other": 0}
    assert (summary.start_ns, summary.end_ns) == (messages[0].receive_ns, messages[2].receive_ns)
    assert summary.file_bytes == file.stat().st_size


def test_a_kill_costs_0_2_s_at_most(tmp_path: Path) -> None:
    now, messages = 0.0, strings(["a", "b", "c"])
    with BagWriter(tmp_path / "bag", [talk()], {}, clock=lambda: now) as writer:
        for message in messages:
            now += 0.21
            assert writer.put_message(message)
            until(lambda last=message: last in Bag(tmp_path / "bag").messages())  # type: ignore[misc]


@pytest.fixture
def synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Names and sizes of files and folders when they were brought to the disk, in this order."""
    synced: list[tuple[str, int]] = []

    def noted(real: Callable[[int], None]) -> Callable[[int], None]:
        def sync(fd: int) -> None:
            real(fd)
            path = Path(f"/proc/self/fd/{fd}").readlink()
            if path.is_relative_to(tmp_path):  # not those of a thread that another test left
                name = re.sub(r"\.(\d+\.part|recovering)$", "", path.name)
                synced.append((name, os.fstat(fd).st_size))

        return sync

    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, name, noted(getattr(os, name)))
    return synced


def test_what_is_said_to_be_on_disk_has_been_synced(
    tmp_path: Path, synced: list[tuple[str, int]]
) -> None:
    folder, messages = tmp_path / "bag", strings(["x" * 900] * 100)
    recording, listing = folder / "bag_0.mcap", folder / "metadata.yaml"

    def check(*places: Path) -> None:
        assert {path.name for path in places} <= dict(synced).keys()
        assert {(path.name, path.stat().st_size) for path in folder.iterdir()} <= {
            *dict(synced).items()
        }
        synced.clear()

    now = 0.0
    with BagWriter(folder, [talk()], {}, clock=lambda: now) as writer:
        stats = writer.stats()
        assert stats.file_bytes == recording.stat().st_size
        assert stats.seconds_since_sync is not None
        check(folder, folder.parent)
        assert writer.put_all(messages) == len(messages)
        now = 0.21
        until(lambda: writer.stats().written == len(messages))
        assert synced[-1] == (recording.name, recording.stat().st_size)
    check(folder)
    os.truncate(recording, recording.stat().st_size - 100)
    listing.unlink()
    assert recover(folder).torn is not None
    (folder / "bag_0.mcap.torn").unlink()
    check(folder)
    add_evidence(folder, strings(["a"], "/camera"))
    synced.clear()
    listing.unlink()
    assert recover(folder).changed
    assert dict(synced)[listing.name] == listing.stat().st_size


def test_no_file_stays_open(tmp_path: Path) -> None:
    def here() -> list[Path]:
        fds = [fd for fd in Path("/proc/self/fd").iterdir() if fd.is_symlink()]
        return [fd for fd in fds if fd.readlink().is_relative_to(tmp_path)]

    folder, recording = tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"
    with BagWriter(folder, [talk()], {}) as writer:
        writer.put_all(strings(["a", "b"]))
        assert here()
    os.truncate(recording, recording.stat().st_size - 100)
    assert here() == []
    assert len(list(Bag(folder).messages())) == 2
    for path in (folder, recording):
        recover(path)
    recording.write_bytes(b"no recording")
    for refused in (BagWriter(folder, [talk()], {}).open, partial(recover, folder)):
        with pytest.raises(RecorderError):
            refused()
    assert here() == []


def test_a_disk_that_takes_little_at_a_time_gets_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages, real = strings(["x" * 900] * 100), os.write
    monkeypatch.setattr(os, "write", lambda fd, data: real(fd, data[:100]))
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        assert writer.put_all(messages) == len(messages)
    read = Bag(tmp_path / "bag")
    assert (list(read.messages()), read.complete) == (messages, True)


@pytest.mark.parametrize("there", [False, True])
def test_what_comes_before_the_file_is_there_is_written_to_it_or_counted(
    tmp_path: Path, *, there: bool
) -> None:
    folder, messages = tmp_path / "bag", strings(["a", "b"])
    writer = BagWriter(folder, [], {})
    if there:
        folder.mkdir()
    writer.start(niceness=19)
    assert writer.add_topic(talk()) or there
    writer.put_all(messages)
    stats = writer.close()
    if there:
        assert "exists already" in (stats.error or "")
        assert (stats.state, stats.drop_reasons) == (RecorderState.FAILED, {DropReason.FAILED: 2})
        assert not writer.add_topic(Topic("/late", "std_msgs/msg/Bool", ""))
    else:
        assert (stats.state, stats.written) == (RecorderState.FINISHED, 2)
        assert list(Bag(folder).messages()) == messages


def test_a_full_queue_drops_at_once_and_counts(tmp_path: Path, stuck: StuckDisk) -> None:
    messages = strings([f"{number:04}" for number in range(1000)])
    writer = BagWriter(tmp_path / "bag", [talk()], {}, queue_bytes=20_000, clock=stuck)
    writer.open()
    taken = [message for message in messages if writer.put_message(message)]
    stats, lost = writer.stats(), 1000 - len(taken)
    assert 0 < len(taken) < len(messages)
    assert (stats.received, stats.dropped) == ({"/talk": 1000}, {"/talk": lost})
    assert stats.drop_reasons == {DropReason.QUEUE_FULL: lost}
    assert stats.queued_bytes <= 20_000
    stuck.answers.set()
    assert writer.close().counts == {"/talk": len(taken)}
    assert list(Bag(tmp_path / "bag").messages()) == taken


def test_a_disk_that_does_not_answer_ends_neither_the_run_nor_the_close(
    tmp_path: Path, stuck: StuckDisk
) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {}, clock=stuck)
    writer.open()
    assert writer.put_message(strings(["a"])[0])
    summary = writer.close(timeout=0.05)
    assert "the disk did not answer within 0.05 s" in (summary.error or "")
    assert (summary.counts, summary.dropped) == ({"/talk": 0}, {"/talk": 1})
    assert (summary.state, summary.queued_bytes) == (RecorderState.FAILED, 0)


def test_a_bag_deleted_while_recording_is_reported(tmp_path: Path) -> None:
    with (  # noqa: PT012  the end of the block raises
        pytest.raises(RecorderError, match="the file was deleted"),
        BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02) as writer,
    ):
        assert not writer.put_message(replace(strings(["odd"])[0], receive_ns=-1))
        shutil.rmtree(tmp_path / "bag")
        until(lambda: writer.stats().state is RecorderState.FAILED)
        assert not writer.put_message(strings(["a"])[0])
        stats = writer.close()
        assert (stats.dropped, stats.file_bytes) == ({"/talk": 2}, 0)
        assert "the file was deleted" in (stats.error or "")


def test_a_folder_renamed_while_recording_stays_a_bag(tmp_path: Path) -> None:
    messages = strings(["a", "b"])
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        writer.put_message(messages[0])
        (tmp_path / "bag").rename(tmp_path / "moved")
        writer.put_message(messages[1])
    read = Bag(tmp_path / "moved")
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
    words = (
        r"not in the bag: /talk 3, /unknown 1 "
        r"\(topic not registered, type differs from the topic's, time outside 1970..2262\)"
    )
    with (  # noqa: PT012  the end of the block raises
        pytest.raises(RecorderError, match=words),
        BagWriter(tmp_path / "bag", [talk()], {}) as writer,
    ):
        for message, reason in odd.items():
            before = writer.stats().drop_reasons.get(reason, 0)
            assert not writer.put_message(message)
            assert writer.stats().drop_reasons[reason] == before + 1
        assert writer.put_message(good)
        assert writer.stats().dropped == {"/unknown": 1, "/talk": 3}
    assert list(Bag(tmp_path / "bag").messages()) == [good]


def test_it_records_from_when_the_bag_is_on_disk_until_it_is_closed(tmp_path: Path) -> None:
    record, early = {"madrob_run": {"n": "1"}}, strings(["too early or late"])[0]
    writer, states = BagWriter(tmp_path / "bag", [talk()], record), list[RecorderState]()
    for act in (lambda: None, writer.open, writer.close):
        act()
        states.append(writer.stats().state)
        if act == writer.open:
            assert {path.name for path in (tmp_path / "bag").iterdir()} == {
                *("bag_0.mcap", "metadata.yaml")
            }
            unfinished = Bag(tmp_path / "bag")
            assert (unfinished.records, unfinished.complete) == (record, False)
        else:
            assert not writer.put_message(early)
            assert not writer.add_topic(talk())
            assert not writer.add_record("note", {})
    assert states == [RecorderState.CLOSED, RecorderState.RECORDING, RecorderState.FINISHED]
    assert writer.stats().drop_reasons == {DropReason.NOT_RECORDING: 2}
    with pytest.raises(RecorderError, match="make a new recorder"):
        writer.open()


@pytest.mark.parametrize(
    ("late", "recorded"),
    [
        (Topic("/late", talk().type, talk().definition), True),
        (talk(), True),
        (Topic("/talk", "std_msgs/msg/Bool", "bool data\n"), False),
        (Topic("late", "std_msgs/msg/Bool", "bool data\n"), False),
        (Topic("/late", "std_msgs/Bool", "bool data\n"), False),
        (Topic("/late", "std_msgs/msg/Bool", "\ud800"), False),
    ],
)
def test_a_late_topic_is_recorded_and_never_ends_the_recording(
    tmp_path: Path, late: Topic, *, recorded: bool
) -> None:
    messages = [*strings(["a"]), *(strings(["late"], name=late.name) if recorded else [])]
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        assert writer.put_message(messages[0])
        assert writer.add_topic(late) is recorded
        assert all(map(writer.put_message, messages[1:]))
    read = Bag(tmp_path / "bag")
    assert (list(read.messages()), read.complete) == (messages, True)
    names = dict.fromkeys(["/talk", late.name if recorded else "/talk"])
    assert [topic.name for topic in read.topics()] == list(names)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [c.topic for c, _, _ in reader.messages()] == [m.topic for m in messages]


ODD = [talk(), Topic("/talk", "std_msgs/msg/Bool", "")]


@pytest.mark.parametrize(
    ("folder", "topics", "words"),
    [
        ("there", [talk()], r"there exists already; move it away or record under"),
        ("link", [talk()], "exists already"),  # none is followed
        ("missing/bag", [talk()], r"cannot record to .*; choose a folder"),
        ("there/metadata.yaml/bag", [talk()], r"cannot record to .*; choose a folder"),
        ("bag", ODD, "/talk is both"),
        ("bag", [Topic("talk", "std_msgs/msg/Bool", "")], "no full topic name"),
        ("bag", [Topic("/talk", "Bool", "")], "no full type name"),
    ],
)
def test_what_cannot_be_recorded_is_refused_in_one_line_before_anything_is_made(
    tmp_path: Path, folder: str, topics: list[Topic], words: str
) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "metadata.yaml").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with pytest.raises(RecorderError, match=words) as caught:
        BagWriter(tmp_path / folder, topics, {}).open()
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["link", "metadata.yaml", "there"]
    assert (tmp_path / "there" / "metadata.yaml").read_text() == "precious"


def test_a_recording_without_a_thread_to_write_it_is_refused_and_can_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {})
    with monkeypatch.context() as short:
        refuse = Mock(side_effect=RuntimeError("can't start new thread"))
        short.setattr(threading.Thread, "start", refuse)
        with pytest.raises(RecorderError, match="can't start new thread; end other programs"):
            writer.open()
    assert list(tmp_path.iterdir()) == []
    assert writer.put_message(strings(["a"])[0]) is False
    writer.open()
    assert writer.close().error is None


def test_a_recording_that_wants_memory_says_that_it_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02)
    writer.open()
    with monkeypatch.context() as short:
        short.setattr(McapFile, "add_message", Mock(side_effect=MemoryError))
        short.setattr(writer, "_report", Mock(side_effect=MemoryError))  # nor to say how far
        writer.put_message(strings(["a"])[0])
        until(lambda: writer.stats().state is RecorderState.FAILED)
    assert "MemoryError" in (writer.close().error or "")


@pytest.mark.parametrize(
    ("what", "most", "words"),
    [
        (resource.RLIMIT_NOFILE, 3, r"Too many open files; raise `ulimit -n`$"),
        (resource.RLIMIT_FSIZE, 100, "^cannot record to .*: File too la"),
    ],
    ids=["no file handles", "a full disk"],
)
def test_a_recording_that_cannot_begin_is_refused_with_the_remedy_and_leaves_nothing(
    tmp_path: Path, what: int, most: int, words: str
) -> None:
    with limited(what, most), pytest.raises(RecorderError, match=words):
        BagWriter(tmp_path / "bag", [talk()], {"madrob_run": {"n": "x" * 100}}).open()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_reported_and_costs_only_what_it_did_not_take(tmp_path: Path) -> None:
    record, sent = {"madrob_run": {"n": "1"}}, count(1)
    writer = BagWriter(tmp_path / "bag", [CAMERA], record, flush_period=0.02)
    with limited(resource.RLIMIT_FSIZE, 2_000_000):
        writer.open()

        def failed() -> bool:
            number = next(sent)
            data = number.to_bytes(4) + os.urandom(100_000)
            writer.put_message(RawMessage(CAMERA.name, CAMERA.type, data, number, number))
            return writer.stats().state is RecorderState.FAILED

        until(failed)
        summary = writer.close()
    assert "File too large; what was written stays readable" in (summary.error or "")
    assert "\n" not in (summary.error or "")
    saved, bag = summary.counts[CAMERA.name], Bag(tmp_path / "bag")
    lost = summary.dropped[CAMERA.name]
    assert (saved + lost, summary.queued_bytes) == (next(sent) - 1, 0)
    numbers = [int.from_bytes(message.data[:4]) for message in bag.messages()]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len(numbers) >= saved > 0
    assert (bag.complete, bag.records) == (False, record)


def evidence(folder: Path, limit: int = 2**62, number: int = 0) -> BagWriter:
    """A writer of a camera whose file may have so many bytes."""

    def refusal(size: int, coming: int) -> str | None:
        return "the budget is used up" if size + coming > limit else None

    return BagWriter(FurtherFile(folder, number, refusal), [CAMERA], {})


CAMERA = Topic("/camera", "sensor_msgs/msg/Image", "uint8[] data\n")


def frames(count: int, size: int = 500_000) -> list[RawMessage]:
    data = random.Random(1).randbytes(size + count)
    return [
        RawMessage(CAMERA.name, CAMERA.type, data[number : number + size], number, number)
        for number in range(1, count + 1)
    ]


def test_evidence_is_a_further_file_that_the_bag_lists_when_it_ends(tmp_path: Path) -> None:
    scored, seen = strings(["a", "b"]), frames(40)
    with BagWriter(tmp_path / "bag", [talk()], {}) as writer:
        with evidence(tmp_path / "bag") as camera:
            assert all(map(camera.put_message, seen[:20]))
        assert all(map(writer.put_message, scored))
        with evidence(tmp_path / "bag", number=1) as camera:
            assert all(map(camera.put_message, seen[20:]))
    assert list(Bag(tmp_path / "bag").messages()) == scored
    assert list(Bag(tmp_path / "bag", evidence=True).messages()) == seen
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == 42


def test_evidence_without_room_ends_in_a_whole_file_and_counts_what_it_has_not(
    tmp_path: Path,
) -> None:
    sent = frames(20)
    BagWriter(tmp_path / "bag", [talk()], {}).__enter__().close()
    with (  # noqa: PT012  the end of the block raises
        pytest.raises(RecorderError, match="the budget is used up"),
        evidence(tmp_path / "bag", limit=4_100_000) as camera,
    ):
        camera.put_all(sent)
        until(lambda: camera.stats().error is not None)
        assert not camera.put_message(sent[0])
    stats, bag = camera.close(), Bag(tmp_path / "bag", evidence=True)
    assert stats.error == "the budget is used up"
    assert 3_000_000 < stats.file_bytes < 4_100_000
    kept = list(bag.messages())
    lost = 21 - len(kept)
    assert (kept, bag.complete) == (sent[: len(kept)], True)
    assert (stats.counts, stats.dropped) == ({CAMERA.name: len(kept)}, {CAMERA.name: lost})
    assert (stats.drop_reasons, stats.queued_bytes) == ({DropReason.FAILED: lost}, 0)


def test_large_messages_of_evidence_take_no_more_memory_than_the_queue_may(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag", [talk()], {}).__enter__().close()
    go_on = threading.Event()

    def wait(_size: int, _coming: int) -> None:
        go_on.wait()

    place = FurtherFile(tmp_path / "bag", 0, wait)
    with (  # noqa: PT012  the end of the block raises
        pytest.raises(RecorderError, match=r"not in the bag: /camera 3 \(queue full\)"),
        BagWriter(place, [CAMERA], {}, queue_bytes=3_000_000) as camera,
    ):
        assert [camera.put_message(message) for message in frames(8)] == [True] * 5 + [False] * 3
        assert camera.stats().queued_bytes <= 3_000_000
        go_on.set()
    assert camera.stats().drop_reasons == {DropReason.QUEUE_FULL: 3}
    assert len(list(Bag(tmp_path / "bag", evidence=True).messages())) == 5


def test_a_sync_of_what_is_scored_never_waits_for_much_evidence(
    tmp_path: Path, synced: list[tuple[str, int]]
) -> None:
    BagWriter(tmp_path / "bag", [talk()], {}).__enter__().close()
    synced.clear()
    place = FurtherFile(tmp_path / "bag", 0, lambda _size, _coming: None)
    with BagWriter(place, [CAMERA], {}, flush_period=1e6) as camera:
        assert all(map(camera.put_message, frames(40)))
    sizes = [size for name, size in synced if name == evidence_file_name("bag", 0)]
    assert sizes[-1] > 9_000_000  # each frame is much like the one before it
    assert max(after - before for before, after in pairwise(sizes)) < 6_000_000


def test_evidence_that_cannot_be_recorded_leaves_nothing(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag", [talk()], {}).__enter__().close()
    there = tmp_path / "bag" / evidence_file_name("bag", 0)
    there.write_bytes(b"precious")
    with pytest.raises(RecorderError, match=r"_evidence_0.mcap exists already; move it away"):
        evidence(tmp_path / "bag").open()
    with pytest.raises(RecorderError, match="No such file"):
        evidence(tmp_path / "none").open()
    assert there.read_bytes() == b"precious"
    assert len(list((tmp_path / "bag").iterdir())) == 3


NOISE = random.Random(0).randbytes(4 * CHUNK_BYTES)
SMALL = 100


class Sample(NamedTuple):
    """A message; `flush` says whether the chunk ends behind it."""

    channel: int
    time: int
    data: bytes
    flush: bool = False


def started(writer: Any) -> Any:  # noqa: ANN401 - ours or the library's
    """One of the two writers, with three channels."""
    writer.start("ros2", "test")
    number = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    for place in range(3):
        writer.register_channel(f"/topic_{place}", "cdr", number, {"offered_qos_profiles": ""})
    return writer


def filled(make: Callable[[BytesIO], Any], samples: Sequence[Sample]) -> bytes:
    """What such a writer makes of samples."""
    file, counts = BytesIO(), Counter[int]()
    writer = started(make(file))
    for channel, at, data, flush in samples:
        counts[channel] += 1
        writer.add_message(channel, at, data, at + 1, counts[channel])
        if flush:
            writer.flush()
    writer.flush()
    writer.add_metadata("setup", {"team": "Türen"})
    writer.finish()
    return file.getvalue()


def ours(file: BytesIO) -> McapWriter:
    return McapWriter(file.write)


def read(file: bytes) -> tuple[object, ...]:
    """What summary and chunk indexes tell, and all messages by time, found by their indexes."""
    reader = SeekingReader(BytesIO(file), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    outlines = [_outline(file, index) for index in summary.chunk_indexes]
    names = [index.name for index in summary.metadata_indexes]
    told = summary.statistics, summary.schemas, summary.channels, outlines, names
    return *told, list(reader.iter_messages()), _order(file)


def _outline(file: bytes, index: ChunkIndex) -> tuple[object, ...]:
    """What an index tells of a chunk, with the indexes of its messages."""
    entries = {}
    for channel, at in index.message_index_offsets.items():
        size = 9 + int.from_bytes(file[at + 1 : at + 9], "little")
        entries[channel] = file[at : at + size]
    return (
        index.message_start_time,
        index.message_end_time,
        index.uncompressed_size,
        index.message_index_length,
        entries,
    )


def _order(file: bytes) -> list[str]:
    """The kinds of the records of the data, and the last one."""
    stream = StreamReader(BytesIO(file), validate_crcs=True)
    names = [type(record).__name__ for record in stream.records]
    return [*names[: names.index("DataEnd") + 1], names[-1]]


samples_strategy = st.lists(
    st.builds(
        Sample,
        st.integers(1, 3),
        st.integers(0, 2**63 - 2),
        st.one_of(
            st.binary(max_size=SMALL), st.just(NOISE[:CHUNK_BYTES]), st.just(bytes(CHUNK_BYTES))
        ),
        st.booleans(),
    ),
    max_size=6,
)


@given(samples_strategy)
def test_a_file_reads_like_the_one_that_the_mcap_library_writes(samples: list[Sample]) -> None:
    library = filled(partial(Writer, chunk_size=CHUNK_BYTES), samples)
    for got, wanted in zip(read(filled(ours, samples)), read(library), strict=True):
        assert got == wanted


def noise(count: int, size: int, head: bytes = b"") -> list[Sample]:
    return [Sample(1, n, head + NOISE[n * size : (n + 1) * size]) for n in range(count)]


POSES = [Sample(2, n, bytes(SMALL)) for n in range(5_000)]


@pytest.mark.parametrize(
    ("samples", "compression", "largest"),
    [
        (noise(8, 200_000), "", 8 * 200_000 + 5_000),  # pictures, stored as they are
        (noise(8, 200_000, bytes(2_000)), "", 8 * 202_000 + 5_000),
        (noise(20, 2_000), "", 60_000),
        ([*POSES[:1_000], *noise(1, 100_000), *POSES[1_000:]], "zstd", 250_000),  # half: indexes
        (POSES[:10], "zstd", 3_000),
    ],
    ids=["pictures", "pictures with alike heads", "few", "a picture among poses", "poses"],
)
def test_what_can_be_made_smaller_is(samples: list[Sample], compression: str, largest: int) -> None:
    file = filled(ours, samples)
    indexes = by_mcap(BytesIO(file))[0].chunk_indexes
    assert {index.compression for index in indexes} == {compression}
    assert len(file) < largest


def test_what_is_pending_is_about_what_finishing_takes() -> None:
    file = BytesIO()
    writer = started(ours(file))
    for number in range(1000):
        writer.add_message(1, number, NOISE[20 * number :][:20], number)
    begin, pending = file.tell(), writer.pending
    writer.finish()
    assert file.tell() - begin < pending < 2 * (file.tell() - begin)


def test_a_disk_that_refuses_is_told_and_what_was_written_counts() -> None:
    room = 3 * CHUNK_BYTES

    def write(data: bytes) -> None:
        nonlocal room
        room -= len(data)
        if room < 0:
            raise OSError(28, "No space left on device")

    writer = started(McapWriter(write))
    for number in range(16):  # two chunks of eight
        writer.add_message(1, number, NOISE[number * 100_000 :][:100_000], number)
    with pytest.raises(OSError, match="No space"):
        writer.add_message(1, 16, NOISE, 16)
    assert writer.statistics.message_count == writer.statistics.channel_message_counts[1] == 16
    assert writer.statistics.message_end_time == 15


def test_mcap_ros2_decodes_it_by_the_schemas_of_the_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run", door_topics(), {}) as writer:
        writer.put_all(recorded := door_messages(rounds=50))
    with (tmp_path / "run" / "run_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [(c.topic, m.data, value) for _, c, m, value in reader.iter_decoded_messages()]
    in_time = sorted(recorded, key=lambda message: message.receive_ns)
    assert [(name, data) for name, data, _ in decoded] == [(m.topic, m.data) for m in in_time]
    last: dict[str, Any] = {name: value for name, _, value in decoded}
    pose = last["/madrob/referee/start_pose"]
    assert (
        list(last["/madrob/door/angle"].position),
        last["/madrob/handle/force"].wrench.force.x,
        list(last["/madrob/passage/cw_left"].ranges)[:3],
        last["/madrob/door/locked"].data,
        last["/madrob/referee/event"].data,
        (pose.pose.position.y, pose.header.frame_id),
    ) == ([0.49], 49.0, [1.0, 2.0, math.inf], False, "event 49", (49.0, "madrob_door"))


TIMES = st.integers(min_value=0, max_value=MAX_NS - 1)
TOPICS = tuple(Topic(f"/t{number}", "test_msgs/msg/Blob", "uint8[] data\n") for number in range(3))
MESSAGES = st.builds(
    RawMessage,
    topic=st.sampled_from([topic.name for topic in TOPICS]),
    type=st.just("test_msgs/msg/Blob"),
    data=st.binary(max_size=300),
    publish_ns=TIMES,
    receive_ns=TIMES,
)


@settings(max_examples=25)
@given(st.lists(MESSAGES, max_size=40), st.integers(min_value=512, max_value=20_000))
def test_bytes_and_times_survive_in_order_and_only_what_is_too_large_is_dropped(
    messages: list[RawMessage], queue_bytes: int
) -> None:
    # as they are received: a machine that is slow flushes between any two of them
    messages = sorted(messages, key=lambda message: message.receive_ns)
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "bag"
        writer = BagWriter(folder, TOPICS, {}, queue_bytes=queue_bytes, block_when_full=True)
        writer.open()
        kept = [message for message in messages if writer.put_message(message)]
        summary, read = writer.close(), Bag(folder)
        assert (list(read.messages()), read.complete, read.topics()) == (kept, True, TOPICS)
        dropped = len(messages) - len(kept)
        assert (sum(summary.counts.values()), sum(summary.dropped.values())) == (len(kept), dropped)
        reasons = {DropReason.TOO_LARGE: dropped} if dropped else {}
        assert writer.stats().drop_reasons == reasons
        assert all(m in kept or len(m.data) + 256 > queue_bytes for m in messages)
        times = [message.receive_ns for message in kept]
        span = (min(times), max(times)) if times else (None, None)
        assert (summary.start_ns, summary.end_ns) == span
        with AnyReader([folder]) as reader:
            assert (reader.message_count, len(reader.connections)) == (len(kept), len(TOPICS))


def test_a_record_added_while_recording_is_kept_and_the_last_of_a_name_counts(
    tmp_path: Path,
) -> None:
    with BagWriter(tmp_path / "bag", [talk()], {"madrob_run": {"n": "1"}}) as writer:
        writer.put_message(strings(["a"])[0])
        assert writer.add_record("madrob_run", {"n": "2"})
        assert writer.add_record("note", {"text": "a stray byte \udcff, as a terminal may send"})
    read = Bag(tmp_path / "bag")
    note = {"text": "a stray byte \\udcff, as a terminal may send"}
    assert read.complete
    assert read.records | {"madrob_run": {"n": "2"}, "note": note} == read.records
