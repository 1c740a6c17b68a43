"""Whatever lies in a bag folder: an answer or a `RecorderError`, soon, and nothing elsewhere."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.records import (
    Channel,
    Chunk,
    Message,
    Schema,
)
from mcap.writer import MCAP0_MAGIC, CompressionType
from msgspec.structs import replace as replaced

from recorder import RecorderError, reader
from recorder.bag import BagInformation, RawMessage
from recorder.reader import Bag
from recorder.recovery import Recovered, recover
from tests.recorder.samples import (
    BEST_EFFORT,
    START_NS,
    by_library,
    encoded,
    little_memory,
    record_starts,
    strings,
    talk,
)

EXAMPLES = 40
LONGEST = 20.0
"""Seconds of the processor for one input; the usual ones take hundredths."""

MESSAGES = strings([f"number {number} " + "text " * (number % 7) for number in range(40)])
MAY_BE_THERE = {"bag_0.mcap", "bag_0.mcap.torn", "metadata.yaml", "metadata.yaml.torn"}

SIZES = st.one_of(
    st.sampled_from([0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1]),
    st.integers(0, 2**64 - 1),
)
PLACES = st.floats(0, 1, exclude_max=True)
CHANGES = st.one_of(
    st.tuples(st.just("flip"), PLACES, st.integers(0, 7)),
    st.tuples(st.just("cut"), PLACES, st.just(0)),
    st.tuples(st.just("insert"), PLACES, st.binary(min_size=1, max_size=40)),
    st.tuples(st.just("remove"), PLACES, st.integers(1, 200)),
    st.tuples(st.just("repeat"), PLACES, st.integers(1, 200)),
    st.tuples(st.just("zeros"), PLACES, st.integers(1, 2000)),
    st.tuples(st.just("claim 4"), PLACES, SIZES),
    st.tuples(st.just("claim 8"), PLACES, SIZES),
    st.tuples(st.just("length"), PLACES, SIZES),
)
METADATA = st.one_of(
    st.none(),
    st.just("stale"),
    st.text(max_size=200),
    st.sampled_from(
        [
            "rosbag2_bagfile_information: {relative_file_paths: [../outside.mcap]}",
            "rosbag2_bagfile_information: {relative_file_paths: [/etc/passwd, bag_0.mcap]}",
            "rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap, bag_0.mcap]}",
            "rosbag2_bagfile_information: {relative_file_paths: [!!int '']}",
            "rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap], message_count: {}}",
            "!!timestamp x",
            "!!python/object/apply:os.system ['touch outside.mcap']",
            "&a [*a, *a]",
            "[" * 600,
        ]
    ),
)


@cache
def whole_files() -> tuple[bytes, ...]:
    """Small recordings of every kind: what a checksum guards is reached in those without."""
    return (
        recording(compression=CompressionType.ZSTD),
        recording(compression=CompressionType.ZSTD, enable_crcs=False),
        recording(compression=CompressionType.LZ4, enable_crcs=False),
        recording(compression=CompressionType.NONE, enable_crcs=False),
        recording(use_chunking=False, enable_crcs=False),
    )


def recording(**options: Any) -> bytes:  # noqa: ANN401
    return by_library(MESSAGES, [replace(talk(), qos=BEST_EFFORT)], chunk_size=800, **options)


def changed(content: bytes, changes: Sequence[tuple[str, float, object]]) -> bytes:
    for how, where, what in changes:
        place = int(where * len(content))
        if how == "length" and (starts := record_starts(content)):
            place = starts[int(where * len(starts))] + 1
        content = content[:place] + put_in(how, what, content[place:])
    return content


def put_in(how: str, what: object, rest: bytes) -> bytes:
    """What a change makes of everything behind its place."""
    match how, what:
        case "flip", int(bit) if rest:
            return bytes([rest[0] ^ 1 << bit]) + rest[1:]
        case "insert", bytes(more):
            return more + rest
        case "remove", int(count):
            return rest[count:]
        case "repeat", int(count):
            return rest[:count] + rest
        case "zeros", int(count):
            return bytes(count) + rest[count:]
        case "claim 4", int(size):
            return (size & 0xFFFF_FFFF).to_bytes(4, "little") + rest[4:]
        case "claim 8" | "length", int(size):
            return size.to_bytes(8, "little") + rest[8:]
    return b""  # a cut


def check(place: Path, content: bytes, metadata: str | None) -> None:
    """Read and repair it; the same messages before and after, nothing outside the folder."""
    folder = place / "bag"
    shutil.rmtree(place, ignore_errors=True)
    folder.mkdir(parents=True)
    (place / "outside.mcap").write_bytes(b"precious")
    (folder / "bag_0.mcap").write_bytes(content)
    if metadata is not None:
        started = BagInformation("bag_0.mcap", [talk()], {}, None, None).metadata_yaml()
        (folder / "metadata.yaml").write_text(started if metadata == "stale" else metadata)
    began = time.process_time()
    before = messages(folder)
    look_up(folder / "bag_0.mcap", before or [], only_cut=whole_start(content))
    recovered = repaired(folder)
    if recovered is not None:
        after = messages(folder)
        assert after is not None
        assert recovered.messages == len(after)
        assert after == before or (before is None and recovered.changed)
        again = repaired(folder)
        assert again is not None
        assert not again.changed
        if recovered.torn is not None:
            assert recovered.torn.read_bytes() == content
    else:
        assert (folder / "bag_0.mcap").read_bytes() == content
    assert time.process_time() - began < LONGEST
    assert {path.name for path in folder.iterdir()} <= MAY_BE_THERE
    assert sorted(path.name for path in place.iterdir()) == ["bag", "outside.mcap"]
    assert (place / "outside.mcap").read_bytes() == b"precious"


def whole_start(content: bytes) -> bool:
    return any(whole.startswith(content) for whole in whole_files()[:1])


def look_up(path: Path, read: list[RawMessage], *, only_cut: bool) -> None:
    """A message that is read of a file that was only cut is also found by its time."""
    try:
        bag = Bag(path)
    except RecorderError:
        return
    instants = [(message.topic, message.receive_ns) for message in read]
    for name, at_ns in [*instants, *(("/talk", at_ns) for at_ns in (0, START_NS, 2**64))]:
        nearest = bag.nearest(name, at_ns, 2**64)
        assert not only_cut or (name, at_ns) not in instants or nearest in read
    assert bag.problem is None or bag.problem.isprintable()


def messages(folder: Path) -> list[RawMessage] | None:
    try:
        bag = Bag(folder)
    except RecorderError as error:
        told: str | None = str(error)
        found = None
    else:
        found = list(bag.messages())
        told = bag.problem
    assert told is None or told.isprintable()
    return found


def repaired(folder: Path) -> Recovered | None:
    recovered = None
    try:
        recovered = recover(folder)
        told = recovered.cut
    except RecorderError as error:
        told = (str(error),)
    assert all(text.isprintable() for text in told)
    return recovered


def fuzz(place: Path, examples: int) -> None:
    """Half of the examples are real recordings, changed; the other half is anything."""
    some = settings(max_examples=max(1, examples // 2), suppress_health_check=list(HealthCheck))

    @some
    @given(st.integers(0, 4), st.lists(CHANGES, min_size=1, max_size=4), METADATA)
    def change(kind: int, changes: list[tuple[str, float, object]], metadata: str | None) -> None:
        check(place, changed(whole_files()[kind], changes), metadata)

    @some
    @given(st.sampled_from([b"", MCAP0_MAGIC]), st.binary(max_size=400), METADATA)
    def invent(start: bytes, content: bytes, metadata: str | None) -> None:
        check(place, start + content, metadata)

    change()
    invent()


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (0, [("remove", 0.5, 3), ("remove", 0.5, 200), ("flip", 0.0195, 0)]),  # a chunk lies
        (4, [("flip", 0.59, 0), ("flip", 0.0313, 0)]),  # a channel is told at the end only
    ],
)
def test_messages_come_by_their_times_before_and_after_a_repair(
    kind: int, changes: list[tuple[str, float, object]], tmp_path: Path
) -> None:
    check(tmp_path / "place", changed(whole_files()[kind], changes), None)


def test_no_file_can_break_reader_or_repair(tmp_path: Path) -> None:
    fuzz(tmp_path / "place", EXAMPLES)


@pytest.mark.slow
def test_no_file_of_many_can_break_reader_or_repair(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """With `--runs 1000` ten thousand inputs."""
    fuzz(tmp_path / "place", 10 * request.config.getoption("--runs"))


def framed(opcode: int, body: bytes, length: int | None = None) -> bytes:
    size = len(body) if length is None else length
    return bytes([opcode]) + size.to_bytes(8, "little") + body


SCHEMA = Schema(1, talk().definition.encode(), "ros2msg", talk().type)
CHANNEL = Channel(1, "/talk", "cdr", {}, 1)
MESSAGE = Message(1, 5, b"data", 4, 0)
GOOD = encoded(SCHEMA, CHANNEL, MESSAGE)
ZEROS = bytes(50_000_000)
"""Packed, they are a few kB."""

TWO_GB = (2**31 - 1).to_bytes(4, "little")


@pytest.mark.parametrize(
    "content",
    [
        framed(0x05, b"x", 2**31),
        framed(0x06, b"x", 2**31),
        framed(0x03, b"\x02\x00" + TWO_GB + b"name"),
        framed(0x03, b"\x02\x00" + bytes(8) + TWO_GB + b"text"),
        framed(0x04, b"\x02\x00\x01\x00" + TWO_GB + b"topic"),
        framed(0x0C, b"\x01\x00\x00\x00a" + TWO_GB + b"text"),
        framed(0x05, b"short"),
        encoded(Chunk("", b"x" * 10, 0, 0, 0, 2**31)),
        encoded(Chunk("", b"x" * 10, 0, 0, 0, 2**26)),
        encoded(Chunk("zstd", zstandard.compress(ZEROS), 0, 0, 0, 1000)),
        encoded(Chunk("lz4", lz4.frame.compress(ZEROS), 0, 0, 0, 1000)),
        encoded(Chunk("zstd", zstandard.compress(b"x"), 0, 0, 0, 2**60)),
        encoded(Chunk("", bytes(100), 0, 0, 0, 100)),
        encoded(Chunk("", framed(0x05, b"short"), 0, 0, 0, 14)),
        framed(0x06, bytes(28) + TWO_GB + b"zstd"),
        framed(0x06, bytes(32) + (2**40).to_bytes(8, "little") + b"x"),
    ],
)
def test_a_claim_is_no_reason_to_take_memory(tmp_path: Path, content: bytes) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes(MCAP0_MAGIC + GOOD + content)
    with little_memory():
        assert len(list(Bag(folder).messages())) == 1
        recovered = recover(folder)
    assert recovered.messages == 1
    assert recovered.cut[0].startswith(("a chunk ", "a record ", "the record at ", "it is torn"))


def test_messages_without_data_take_memory_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "HELD_LIMIT", 10_000)
    path = tmp_path / "many.mcap"
    empty = [replaced(message, data=b"") for message in MESSAGES[::-1] * 10]
    path.write_bytes(by_library(empty, chunk_size=1))
    bag = Bag(path)
    assert len(list(bag.messages())) < 50
    assert "too large to be put in the order of its times" in (bag.problem or "")


def test_words_from_a_file_cannot_steer_a_terminal(tmp_path: Path) -> None:
    path = tmp_path / "evil.mcap"
    evil = Channel(1, "/\x1b]0;owned\x07\n" + "x" * 5000, "json", {}, 1)
    path.write_bytes(MCAP0_MAGIC + encoded(SCHEMA, evil, MESSAGE))
    with pytest.raises(RecorderError, match="owned") as caught:
        recover(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
