"""Bags of any writer, torn bags and no bags at all."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Sequence
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import (
    Channel,
    Chunk,
    Message,
    Schema,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType
from msgspec.structs import replace
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from recorder import RecorderError
from recorder.bag import (
    BAG_INFORMATION,
    Batch,
    Durability,
    Qos,
    RawMessage,
    Reliability,
    Topic,
    parse_qos,
    qos_text,
)
from recorder.reader import Bag
from recorder.writer import BagWriter
from tests.recorder.samples import (
    BEST_EFFORT,
    LATCHED,
    START_NS,
    by_library,
    encoded,
    record_starts,
    strings,
    talk,
    topic,
    typestore,
    written,
)

MESSAGES = strings([f"number {number}" for number in range(60)])
at = attrgetter("receive_ns")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording of three chunks and a record in its middle."""
    path = tmp_path_factory.mktemp("bags") / "bag_0.mcap"
    batches = [Batch([talk()], records={"madrob_run": {"n": "1"}})]
    for start, end in pairwise([0, 10, 30, 50]):
        record = {f"note {end}": {"text": "x" * 50}}
        batches.append(Batch(messages=MESSAGES[start:end], records=record))
    written(path, [*batches, Batch(messages=MESSAGES[50:])])
    return path.read_bytes()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a test may put one file after the other."""
    return tmp_path_factory.mktemp("damaged") / "damaged.mcap"


def opened(place: Path, content: bytes) -> Bag:
    place.write_bytes(content)
    return Bag(place)


TOPICS = [topic("/a", "std_msgs/msg/String"), topic("/b", "std_msgs/msg/Bool", LATCHED), talk()]
TIMES = st.one_of(st.integers(START_NS, START_NS + 20), st.just(0), st.integers(0, 2**62))
"""A simulated clock begins at 0: so may a chunk, which then looks like one without messages."""
ANY_MESSAGE = st.builds(
    lambda topic, data, receive_ns, publish_ns: RawMessage(
        topic.name, topic.type, data, publish_ns, receive_ns
    ),
    st.sampled_from(TOPICS[:2]),
    st.binary(max_size=40),
    TIMES,
    TIMES,
)


def of_recorder(folder: Path, messages: Sequence[RawMessage]) -> None:
    with BagWriter(folder, TOPICS, {}) as writer:
        for message in messages:
            assert writer.put_message(message)


def of_rosbags(
    folder: Path, messages: Sequence[RawMessage], mode: CompressionMode = CompressionMode.NONE
) -> None:
    writer = RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.type, typestore=typestore())
            for topic in TOPICS
        }
        for message in messages:
            writer.write(connections[message.topic], message.receive_ns, message.data)


def of_library(**options: Any) -> Callable[[Path, Sequence[RawMessage]], None]:  # noqa: ANN401
    def write(folder: Path, messages: Sequence[RawMessage]) -> None:
        folder.mkdir()
        (folder / "a_0.mcap").write_bytes(by_library(messages, TOPICS, **options))

    return write


WRITERS: dict[str, Callable[[Path, Sequence[RawMessage]], None]] = {
    "recorder": of_recorder,
    "rosbags": of_rosbags,
    "rosbags, packed": lambda folder, messages: of_rosbags(
        folder, messages, CompressionMode.STORAGE
    ),
    "each message a chunk": of_library(chunk_size=1),
    "small chunks": of_library(chunk_size=100),
    "lz4": of_library(chunk_size=100, compression=CompressionType.LZ4),
    "without checksums": of_library(
        chunk_size=100, compression=CompressionType.NONE, enable_crcs=False
    ),
    "without chunks": of_library(use_chunking=False),
    "without statistics": of_library(chunk_size=100, use_statistics=False),
    "nothing repeated": of_library(repeat_channels=False, repeat_schemas=False),
    "without indexes": of_library(chunk_size=100, index_types=IndexType.NONE),
    "indexes of chunks": of_library(chunk_size=100, index_types=IndexType.CHUNK),
    "checksum of the data": of_library(enable_data_crcs=True),
}


def chunk_starts(file: Path) -> list[int]:
    """First log times of the chunks of a file, of its first message without any; by mcap."""
    with file.open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    chunks = [r.message_start_time for r in records if isinstance(r, Chunk) and has_messages(r)]
    return chunks or [r.log_time for r in records if isinstance(r, Message)]


def has_messages(chunk: Chunk) -> bool:
    return any(isinstance(record, Message) for record in breakup_chunk(chunk))


def placed(
    folder: Path,
    writer: str,
    files: Sequence[Sequence[RawMessage]],
    order: random.Random | None = None,
) -> list[tuple[Path, Sequence[RawMessage]]]:
    """A bag of files by a writer, and what each holds, as `metadata.yaml` lists them."""
    folder.mkdir()
    listed: list[tuple[Path, Sequence[RawMessage]]] = []
    for number, messages in enumerate(files):
        WRITERS[writer](folder / "part", messages)
        (part,) = (folder / "part").glob("*.mcap")
        listed.append((part.rename(folder / f"bag_{number}.mcap"), messages))
        shutil.rmtree(folder / "part")
    if order is not None:
        order.shuffle(listed)
    names = [f"bag/{part.name}" for part, _ in listed]  # early versions put the folder before it
    information = {"storage_identifier": "mcap", "relative_file_paths": names}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({BAG_INFORMATION: information}))
    return listed


def check_nearest(bag: Bag, messages: Sequence[RawMessage], at_ns: int, within_ns: int) -> None:
    """The nearest message is the one that looking at all of them finds."""
    for name in ("/a", "/b", "/talk"):
        nearest = bag.nearest(name, at_ns, within_ns)
        distances = [abs(m.receive_ns - at_ns) for m in messages if m.topic == name]
        distance = min(distances, default=2**63)
        assert (nearest is None) is (distance > within_ns)
        if nearest is not None:
            assert replace(nearest, sequence=0) in messages
            assert abs(nearest.receive_ns - at_ns) == distance


@settings(max_examples=60, deadline=None)
@given(
    writer=st.sampled_from(sorted(WRITERS)),
    files=st.lists(st.lists(ANY_MESSAGE, max_size=15), min_size=1, max_size=3),
    in_order=st.booleans(),
    order=st.randoms(use_true_random=False),
    instants=st.lists(st.tuples(TIMES, st.integers(0, 2**62)), max_size=5),
)
def test_a_recording_is_read_in_the_order_of_its_times(
    writer: str,
    files: list[list[RawMessage]],
    in_order: bool,
    order: random.Random,
    instants: list[tuple[int, int]],
) -> None:
    """Whoever wrote it, in however many files, listed in any order."""
    if in_order:
        run = sorted((message for part in files for message in part), key=at)
        ends = sorted(order.choices(range(len(run) + 1), k=len(files) - 1))
        files = [run[begin:end] for begin, end in pairwise([0, *ends, len(run)])]
    if writer == "without chunks" and len(files) > 1:
        files = [sorted(part, key=at) for part in files]
    if writer.startswith("rosbags"):
        files = [[replace(m, publish_ns=m.receive_ns) for m in part] for part in files]
    with TemporaryDirectory() as parent:
        folder = Path(parent) / "bag"
        listed = placed(folder, writer, files, order)
        for at_ns, within_ns in instants:
            check_nearest(Bag(folder), [m for part in files for m in part], at_ns, within_ns)
        listed.sort(key=lambda file: min(chunk_starts(file[0]), default=0))
        expected = [message for _, messages in listed for message in messages]
        starts = [start for part, _ in listed for start in chunk_starts(part)]
        if starts != sorted(starts):
            expected.sort(key=at)
        bag = Bag(folder)
        assert [replace(message, sequence=0) for message in bag.messages()] == expected
        assert bag.problem is None
        described = {(t.name, t.type, t.definition) for t in bag.topics()}
        expected_topics = {(t.name, t.type, t.definition) for t in TOPICS}
        assert described == expected_topics or (not expected and not described)


def test_a_flipped_bit_never_passes_for_a_message_and_is_never_silent(
    finished: bytes, place: Path
) -> None:
    """Anywhere, and where a record says of which kind it is."""
    somewhere = random.Random(0)
    flips = [(start, bit) for start in record_starts(finished) for bit in range(8)]
    flips += [(somewhere.randrange(8, len(finished)), somewhere.randrange(8)) for _ in range(100)]
    for position, bit in flips:
        damaged = bytearray(finished)
        damaged[position] ^= 1 << bit
        try:
            bag = opened(place, bytes(damaged))
        except RecorderError as error:
            assert "\n" not in str(error)  # noqa: PT017 - it may, but need not, be refused
            continue
        rest, messages = iter(MESSAGES), list(bag.messages())
        assert all(message in rest for message in messages), (position, bit)
        assert messages == MESSAGES or not bag.complete, (position, bit)


def test_a_message_without_a_channel_ends_the_reading(place: Path, finished: bytes) -> None:
    records = encoded(
        Schema(1, b"string data\n", "ros2msg", "std_msgs/msg/String"),
        Channel(1, "/talk", "cdr", {}, 1),
        Message(1, 5, b"data", 4, 0),
        Message(3, 6, b"data", 4, 0),
    )
    bag = opened(place, finished[:8] + records)
    assert [topic.name for topic in bag.topics()] == ["/talk"]
    assert list(bag.messages()) == [RawMessage("/talk", "std_msgs/msg/String", b"data", 4, 5)]
    assert not bag.complete


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_bags_compressed_by_rosbag2_itself_are_refused(
    tmp_path: Path, mode: CompressionMode
) -> None:
    of_rosbags(tmp_path / "bag", [], mode)
    with pytest.raises(RecorderError, match=r"is compressed by .*; unpack it by `ros2"):
        Bag(tmp_path / "bag")


TWICE = b"rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap, bag_0.mcap]}"


@pytest.mark.parametrize(
    ("name", "content", "count", "problem"),
    [
        ("bag_0.mcap", "as it is", 60, None),  # in the order of its files
        *(
            ("metadata.yaml", text, 60, "metadata.yaml")  # they are found but not taken as all
            for text in (
                None,
                b"",
                b"[",
                b"rosbag2_bagfile_information: 3",
                b"a: b",
                b"\x00",
                TWICE,
            )
        ),
        *(("bag_1.mcap", content, 5, "bag_1.mcap") for content in (None, b"", b"not mcap")),
    ],
)
def test_a_split_bag_is_read_up_to_its_first_bad_file(
    tmp_path: Path, name: str, content: bytes | str | None, count: int, problem: str | None
) -> None:
    parts = [MESSAGES[start : start + 5] for start in range(0, 60, 5)]
    placed(tmp_path / "bag", "recorder", parts)
    changed = tmp_path / "bag" / name
    if content is None:
        changed.unlink()
    elif isinstance(content, bytes):
        changed.write_bytes(content)
    bag = Bag(tmp_path / "bag")
    assert list(bag.messages()) == MESSAGES[:count]
    assert bag.complete is (problem is None)
    assert (problem or "") in (bag.problem or "")


def test_qos_and_type_hash_of_other_recordings_are_kept(tmp_path: Path) -> None:
    profiles = "- reliability: 2\n  durability: 1\n"
    metadata = {"offered_qos_profiles": profiles, "topic_type_hash": "RIHS01_ab"}
    schema = Schema(1, b"module std_msgs", "ros2idl", talk().type)  # a definition of another kind
    records = encoded(schema, Channel(1, "/old", "cdr", metadata, 1))
    (topic,) = opened(tmp_path / "old.mcap", MCAP0_MAGIC + records).topics()
    qos = Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL)
    assert topic == Topic("/old", talk().type, "", "RIHS01_ab", qos)


def test_to_find_one_message_a_small_part_of_the_file_is_read(place: Path) -> None:
    messages = strings(["x" * 20_000] * 500)
    place.write_bytes(by_library(messages, chunk_size=100_000, compression=CompressionType.NONE))

    def read() -> int:
        return int(Path("/proc/self/io").read_text().split()[1])

    before = read()
    assert Bag(place).nearest("/talk", messages[250].receive_ns, 0) == messages[250]
    assert read() - before < place.stat().st_size / 20


@pytest.mark.parametrize("index_types", [IndexType.ALL, IndexType.CHUNK])
def test_a_chunk_at_time_0_is_not_taken_for_an_empty_one(
    place: Path, index_types: IndexType
) -> None:
    """A simulated clock that is set back leaves one behind the others."""
    messages = [*MESSAGES[:3], replace(MESSAGES[3], receive_ns=0)]
    place.write_bytes(by_library(messages, chunk_size=1, index_types=index_types))
    bag = Bag(place)
    assert bag.nearest("/talk", 0, 0) == messages[3]
    assert list(bag.messages()) == [messages[3], *MESSAGES[:3]]


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        (
            "- reliability: 2\n  durability: 1\n",
            Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL),
        ),
        ("- reliability: 1\n  durability: 2\n", Qos()),
        *((qos_text(qos), qos) for qos in (Qos(), BEST_EFFORT, LATCHED)),
        ("[{reliability: reliable}, {reliability: best_effort}]", BEST_EFFORT),
        ("[{durability: transient_local}, {durability: volatile}]", Qos()),
        ("", Qos()),
        ("[", Qos()),
        ("a: b", Qos()),
        ("[1, 2]", Qos()),
        ("[" * 600, Qos()),
        ('!!int ""', Qos()),
        ("!!timestamp x", Qos()),
    ],
)
def test_qos_of_older_recordings_and_of_several_publishers(text: str, qos: Qos) -> None:
    assert parse_qos(text) == qos


@given(st.text())
def test_no_qos_text_can_break_the_reader(text: str) -> None:
    assert isinstance(parse_qos(text), Qos)
