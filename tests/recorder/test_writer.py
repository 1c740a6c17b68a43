"""The recorder never stops its caller, and accounts for every message."""

from __future__ import annotations

import errno
import math
import os
import resource
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from msgspec.structs import replace
from rosbags.highlevel import AnyReader

from recorder import Bag, BagWriter, RawMessage, RecorderError, Topic, recover
from recorder.bag import MAX_NS, BagInformation
from recorder.writer import RecorderState
from tests.recorder.samples import by_mcap, door_messages, door_topics, limited, strings, talk
from tests.watching import until

BLOB = Topic("/blob", "test_msgs/msg/Blob", "uint8[] data\n")


def blob(number: int, size: int = 100_000) -> RawMessage:
    """A message that cannot be compressed."""
    return RawMessage(BLOB.name, BLOB.type, os.urandom(size), number, number)


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
    with BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02) as writer:
        assert writer.put_all(messages) == 3
        until(lambda: writer.stats().recorded == {"/talk": 3})
        stats = writer.stats()
        assert list(Bag(tmp_path / "bag").messages()) == messages
    assert (stats.memory_bytes, stats.file_bytes < file.stat().st_size) == (0, True)
    assert stats.seconds_since_sync is not None
    stats = writer.close()
    assert (stats.received, stats.recorded, stats.lost) == ({"/talk": 3}, {"/talk": 3}, {})
    assert (stats.state, stats.error) == (RecorderState.FINISHED, None)
    assert stats.file_bytes == file.stat().st_size


def test_a_kill_costs_0_2_s_at_most(tmp_path: Path) -> None:
    now, messages = 0.0, strings(["a", "b", "c"])
    with BagWriter(tmp_path / "bag", [talk()], {}, clock=lambda: now) as writer:
        for message in messages:
            now += 0.21
            assert writer.put_message(message)
            until(lambda last=message: last in Bag(tmp_path / "bag").messages())  # type: ignore[misc]


def test_no_file_stays_open(tmp_path: Path) -> None:
    def here() -> list[Path]:
        fds = [fd for fd in Path("/proc/self/fd").iterdir() if fd.is_symlink()]
        return [fd for fd in fds if fd.readlink().is_relative_to(tmp_path)]

    folder, recording = tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"
    with BagWriter(folder, [talk()], {}) as writer:
        writer.put_all(strings(["a", "b"]))
        assert here()
    os.truncate(recording, recording.stat().st_size - 100)
    assert len(list(Bag(folder).messages())) == 2
    for path in (folder, recording):
        recover(path)
    recording.write_bytes(b"no recording")
    for refused in (BagWriter(folder, [talk()], {}).open, partial(recover, folder)):
        with pytest.raises(RecorderError):
            refused()
    assert here() == []


def test_nothing_is_lost_while_a_full_disk_gets_room_in_time(tmp_path: Path) -> None:
    sent = [blob(number) for number in range(50)]
    with BagWriter(tmp_path / "bag", [BLOB], {}, flush_period=0.02) as writer:
        with limited(resource.RLIMIT_FSIZE, 2_050_000):  # in the middle of a message
            writer.put_all(sent[:30])
            until(lambda: writer.stats().error is not None)
            writer.put_all(sent[30:])
            words = writer.stats().error
        until(lambda: writer.stats().error is None)
    assert words is not None
    assert words.endswith(
        "File too large; what comes waits in memory: make room, or see to the disk"
    )
    assert (writer.stats().recorded, writer.stats().lost) == ({BLOB.name: 50}, {})
    read = Bag(tmp_path / "bag")
    assert (list(read.messages()), read.complete) == (sent, True)


def test_what_a_failed_sync_may_have_lost_is_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel forgets what it could not write, and says so only once."""
    messages, real = strings([os.urandom(1000).hex(), "b"]), os.fdatasync
    failures: list[int] = []

    def forget(fd: int) -> None:
        size = os.fstat(fd).st_size
        if not failures and size > 1000:
            failures.append(size)
            os.pwrite(fd, bytes(100), size - 100)
            raise OSError(errno.EIO, "Input/output error")
        real(fd)

    monkeypatch.setattr(os, "fdatasync", forget)
    with BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02) as writer:
        writer.put_all(messages)
        until(lambda: writer.stats().recorded == {"/talk": 2})
    assert failures
    read = Bag(tmp_path / "bag")
    assert (list(read.messages()), read.complete) == (messages, True)


def test_who_waits_for_room_waits_for_no_sync(tmp_path: Path) -> None:
    sent = [blob(number) for number in range(50)]
    options: dict[str, Any] = {"memory_bytes": 1_000_000, "flush_period": 1e6}
    with BagWriter(tmp_path / "bag", [BLOB], {}, block_when_full=True, **options) as writer:
        assert writer.put_all(sent) == 50
    assert list(Bag(tmp_path / "bag").messages()) == sent


def test_a_disk_that_stays_full_costs_what_it_did_not_take(tmp_path: Path) -> None:
    record, sent = {"madrob_run": {"n": "1"}}, [blob(number) for number in range(50)]
    writer = BagWriter(tmp_path / "bag", [BLOB], record, memory_bytes=2_500_000)
    with limited(resource.RLIMIT_FSIZE, 1_000_000):
        writer.open()
        for message in sent:
            writer.put_message(message)
        stats = writer.close()
    assert "File too large; what was written stays readable" in (stats.error or "")
    assert (stats.state, stats.memory_bytes) == (RecorderState.FAILED, 0)
    assert stats.recorded.get(BLOB.name, 0) + stats.lost[BLOB.name] == len(sent)
    bag = Bag(tmp_path / "bag")
    kept = list(bag.messages())
    assert kept == sent[: len(kept)]
    assert len(kept) >= stats.recorded.get(BLOB.name, 0)
    assert (bag.complete, bag.records) == (False, record)


def test_a_full_queue_drops_at_once_and_counts(tmp_path: Path, stuck: StuckDisk) -> None:
    messages = strings([f"{number:04}" for number in range(1000)])
    writer = BagWriter(tmp_path / "bag", [talk()], {}, memory_bytes=20_000, clock=stuck)
    writer.open()
    taken = [message for message in messages if writer.put_message(message)]
    stats = writer.stats()
    assert 0 < len(taken) < len(messages)
    assert (stats.received, stats.lost) == ({"/talk": 1000}, {"/talk": 1000 - len(taken)})
    assert stats.memory_bytes <= 20_000
    stuck.answers.set()
    assert writer.close().recorded == {"/talk": len(taken)}
    assert list(Bag(tmp_path / "bag").messages()) == taken


def test_a_disk_that_does_not_answer_ends_neither_the_run_nor_the_close(
    tmp_path: Path, stuck: StuckDisk
) -> None:
    writer = BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0, clock=stuck)
    writer.open()
    assert writer.put_message(strings(["a"])[0])
    stats = writer.close(timeout=0.05)
    assert "the disk did not answer within 0.05 s" in (stats.error or "")
    assert (stats.recorded, stats.lost) == ({}, {"/talk": 1})
    assert (stats.state, stats.memory_bytes) == (RecorderState.FAILED, 0)
    stuck.answers.set()
    late = writer.close()  # the disk answers after all, and changes no word
    assert (late.state, late.error, late.lost) == (stats.state, stats.error, stats.lost)


def test_a_bag_deleted_while_recording_is_reported(tmp_path: Path) -> None:
    with (  # noqa: PT012  the end of the block raises
        pytest.raises(RecorderError, match="the file was deleted"),
        BagWriter(tmp_path / "bag", [talk()], {}, flush_period=0.02) as writer,
    ):
        writer.put_message(strings(["a"])[0])
        shutil.rmtree(tmp_path / "bag")
        until(lambda: writer.stats().state is RecorderState.FAILED)
        assert not writer.put_message(strings(["b"])[0])
        assert (writer.stats().lost, writer.stats().file_bytes) == ({"/talk": 2}, 0)


def test_what_does_not_fit_the_bag_is_lost_and_counted(tmp_path: Path) -> None:
    good = strings(["good"])[0]
    odd = [
        replace(good, topic="/unknown"),
        replace(good, type="std_msgs/msg/Bool"),
        replace(good, receive_ns=-1),
        replace(good, publish_ns=MAX_NS),
    ]
    with (
        pytest.raises(RecorderError, match="messages are not in the bag: /talk 3, /unknown 1"),
        BagWriter(tmp_path / "bag", [talk()], {}) as writer,
    ):
        assert [writer.put_message(message) for message in (*odd, good)] == [False] * 4 + [True]
    assert list(Bag(tmp_path / "bag").messages()) == [good]


def test_it_records_from_when_the_bag_is_on_disk_until_it_is_closed(tmp_path: Path) -> None:
    record, early = {"madrob_run": {"n": "1"}}, strings(["too early or late"])[0]
    writer = BagWriter(tmp_path / "bag", [talk()], record)
    assert (writer.stats().state, writer.put_message(early)) == (RecorderState.CLOSED, False)
    writer.open()
    assert writer.stats().state is RecorderState.RECORDING
    assert {path.name for path in (tmp_path / "bag").iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    unfinished = Bag(tmp_path / "bag")
    assert (unfinished.records, unfinished.complete) == (record, False)
    writer.close()
    assert not writer.put_message(early)
    assert not writer.add_topic(BLOB)
    assert writer.stats().lost == {"/talk": 2}
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
        assert writer.put_all(messages[1:]) == len(messages) - 1
    read = Bag(tmp_path / "bag")
    assert (list(read.messages()), read.complete) == (messages, True)
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [c.topic for c, _, _ in reader.messages()] == [m.topic for m in messages]


@pytest.mark.parametrize(
    ("folder", "topics", "words"),
    [
        ("there", [talk()], r"there exists already; move it away or record under"),
        ("link", [talk()], "exists already"),  # none is followed
        ("missing/bag", [talk()], r"cannot record to .*; choose a folder"),
        ("there/metadata.yaml/bag", [talk()], r"cannot record to .*; choose a folder"),
        ("bag", [talk(), Topic("/talk", "std_msgs/msg/Bool", "")], "/talk is both"),
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


@pytest.mark.parametrize(
    ("what", "most", "words"),
    [
        (resource.RLIMIT_NOFILE, 3, "cannot record to .*: Too many open files"),
        (resource.RLIMIT_FSIZE, 100, "cannot record to .*: File too large"),
    ],
)
def test_a_recording_that_cannot_begin_leaves_nothing(
    tmp_path: Path, what: int, most: int, words: str
) -> None:
    with limited(what, most), pytest.raises(RecorderError, match=words):
        BagWriter(tmp_path / "bag", [talk()], {"madrob_run": {"n": "x" * 100}}).open()
    assert list(tmp_path.iterdir()) == []


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
TOPICS = tuple(Topic(f"/t{number}", BLOB.type, BLOB.definition) for number in range(3))
MESSAGES = st.builds(
    RawMessage,
    topic=st.sampled_from([topic.name for topic in TOPICS]),
    type=st.just(BLOB.type),
    data=st.binary(max_size=300),
    publish_ns=TIMES,
    receive_ns=TIMES,
)


@settings(max_examples=25)
@given(st.lists(MESSAGES, max_size=40), st.integers(min_value=512, max_value=20_000))
def test_bytes_and_times_survive_in_order_and_only_what_is_too_large_is_lost(
    messages: list[RawMessage], memory_bytes: int
) -> None:
    # as they are received: a machine that is slow flushes between any two of them
    messages = sorted(messages, key=lambda message: message.receive_ns)
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "bag"
        writer = BagWriter(folder, TOPICS, {}, memory_bytes=memory_bytes, block_when_full=True)
        writer.open()
        kept = [message for message in messages if writer.put_message(message)]
        stats, read = writer.close(), Bag(folder)
        assert (list(read.messages()), read.complete, read.topics()) == (kept, True, TOPICS)
        assert sum(stats.recorded.values()) == len(kept)
        assert sum(stats.lost.values()) == len(messages) - len(kept)
        assert all(m in kept or len(m.data) + 256 > memory_bytes for m in messages)
        with AnyReader([folder]) as reader:
            assert (reader.message_count, len(reader.connections)) == (len(kept), len(TOPICS))


NEVER = {"sec": 9223372036, "nsec": 854775807}
PLAIN_QOS = {
    "history": "unknown",
    "depth": 0,
    "reliability": "best_effort",
    "durability": "volatile",
    "deadline": NEVER,
    "lifespan": NEVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": NEVER,
    "avoid_ros_namespace_conventions": False,
}


def test_metadata_yaml_has_every_key_of_version_9_and_the_file_says_the_same(
    tmp_path: Path,
) -> None:
    messages, file = door_messages(rounds=10), tmp_path / "run" / "run_0.mcap"
    with BagWriter(tmp_path / "run", door_topics(), {"madrob_run": {"setup": "{}"}}) as writer:
        writer.put_all(messages)
    text = (tmp_path / "run" / "metadata.yaml").read_text()
    summary, read = by_mcap(BytesIO(file.read_bytes()))
    times = [message.receive_ns for message in messages]
    span = {
        "duration": {"nanoseconds": max(times) - min(times)},
        "starting_time": {"nanoseconds_since_epoch": min(times)},
        "message_count": 60,
    }
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        **span,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": ["run_0.mcap"],
        "files": [{"path": "run_0.mcap", **span}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    topics: list[dict[str, Any]] = [
        {
            "topic_metadata": {
                "name": channel.topic,
                "type": summary.schemas[channel.schema_id].name,
                "serialization_format": channel.message_encoding,
                "offered_qos_profiles": yaml.safe_load(channel.metadata["offered_qos_profiles"]),
                "type_description_hash": channel.metadata["topic_type_hash"],
            },
            "message_count": 10,
        }
        for channel in summary.channels.values()
    ]
    told = {**information, "topics_with_message_count": topics}
    assert yaml.safe_load(text) == {"rosbag2_bagfile_information": told}
    assert not {"&", "*"} & set(text)  # no anchors
    assert [one["topic_metadata"]["name"] for one in topics] == [t.name for t in door_topics()]
    assert topics[0]["topic_metadata"]["offered_qos_profiles"] == [PLAIN_QOS]
    assert topics[0]["topic_metadata"]["type_description_hash"] == door_topics()[0].type_hash
    assert len(read) == 60
    assert all(index.message_index_offsets for index in summary.chunk_indexes)
    records = Bag(tmp_path / "run").records
    assert set(records) == {"madrob_run", "rosbag2"}
    repeated = yaml.safe_load(records["rosbag2"]["serialized_metadata"])
    assert repeated.items() >= information.items()


def test_a_folder_whose_name_is_no_text_can_be_recorded_to(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"run \xff")
    with BagWriter(folder, door_topics(), {}) as writer:
        writer.put_all(door_messages(rounds=1))
    assert len(list(Bag(folder).messages())) == 6


def test_an_empty_bag_starts_at_the_end_of_time() -> None:
    text = BagInformation("a_0.mcap", door_topics(), {}, None, None).metadata_yaml()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["starting_time"] == {"nanoseconds_since_epoch": 2**63 - 1}
    assert information["duration"] == {"nanoseconds": 0}
    assert len(information["topics_with_message_count"]) == 6
