"""What is written is what the library's own writer writes, but for the compression."""

from __future__ import annotations

import io
import random
from collections.abc import Callable, Sequence
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import SeekingReader
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import Writer

from recorder.mcap_writer import CHUNK_BYTES, McapWriter

NOISE = random.Random(0).randbytes(4 * CHUNK_BYTES)
SMALL = 100


class Sample(NamedTuple):
    """A message; `flush` says whether the chunk ends behind it."""

    channel: int
    time: int
    data: bytes
    flush: bool = False


def ours(samples: Sequence[Sample], channels: int = 3) -> bytes:
    file = io.BytesIO()
    writer = McapWriter(file.write)
    writer.start("ros2", "test")
    _register(writer.register_schema, writer.register_channel, channels)
    for sample in samples:
        writer.add_message(sample.channel, sample.time, sample.data, sample.time + 1)
        if sample.flush:
            writer.flush()
    writer.add_metadata("setup", {"team": "Türen"})
    writer.finish()
    return file.getvalue()


def library(samples: Sequence[Sample], channels: int = 3) -> bytes:
    file, numbers = io.BytesIO(), dict.fromkeys(range(1, channels + 1), 0)
    writer = Writer(file, chunk_size=CHUNK_BYTES)
    writer.start("ros2", "test")
    _register(writer.register_schema, writer.register_channel, channels)
    for channel, time, data, flush in samples:
        numbers[channel] += 1
        writer.add_message(channel, time, data, time + 1, numbers[channel])
        if flush:
            writer.flush()  # type: ignore[no-untyped-call]
    writer.flush()  # type: ignore[no-untyped-call]
    writer.add_metadata("setup", {"team": "Türen"})
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


def _register(
    schema: Callable[[str, str, bytes], int],
    channel: Callable[[str, str, int, dict[str, str]], int],
    channels: int,
) -> None:
    number = schema("std_msgs/msg/String", "ros2msg", b"string data\n")
    for place in range(channels):
        channel(f"/topic_{place}", "cdr", number, {"offered_qos_profiles": ""})


def read(file: bytes) -> tuple[Summary, list[object]]:
    """The summary, and all messages by time, found by their indexes."""
    reader = SeekingReader(io.BytesIO(file), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    return summary, [(s, c, m) for s, c, m in reader.iter_messages()]


def compressions(file: bytes) -> list[str]:
    return [index.compression for index in read(file)[0].chunk_indexes]


def _outline(index: ChunkIndex) -> tuple[object, ...]:
    return (
        index.message_start_time,
        index.message_end_time,
        index.uncompressed_size,
        set(index.message_index_offsets),
        index.message_index_length,
    )


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
    got, wanted = read(ours(samples)), read(library(samples))
    assert got[1] == wanted[1]
    assert got[0].statistics == wanted[0].statistics
    assert got[0].schemas == wanted[0].schemas
    assert got[0].channels == wanted[0].channels
    assert [_outline(i) for i in got[0].chunk_indexes] == [
        _outline(i) for i in wanted[0].chunk_indexes
    ]
    assert [i.name for i in got[0].metadata_indexes] == ["setup"]


@given(samples_strategy)
def test_the_records_stand_in_the_order_in_which_the_mcap_library_has_them(
    samples: list[Sample],
) -> None:
    got = [
        type(record).__name__
        for record in StreamReader(io.BytesIO(ours(samples)), validate_crcs=True).records
    ]
    wanted = [
        type(record).__name__
        for record in StreamReader(io.BytesIO(library(samples)), validate_crcs=True).records
    ]
    assert got[: got.index("DataEnd") + 1] == wanted[: wanted.index("DataEnd") + 1]
    assert got[-1] == wanted[-1] == "Footer"


def test_pictures_that_are_compressed_already_are_stored_as_they_are() -> None:
    pictures = [Sample(1, n, NOISE[n * 200_000 : (n + 1) * 200_000]) for n in range(8)]
    file = ours(pictures)
    assert set(compressions(file)) == {""}
    assert len(file) < 8 * 200_000 + 5_000
    head = bytes(2_000)
    alike = [Sample(1, n, head + NOISE[n * 200_000 : (n + 1) * 200_000]) for n in range(8)]
    assert set(compressions(ours(alike))) == {""}
    few = ours([Sample(1, n, NOISE[n * 2_000 : (n + 1) * 2_000]) for n in range(20)])
    assert set(compressions(few)) == {""}


def test_what_can_be_made_smaller_is_even_where_a_picture_is_among_it() -> None:
    poses = [Sample(2, n, bytes(SMALL)) for n in range(5_000)]
    picture = Sample(1, 0, NOISE[:100_000])
    file = ours([*poses[:1_000], picture, *poses[1_000:]])
    assert set(compressions(file)) == {"zstd"}
    assert len(file) < 250_000  # half of it are the indexes
    assert set(compressions(ours(poses[:10]))) == {"zstd"}


def test_a_disk_that_refuses_is_told_and_what_was_written_counts() -> None:
    room = 3 * CHUNK_BYTES

    def write(data: bytes) -> None:
        nonlocal room
        room -= len(data)
        if room < 0:
            raise OSError(28, "No space left on device")

    writer = McapWriter(write)
    writer.start("ros2", "test")
    _register(writer.register_schema, writer.register_channel, 1)
    for number in range(16):  # two chunks of eight
        writer.add_message(1, number, NOISE[number * 100_000 :][:100_000], number)
    with pytest.raises(OSError, match="No space"):
        writer.add_message(1, 16, NOISE, 16)
    assert writer.statistics.message_count == writer.statistics.channel_message_counts[1] == 16
    assert writer.statistics.message_end_time == 15
